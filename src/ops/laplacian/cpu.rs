//! Reference twin.

use crate::ops::linear::{Vector, accumulate, add, dot, scale, sub};
use crate::ops::{Real, Rows};

/// The loss and the residuals `[V]`.
pub fn forward<T: Real>(neighbours: &Rows, offsets: &[Vector<T>]) -> (T, Vec<Vector<T>>) {
    let residual = |(row, &own): (&[u32], &Vector<T>)| {
        let zero = [T::zero(); 3];
        let sum = row.iter().fold(zero, |sum, &n| add(sum, offsets[n as usize]));
        if row.is_empty() { zero } else { sub(own, scale(T::one() / T::of(row.len() as f64), sum)) }
    };
    let residuals: Vec<Vector<T>> = neighbours.iter().zip(offsets).map(residual).collect();
    (residuals.iter().map(|&r| dot(r, r)).sum(), residuals)
}

/// Adds λ times the gradient to `grad_offsets`.
pub fn backward<T: Real>(neighbours: &Rows, residuals: &[Vector<T>], weight: T, grad_offsets: &mut [Vector<T>]) {
    for (v, row) in neighbours.iter().enumerate() {
        let mut grad = residuals[v];
        for &n in row {
            let degree = T::of(neighbours.row(n as usize).len() as f64);
            grad = sub(grad, scale(T::one() / degree, residuals[n as usize]));
        }
        accumulate(&mut grad_offsets[v], scale(T::of(2.0) * weight, grad));
    }
}
