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
//! `1 + λ deg_i`, for eigenvalues in `[low, high]` ([`Spectrum`]). The residual of a part of the field with such an
//! eigenvalue is after k rounds at most `2 ((√κ − 1) / (√κ + 1))ᵏ` of the first, with `κ = high / low`. Ended early, when
//! that is small or the rounds are used up, P is still symmetric and positive definite: all directions that it gives descend.

pub mod cpu;
mod gpu;

pub use gpu::LargeSteps;

/// Rounds of a solve, at most.
pub const ROUNDS: usize = 32;
/// A solve ends when its residual is at most this part of the first. A gradient need not be spread more exactly: what is left
/// makes P another one, nearly as smooth.
const TOLERANCE: f64 = 0.05;

/// Where the eigenvalues of the scaled matrix `D^{-1/2} (I + λL) D^{-1/2}` lie, D the diagonal.
#[derive(Clone, Copy, Debug)]
pub struct Spectrum {
    low: f64,
    high: f64,
}

impl Spectrum {
    /// Rounds of the power iteration, and what is added to its result: it ends below the largest eigenvalue, and above that
    /// one the polynomial would not be bounded.
    const POWER_ROUNDS: usize = 40;
    const MARGIN: f64 = 1.05;

    /// Of the adjacency in compressed rows.
    ///
    /// `high` by power iteration, at most `1 + ρ`, which Gershgorin allows (`ρ = λd / (1 + λd)` with the largest degree d).
    /// `low` is the Rayleigh quotient of the field that is the same everywhere, which L does not see: the least eigenvalue
    /// lies a little below, where a vertex has more neighbours than most; fields there are spread a little less, no more.
    pub fn new(starts: &[u32], neighbours: &[u32], lambda: f64) -> Self {
        let n = starts.len() - 1;
        let row = |i: usize| &neighbours[starts[i] as usize..starts[i + 1] as usize];
        let diagonal: Vec<f64> = (0..n).map(|i| 1.0 + lambda * row(i).len() as f64).collect();
        let low = n as f64 / diagonal.iter().sum::<f64>();
        let rho = diagonal.iter().map(|d| 1.0 - 1.0 / d).fold(0.0, f64::max);
        // Neighbours with opposite signs come nearest to the largest eigenvalue; any start that is not smooth will do.
        let mut x: Vec<f64> = (0..n).map(|i| (i as f64 * 2.399).sin()).collect();
        let mut largest = 1.0;
        for _ in 0..Self::POWER_ROUNDS {
            let scaled: Vec<f64> = x.iter().zip(&diagonal).map(|(x, d)| x / d.sqrt()).collect();
            let around = |i: usize| row(i).iter().map(|&j| scaled[j as usize]).sum::<f64>();
            let next: Vec<f64> = (0..n).map(|i| x[i] - lambda * around(i) / diagonal[i].sqrt()).collect();
            let norm = |x: &[f64]| x.iter().map(|x| x * x).sum::<f64>().sqrt();
            let length = norm(&next).max(1e-300);
            largest = length / norm(&x).max(1e-300);
            x = next.iter().map(|y| y / length).collect();
        }
        Self { low, high: (Self::MARGIN * largest).clamp(low, 1.0 + rho) }
    }

    /// The rounds that [`TOLERANCE`] takes, up to [`ROUNDS`].
    fn rounds(self) -> usize {
        let root = (self.high / self.low).sqrt();
        let shrink = (root - 1.0) / (root + 1.0);
        let fits = |k: &usize| 2.0 * shrink.powi(*k as i32) <= TOLERANCE;
        (2..ROUNDS).find(fits).unwrap_or(ROUNDS)
    }

    /// The factors `(momentum, gain)` of `rounds` Chebyshev steps.
    fn chebyshev(self, rounds: usize) -> Vec<(f64, f64)> {
        let middle = 0.5 * (self.high + self.low);
        // Without edges the scaled matrix is the identity, and one step is all.
        let half = (0.5 * (self.high - self.low)).max(1e-9);
        let sigma = middle / half;
        let mut last = 1.0 / sigma;
        let mut factors = vec![(0.0, 1.0 / middle)];
        while factors.len() < rounds {
            let next = 1.0 / (2.0 * sigma - last);
            factors.push((next * last, 2.0 * next / half));
            last = next;
        }
        factors
    }
}

#[cfg(test)]
mod tests;
