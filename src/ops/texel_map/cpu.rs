//! Reference twin.

use crate::ops::Real;

/// Where a coordinate lies between the texels of a row or column of `side`: the lower one, the part beyond it, and the
/// derivative of the position.
fn cell<T: Real>(x: T, side: usize) -> (usize, T, T) {
    let last = T::of((side - 1) as f64);
    let position = x * T::of(side as f64) - T::of(0.5);
    let held = if position < T::zero() {
        T::zero()
    } else if position > last {
        last
    } else {
        position
    };
    let lower = (held.f64().floor() as usize).min(side.saturating_sub(2));
    let slope = if position < T::zero() || position > last { T::zero() } else { T::of(side as f64) };
    (lower, held - T::of(lower as f64), slope)
}

/// The four texels of a cell, row after row; at the end of a map of one texel all are the same.
fn corners(i: usize, j: usize, side: usize) -> [usize; 4] {
    let (right, below) = ((i + 1).min(side - 1), (j + 1).min(side - 1));
    [j * side + i, j * side + right, below * side + i, below * side + right]
}

fn weights<T: Real>(a: T, b: T) -> [T; 4] {
    let one = T::one();
    [(one - a) * (one - b), a * (one - b), (one - a) * b, a * b]
}

/// The colour at `coord`, from `texels [S, S, 3]`.
pub fn forward<T: Real>(texels: &[T], side: usize, coord: &[T; 3]) -> [T; 3] {
    let ((i, a, _), (j, b, _)) = (cell(coord[0], side), cell(coord[1], side));
    let (at, w) = (corners(i, j, side), weights(a, b));
    std::array::from_fn(|c| (0..4).map(|k| w[k] * texels[3 * at[k] + c]).sum())
}

/// Adds to `grad_texels [S, S, 3]`; the gradient by the coordinate.
pub fn backward<T: Real>(
    texels: &[T],
    side: usize,
    coord: &[T; 3],
    grad_rgb: &[T; 3],
    grad_texels: &mut [T],
) -> [T; 3] {
    let ((i, a, slope_u), (j, b, slope_v)) = (cell(coord[0], side), cell(coord[1], side));
    let (at, w) = (corners(i, j, side), weights(a, b));
    let one = T::one();
    let (mut grad_u, mut grad_v) = (T::zero(), T::zero());
    for c in 0..3 {
        (0..4).for_each(|k| grad_texels[3 * at[k] + c] += w[k] * grad_rgb[c]);
        let [p, q, r, s] = at.map(|t| texels[3 * t + c]);
        grad_u += grad_rgb[c] * ((one - b) * (q - p) + b * (s - r));
        grad_v += grad_rgb[c] * ((one - a) * (r - p) + a * (s - q));
    }
    [grad_u * slope_u, grad_v * slope_v, T::zero()]
}
