//! Reference twin.

use crate::ops::Real;

/// Intersection and union.
fn sums<T: Real>(alpha: &[T], mask: &[T]) -> (T, T) {
    let pairs = || alpha.iter().zip(mask);
    (pairs().map(|(a, s)| *a * *s).sum(), pairs().map(|(a, s)| *a + *s - *a * *s).sum())
}

/// `1 − I/U` of two images `[H, W]`; zero where both are empty.
pub fn forward<T: Real>(alpha: &[T], mask: &[T]) -> T {
    let (intersection, union) = sums(alpha, mask);
    if union > T::zero() { T::one() - intersection / union } else { T::zero() }
}

/// Adds to `grad_alpha`.
pub fn backward<T: Real>(alpha: &[T], mask: &[T], lambda: T, grad_alpha: &mut [T]) {
    let (intersection, union) = sums(alpha, mask);
    if union <= T::zero() {
        return;
    }
    for (grad, &s) in grad_alpha.iter_mut().zip(mask) {
        *grad += lambda * (intersection * (T::one() - s) - union * s) / (union * union);
    }
}
