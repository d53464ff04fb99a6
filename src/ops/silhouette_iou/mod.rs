//! The silhouette loss (the paper's L_Sil): `1 − I/U` with `I = Σ ŜS` and `U = Σ (Ŝ + S − ŜS)` over all pixels.
//!
//! | buffer | shape | role |
//! |---|---|---|
//! | `alpha` | `[H, W]` | the rendered coverage Ŝ |
//! | target | [`Target`](crate::ops::Target) | the mask S: a packed pixel's fourth byte, or floats `[H, W]` |
//! | `grad_alpha` | `[H, W]` | `backward` adds `λ (I(1 − S) − US)/U²` |
//!
//! Where nothing is covered on either side (`U = 0`) the loss and its gradient are zero. `backward` uses the sums of the
//! last `forward`.

pub mod cpu;
mod gpu;

pub use gpu::SilhouetteIou;

#[cfg(test)]
mod tests;
