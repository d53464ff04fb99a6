//! Host side of `shaders/large_steps/`.

use std::sync::Arc;

use super::Spectrum;
use crate::gpu::{AnyBuffer, Buffer, Gpu, Kernel, Recorder, linear_groups};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    n_vertices: u32,
    lambda: f32,
    momentum: f32,
    gain: f32,
}

/// The solver of one mesh.
pub struct LargeSteps {
    iterate: Arc<Kernel>,
    starts: Buffer<u32>,
    neighbours: Buffer<u32>,
    /// Every other round's result.
    other: Buffer<f32>,
    moves: Buffer<f32>,
    lambda: f64,
    factors: Vec<(f64, f64)>,
}

impl LargeSteps {
    /// `starts [V + 1]` and `neighbours` are the adjacency in compressed rows.
    pub fn new(gpu: &Gpu, starts: &[u32], neighbours: &[u32], lambda: f64) -> Self {
        let len = 3 * (starts.len() - 1);
        let spectrum = Spectrum::new(starts, neighbours, lambda);
        Self {
            iterate: gpu.kernel("large_steps/iterate", include_str!("../../../shaders/large_steps/iterate.wgsl"), &[]),
            starts: gpu.upload("large_steps/starts", starts),
            neighbours: gpu.upload("large_steps/neighbours", neighbours),
            other: gpu.zeros("large_steps/other", len),
            moves: gpu.zeros("large_steps/moves", len),
            lambda,
            factors: spectrum.chebyshev(spectrum.rounds()),
        }
    }

    /// Records `x = P · right_side`, both `[V, 3]`.
    ///
    /// # Panics
    /// When a length differs.
    pub fn solve(&self, recorder: &mut Recorder<'_>, right_side: &Buffer<f32>, x: &Buffer<f32>) {
        let len = self.other.len();
        assert!(right_side.len() == len && x.len() == len, "{}: length", x.label());
        debug_assert!(self.factors.len().is_multiple_of(2), "the last round writes x");
        recorder.clear(x);
        recorder.clear(&self.moves);
        let groups = linear_groups(len / 3, 64);
        let (mut from, mut to) = (x, &self.other);
        for &(momentum, gain) in &self.factors {
            let params = Params {
                n_vertices: (len / 3) as u32,
                lambda: self.lambda as f32,
                momentum: momentum as f32,
                gain: gain as f32,
            };
            let buffers: [&dyn AnyBuffer; 6] = [&self.starts, &self.neighbours, right_side, from, &self.moves, to];
            recorder.dispatch(&self.iterate, &params, &buffers, groups);
            (from, to) = (to, from);
        }
    }
}
