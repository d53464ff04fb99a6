//! Normal consistency, the paper's L_NC: `Σ (1 − n̂_f · n̂_g)` over pairs of faces that share an edge, each pair once.
//!
//! It works on [`face_normals`](crate::ops::face_normals) of the T-pose mesh M_D:
//!
//! | buffer | shape | role |
//! |---|---|---|
//! | `normals` | `[F, 3]` | unnormalised |
//! | `grad_normals` | `[F, 3]` | `+= λ (I − n̂n̂ᵀ)(−Σ_g n̂_g) / |n|` |
//!
//! Not differentiable where a face has no area: such a face counts as orthogonal to its neighbours and gets no gradient.

pub mod cpu;
mod gpu;

pub use gpu::NormalConsistency;

#[cfg(test)]
mod tests;
