//! Host side of `shaders/silhouette_iou/`.

use std::sync::Arc;

use crate::gpu::{AnyBuffer, Buffer, Gpu, Kernel, Recorder, linear_groups};
use crate::ops::{LossSlot, Target};

/// Workgroups of the first pass.
const PARTIALS: usize = 64;

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct SumsParams {
    n_pixels: u32,
    offset: u32,
}

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct FinishParams {
    n_partials: u32,
    slot: u32,
}

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct BackwardParams {
    n_pixels: u32,
    offset: u32,
    lambda: f32,
    unused: u32,
}

/// The loss and the sums of its last forward pass.
pub struct SilhouetteIou {
    // [packed]
    sums_pass: [Arc<Kernel>; 2],
    finish: Arc<Kernel>,
    backward: [Arc<Kernel>; 2],
    partials: Buffer<f32>,
    sums: Buffer<f32>,
}

impl SilhouetteIou {
    pub fn new(gpu: &Gpu) -> Self {
        let constants = [false, true].map(|packed| [("PACKED", packed.to_string())]);
        Self {
            sums_pass: constants.each_ref().map(|c| kernel!(gpu, "silhouette_iou/sums", c)),
            finish: kernel!(gpu, "silhouette_iou/finish"),
            backward: constants.each_ref().map(|c| kernel!(gpu, "silhouette_iou/backward", c)),
            partials: gpu.zeros("silhouette_iou/partials", PARTIALS * 2),
            sums: gpu.zeros("silhouette_iou/sums", 2),
        }
    }

    /// Records the loss of the first `n_pixels` of `alpha`.
    ///
    /// # Panics
    /// When a buffer is too short.
    pub fn forward(
        &self,
        recorder: &mut Recorder<'_>,
        n_pixels: usize,
        alpha: &Buffer<f32>,
        target: Target<'_>,
        loss: LossSlot<'_>,
    ) {
        assert!(alpha.len() >= n_pixels, "{}: length", alpha.label());
        let params = SumsParams { n_pixels: n_pixels as u32, offset: target.offset() };
        let buffers: [&dyn AnyBuffer; 3] = [alpha, target.buffer(n_pixels, 1), &self.partials];
        let kernel = &self.sums_pass[usize::from(target.is_packed())];
        recorder.dispatch(kernel, &params, &buffers, [PARTIALS as u32, 1, 1]);
        let params = FinishParams { n_partials: PARTIALS as u32, slot: loss.index as u32 };
        recorder.dispatch(&self.finish, &params, &[&self.partials, &self.sums, loss.losses], [1, 1, 1]);
    }

    /// Records `grad_alpha += λ ∂L/∂alpha` for the sums of the last forward pass.
    ///
    /// # Panics
    /// When a buffer is too short.
    pub fn backward(
        &self,
        recorder: &mut Recorder<'_>,
        n_pixels: usize,
        target: Target<'_>,
        lambda: f32,
        grad_alpha: &Buffer<f32>,
    ) {
        assert!(grad_alpha.len() >= n_pixels, "{}: length", grad_alpha.label());
        let params = BackwardParams { n_pixels: n_pixels as u32, offset: target.offset(), lambda, unused: 0 };
        let buffers: [&dyn AnyBuffer; 3] = [&self.sums, target.buffer(n_pixels, 1), grad_alpha];
        let kernel = &self.backward[usize::from(target.is_packed())];
        recorder.dispatch(kernel, &params, &buffers, linear_groups(n_pixels, 64));
    }
}
