//! `x = (I + λL)⁻¹ b` along chains: entry `p` of frame `i` is tied to entry `p` of frame `i + 1`, where the two are linked. L is
//! the chains' Laplacian. What [`super::large_steps`] does by iteration on a mesh is exact here: the matrix is tridiagonal, and
//! one elimination serves all right sides.
//!
//! | buffer | shape | role |
//! |---|---|---|
//! | `right_side` | `[N, P, 3]` | read |
//! | `x` | `[N, P, 3]` | overwritten |
//!
//! With the pivots `m_i = 1 + λ (l_{i−1} + l_i) − λ² l_{i−1} / m_{i−1}`, where `l_i` is 1 if frame i is linked to the next one and
//! else 0: `y_i = b_i + r_{i−1} y_{i−1}`, `x_i = q_i y_i + r_i x_{i+1}` with `q_i = 1 / m_i` and `r_i = λ l_i / m_i`. The inverse is
//! symmetric, so it is its own backward pass.

pub mod cpu;
mod gpu;

pub use gpu::Tridiagonal;

/// `(q, r)` for each frame and entry, `[N, P]`. `linked [N, P]` says whether an entry is tied to that of the next frame; the
/// last frame's are not looked at.
fn factors(linked: &[bool], per_frame: usize, lambda: f64) -> Vec<[f64; 2]> {
    let n_frames = linked.len() / per_frame;
    let mut factors: Vec<[f64; 2]> = Vec::with_capacity(linked.len());
    for at in 0..n_frames * per_frame {
        let ties = |at: usize| f64::from(linked[at] && at + per_frame < linked.len());
        let before = at.checked_sub(per_frame).map_or(0.0, ties);
        let last_ratio = if before > 0.0 { factors[at - per_frame][1] } else { 0.0 };
        let pivot = 1.0 + lambda * (before + ties(at)) - lambda * before * last_ratio;
        factors.push([1.0 / pivot, lambda * ties(at) / pivot]);
    }
    factors
}

#[cfg(test)]
mod tests;
