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
    write: u32,
}

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct PartParams {
    direction: [f32; 3],
    wrap: f32,
    slope: [f32; 3],
    n: u32,
}

/// What becomes of a product. The numbers are those of `shaders/light/apply.wgsl`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Write {
    /// It replaces what is there.
    Over = 0,
    /// It is added to what is there.
    Add = 1,
    /// It replaces what is there and is at most one: a picture shows nothing brighter than white.
    Cut = 2,
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
    face_parts: Arc<Kernel>,
    vertex_normals: Arc<Kernel>,
    pixel_parts: Arc<Kernel>,
    corner_starts: Buffer<u32>,
    corners: Buffer<u32>,
}

impl Shading {
    pub fn new(gpu: &Gpu, topology: &Topology) -> Self {
        Self {
            apply: kernel!(gpu, "light/apply"),
            face_parts: kernel!(gpu, "light/face_parts"),
            vertex_normals: kernel!(gpu, "light/vertex_normals"),
            pixel_parts: kernel!(gpu, "light/pixel_parts"),
            corner_starts: gpu.upload("light/corner_starts", &topology.corners.starts),
            corners: gpu.upload("light/corners", &topology.corners.items),
        }
    }

    /// Records `shaded = values · shade` by `parts`, of the first or of listed rows.
    ///
    /// # Panics
    /// When a buffer is shorter than the rows can be.
    #[expect(clippy::too_many_arguments, reason = "the operands of the contract")]
    pub fn apply(
        &self,
        recorder: &mut Recorder<'_>,
        light: &Light,
        rows: ShadedRows<'_>,
        parts: &Buffer<f32>,
        values: &Buffer<f32>,
        shaded: &Buffer<f32>,
        write: Write,
    ) {
        let n_max = match rows {
            ShadedRows::Counted(_, n_max) => n_max,
            ShadedRows::Listed(list, n_pixels) => list.n_max(n_pixels),
        };
        assert!(parts.len() >= 2 * n_max, "{}: {} values for {n_max} rows", parts.label(), parts.len());
        for buffer in [values, shaded] {
            assert!(buffer.len() >= 3 * n_max, "{}: {} values for {n_max} rows", buffer.label(), buffer.len());
        }
        let (ambient, strength) = (light.ambient, light.strength);
        let params = ApplyParams { ambient, n_max: n_max as u32, strength, write: write as u32 };
        match rows {
            ShadedRows::Counted(count, _) => {
                let buffers: [&dyn AnyBuffer; 4] = [count, parts, values, shaded];
                recorder.dispatch(&self.apply, &params, &buffers, linear_groups(n_max, 64));
            }
            ShadedRows::Listed(list, _) => {
                list.over_list(recorder, &self.apply, &params, &[&list.count, parts, values, shaded]);
            }
        }
    }

    /// Records the parts of the shade of `faces [F, 3]` by their `normals [F, 3]`, `parts [F, 2]`.
    ///
    /// # Panics
    /// When a length is wrong.
    pub fn face_parts(
        &self,
        recorder: &mut Recorder<'_>,
        light: &Light,
        exposure: &Buffer<f32>,
        faces: &Buffer<u32>,
        normals: &Buffer<f32>,
        parts: &Buffer<f32>,
    ) {
        let n = parts.len() / 2;
        assert_eq!(normals.len(), 3 * n, "{}: length", normals.label());
        assert_eq!(faces.len(), 3 * n, "{}: length", faces.label());
        let buffers: [&dyn AnyBuffer; 4] = [faces, normals, exposure, parts];
        recorder.dispatch(&self.face_parts, &self.part_params(light, exposure, n), &buffers, linear_groups(n, 64));
    }

    fn part_params(&self, light: &Light, exposure: &Buffer<f32>, n: usize) -> PartParams {
        let n_vertices = self.corner_starts.len() - 1;
        assert_eq!(exposure.len(), 2 * n_vertices, "{}: length", exposure.label());
        PartParams { direction: light.direction, wrap: WRAP, slope: light.slope, n: n as u32 }
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

    /// Records the parts of the shade of the listed pixels, `[P, 2]`, by unit normals `[V, 3]` of the vertices.
    ///
    /// # Panics
    /// When `parts` is shorter than the list can be, or the exposure is not that of the vertices.
    #[expect(clippy::too_many_arguments, reason = "the operands of the contract")]
    pub fn pixel_parts(
        &self,
        recorder: &mut Recorder<'_>,
        light: &Light,
        exposure: &Buffer<f32>,
        list: &Interpolate,
        n_pixels: usize,
        pix_to_face: &Buffer<i32>,
        bary_coords: &Buffer<f32>,
        faces: &Buffer<u32>,
        vertex_normals: &Buffer<f32>,
        parts: &Buffer<f32>,
    ) {
        let n_max = list.n_max(n_pixels);
        assert!(parts.len() >= 2 * n_max, "{}: length", parts.label());
        let buffers: [&dyn AnyBuffer; 8] =
            [&list.count, &list.pixel_index, pix_to_face, bary_coords, faces, vertex_normals, exposure, parts];
        list.over_list(recorder, &self.pixel_parts, &self.part_params(light, exposure, n_max), &buffers);
    }
}
