//! Host side of `shaders/face_normals/`.

use std::sync::Arc;

use crate::gpu::{Buffer, Gpu, Kernel, Recorder, linear_groups};
use crate::ops::Topology;

/// The faces of a mesh on the device.
pub struct FaceNormals {
    forward: Arc<Kernel>,
    backward: Arc<Kernel>,
    n_faces: usize,
    n_vertices: usize,
    faces: Buffer<u32>,
    corner_starts: Buffer<u32>,
    corners: Buffer<u32>,
}

impl FaceNormals {
    /// `topology` is that of `faces`.
    pub fn new(gpu: &Gpu, faces: &[[u32; 3]], topology: &Topology) -> Self {
        Self {
            forward: kernel!(gpu, "face_normals/forward"),
            backward: kernel!(gpu, "face_normals/backward"),
            n_faces: faces.len(),
            n_vertices: topology.corners.len(),
            faces: gpu.upload("face_normals/faces", faces.as_flattened()),
            corner_starts: gpu.upload("face_normals/corner_starts", &topology.corners.starts),
            corners: gpu.upload("face_normals/corners", &topology.corners.items),
        }
    }

    /// A buffer for `normals` or `grad_normals`.
    pub fn normals(&self, gpu: &Gpu, label: &str) -> Buffer<f32> {
        gpu.zeros(label, 3 * self.n_faces)
    }

    /// Records `vertices [V, 3]` to `normals [F, 3]`.
    ///
    /// # Panics
    /// When a length is wrong.
    pub fn forward(&self, recorder: &mut Recorder<'_>, vertices: &Buffer<f32>, normals: &Buffer<f32>) {
        self.check(vertices, normals);
        recorder.dispatch(
            &self.forward,
            &(self.n_faces as u32),
            &[&self.faces, vertices, normals],
            linear_groups(self.n_faces, 64),
        );
    }

    /// Records the gather: adds to `grad_vertices [V, 3]`.
    ///
    /// # Panics
    /// When a length is wrong.
    pub fn backward(
        &self,
        recorder: &mut Recorder<'_>,
        vertices: &Buffer<f32>,
        grad_normals: &Buffer<f32>,
        grad_vertices: &Buffer<f32>,
    ) {
        self.check(vertices, grad_normals);
        self.check(grad_vertices, grad_normals);
        recorder.dispatch(
            &self.backward,
            &(self.n_vertices as u32),
            &[&self.faces, &self.corner_starts, &self.corners, vertices, grad_normals, grad_vertices],
            linear_groups(self.n_vertices, 64),
        );
    }

    fn check(&self, vertices: &Buffer<f32>, normals: &Buffer<f32>) {
        assert!(vertices.len() == 3 * self.n_vertices, "{}: length", vertices.label());
        assert!(normals.len() == 3 * self.n_faces, "{}: length", normals.label());
    }
}
