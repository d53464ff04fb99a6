//! Host side of `shaders/normal_consistency/`.

use std::sync::Arc;

use crate::gpu::{Buffer, Gpu, Kernel, Recorder, linear_groups};
use crate::ops::reduce::{LossSlot, Sum};
use crate::ops::{Rows, Topology};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    n_faces: u32,
    weight: f32,
}

/// Which faces lie across the edges of which, on the device.
pub struct NormalConsistency {
    forward: Arc<Kernel>,
    backward: Arc<Kernel>,
    sum: Sum,
    n_faces: usize,
    starts: Buffer<u32>,
    neighbours: Buffer<u32>,
    values: Buffer<f32>,
}

impl NormalConsistency {
    pub fn new(gpu: &Gpu, topology: &Topology) -> Self {
        let Rows { starts, items } = &topology.face_neighbours;
        let n_faces = topology.face_neighbours.len();
        Self {
            forward: kernel!(gpu, "normal_consistency/forward"),
            backward: kernel!(gpu, "normal_consistency/backward"),
            sum: Sum::new(gpu),
            n_faces,
            starts: gpu.upload("normal_consistency/starts", starts),
            neighbours: gpu.upload("normal_consistency/neighbours", items),
            values: gpu.zeros("normal_consistency/values", n_faces),
        }
    }

    /// Records the loss of `normals [F, 3]`.
    pub fn forward(&self, recorder: &mut Recorder<'_>, normals: &Buffer<f32>, loss: LossSlot<'_>) {
        assert!(normals.len() == 3 * self.n_faces, "{}: length", normals.label());
        recorder.dispatch(
            &self.forward,
            &Params { n_faces: self.n_faces as u32, weight: 0.0 },
            &[&self.starts, &self.neighbours, normals, &self.values],
            linear_groups(self.n_faces, 64),
        );
        self.sum.add(recorder, &self.values, self.n_faces, loss);
    }

    /// Records the gradient, times `weight`, into `grad_normals [F, 3]`.
    pub fn backward(
        &self,
        recorder: &mut Recorder<'_>,
        normals: &Buffer<f32>,
        weight: f32,
        grad_normals: &Buffer<f32>,
    ) {
        assert!(
            normals.len() == 3 * self.n_faces && grad_normals.len() == normals.len(),
            "{}: length",
            normals.label()
        );
        recorder.dispatch(
            &self.backward,
            &Params { n_faces: self.n_faces as u32, weight },
            &[&self.starts, &self.neighbours, normals, grad_normals],
            linear_groups(self.n_faces, 64),
        );
    }
}
