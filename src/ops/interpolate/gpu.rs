//! Host side of `shaders/interpolate/`.

use std::sync::Arc;

use super::Sampling;
use crate::gpu::{AnyBuffer, Buffer, Gpu, Kernel, Recorder, linear_groups};
use crate::ops::exact_sum::ExactSum;
use crate::ops::fill::Fill;

/// Pixels of a mask.
pub(super) const BLOCK: usize = 32;

struct Kernels {
    mark: Arc<Kernel>,
    scan: Arc<Kernel>,
    list: Arc<Kernel>,
    forward: Arc<Kernel>,
    backward: Arc<Kernel>,
    backward_bary: Arc<Kernel>,
    scatter: Arc<Kernel>,
    gather: Arc<Kernel>,
}

/// A list of pixels on the device. One frame's list at a time: `forward` overwrites it.
pub struct Interpolate {
    kernels: Kernels,
    max_pixels: usize,
    capacity: usize,
    masks: Buffer<u32>,
    firsts: Buffer<u32>,
    /// Of 64, for the listed pixels.
    workgroups: Buffer<u32>,
    fill: Fill,
    texcoords_sums: ExactSum,
    /// `[1]`
    pub count: Buffer<u32>,
    /// `[capacity]`
    pub pixel_index: Buffer<u32>,
    /// `[capacity, 3]`
    pub coords: Buffer<f32>,
}

impl Interpolate {
    /// For images of up to `max_pixels`, of which up to `capacity` are listed, and an attribute of `n_vertices` vertices; where
    /// [`backward`](Self::backward) is not used, 0 will do.
    pub fn new(gpu: &Gpu, max_pixels: usize, capacity: usize, n_vertices: usize) -> Self {
        let blocks = max_pixels.div_ceil(BLOCK);
        Self {
            kernels: kernels(gpu),
            max_pixels,
            capacity,
            masks: gpu.zeros("interpolate/masks", blocks),
            firsts: gpu.zeros("interpolate/firsts", blocks),
            workgroups: gpu.zeros("interpolate/workgroups", 3),
            fill: Fill::new(gpu),
            texcoords_sums: ExactSum::new(gpu, "interpolate/texcoords_sums", 3 * n_vertices),
            count: gpu.zeros("interpolate/count", 1),
            pixel_index: gpu.zeros("interpolate/pixel_index", capacity),
            coords: gpu.zeros("interpolate/coords", 3 * capacity),
        }
    }

    /// The most pixels that the list can hold for an image of `n_pixels`: the `n_max` of what reads the list.
    pub fn n_max(&self, n_pixels: usize) -> usize {
        self.capacity.min(n_pixels)
    }

    /// Records the list of an image of `n_pixels = H·W`: `count`, `pixel_index`, `coords`.
    ///
    /// # Panics
    /// When the image is larger than `max_pixels` or than its buffers.
    #[expect(clippy::too_many_arguments, reason = "the operands of the contract")]
    pub fn forward(
        &self,
        recorder: &mut Recorder<'_>,
        n_pixels: usize,
        pix_to_face: &Buffer<i32>,
        bary_coords: &Buffer<f32>,
        faces: &Buffer<u32>,
        texcoords: &Buffer<f32>,
        sampling: Sampling,
    ) {
        let shortest = [self.max_pixels, pix_to_face.len(), bary_coords.len() / 3];
        assert!(shortest.iter().all(|&len| n_pixels <= len), "interpolate: {n_pixels} pixels of {shortest:?}");
        let blocks = n_pixels.div_ceil(BLOCK);
        let params: [u32; 4] = [n_pixels as u32, sampling.seed, sampling.threshold(), 0];
        let buffers: [&dyn AnyBuffer; 2] = [pix_to_face, &self.masks];
        recorder.dispatch(&self.kernels.mark, &params, &buffers, linear_groups(blocks, 64));
        let params: [u32; 4] = [blocks as u32, self.capacity as u32, 0, 0];
        let buffers: [&dyn AnyBuffer; 4] = [&self.masks, &self.firsts, &self.count, &self.workgroups];
        recorder.dispatch(&self.kernels.scan, &params, &buffers, [1, 1, 1]);
        let params: [u32; 4] = [n_pixels as u32, self.capacity as u32, 0, 0];
        let buffers: [&dyn AnyBuffer; 3] = [&self.masks, &self.firsts, &self.pixel_index];
        recorder.dispatch(&self.kernels.list, &params, &buffers, linear_groups(n_pixels, 64));
        let buffers: [&dyn AnyBuffer; 7] =
            [&self.count, &self.pixel_index, pix_to_face, bary_coords, faces, texcoords, &self.coords];
        self.each(recorder, &self.kernels.forward, self.n_max(n_pixels), &buffers);
    }

    /// Records a kernel that takes a listed pixel an invocation, 64 a workgroup.
    pub(in crate::ops) fn over_list<P: bytemuck::Pod>(
        &self,
        recorder: &mut Recorder<'_>,
        kernel: &Arc<Kernel>,
        params: &P,
        buffers: &[&dyn AnyBuffer],
    ) {
        recorder.dispatch_indirect(kernel, params, buffers, &self.workgroups, 0);
    }

