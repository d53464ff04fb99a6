//! Reference twin.

use crate::ops::Real;

/// One step. `starts [V + 1]` and `neighbours` are the adjacency in compressed rows.
pub fn step<T: Real>(starts: &[u32], neighbours: &[u32], values: &[T]) -> Vec<T> {
    let row = |i: usize| starts[i] as usize..starts[i + 1] as usize;
    let mut moved = values.to_vec();
    for i in 0..starts.len() - 1 {
        for &j in &neighbours[row(i)] {
            let j = j as usize;
            let weight = T::of(0.5) / T::of(row(i).len().max(row(j).len()) as f64);
            for axis in 0..3 {
                moved[3 * i + axis] += weight * (values[3 * j + axis] - values[3 * i + axis]);
            }
        }
    }
    moved
}
