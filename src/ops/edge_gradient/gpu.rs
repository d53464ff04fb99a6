//! Host side of `shaders/edge_gradient/` and of what `shaders/nmr/` shares with it.

use std::sync::Arc;

use super::RgbGradient;
use crate::camera::Camera;
use crate::gpu::{AnyBuffer, Buffer, Gpu, Kernel, Recorder};
use crate::ops::hard_rasterize::{Each, HardRasterizer};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    width: u32,
    height: u32,
    min_step: f32,
    max_sweep: u32,
}

/// A kernel that finds `grad_screen`, and the way from there to the vertices.
pub(in crate::ops) struct ScreenPass {
    mark: Arc<Kernel>,
    groups_pass: Arc<Kernel>,
    // [with colours]
    kernels: [Arc<Kernel>; 2],
    min_step: f32,
    max_sweep: u32,
    grad_screen: Buffer<f32>,
    /// Pixels that have a border, and the workgroups that they take.
    count: Buffer<u32>,
    borders: Buffer<u32>,
    groups: Buffer<u32>,
}

impl ScreenPass {
    /// `kernel` makes the pass for values of its constants.
    pub fn new(
        gpu: &Gpu,
        kernel: impl Fn(&[(&str, String)]) -> Arc<Kernel>,
        max_pixels: usize,
        min_step: f64,
        max_sweep: u32,
    ) -> Self {
        let kernels = [false, true].map(|has_rgb| kernel(&[("HAS_RGB", has_rgb.to_string())]));
        Self {
            mark: kernel!(gpu, "edge_gradient/mark"),
            groups_pass: kernel!(gpu, "edge_gradient/groups"),
            kernels,
            min_step: min_step as f32,
            max_sweep,
            grad_screen: gpu.zeros("edge_gradient/grad_screen", max_pixels * 2),
            count: gpu.zeros("edge_gradient/count", 1),
            borders: gpu.zeros("edge_gradient/borders", max_pixels),
            groups: gpu.zeros("edge_gradient/groups", 3),
        }
    }

    #[expect(clippy::too_many_arguments, reason = "the contract's buffers, in its order")]
    pub fn backward(
        &self,
        recorder: &mut Recorder<'_>,
        hard: &HardRasterizer,
        camera: &Camera,
        view: &Buffer<f32>,
        rgb: Option<RgbGradient<'_>>,
        grad_alpha: &Buffer<f32>,
        grad_view: &Buffer<f32>,
    ) {
        let n = camera.n_pixels();
        assert!(n * 2 <= self.grad_screen.len(), "{}: {n} pixels", self.grad_screen.label());
        assert!(grad_alpha.len() >= n, "{}: length", grad_alpha.label());
        // Without colours the kernel reads nothing there.
        let (image, grad_image) = rgb.map_or((grad_alpha, grad_alpha), |rgb| (rgb.image, rgb.grad_image));
        let enough = rgb.is_none() || image.len() >= n * 3 && grad_image.len() >= n * 3;
        assert!(enough, "{}, {}: length", image.label(), grad_image.label());
        let Self { min_step, max_sweep, .. } = *self;
        let params = Params { width: camera.width, height: camera.height, min_step, max_sweep };
        let Self { count, borders, groups, grad_screen, .. } = self;
        recorder.clear(count);
        let [counts, owned] = hard.owned_pixels();
        hard.each(recorder, Each::Pixel, &self.mark, &params, &[&hard.zbuf, counts, owned, count, borders]);
        recorder.dispatch(&self.groups_pass, &[n as u32, 0, 0, 0], &[count, groups], [1, 1, 1]);
        recorder.clear(grad_screen);
        let buffers: [&dyn AnyBuffer; 9] =
            [&hard.pix_to_face, &hard.zbuf, &hard.alpha, grad_alpha, image, grad_image, grad_screen, count, borders];
        recorder.dispatch_indirect(&self.kernels[usize::from(rgb.is_some())], &params, &buffers, groups, 0);
        hard.screen_backward(recorder, camera, view, &self.grad_screen, grad_view);
    }
}

/// The operator for images of up to `max_pixels`.
pub struct EdgeGradient(ScreenPass);

impl EdgeGradient {
    /// `min_step` in metres; 0.02 keeps the borders within a body's surface out.
    pub fn new(gpu: &Gpu, max_pixels: usize, min_step: f64) -> Self {
        let kernel = |constants: &[(&str, String)]| kernel!(gpu, "edge_gradient/screen", constants);
        Self(ScreenPass::new(gpu, kernel, max_pixels, min_step, 0))
    }

    /// Records `grad_view +=` the gradient through the borders in the last image of `hard`.
    ///
    /// # Panics
    /// When a buffer does not fit the image or the mesh.
    #[expect(clippy::too_many_arguments, reason = "the contract's buffers, in its order")]
    pub fn backward(
        &self,
        recorder: &mut Recorder<'_>,
        hard: &HardRasterizer,
        camera: &Camera,
        view: &Buffer<f32>,
        rgb: Option<RgbGradient<'_>>,
        grad_alpha: &Buffer<f32>,
        grad_view: &Buffer<f32>,
    ) {
        self.0.backward(recorder, hard, camera, view, rgb, grad_alpha, grad_view);
    }
}
