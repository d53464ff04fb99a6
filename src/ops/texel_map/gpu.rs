//! Host side of `shaders/texel_map/`.

use std::sync::Arc;

use crate::gpu::{AnyBuffer, Buffer, Gpu, Kernel, Recorder, linear_groups};
use crate::ops::exact_sum::ExactSum;

/// A texel map on the device with its gradient.
pub struct TexelMap {
    forward: Arc<Kernel>,
    backward: Arc<Kernel>,
    side: usize,
    capacity: usize,
    /// `[S, S, 3]`
    pub texels: Buffer<f32>,
    pub grad_texels: Buffer<f32>,
    texel_sums: ExactSum,
    /// `[capacity, 3]`
    pub rgb: Buffer<f32>,
}

impl TexelMap {
    /// A map of `side`² texels for up to `capacity` coordinates a pass.
    ///
    /// # Panics
    /// When `texels` is not `[side, side, 3]`.
    pub fn new(gpu: &Gpu, side: usize, texels: &[f32], capacity: usize) -> Self {
        assert!(side > 0 && texels.len() == 3 * side * side, "texel_map: {} values for {side}²", texels.len());
        Self {
            forward: kernel!(gpu, "texel_map/forward"),
            backward: kernel!(gpu, "texel_map/backward"),
            side,
            capacity,
            texels: gpu.upload("texel_map/texels", texels),
            grad_texels: gpu.zeros("texel_map/grad_texels", texels.len()),
            texel_sums: ExactSum::new(gpu, "texel_map/texel_sums", texels.len()),
            rgb: gpu.zeros("texel_map/rgb", 3 * capacity),
        }
    }

    /// Records `rgb` of the first `min(count, n_max)` coordinates.
    ///
    /// # Panics
    /// When `n_max` is above the capacity or above the coordinates.
    pub fn forward(&self, recorder: &mut Recorder<'_>, coords: &Buffer<f32>, count: &Buffer<u32>, n_max: usize) {
        assert!(n_max <= self.capacity && 3 * n_max <= coords.len(), "texel_map: {n_max} coordinates");
        let buffers: [&dyn AnyBuffer; 4] = [count, coords, &self.texels, &self.rgb];
        recorder.dispatch(&self.forward, &self.params(n_max), &buffers, linear_groups(n_max, 64));
    }

    /// Records the backward pass: adds to `grad_texels` and `grad_coords [P, 3]`.
    ///
    /// # Panics
    /// As `forward`, and when a gradient is shorter than `n_max` rows.
    pub fn backward(
        &self,
        recorder: &mut Recorder<'_>,
        coords: &Buffer<f32>,
        count: &Buffer<u32>,
        n_max: usize,
        grad_rgb: &Buffer<f32>,
        grad_coords: &Buffer<f32>,
    ) {
        let shortest = [coords.len() / 3, grad_rgb.len() / 3, grad_coords.len() / 3];
        assert!(shortest.iter().all(|&len| n_max <= len), "texel_map: {n_max} coordinates of {shortest:?}");
        let buffers: [&dyn AnyBuffer; 6] = [count, coords, &self.texels, grad_rgb, &self.texel_sums.sums, grad_coords];
        recorder.dispatch(&self.backward, &self.params(n_max), &buffers, linear_groups(n_max, 64));
        self.texel_sums.settle(recorder, &self.grad_texels);
    }

    fn params(&self, n_max: usize) -> [u32; 4] {
        [n_max as u32, self.side as u32, 0, 0]
    }
}
