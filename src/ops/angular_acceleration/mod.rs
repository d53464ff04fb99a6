//! Steady turning: a penalty on accelerations of per-frame rotations.
//!
//! | buffer | shape | role |
//! |---|---|---|
//! | `values` | `[N, K]` | one row a frame, in the order of time; the first three numbers are a rotation vector (radians) |
//! | `expected` | `[N, 3]` | accelerations that cost nothing, in the body's own axes |
//! | `spacing` | `[N, 2]` | β and α of each frame, see [`temporal::spacing`](super::temporal::spacing) |
//! | `grads` | `[N, K]` | `backward` adds `λ ∂L/∂values` to the first three numbers of each row |
//!
//! `L = Σ_i |(α_i s_i − β_i s_{i−1} − e_i) / scale|²` over the inner frames, `s_i` the turn from frame i to the next in the body's own
//! axes: of `Q = R_iᵀ R_{i+1}` the vector `½ (Q₂₁ − Q₁₂, Q₀₂ − Q₂₀, Q₁₀ − Q₀₁)`, which points along Q's axis and is the sine
//! of its angle long. A turn of more than `max_turn` is a gap in the clip, and what meets there costs nothing.
//!
//! [`temporal`](super::temporal) would not do for a body that turns: the rotation vectors of somebody upright before a
//! camera whose y runs down follow half a circle of radius π, so a steady turn has accelerations, and where the clip begins
//! and ends nothing holds against them. Its first and last frames would lean.

pub mod cpu;
mod gpu;

pub use super::temporal::Given;
pub use gpu::AngularAcceleration;

/// The constants of the penalty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AngularAccelerationConfig {
    /// Numbers a frame, three or more.
    pub stride: usize,
    /// The acceleration that costs 1, radians a frame², the mean time from frame to frame taken for 1.
    pub scale: f64,
    /// The largest turn between frames that is motion, radians, below a quarter turn.
    pub max_turn: f64,
}

#[cfg(test)]
mod tests;
