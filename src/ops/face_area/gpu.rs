//! Host side of `shaders/face_area/`.

use std::sync::Arc;

use super::RATIO_MIN;
use crate::gpu::{Buffer, Gpu, Kernel, Recorder, linear_groups};
use crate::ops::reduce::{LossSlot, Sum};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    n_faces: u32,
    ratio_min: f32,
    least_rest: f32,
    weight: f32,
}

/// The loss of a mesh with `n_faces` faces.
pub struct FaceArea {
    forward: Arc<Kernel>,
    backward: Arc<Kernel>,
    sum: Sum,
    n_faces: usize,
    least_rest: f32,
    values: Buffer<f32>,
}

impl FaceArea {
    /// Faces whose undeformed normal is not longer than `least_rest`, twice their area, do not count.
    pub fn new(gpu: &Gpu, n_faces: usize, least_rest: f32) -> Self {
        Self {
            forward: kernel!(gpu, "face_area/forward"),
            backward: kernel!(gpu, "face_area/backward"),
            sum: Sum::new(gpu),
            n_faces,
            // In f32 a collapsed face has a length, too.
            least_rest: least_rest.max(1e-12),
            values: gpu.zeros("face_area/values", n_faces),
        }
    }

    /// Records the loss of `normals [F, 3]` against `rest_normals [F, 3]`.
    pub fn forward(
        &self,
        recorder: &mut Recorder<'_>,
        normals: &Buffer<f32>,
        rest_normals: &Buffer<f32>,
        loss: LossSlot<'_>,
    ) {
        self.check(normals, rest_normals);
        let buffers: [&dyn crate::gpu::AnyBuffer; 3] = [normals, rest_normals, &self.values];
        recorder.dispatch(&self.forward, &self.params(0.0), &buffers, linear_groups(self.n_faces, 64));
        self.sum.add(recorder, &self.values, self.n_faces, loss);
    }

    /// Records the gradient, times `weight`, into `grad_normals [F, 3]`.
    pub fn backward(
        &self,
        recorder: &mut Recorder<'_>,
        normals: &Buffer<f32>,
        rest_normals: &Buffer<f32>,
        weight: f32,
        grad_normals: &Buffer<f32>,
    ) {
        self.check(normals, rest_normals);
        self.check(grad_normals, rest_normals);
        let buffers: [&dyn crate::gpu::AnyBuffer; 3] = [normals, rest_normals, grad_normals];
        recorder.dispatch(&self.backward, &self.params(weight), &buffers, linear_groups(self.n_faces, 64));
    }

    fn params(&self, weight: f32) -> Params {
        Params { n_faces: self.n_faces as u32, ratio_min: RATIO_MIN as f32, least_rest: self.least_rest, weight }
    }

    fn check(&self, normals: &Buffer<f32>, rest_normals: &Buffer<f32>) {
        for normals in [normals, rest_normals] {
            assert!(normals.len() == 3 * self.n_faces, "{}: length", normals.label());
        }
    }
}
