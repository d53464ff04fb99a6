//! Host side of `shaders/large_steps/`.

use std::sync::Arc;

use super::Spectrum;
use crate::gpu::{AnyBuffer, Buffer, Gpu, Kernel, Recorder, linear_groups};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Begin {
    n_vertices: u32,
    lambda: f32,
    gain: f32,
}

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    n_vertices: u32,
    lambda: f32,
    momentum: f32,
    gain: f32,
}

/// The solver of one mesh. Its rounds work on `[V, 4]`, of which the last column is zero: a vertex is then one access, not three.
pub struct LargeSteps {
    begin: Arc<Kernel>,
    iterate: Arc<Kernel>,
    end: Arc<Kernel>,
    starts: Buffer<u32>,
    neighbours: Buffer<u32>,
    right_side: Buffer<f32>,
    /// The last two rounds' results by turns; their difference is the last move.
    rounds: [Buffer<f32>; 2],
    lambda: f32,
    factors: Vec<(f64, f64)>,
}

impl LargeSteps {
    /// `starts [V + 1]` and `neighbours` are the adjacency in compressed rows.
    pub fn new(gpu: &Gpu, starts: &[u32], neighbours: &[u32], lambda: f64) -> Self {
        let padded = |name: &str| gpu.zeros(&format!("large_steps/{name}"), 4 * (starts.len() - 1));
        let spectrum = Spectrum::new(starts, neighbours, lambda);
        Self {
            begin: kernel!(gpu, "large_steps/begin"),
            iterate: kernel!(gpu, "large_steps/iterate"),
            end: kernel!(gpu, "large_steps/end"),
            starts: gpu.upload("large_steps/starts", starts),
            neighbours: gpu.upload("large_steps/neighbours", neighbours),
            right_side: padded("right_side"),
            rounds: [padded("round_0"), padded("round_1")],
            lambda: lambda as f32,
            factors: spectrum.chebyshev(spectrum.rounds()),
        }
    }

    /// Records `x = P · right_side`, both `[V, 3]`.
    ///
    /// # Panics
    /// When a length differs.
    pub fn solve(&self, recorder: &mut Recorder<'_>, right_side: &Buffer<f32>, x: &Buffer<f32>) {
        let n = self.starts.len() - 1;
        assert!(right_side.len() == 3 * n && x.len() == 3 * n, "{}: length", x.label());
        let (n_vertices, lambda) = (n as u32, self.lambda);
        let groups = linear_groups(n, 64);
        let [mut other, mut last] = self.rounds.each_ref();
        let gain = self.factors[0].1 as f32;
        let buffers: [&dyn AnyBuffer; 5] = [&self.starts, right_side, &self.right_side, other, last];
        recorder.dispatch(&self.begin, &Begin { n_vertices, lambda, gain }, &buffers, groups);
        for &(momentum, gain) in &self.factors[1..] {
            let params = Params { n_vertices, lambda, momentum: momentum as f32, gain: gain as f32 };
            let buffers: [&dyn AnyBuffer; 5] = [&self.starts, &self.neighbours, &self.right_side, last, other];
            recorder.dispatch(&self.iterate, &params, &buffers, groups);
            (last, other) = (other, last);
        }
        recorder.dispatch(&self.end, &n_vertices, &[last as &dyn AnyBuffer, x], groups);
    }
}
