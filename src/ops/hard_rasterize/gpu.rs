//! Host side of `shaders/hard_rasterize/`.

use std::sync::Arc;

use super::HardRasterizeConfig;
use crate::camera::Camera;
use crate::gpu::{AnyBuffer, Buffer, Gpu, Kernel, Recorder, linear_groups};
use crate::ops::Corners;

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    n_faces: u32,
    width: u32,
    height: u32,
    near: f32,
    fx: f32,
    fy: f32,
    cx: f32,
    cy: f32,
}

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct ShadeParams {
    n_pixels: u32,
    background: [f32; 3],
}

/// A rasteriser for one mesh and images of up to `max_pixels`. A call uses the start of each image buffer.
pub struct HardRasterizer {
    corners: Arc<Corners>,
    config: HardRasterizeConfig,
    max_pixels: usize,
    passes: [Arc<Kernel>; 3],
    faces: Arc<Kernel>,
    backward: Arc<Kernel>,
    backward_zbuf: Arc<Kernel>,
    screen_backward: Arc<Kernel>,
    shade: Arc<Kernel>,
    shade_backward: Arc<Kernel>,
    nearest: Buffer<u32>,
    owner: Buffer<u32>,
    grad_corners: Buffer<f32>,
    pub pix_to_face: Buffer<i32>,
    pub bary_coords: Buffer<f32>,
    pub zbuf: Buffer<f32>,
    pub alpha: Buffer<f32>,
}

impl HardRasterizer {
    pub fn new(gpu: &Gpu, corners: &Arc<Corners>, max_pixels: usize, config: HardRasterizeConfig) -> Self {
        let cull = &[("CULL_BACK", config.cull_back.to_string())];
        Self {
            passes: [
                kernel!(gpu, "hard_rasterize/depth", cull),
                kernel!(gpu, "hard_rasterize/claim", cull),
                kernel!(gpu, "hard_rasterize/resolve"),
            ],
            faces: kernel!(gpu, "hard_rasterize/faces"),
            backward: kernel!(gpu, "hard_rasterize/backward"),
            backward_zbuf: kernel!(gpu, "hard_rasterize/backward", &[("HAS_GRAD_ZBUF", "true".to_owned())]),
            screen_backward: kernel!(gpu, "hard_rasterize/screen_backward"),
            shade: kernel!(gpu, "hard_rasterize/shade"),
            shade_backward: kernel!(gpu, "hard_rasterize/shade_backward"),
            nearest: gpu.zeros("hard_rasterize/nearest", max_pixels),
            owner: gpu.zeros("hard_rasterize/owner", max_pixels),
            grad_corners: gpu.zeros("hard_rasterize/grad_corners", corners.n_faces() * 9),
            pix_to_face: gpu.zeros("hard_rasterize/pix_to_face", max_pixels),
            bary_coords: gpu.zeros("hard_rasterize/bary_coords", max_pixels * 3),
            zbuf: gpu.zeros("hard_rasterize/zbuf", max_pixels),
            alpha: gpu.zeros("hard_rasterize/alpha", max_pixels),
            corners: corners.clone(),
            config,
            max_pixels,
        }
    }

    fn params(&self, camera: &Camera, view: &Buffer<f32>) -> Params {
        assert!(
            camera.n_pixels() <= self.max_pixels,
            "hard_rasterize: {camera:?} has more than {} pixels",
            self.max_pixels
        );
        assert_eq!(view.len(), self.corners.n_vertices() * 3, "{}: length", view.label());
        Params {
            n_faces: self.corners.n_faces() as u32,
            width: camera.width,
            height: camera.height,
            near: self.config.near as f32,
            fx: camera.fx as f32,
            fy: camera.fy as f32,
            cx: camera.cx as f32,
            cy: camera.cy as f32,
        }
    }

    /// Records the image into `pix_to_face`, `bary_coords`, `zbuf` and `alpha`.
    ///
    /// # Panics
    /// When the image has more pixels than this rasteriser was made for, or `view` does not fit the mesh.
    pub fn forward(&self, recorder: &mut Recorder<'_>, camera: &Camera, view: &Buffer<f32>) {
        let params = self.own(recorder, camera, view);
        let Self { nearest, owner, .. } = self;
        let faces = &self.corners.faces;
        let buffers: [&dyn AnyBuffer; 8] =
            [view, faces, nearest, owner, &self.pix_to_face, &self.bary_coords, &self.zbuf, &self.alpha];
        recorder.dispatch(&self.passes[2], &params, &buffers, linear_groups(camera.n_pixels(), 64));
    }

    /// Records `pix_to_face` of the image, and nothing else of it: for those who find the rest where they need it
    /// ([`super::cpu::bary_at`]).
    ///
    /// # Panics
    /// As [`HardRasterizer::forward`].
    pub fn forward_faces(&self, recorder: &mut Recorder<'_>, camera: &Camera, view: &Buffer<f32>) {
        self.own(recorder, camera, view);
        let n = camera.n_pixels();
        let params = [self.corners.n_faces() as u32, n as u32, 0, 0];
        let buffers: [&dyn AnyBuffer; 3] = [&self.nearest, &self.owner, &self.pix_to_face];
        recorder.dispatch(&self.faces, &params, &buffers, linear_groups(n, 64));
    }

