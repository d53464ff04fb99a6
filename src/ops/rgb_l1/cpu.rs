//! Reference twin; `weights` has one value a pixel.

use crate::ops::Real;

fn weight<T: Real>(weights: Option<&[T]>, i: usize) -> T {
    weights.map_or(T::one(), |w| w[i / 3])
}

/// The weighted sum of absolute differences of two images `[H, W, 3]`.
pub fn forward<T: Real>(image: &[T], target: &[T], weights: Option<&[T]>) -> T {
    let off = image.iter().zip(target).map(|(a, b)| (*a - *b).abs());
    off.enumerate().map(|(i, off)| weight(weights, i) * off).sum()
}

/// Adds to `grad_image`.
pub fn backward<T: Real>(image: &[T], target: &[T], weights: Option<&[T]>, lambda: T, grad_image: &mut [T]) {
    for (i, grad) in grad_image.iter_mut().enumerate() {
        let off = image[i] - target[i];
        if off != T::zero() {
            *grad += lambda * weight(weights, i) * off.signum();
        }
    }
}
