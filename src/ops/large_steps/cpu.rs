//! Reference twin.

use super::Spectrum;
use crate::ops::Real;

/// `P · right_side`. `starts [V + 1]` and `neighbours` are the adjacency in compressed rows.
pub fn solve<T: Real>(starts: &[u32], neighbours: &[u32], right_side: &[T], lambda: f64, rounds: usize) -> Vec<T> {
    let mut x = vec![T::zero(); right_side.len()];
    let mut moves = x.clone();
    for (momentum, gain) in Spectrum::new(starts, neighbours, lambda).chebyshev(rounds) {
        let from = x.clone();
        for i in 0..starts.len() - 1 {
            let row = &neighbours[starts[i] as usize..starts[i + 1] as usize];
            let diagonal = T::of(1.0 + lambda * row.len() as f64);
            for axis in 0..3 {
                let k = 3 * i + axis;
                let mut around = T::zero();
                for &j in row {
                    around += from[3 * j as usize + axis];
                }
                let residual = (right_side[k] + T::of(lambda) * around) / diagonal - from[k];
                moves[k] = T::of(momentum) * moves[k] + T::of(gain) * residual;
                x[k] = from[k] + moves[k];
            }
        }
    }
    x
}
