//! Unnormalised face normals, which the losses on a mesh's geometry share: they add to one `grad_normals`, and one
//! backward pass takes it to the vertices.
//!
//! `normals_f = (v1 − v0) × (v2 − v0)`: outward where faces run counter-clockwise, twice the face's area long.
//!
//! | buffer | shape | role |
//! |---|---|---|
//! | `vertices`, `grad_vertices` | `[V, 3]` | |
//! | `normals`, `grad_normals` | `[F, 3]` | the caller clears `grad_normals` before the losses' backward passes |
//!
//! A vertex gathers from its corners in a fixed order, without atomics.

pub mod cpu;
mod gpu;

pub use gpu::FaceNormals;

/// A face whose normal is not longer has no area: its direction counts as zero and feels no gradient.
pub const DEGENERATE: f64 = 1e-12;

#[cfg(test)]
mod tests;
