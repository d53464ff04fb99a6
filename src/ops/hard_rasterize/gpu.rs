//! Host side of `shaders/hard_rasterize/`.

use std::sync::Arc;

use super::HardRasterizeConfig;
use super::nearest::Nearest;
use super::owned::{Each, Owned};
use crate::camera::Camera;
use crate::gpu::{AnyBuffer, Buffer, Gpu, Kernel, Recorder, linear_groups};
use crate::ops::Corners;
use crate::ops::fill::Fill;

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
pub(super) struct Params {
    n_faces: u32,
    width: u32,
    height: u32,
    near: f32,
    fx: f32,
    fy: f32,
    cx: f32,
    cy: f32,
}

impl Params {
    pub fn n_pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }
}

/// A rasteriser for one mesh and images of up to `max_pixels`. A call uses the start of each image buffer.
pub struct HardRasterizer {
    corners: Arc<Corners>,
    config: HardRasterizeConfig,
    max_pixels: usize,
    nearest: Nearest,
    list: Arc<Kernel>,
    resolve: Arc<Kernel>,
    faces: Arc<Kernel>,
    backward: Arc<Kernel>,
    backward_zbuf: Arc<Kernel>,
    screen_backward: Arc<Kernel>,
    shade: Arc<Kernel>,
    shade_backward: Arc<Kernel>,
    fill: Fill,
    owned: Owned,
    grad_corners: Buffer<f32>,
    pub pix_to_face: Buffer<i32>,
    pub bary_coords: Buffer<f32>,
    pub zbuf: Buffer<f32>,
    pub alpha: Buffer<f32>,
}

impl HardRasterizer {
    pub fn new(gpu: &Gpu, corners: &Arc<Corners>, max_pixels: usize, config: HardRasterizeConfig) -> Self {
        Self::with_passes(gpu, corners, max_pixels, config, gpu.info().wide_atomics)
    }

    /// As [`HardRasterizer::new`], with the nearest faces found in one pass or in two.
    pub(super) fn with_passes(
        gpu: &Gpu,
        corners: &Arc<Corners>,
        max_pixels: usize,
        config: HardRasterizeConfig,
        wide: bool,
    ) -> Self {
        let nearest = Nearest::new(gpu, max_pixels, config.cull_back, wide);
        Self {
            list: kernel!(gpu, "hard_rasterize/list", &nearest.constants()),
            resolve: kernel!(gpu, "hard_rasterize/resolve"),
            faces: kernel!(gpu, "hard_rasterize/faces", &nearest.constants()),
            backward: kernel!(gpu, "hard_rasterize/backward"),
            backward_zbuf: kernel!(gpu, "hard_rasterize/backward", &[("HAS_GRAD_ZBUF", "true".to_owned())]),
            screen_backward: kernel!(gpu, "hard_rasterize/screen_backward"),
            shade: kernel!(gpu, "hard_rasterize/shade"),
            shade_backward: kernel!(gpu, "hard_rasterize/shade_backward"),
            nearest,
            fill: Fill::new(gpu),
            owned: Owned::new(gpu, max_pixels, corners.n_faces()),
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
        let params = self.params(camera, view);
        let n = camera.n_pixels();
        let Self { owned, pix_to_face, bary_coords, zbuf, alpha, .. } = self;
        owned.clear(recorder);
        recorder.clear_front(bary_coords, 3 * n);
        recorder.clear_front(alpha, n);
        self.nearest.record(recorder, &params, view, &self.corners);
        let buffers: [&dyn AnyBuffer; 5] = [self.nearest.owners(), pix_to_face, zbuf, &owned.counts, &owned.pixels];
        self.by_fours(recorder, &self.list, n, &buffers);
        owned.count(recorder, Each::Pixel);
        let faces = &self.corners.faces;
        let lists = [&owned.counts, &owned.pixels, &owned.owns, &owned.faces];
        let buffers: [&dyn AnyBuffer; 6] = [view, faces, pix_to_face, bary_coords, zbuf, alpha];
        let buffers: Vec<&dyn AnyBuffer> =
            buffers.into_iter().chain(lists.map(|list| list as &dyn AnyBuffer)).collect();
        self.each(recorder, Each::Pixel, &self.resolve, &params, &buffers);
        owned.count(recorder, Each::Face);
    }

    /// Records `pix_to_face` of the image, and nothing else of it: for those who find the rest where they need it
    /// ([`super::cpu::bary_at`]). No backward pass may follow.
    ///
    /// # Panics
    /// As [`HardRasterizer::forward`].
    pub fn forward_faces(&self, recorder: &mut Recorder<'_>, camera: &Camera, view: &Buffer<f32>) {
        let params = self.params(camera, view);
        self.nearest.record(recorder, &params, view, &self.corners);
        self.by_fours(recorder, &self.faces, camera.n_pixels(), &[self.nearest.owners(), &self.pix_to_face]);
    }

    /// Records a kernel that takes four of `n` pixels an invocation.
    fn by_fours(&self, recorder: &mut Recorder<'_>, kernel: &Arc<Kernel>, n: usize, buffers: &[&dyn AnyBuffer]) {
        let params = [self.corners.n_faces() as u32, n as u32, 0, 0];
        recorder.dispatch(kernel, &params, buffers, linear_groups(n.div_ceil(4), 64));
    }

    /// Records a kernel for the last image's pixels that show a face, or for the faces that a pixel shows.
    pub(in crate::ops) fn each<P: bytemuck::Pod>(
        &self,
        recorder: &mut Recorder<'_>,
        list: Each,
        kernel: &Arc<Kernel>,
        params: &P,
        buffers: &[&dyn AnyBuffer],
    ) {
        let (groups, at) = self.owned.groups(list);
        recorder.dispatch_indirect(kernel, params, buffers, groups, at);
    }

    /// How many pixels of the last image show a face, and which.
    pub(in crate::ops) fn owned_pixels(&self) -> [&dyn AnyBuffer; 2] {
        [&self.owned.counts, &self.owned.pixels]
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
        let Self { owned, pix_to_face, grad_corners, .. } = self;
        // Without a gradient the kernel reads nothing there.
        let grad_zbuf = grad_zbuf.unwrap_or(grad_bary);
        let faces = &self.corners.faces;
        let buffers: [&dyn AnyBuffer; 8] =
            [view, faces, pix_to_face, grad_bary, grad_zbuf, grad_corners, &owned.counts, &owned.faces];
        recorder.clear(grad_corners);
        self.each(recorder, Each::Face, kernel, &params, &buffers);
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
        let Self { owned, pix_to_face, grad_corners, .. } = self;
        let faces = &self.corners.faces;
        let buffers: [&dyn AnyBuffer; 7] =
            [view, faces, pix_to_face, grad_screen, grad_corners, &owned.counts, &owned.faces];
        recorder.clear(grad_corners);
        self.each(recorder, Each::Face, &self.screen_backward, &params, &buffers);
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
        self.fill.record(recorder, camera.n_pixels(), background, image);
        let Owned { counts, pixels, .. } = &self.owned;
        let buffers: [&dyn AnyBuffer; 5] = [counts, pixels, &self.pix_to_face, face_colours, image];
        self.each(recorder, Each::Pixel, &self.shade, &[camera.n_pixels() as u32, 0, 0, 0], &buffers);
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
        let (faces, Owned { counts, faces: owners, .. }) = (&self.corners.faces, &self.owned);
        let buffers: [&dyn AnyBuffer; 7] =
            [view, faces, &self.pix_to_face, grad_image, grad_face_colours, counts, owners];
        self.each(recorder, Each::Face, &self.shade_backward, &params, &buffers);
    }
}
