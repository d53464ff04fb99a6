//! Host side of `shaders/nmr/`.

use crate::camera::Camera;
use crate::gpu::{Buffer, Gpu, Recorder};
use crate::ops::edge_gradient::{RgbGradient, ScreenPass};
use crate::ops::hard_rasterize::HardRasterizer;

/// What is swept.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NmrConfig {
    /// Metres between a surface and what it hides; borders of smaller steps are not swept.
    pub min_step: f64,
    /// Pixels that a sweep covers at most.
    pub max_sweep: u32,
}

impl Default for NmrConfig {
    /// Sweeps reach the border of the image.
    fn default() -> Self {
        Self { min_step: 0.02, max_sweep: 1 << 16 }
    }
}

/// The operator for images of up to `max_pixels`.
pub struct Nmr(ScreenPass);

impl Nmr {
    pub fn new(gpu: &Gpu, max_pixels: usize, config: NmrConfig) -> Self {
        let kernel = |constants: &[(&str, String)]| kernel!(gpu, "nmr/screen", constants);
        Self(ScreenPass::new(gpu, kernel, max_pixels, config.min_step, config.max_sweep))
    }

    /// Records `grad_view +=` the pull on the borders in the last image of `hard`.
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
