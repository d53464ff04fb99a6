//! Diffusion of a vertex field over the mesh, as a preconditioner: descending along the diffused gradient moves the
//! mesh smoothly and keeps it from tangling, which the plain gradient of a silhouette does not (cf. Nicolet et al.
//! 2021, who solve `(I + λL)` instead).
//!
//! | buffer | shape | role |
//! |---|---|---|
//! | `values` | `[V, 3]` | replaced by `Sᵏ · values` |
//!
//! `(S x)_i = x_i + Σ_{j∈N(i)} w_ij (x_j − x_i)` with `w_ij = ½ / max(deg_i, deg_j)`. The weights are symmetric and a
//! row sums to at most ½, so S is symmetric, keeps constants and has its eigenvalues in [0, 1]: `Sᵏ g` is always a
//! descent direction, and S is its own adjoint. k steps spread a value over about √k edges.

pub mod cpu;
mod gpu;

pub use gpu::Diffuse;

#[cfg(test)]
mod tests;
