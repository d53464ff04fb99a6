//! Host side of `shaders/light/`.

use std::sync::Arc;

use super::{Light, WRAP};
use crate::gpu::{AnyBuffer, Buffer, Gpu, Kernel, Recorder, linear_groups};
use crate::ops::Topology;
use crate::ops::interpolate::Interpolate;

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    ambient: [f32; 3],
    n_max: u32,
    strength: [f32; 3],
    wrap: f32,
    direction: [f32; 3],
    add: u32,
}

/// Whether a result replaces what is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Write {
    Over,
    Add,
}

/// The kernels with the topology of one mesh.
pub struct Shading {
    apply: Arc<Kernel>,
    vertex_normals: Arc<Kernel>,
    pixel_normals: Arc<Kernel>,
    corner_starts: Buffer<u32>,
    corners: Buffer<u32>,
}

impl Shading {
    pub fn new(gpu: &Gpu, topology: &Topology) -> Self {
        Self {
            apply: kernel!(gpu, "light/apply"),
            vertex_normals: kernel!(gpu, "light/vertex_normals"),
            pixel_normals: kernel!(gpu, "light/pixel_normals"),
            corner_starts: gpu.upload("light/corner_starts", &topology.corners.starts),
            corners: gpu.upload("light/corners", &topology.corners.items),
        }
    }

    /// Records `shaded = values · shade(normals)` for the first `count` rows, at most `n_max`.
    ///
    /// # Panics
    /// When a buffer is shorter than `n_max` rows.
    #[expect(clippy::too_many_arguments, reason = "the operands of the contract")]
    pub fn apply(
        &self,
        recorder: &mut Recorder<'_>,
        light: &Light,
        normals: &Buffer<f32>,
        count: &Buffer<u32>,
        n_max: usize,
        values: &Buffer<f32>,
        shaded: &Buffer<f32>,
        write: Write,
    ) {
        for buffer in [normals, values, shaded] {
            assert!(buffer.len() >= 3 * n_max, "{}: {} values for {n_max} rows", buffer.label(), buffer.len());
        }
        let params = Params {
            ambient: light.ambient,
            n_max: n_max as u32,
            strength: light.strength,
            wrap: WRAP,
            direction: light.direction,
            add: (write == Write::Add).into(),
        };
        let buffers: [&dyn AnyBuffer; 4] = [count, normals, values, shaded];
        recorder.dispatch(&self.apply, &params, &buffers, linear_groups(n_max, 64));
    }

    /// Records `face_normals [F, 3]` to `vertex_normals [V, 3]`.
    ///
    /// # Panics
    /// When a length is wrong.
    pub fn vertex_normals(
        &self,
        recorder: &mut Recorder<'_>,
        face_normals: &Buffer<f32>,
        vertex_normals: &Buffer<f32>,
    ) {
        assert_eq!(face_normals.len(), self.corners.len(), "{}: length", face_normals.label());
        let n = self.corner_starts.len() - 1;
        assert_eq!(vertex_normals.len(), 3 * n, "{}: length", vertex_normals.label());
        let buffers: [&dyn AnyBuffer; 4] = [&self.corner_starts, &self.corners, face_normals, vertex_normals];
        recorder.dispatch(&self.vertex_normals, &(n as u32), &buffers, linear_groups(n, 64));
    }

    /// Records the normals of the listed pixels, `[P, 3]`.
    ///
    /// # Panics
    /// When `normals` is shorter than the list can be.
    #[expect(clippy::too_many_arguments, reason = "the operands of the contract")]
    pub fn pixel_normals(
        &self,
        recorder: &mut Recorder<'_>,
        list: &Interpolate,
        n_pixels: usize,
        pix_to_face: &Buffer<i32>,
        bary_coords: &Buffer<f32>,
        faces: &Buffer<u32>,
        vertex_normals: &Buffer<f32>,
        normals: &Buffer<f32>,
    ) {
        let n_max = list.n_max(n_pixels);
        assert!(normals.len() >= 3 * n_max, "{}: length", normals.label());
        let buffers: [&dyn AnyBuffer; 7] =
            [&list.count, &list.pixel_index, pix_to_face, bary_coords, faces, vertex_normals, normals];
        recorder.dispatch(&self.pixel_normals, &(n_max as u32), &buffers, linear_groups(n_max, 64));
    }
}
