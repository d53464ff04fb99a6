//! Reference twin.

use crate::ops::Real;
use crate::ops::face_normals::cpu::unit_or_zero;
use crate::ops::linear::{Vector, accumulate, dot, scale, sub};

/// The loss over `face_pairs`.
pub fn forward<T: Real>(face_pairs: &[[u32; 2]], normals: &[Vector<T>]) -> T {
    let unit = |f: u32| unit_or_zero(normals[f as usize]).0;
    face_pairs.iter().map(|&[f, g]| T::one() - dot(unit(f), unit(g))).sum()
}

/// Adds λ times the gradient to `grad_normals`.
pub fn backward<T: Real>(face_pairs: &[[u32; 2]], normals: &[Vector<T>], weight: T, grad_normals: &mut [Vector<T>]) {
    for &[f, g] in face_pairs {
        for (own, other) in [(f, g), (g, f)] {
            let (unit, norm) = unit_or_zero(normals[own as usize]);
            let (across, _) = unit_or_zero(normals[other as usize]);
            if norm > T::zero() {
                let turn = sub(scale(dot(across, unit), unit), across);
                accumulate(&mut grad_normals[own as usize], scale(weight / norm, turn));
            }
        }
    }
}
