//! Host side of `shaders/diffuse/step.wgsl`.

use std::sync::Arc;

use crate::gpu::{Buffer, Gpu, Kernel, Recorder, linear_groups};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    n_vertices: u32,
    padding: [u32; 3],
}

/// The adjacency of a mesh on the device.
pub struct Diffuse {
    kernel: Arc<Kernel>,
    starts: Buffer<u32>,
    neighbours: Buffer<u32>,
    other: Buffer<f32>,
    n_vertices: usize,
}

impl Diffuse {
    /// `starts [V + 1]` and `neighbours` are the adjacency in compressed rows.
    pub fn new(gpu: &Gpu, starts: &[u32], neighbours: &[u32]) -> Self {
        let n_vertices = starts.len() - 1;
        Self {
            kernel: gpu.kernel("diffuse/step", include_str!("../../../shaders/diffuse/step.wgsl"), &[]),
            starts: gpu.upload("diffuse/starts", starts),
            neighbours: gpu.upload("diffuse/neighbours", neighbours),
            other: gpu.zeros("diffuse/other", n_vertices * 3),
            n_vertices,
        }
    }

    /// Records `2 · pairs` steps over `values [V, 3]`.
    ///
    /// # Panics
    /// When `values` has another length.
    pub fn apply(&self, recorder: &mut Recorder<'_>, values: &Buffer<f32>, pairs: usize) {
        assert_eq!(values.len(), self.n_vertices * 3, "{}: length", values.label());
        let params = Params { n_vertices: self.n_vertices as u32, padding: [0; 3] };
        let groups = linear_groups(self.n_vertices, 64);
        for _ in 0..pairs {
            let there: [&dyn crate::gpu::AnyBuffer; 4] = [&self.starts, &self.neighbours, values, &self.other];
            recorder.dispatch(&self.kernel, &params, &there, groups);
            let back: [&dyn crate::gpu::AnyBuffer; 4] = [&self.starts, &self.neighbours, &self.other, values];
            recorder.dispatch(&self.kernel, &params, &back, groups);
        }
    }
}
