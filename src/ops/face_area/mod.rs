//! Face area, the paper's L_FA: `Σ (A/A′ + A′/A)` over faces, A on the deformed and A′ on the undeformed T-pose mesh.
//!
//! It works on [`face_normals`](crate::ops::face_normals) of both meshes, because `A/A′ = |n|/|n′|`; A′ is a constant of
//! the step:
//!
//! | buffer | shape | role |
//! |---|---|---|
//! | `normals` | `[F, 3]` | unnormalised, of M_D (`v_deformed`) |
//! | `rest_normals` | `[F, 3]` | unnormalised, of `v_shaped` |
//! | `grad_normals` | `[F, 3]` | `+= λ (1 − 1/r²) n̂ / |n′|`, `r = A/A′` |
//!
//! Below [`RATIO_MIN`] the cost of a face goes on as a straight line, so that a collapsed face stays finite. A face whose
//! `|n′|` is not above `least_rest` does not count: one without area has no ratio, and a tiny one has a gradient that grows as
//! it shrinks.

pub mod cpu;
mod gpu;

pub use gpu::FaceArea;

/// The least A/A′ at which the formula itself holds.
pub const RATIO_MIN: f64 = 1e-3;

#[cfg(test)]
mod tests;
