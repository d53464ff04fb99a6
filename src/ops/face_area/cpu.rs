//! Reference twin.

use super::RATIO_MIN;
use crate::ops::Real;
use crate::ops::face_normals::cpu::unit_or_zero;
use crate::ops::linear::{Vector, accumulate, scale};

/// `r + 1/r` and its derivative.
fn cost<T: Real>(r: T) -> (T, T) {
    let clamped = r.max(T::of(RATIO_MIN));
    let slope = T::one() - T::one() / (clamped * clamped);
    (clamped + T::one() / clamped + slope * (r - clamped), slope)
}

/// The sum over the faces whose normal at rest is longer than `least_rest`; both `[F]`, not normalised.
pub fn forward<T: Real>(normals: &[Vector<T>], rest_normals: &[Vector<T>], least_rest: T) -> T {
    let pairs = normals.iter().zip(rest_normals).map(|(&n, &rest)| (unit_or_zero(n).1, unit_or_zero(rest).1));
    pairs.filter(|&(_, rest)| rest > least_rest).map(|(norm, rest)| cost(norm / rest).0).sum()
}

/// Adds λ times the gradient to `grad_normals`.
pub fn backward<T: Real>(
    normals: &[Vector<T>],
    rest_normals: &[Vector<T>],
    least_rest: T,
    weight: T,
    grad_normals: &mut [Vector<T>],
) {
    for (f, (&n, &rest)) in normals.iter().zip(rest_normals).enumerate() {
        let ((unit, norm), (_, rest)) = (unit_or_zero(n), unit_or_zero(rest));
        if rest > least_rest {
            accumulate(&mut grad_normals[f], scale(weight * cost(norm / rest).1 / rest, unit));
        }
    }
}
