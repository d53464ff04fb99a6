//! Adam (Kingma & Ba 2015) over one parameter group.
//!
//! | buffer | shape | role |
//! |---|---|---|
//! | `params` | `[N]` | read and written |
//! | `grads` | `[N]` | read; the caller clears it before the next backward pass |
//! | `exp_avg`, `exp_avg_sq` | `[N]` | state, zero at the start |
//!
//! `m ← β₁m + (1−β₁)g`, `v ← β₂v + (1−β₂)g²`, `p ← p − lr · m̂ / (√v̂ + ε)` with `m̂ = m/(1−β₁ᵗ)`, `v̂ = v/(1−β₂ᵗ)`.
//! A step may cover a part of the buffers (`offset`, `len`): a frame's pose moves only in the steps that saw the frame,
//! and counts its own `t`.
//!
//! **Uniform Adam** ([`UniformAdam`], Nicolet et al. 2021) is for vertex fields `[V, 3]`: its second moment is one number,
//! the running mean of the largest |gᵢ|² over the vertices. Adam's own would scale the gradients of hardly seen vertices up
//! to those of well seen ones, and a smooth gradient would not stay smooth.

pub mod cpu;
mod gpu;
mod uniform;

pub use gpu::Adam;
pub use uniform::UniformAdam;

/// The constants of a group.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct AdamConfig {
    pub beta1: f64,
    pub beta2: f64,
    pub eps: f64,
}

impl Default for AdamConfig {
    fn default() -> Self {
        Self { beta1: 0.9, beta2: 0.999, eps: 1e-8 }
    }
}

#[cfg(test)]
mod tests;
