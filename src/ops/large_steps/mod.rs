//! Large steps (Nicolet et al. 2021): a vertex field is optimised in coordinates u in which a step moves the mesh
//! smoothly, `offsets = start + P u` with `P ≈ (I + λL)⁻¹`. L is the mesh's uniform Laplacian, `(L x)_i = Σ_{j∈N(i)}
//! (x_i − x_j)`. The gradient of u is `P ∇`, since P is symmetric.
//!
//! | buffer | shape | role |
//! |---|---|---|
//! | `right_side` | `[V, 3]` | read |
//! | `x` | `[V, 3]` | overwritten with `P · right_side` |
//!
//! P is a polynomial of fixed degree: Chebyshev's iteration from zero on the equations scaled by their diagonal
//! `1 + λ deg_i`. By Gershgorin the scaled matrix has its eigenvalues in `[1 − ρ, 1 + ρ]` with `ρ = λd / (1 + λd)` and d the
//! largest degree, so that the residual after k rounds is at most `2 ((√κ − 1) / (√κ + 1))ᵏ` of the first, with
//! `κ = (1 + ρ) / (1 − ρ)`. Ended early, when that is small or the rounds are used up, P is still symmetric and positive
//! definite: all directions that it gives descend.

pub mod cpu;
mod gpu;

pub use gpu::LargeSteps;

/// Rounds of a solve, at most.
pub const ROUNDS: usize = 32;
/// A solve ends when its residual is at most this part of the first.
const TOLERANCE: f64 = 1e-3;

/// The rounds that [`TOLERANCE`] takes for eigenvalues in `[1 − rho, 1 + rho]`: an even number up to [`ROUNDS`].
fn rounds(rho: f64) -> usize {
    let root = ((1.0 + rho) / (1.0 - rho)).sqrt();
    let shrink = (root - 1.0) / (root + 1.0);
    let fits = |k: &usize| 2.0 * shrink.powi(*k as i32) <= TOLERANCE;
    (2..ROUNDS).step_by(2).find(fits).unwrap_or(ROUNDS)
}

/// The factors `(momentum, gain)` of `rounds` Chebyshev steps for eigenvalues in `[1 − rho, 1 + rho]`.
fn chebyshev(rho: f64, rounds: usize) -> Vec<(f64, f64)> {
    // Without edges the scaled matrix is the identity, and one step is all.
    let delta = rho.max(1e-9);
    let sigma = 1.0 / delta;
    let mut last = delta;
    let mut factors = vec![(0.0, 1.0)];
    while factors.len() < rounds {
        let next = 1.0 / (2.0 * sigma - last);
        factors.push((next * last, 2.0 * next / delta));
        last = next;
    }
    factors
}

/// ρ of the contract.
fn radius(starts: &[u32], lambda: f64) -> f64 {
    let degree = starts.windows(2).map(|w| w[1] - w[0]).max().unwrap_or(0);
    let weight = lambda * f64::from(degree);
    weight / (1.0 + weight)
}

#[cfg(test)]
mod tests;
