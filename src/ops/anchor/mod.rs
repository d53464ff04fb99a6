//! A pull back to where parameters started.
//!
//! | buffer | shape | role |
//! |---|---|---|
//! | `values` | `[N, K]` | one row a frame |
//! | `start` | `[N, K]` | where they started |
//! | `grads` | `[N, K]` | `backward` adds `λ ∂L/∂values` |
//!
//! `L = Σ_i Σ_k ((x_ik − start_ik) / scale_k)²`; an infinite scale leaves a number free. Some numbers of a pose are hardly
//! seen (how far a straight limb is twisted, where a shoe ends and a foot turns), and an optimiser that scales each by its own gradient lets them wander.

pub mod cpu;
mod gpu;

pub use gpu::Anchor;

/// The constants of the pull.
#[derive(Clone, Debug, PartialEq)]
pub struct AnchorConfig {
    /// `[K]`: the distance that costs 1, in units of the values.
    pub scales: Vec<f64>,
}

#[cfg(test)]
mod tests;