    fn each(&self, recorder: &mut Recorder<'_>, kernel: &Arc<Kernel>, n_max: usize, buffers: &[&dyn AnyBuffer]) {
        let params: [u32; 4] = [n_max as u32, 0, 0, 0];
        self.over_list(recorder, kernel, &params, buffers);
    }

    /// Records the gradient by the attribute: adds to `grad_texcoords [V, 3]` what `grad_coords [P, 3]` says.
    ///
    /// # Panics
    /// When `grad_coords` is shorter than the list can be, or `grad_texcoords` is not of the vertices that this was made for.
    #[expect(clippy::too_many_arguments, reason = "the operands of the contract")]
    pub fn backward(
        &self,
        recorder: &mut Recorder<'_>,
        n_pixels: usize,
        pix_to_face: &Buffer<i32>,
        bary_coords: &Buffer<f32>,
        faces: &Buffer<u32>,
        grad_coords: &Buffer<f32>,
        grad_texcoords: &Buffer<f32>,
    ) {
        let n_max = self.checked_n_max(n_pixels, grad_coords);
        let buffers: [&dyn AnyBuffer; 7] =
            [&self.count, &self.pixel_index, pix_to_face, bary_coords, faces, grad_coords, &self.texcoords_sums.sums];
        self.each(recorder, &self.kernels.backward, n_max, &buffers);
        self.texcoords_sums.settle(recorder, grad_texcoords);
    }

    /// Records the gradient by the barycentric coordinates: adds to `grad_bary [H, W, 3]` at the listed pixels.
    ///
    /// # Panics
    /// As `backward`, and when `grad_bary` is smaller than the image.
    #[expect(clippy::too_many_arguments, reason = "the operands of the contract")]
    pub fn backward_bary(
        &self,
        recorder: &mut Recorder<'_>,
        n_pixels: usize,
        pix_to_face: &Buffer<i32>,
        faces: &Buffer<u32>,
        texcoords: &Buffer<f32>,
        grad_coords: &Buffer<f32>,
        grad_bary: &Buffer<f32>,
    ) {
        let n_max = self.checked_n_max(n_pixels, grad_coords);
        assert!(3 * n_pixels <= grad_bary.len(), "interpolate: grad_bary has {} values", grad_bary.len());
        let buffers: [&dyn AnyBuffer; 7] =
            [&self.count, &self.pixel_index, pix_to_face, faces, texcoords, grad_coords, grad_bary];
        self.each(recorder, &self.kernels.backward_bary, n_max, &buffers);
    }

    /// Records `image [H, W, 3]`: `rgb [P, 3]` at the listed pixels, `background` elsewhere.
    ///
    /// # Panics
    /// When `rgb` is shorter than the list can be or `image` smaller than `n_pixels`.
    pub fn scatter(
        &self,
        recorder: &mut Recorder<'_>,
        n_pixels: usize,
        rgb: &Buffer<f32>,
        background: [f32; 3],
        image: &Buffer<f32>,
    ) {
        let n_max = self.checked_n_max(n_pixels, rgb);
        assert!(3 * n_pixels <= image.len(), "interpolate: the image has {} values", image.len());
        self.fill.record(recorder, n_pixels, background, image);
        let buffers: [&dyn AnyBuffer; 4] = [&self.count, &self.pixel_index, rgb, image];
        self.each(recorder, &self.kernels.scatter, n_max, &buffers);
    }

    /// Records `grad_rgb [P, 3] = grad_image [H, W, 3]` at the listed pixels; overwrites.
    ///
    /// # Panics
    /// As `scatter`.
    pub fn gather(
        &self,
        recorder: &mut Recorder<'_>,
        n_pixels: usize,
        grad_image: &Buffer<f32>,
        grad_rgb: &Buffer<f32>,
    ) {
        let n_max = self.checked_n_max(n_pixels, grad_rgb);
        assert!(3 * n_pixels <= grad_image.len(), "interpolate: the image has {} values", grad_image.len());
        let buffers: [&dyn AnyBuffer; 4] = [&self.count, &self.pixel_index, grad_image, grad_rgb];
        self.each(recorder, &self.kernels.gather, n_max, &buffers);
    }

    fn checked_n_max(&self, n_pixels: usize, rows: &Buffer<f32>) -> usize {
        let n_max = self.n_max(n_pixels);
        assert!(n_pixels <= self.max_pixels, "interpolate: {n_pixels} pixels of {}", self.max_pixels);
        assert!(3 * n_max <= rows.len(), "interpolate: {} has {} values for {n_max} rows", rows.label(), rows.len());
        n_max
    }
}

fn kernels(gpu: &Gpu) -> Kernels {
    Kernels {
        mark: kernel!(gpu, "interpolate/mark"),
        scan: kernel!(gpu, "interpolate/scan"),
        list: kernel!(gpu, "interpolate/list"),
        forward: kernel!(gpu, "interpolate/forward"),
        backward: kernel!(gpu, "interpolate/backward"),
        backward_bary: kernel!(gpu, "interpolate/backward_bary"),
        scatter: kernel!(gpu, "interpolate/scatter"),
        gather: kernel!(gpu, "interpolate/gather"),
    }
}
