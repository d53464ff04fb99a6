//! Smooth motion: a penalty on accelerations of per-frame parameters.
//!
//! | buffer | shape | role |
//! |---|---|---|
//! | `values` | `[N, K]` | one row a frame, in the order of time |
//! | `expected` | `[N, K]` | accelerations that cost nothing |
//! | `grads` | `[N, K]` | `backward` adds `λ ∂L/∂values` |
//!
//! `L = Σ_i Σ_k ((a_ik − e_ik) / scale)²` over the inner frames and the numbers from `first` on, `a_i = x_{i+1} − 2 x_i + x_{i−1}`.
//! Where a number changes by more than `max_change` from one frame to the next, `a = e`: axis-angle vectors jump at half
//! turns, and a gap in the clip is no motion. One camera sees depth badly, and a frame alone would place the person a few
//! centimetres too near or too far; its neighbours know better.

pub mod cpu;
mod gpu;

pub use gpu::Temporal;

/// The constants of the penalty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TemporalConfig {
    /// Numbers a frame.
    pub stride: usize,
    /// The numbers before this one are left alone.
    pub first: usize,
    /// The acceleration that costs 1, in units of the values a frame².
    pub scale: f64,
    /// The largest change between frames that is motion.
    pub max_change: f64,
}

#[cfg(test)]
mod tests;
