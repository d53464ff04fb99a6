//! The soft image of a frame (paper eq. 1) and its gradients' buffers.

use super::config::Phase;
use super::scene::Scene;
use crate::camera::Camera;
use crate::gpu::{Buffer, Recorder};
use crate::ops::soft_rasterize::{SoftRasterizeParams, SoftRasterizer};

/// The soft rasteriser with the gradients that its images receive.
pub struct SoftTerm {
    rasterizer: SoftRasterizer,
    pub grad_rgb: Buffer<f32>,
}

impl SoftTerm {
    pub fn new(scene: &Scene) -> Self {
        let (gpu, n) = (&scene.gpu, scene.max_pixels);
        // Tiles whose lists do not fit would be right, but hundreds of times slower.
        let entries = SoftRasterizer::list_capacity(scene.corners.n_faces(), n);
        Self {
            rasterizer: SoftRasterizer::new(gpu, &scene.corners, n, entries),
            grad_rgb: gpu.zeros("fit/grad_soft_rgb", n * 3),
        }
    }

    pub fn rgb(&self) -> &Buffer<f32> {
        &self.rasterizer.rgb
    }

    /// Over the scene's hard image: the colours of what it does not hide.
    pub fn forward(
        &self,
        recorder: &mut Recorder<'_>,
        params: &SoftRasterizeParams,
        camera: &Camera,
        scene: &Scene,
        face_colours: &Buffer<f32>,
    ) {
        self.rasterizer.forward(recorder, params, camera, &scene.view, face_colours, Some(&scene.hard.zbuf));
    }

    /// Adds to the scene's `grad_view` and to `grad_face_colours`.
    pub fn backward(
        &self,
        recorder: &mut Recorder<'_>,
        params: &SoftRasterizeParams,
        camera: &Camera,
        scene: &Scene,
        face_colours: &Buffer<f32>,
        grad_face_colours: &Buffer<f32>,
    ) {
        self.rasterizer.backward(
            recorder,
            params,
            camera,
            face_colours,
            &self.grad_rgb,
            None,
            &scene.grad_view,
            grad_face_colours,
        );
    }
}

/// The constants of a frame's soft image. `near` and `far` enclose the person, and γ is rescaled to them, so that the
/// phase's depth softness stays in metres.
pub fn soft_params(scene: &Scene, phase: &Phase, frame: usize, background: [f32; 3]) -> SoftRasterizeParams {
    let (near, far) = scene.depth_ranges[frame];
    SoftRasterizeParams {
        sigma: phase.sigma as f64,
        cut: phase.cut as f64,
        gamma: phase.depth_softness_m as f64 / (far - near),
        near,
        far,
        norm_px: scene.norm_px * 0.5f64.powi(phase.level as i32),
        background: background.map(f64::from),
        ..SoftRasterizeParams::new(1, 1)
    }
}
