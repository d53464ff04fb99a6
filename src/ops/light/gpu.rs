//! Host side of `shaders/light/`.

use std::sync::Arc;

use super::{Light, WRAP};
use crate::gpu::{AnyBuffer, Buffer, Gpu, Kernel, Recorder, linear_groups};
use crate::ops::Topology;
use crate::ops::interpolate::Interpolate;

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct ApplyParams {
    ambient: [f32; 3],
    n_max: u32,
    strength: [f32; 3],
    add: u32,
}

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct LampParams {
    direction: [f32; 3],
    wrap: f32,
    n: u32,
    unused: [u32; 3],
}

fn lamp_params(light: &Light, n: usize) -> LampParams {
    LampParams { direction: light.direction, wrap: WRAP, n: n as u32, unused: [0; 3] }
}

/// Whether a result replaces what is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Write {
    Over,
    Add,
}

/// The rows that a product is taken of.
#[derive(Clone, Copy)]
pub enum ShadedRows<'a> {
    /// The first ones, as many as the buffer `[1]` says.
    Counted(&'a Buffer<u32>, usize),
    /// Those of the listed pixels of an image of so many.
    Listed(&'a Interpolate, usize),
}

/// The kernels with the topology of one mesh.
pub struct Shading {
    apply: Arc<Kernel>,
    lamps: Arc<Kernel>,
    vertex_normals: Arc<Kernel>,
    pixel_lamps: Arc<Kernel>,
    corner_starts: Buffer<u32>,
    corners: Buffer<u32>,
}

impl Shading {
    pub fn new(gpu: &Gpu, topology: &Topology) -> Self {
        Self {
            apply: kernel!(gpu, "light/apply"),
            lamps: kernel!(gpu, "light/lamps"),
            vertex_normals: kernel!(gpu, "light/vertex_normals"),
            pixel_lamps: kernel!(gpu, "light/pixel_lamps"),
            corner_starts: gpu.upload("light/corner_starts", &topology.corners.starts),
            corners: gpu.upload("light/corners", &topology.corners.items),
        }
    }

    /// Records `shaded = values · shade` by `lamps`, of the first or of listed rows.
    ///
    /// # Panics
    /// When a buffer is shorter than the rows can be.
    #[expect(clippy::too_many_arguments, reason = "the operands of the contract")]
    pub fn apply(
        &self,
        recorder: &mut Recorder<'_>,
        light: &Light,
        rows: ShadedRows<'_>,
        lamps: &Buffer<f32>,
        values: &Buffer<f32>,
        shaded: &Buffer<f32>,
        write: Write,
    ) {
        let n_max = match rows {
            ShadedRows::Counted(_, n_max) => n_max,
            ShadedRows::Listed(list, n_pixels) => list.n_max(n_pixels),
        };
        assert!(lamps.len() >= n_max, "{}: {} values for {n_max} rows", lamps.label(), lamps.len());
        for buffer in [values, shaded] {
            assert!(buffer.len() >= 3 * n_max, "{}: {} values for {n_max} rows", buffer.label(), buffer.len());
        }
        let add = (write == Write::Add).into();
        let params = ApplyParams { ambient: light.ambient, n_max: n_max as u32, strength: light.strength, add };
        match rows {
            ShadedRows::Counted(count, _) => {
                let buffers: [&dyn AnyBuffer; 4] = [count, lamps, values, shaded];
                recorder.dispatch(&self.apply, &params, &buffers, linear_groups(n_max, 64));
            }
            ShadedRows::Listed(list, _) => {
                list.over_list(recorder, &self.apply, &params, &[&list.count, lamps, values, shaded]);
            }
        }
    }

    /// Records `normals [R, 3]` to `lamps [R]`.
    ///
    /// # Panics
    /// When a length is wrong.
    pub fn lamps(&self, recorder: &mut Recorder<'_>, light: &Light, normals: &Buffer<f32>, lamps: &Buffer<f32>) {
        let n = lamps.len();
        assert_eq!(normals.len(), 3 * n, "{}: length", normals.label());
        recorder.dispatch(&self.lamps, &lamp_params(light, n), &[normals, lamps], linear_groups(n, 64));
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

    /// Records the lamp's part of the shade of the listed pixels, `[P]`, by unit normals `[V, 3]` of the vertices.
    ///
    /// # Panics
    /// When `lamps` is shorter than the list can be.
    #[expect(clippy::too_many_arguments, reason = "the operands of the contract")]
    pub fn pixel_lamps(
        &self,
        recorder: &mut Recorder<'_>,
        light: &Light,
        list: &Interpolate,
        n_pixels: usize,
        pix_to_face: &Buffer<i32>,
        bary_coords: &Buffer<f32>,
        faces: &Buffer<u32>,
        vertex_normals: &Buffer<f32>,
        lamps: &Buffer<f32>,
    ) {
        let n_max = list.n_max(n_pixels);
        assert!(lamps.len() >= n_max, "{}: length", lamps.label());
        let buffers: [&dyn AnyBuffer; 7] =
            [&list.count, &list.pixel_index, pix_to_face, bary_coords, faces, vertex_normals, lamps];
        list.over_list(recorder, &self.pixel_lamps, &lamp_params(light, n_max), &buffers);
    }
}
