//! From gradients of triangle corners to gradients of vertices, without float atomics: each face writes its own
//! corners, each vertex then sums the corners that meet in it, in a fixed order.

use std::sync::Arc;

use super::Real;
use super::topology::Topology;
use crate::gpu::{Buffer, Gpu, Kernel, Recorder, linear_groups};

/// The faces of a mesh and, for each vertex, its corners (`3·face + k`) as a compressed row.
pub struct Corners {
    /// `[F, 3]`.
    pub faces: Buffer<u32>,
    starts: Buffer<u32>,
    corners: Buffer<u32>,
    n_vertices: usize,
    gather: Arc<Kernel>,
}

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    n_vertices: u32,
}

impl Corners {
    /// `topology` is that of `faces`.
    pub fn new(gpu: &Gpu, faces: &[[u32; 3]], topology: &Topology) -> Self {
        Self {
            faces: gpu.upload("corners/faces", faces.as_flattened()),
            starts: gpu.upload("corners/starts", &topology.corners.starts),
            corners: gpu.upload("corners/corners", &topology.corners.items),
            n_vertices: topology.corners.len(),
            gather: kernel!(gpu, "corners/gather"),
        }
    }

    pub fn n_faces(&self) -> usize {
        self.faces.len() / 3
    }

    pub fn n_vertices(&self) -> usize {
        self.n_vertices
    }

    /// Records `grad_view[v] += Σ grad_corners[c]` over the corners `c` of `v`; `grad_corners [F, 3, 3]`,
    /// `grad_view [V, 3]`.
    ///
    /// # Panics
    /// When a length does not fit the mesh.
    pub fn gather(&self, recorder: &mut Recorder<'_>, grad_corners: &Buffer<f32>, grad_view: &Buffer<f32>) {
        assert_eq!(grad_corners.len(), self.faces.len() * 3, "{}: length", grad_corners.label());
        assert_eq!(grad_view.len(), self.n_vertices * 3, "{}: length", grad_view.label());
        let params = Params { n_vertices: self.n_vertices as u32 };
        let groups = linear_groups(self.n_vertices, 64);
        recorder.dispatch(&self.gather, &params, &[&self.starts, &self.corners, grad_corners, grad_view], groups);
    }
}

/// The corners of one face, from `values [V, 3]`.
pub(super) fn triangle<T: Real>(values: &[T], face: &[u32; 3]) -> [[T; 3]; 3] {
    face.map(|v| std::array::from_fn(|c| values[v as usize * 3 + c]))
}

/// Twin of [`Corners::gather`], one face at a time.
pub(super) fn add_corners<T: Real>(grad_view: &mut [T], face: &[u32; 3], grad: &[[T; 3]; 3]) {
    for (&v, grad) in face.iter().zip(grad) {
        for c in 0..3 {
            grad_view[v as usize * 3 + c] += grad[c];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ops::testing::gpu;

    #[test]
    fn each_vertex_adds_the_corners_that_meet_in_it() {
        let Some(gpu) = gpu("corners::each_vertex_adds_the_corners_that_meet_in_it") else { return };
        let corners = {
            let faces = [[0, 1, 2], [2, 1, 4]];
            Corners::new(&gpu, &faces, &Topology::new(5, &faces))
        };
        let values: Vec<f32> = (0..18).map(|x| x as f32).collect();
        let grad_corners = gpu.upload("grad_corners", &values);
        let grad_view = gpu.upload("grad_view", &[100.0f32; 15]);
        let mut recorder = gpu.recorder("corners/test");
        corners.gather(&mut recorder, &grad_corners, &grad_view);
        recorder.submit().unwrap();
        let want: [f32; 15] =
            [0., 1., 2., 15., 17., 19., 15., 17., 19., 0., 0., 0., 15., 16., 17.].map(|x: f32| x + 100.0);
        assert_eq!(gpu.read(&grad_view).unwrap(), want);
    }
}
