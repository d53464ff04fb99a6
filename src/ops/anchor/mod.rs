//! A pull back to where parameters started.
//!
//! | buffer | shape | role |
//! |---|---|---|
//! | `values` | `[N, K]` | one row a frame |
//! | `start` | `[N, K]` | where they started |
//! | `grads` | `[N, K]` | `backward` adds `λ ∂L/∂values` |
//!
//! `L = Σ_i Σ_{k ≥ first} ((x_ik − start_ik) / scale)²`. Some numbers of a pose are hardly seen (how far a straight limb is
//! twisted, where a shoe ends and a foot turns), and an optimiser that scales each by its own gradient lets them wander.

pub mod cpu;
mod gpu;

pub use gpu::Anchor;

/// The constants of the pull.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnchorConfig {
    /// Numbers a frame.
    pub stride: usize,
    /// Leading numbers of a frame that are left free.
    pub first: usize,
    /// The distance that costs 1, in units of the values.
    pub scale: f64,
}

#[cfg(test)]
mod tests;