    /// Records which face owns each pixel.
    fn own(&self, recorder: &mut Recorder<'_>, camera: &Camera, view: &Buffer<f32>) -> Params {
        let params = self.params(camera, view);
        let Self { nearest, owner, .. } = self;
        let [depth, claim, _] = &self.passes;
        let faces = &self.corners.faces;
        let by_face = linear_groups(self.corners.n_faces(), 64);
        recorder.dispatch(depth, &params, &[view, faces, nearest], by_face);
        recorder.dispatch(claim, &params, &[view, faces, nearest, owner], by_face);
        params
    }

    /// Records `grad_view +=` the gradient through `bary_coords` (and `zbuf`) of the last image.
    ///
    /// # Panics
    /// As [`HardRasterizer::forward`], and when a gradient is shorter than the image.
    pub fn backward(
        &self,
        recorder: &mut Recorder<'_>,
        camera: &Camera,
        view: &Buffer<f32>,
        grad_bary: &Buffer<f32>,
        grad_zbuf: Option<&Buffer<f32>>,
        grad_view: &Buffer<f32>,
    ) {
        let params = self.params(camera, view);
        assert!(grad_bary.len() >= camera.n_pixels() * 3, "{}: length", grad_bary.label());
        assert!(grad_zbuf.is_none_or(|g| g.len() >= camera.n_pixels()), "hard_rasterize: length of grad_zbuf");
        let kernel = if grad_zbuf.is_some() { &self.backward_zbuf } else { &self.backward };
        let buffers: [&dyn AnyBuffer; 6] = [
            view,
            &self.corners.faces,
            &self.pix_to_face,
            grad_bary,
            // Without a gradient the kernel reads nothing there.
            grad_zbuf.unwrap_or(grad_bary),
            &self.grad_corners,
        ];
        recorder.dispatch(kernel, &params, &buffers, linear_groups(self.corners.n_faces(), 64));
        self.corners.gather(recorder, &self.grad_corners, grad_view);
    }

    /// Records `grad_view +=` the gradient through the places in the image of the points that pixels show:
    /// `grad_screen [H, W, 2]`, per pixel of motion to the right and down.
    ///
    /// # Panics
    /// As [`HardRasterizer::forward`], and when the gradient is shorter than the image.
    pub fn screen_backward(
        &self,
        recorder: &mut Recorder<'_>,
        camera: &Camera,
        view: &Buffer<f32>,
        grad_screen: &Buffer<f32>,
        grad_view: &Buffer<f32>,
    ) {
        let params = self.params(camera, view);
        assert!(grad_screen.len() >= camera.n_pixels() * 2, "{}: length", grad_screen.label());
        let buffers: [&dyn AnyBuffer; 5] =
            [view, &self.corners.faces, &self.pix_to_face, grad_screen, &self.grad_corners];
        recorder.dispatch(&self.screen_backward, &params, &buffers, linear_groups(self.corners.n_faces(), 64));
        self.corners.gather(recorder, &self.grad_corners, grad_view);
    }

    /// Records `image [H, W, 3]`: the last image with one colour a face.
    ///
    /// # Panics
    /// When a buffer is too short.
    pub fn shade(
        &self,
        recorder: &mut Recorder<'_>,
        camera: &Camera,
        face_colours: &Buffer<f32>,
        background: [f32; 3],
        image: &Buffer<f32>,
    ) {
        assert!(
            camera.n_pixels() <= self.max_pixels,
            "hard_rasterize: {camera:?} has more than {} pixels",
            self.max_pixels
        );
        assert_eq!(face_colours.len(), self.corners.n_faces() * 3, "{}: length", face_colours.label());
        assert!(image.len() >= camera.n_pixels() * 3, "{}: length", image.label());
        let params = ShadeParams { n_pixels: camera.n_pixels() as u32, background };
        let groups = linear_groups(camera.n_pixels(), 64);
        recorder.dispatch(&self.shade, &params, &[&self.pix_to_face, face_colours, image], groups);
    }

    /// Records `grad_face_colours += Σ grad_image` over the pixels of each face; `view` as for the image.
    ///
    /// # Panics
    /// As [`HardRasterizer::shade`].
    pub fn shade_backward(
        &self,
        recorder: &mut Recorder<'_>,
        camera: &Camera,
        view: &Buffer<f32>,
        grad_image: &Buffer<f32>,
        grad_face_colours: &Buffer<f32>,
    ) {
        let params = self.params(camera, view);
        assert_eq!(grad_face_colours.len(), self.corners.n_faces() * 3, "{}: length", grad_face_colours.label());
        assert!(grad_image.len() >= camera.n_pixels() * 3, "{}: length", grad_image.label());
        let buffers: [&dyn AnyBuffer; 5] =
            [view, &self.corners.faces, &self.pix_to_face, grad_image, grad_face_colours];
        recorder.dispatch(&self.shade_backward, &params, &buffers, linear_groups(self.corners.n_faces(), 64));
    }
}
