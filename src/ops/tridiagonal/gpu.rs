//! Host side of `shaders/tridiagonal/`.

use std::sync::Arc;

use super::factors;
use crate::gpu::{Buffer, Gpu, Kernel, Recorder, linear_groups};

/// The solver of one set of chains.
pub struct Tridiagonal {
    kernel: Arc<Kernel>,
    /// `[N, P, 2]`
    factors: Buffer<f32>,
    n_frames: usize,
    per_frame: usize,
}

impl Tridiagonal {
    /// `linked [N, per_frame]`: whether an entry is tied to that of the next frame.
    ///
    /// # Panics
    /// When `linked` has no whole number of frames.
    pub fn new(gpu: &Gpu, linked: &[bool], per_frame: usize, lambda: f64) -> Self {
        assert!(linked.len().is_multiple_of(per_frame), "{} links of {per_frame} a frame", linked.len());
        let factors: Vec<f32> = factors(linked, per_frame, lambda).as_flattened().iter().map(|&x| x as f32).collect();
        Self {
            kernel: kernel!(gpu, "tridiagonal/solve"),
            factors: gpu.upload("tridiagonal/factors", &factors),
            n_frames: linked.len() / per_frame,
            per_frame,
        }
    }

    /// Records `x = (I + λL)⁻¹ right_side`, both `[N, P, 3]`.
    ///
    /// # Panics
    /// When a length differs.
    pub fn solve(&self, recorder: &mut Recorder<'_>, right_side: &Buffer<f32>, x: &Buffer<f32>) {
        let len = 3 * self.n_frames * self.per_frame;
        assert!(right_side.len() == len && x.len() == len, "{}: length", x.label());
        let params = [self.n_frames as u32, self.per_frame as u32, 0, 0];
        recorder.dispatch(&self.kernel, &params, &[&self.factors, right_side, x], linear_groups(3 * self.per_frame, 8));
    }
}
