//! Host side of `shaders/laplacian/`.

use std::sync::Arc;

use crate::gpu::{Buffer, Gpu, Kernel, Recorder, linear_groups};
use crate::ops::reduce::{LossSlot, Sum};
use crate::ops::{Rows, Topology};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    n_vertices: u32,
    weight: f32,
}

/// Which vertices share edges, on the device, and the residuals.
pub struct Laplacian {
    forward: Arc<Kernel>,
    backward: Arc<Kernel>,
    sum: Sum,
    n_vertices: usize,
    starts: Buffer<u32>,
    neighbours: Buffer<u32>,
    residuals: Buffer<f32>,
    values: Buffer<f32>,
}

impl Laplacian {
    pub fn new(gpu: &Gpu, topology: &Topology) -> Self {
        let Rows { starts, items } = &topology.neighbours;
        let n_vertices = topology.neighbours.len();
        Self {
            forward: kernel!(gpu, "laplacian/forward"),
            backward: kernel!(gpu, "laplacian/backward"),
            sum: Sum::new(gpu),
            n_vertices,
            starts: gpu.upload("laplacian/starts", starts),
            neighbours: gpu.upload("laplacian/neighbours", items),
            residuals: gpu.zeros("laplacian/residuals", 3 * n_vertices),
            values: gpu.zeros("laplacian/values", n_vertices),
        }
    }

    /// Records the loss of `offsets [V, 3]` and keeps the residuals.
    pub fn forward(&self, recorder: &mut Recorder<'_>, offsets: &Buffer<f32>, loss: LossSlot<'_>) {
        assert!(offsets.len() == 3 * self.n_vertices, "{}: length", offsets.label());
        recorder.dispatch(
            &self.forward,
            &Params { n_vertices: self.n_vertices as u32, weight: 0.0 },
            &[&self.starts, &self.neighbours, offsets, &self.residuals, &self.values],
            linear_groups(self.n_vertices, 64),
        );
        self.sum.add(recorder, &self.values, self.n_vertices, loss);
    }

    /// Records the gradient of what `forward` saw, times `weight`, into `grad_offsets [V, 3]`.
    pub fn backward(&self, recorder: &mut Recorder<'_>, weight: f32, grad_offsets: &Buffer<f32>) {
        assert!(grad_offsets.len() == 3 * self.n_vertices, "{}: length", grad_offsets.label());
        recorder.dispatch(
            &self.backward,
            &Params { n_vertices: self.n_vertices as u32, weight },
            &[&self.starts, &self.neighbours, &self.residuals, grad_offsets],
            linear_groups(self.n_vertices, 64),
        );
    }
}
