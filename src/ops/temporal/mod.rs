//! Smooth motion: a penalty on accelerations of per-frame parameters.
//!
//! | buffer | shape | role |
//! |---|---|---|
//! | `values` | `[N, K]` | one row a frame, in the order of time |
//! | `expected` | `[N, K]` | accelerations that cost nothing |
//! | `spacing` | `[N, 2]` | β and α of each frame, see [`spacing`] |
//! | `grads` | `[N, K]` | `backward` adds `λ ∂L/∂values` |
//!
//! `L = Σ_i Σ_k ((a_ik − e_ik) / scale)²` over the inner frames and the numbers from `first` on, `a_i = α_i (x_{i+1} − x_i) −
//! β_i (x_i − x_{i−1})`, which is `x_{i+1} − 2 x_i + x_{i−1}` where frames follow each other evenly.
//! Where a number changes by more than `max_change` from one frame to the next, `a = e`: axis-angle vectors jump at half
//! turns, and a gap in the clip is no motion. One camera sees depth badly, and a frame alone would place the person a few
//! centimetres too near or too far; its neighbours know better.

pub mod cpu;
mod gpu;

pub use gpu::Temporal;
pub(super) use gpu::upload_spacing;

/// The constants of the penalty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TemporalConfig {
    /// Numbers a frame.
    pub stride: usize,
    /// The numbers before this one are left alone.
    pub first: usize,
    /// The acceleration that costs 1, in units of the values a frame², the mean time from frame to frame taken for 1.
    pub scale: f64,
    /// The largest change between frames that is motion.
    pub max_change: f64,
}

/// What is given beside the values: accelerations that are expected, and the frames' spacing.
#[derive(Clone, Copy)]
pub struct Given<'a, T> {
    /// `[N, K]`, of a rotation `[N, 3]`
    pub expected: &'a [T],
    /// `[N, 2]`
    pub spacing: &'a [[f64; 2]],
}

/// What the changes before and after each frame are multiplied with in its acceleration, of frames at `times [N]`: the second
/// divided difference, times two, in units of the mean time from frame to frame. Zeros in the first and the last frame, and where
/// a neighbour is not earlier and later: several pictures of one moment tell of no motion.
///
/// Kept frames do not lie evenly: of 60 frames 40 are every one or two apart, and a steady turn would be taken for a jerky one.
pub fn spacing(times: &[f64]) -> Vec<[f64; 2]> {
    let mut spacing = vec![[0.0; 2]; times.len()];
    let [first, .., last] = times else { return spacing };
    let mean = (last - first) / (times.len() - 1) as f64;
    for (factors, t) in spacing[1..].iter_mut().zip(times.windows(3)) {
        let (before, after) = ((t[1] - t[0]) / mean, (t[2] - t[1]) / mean);
        if before > 0.0 && after > 0.0 {
            *factors = [before, after].map(|gap| 2.0 / (gap * (before + after)));
        }
    }
    spacing
}

#[cfg(test)]
mod tests;
