//! Reference twin.

use super::factors;
use crate::ops::Real;

/// `(I + λL)⁻¹ right_side`, `[N, P, 3]`; `linked [N, P]`.
pub fn solve<T: Real>(linked: &[bool], per_frame: usize, lambda: f64, right_side: &[T]) -> Vec<T> {
    let factors = factors(linked, per_frame, lambda);
    let stride = 3 * per_frame;
    let mut x = right_side.to_vec();
    for k in stride..x.len() {
        let ratio = T::of(factors[(k - stride) / 3][1]);
        let before = x[k - stride];
        x[k] += ratio * before;
    }
    for k in (0..x.len()).rev() {
        let [inverse, ratio] = factors[k / 3].map(T::of);
        let after = if k + stride < x.len() { ratio * x[k + stride] } else { T::zero() };
        x[k] = inverse * x[k] + after;
    }
    x
}
