//! Host side of `shaders/soft_rasterize/`.

use std::sync::Arc;

use super::SoftRasterizeParams;
use crate::camera::Camera;
use crate::gpu::{AnyBuffer, Buffer, Gpu, GpuError, Kernel, Recorder, linear_groups};
use crate::ops::Corners;

/// Side of a tile in pixels.
const TILE: u32 = 4;

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    n_faces: u32,
    width: u32,
    height: u32,
    tiles_x: u32,
    n_tiles: u32,
    capacity: u32,
    fx: f32,
    fy: f32,
    cx: f32,
    cy: f32,
    norm_px: f32,
    sigma: f32,
    gamma: f32,
    eps: f32,
    near: f32,
    far: f32,
    cut: f32,
    background: [f32; 3],
}

/// A rasteriser for one mesh and images of up to `max_pixels`. A call uses the start of each image buffer.
pub struct SoftRasterizer {
    corners: Arc<Corners>,
    max_pixels: usize,
    setup: Arc<Kernel>,
    scan: Arc<Kernel>,
    fill: Arc<Kernel>,
    forward: Arc<Kernel>,
    pixels_pass: Arc<Kernel>,
    backward: Arc<Kernel>,
    records: Buffer<f32>,
    boxes: Buffer<[u32; 2]>,
    counts: Buffer<u32>,
    starts: Buffer<u32>,
    cursors: Buffer<u32>,
    entries: Buffer<u32>,
    state: Buffer<f32>,
    pixels: Buffer<f32>,
    gates: Buffer<f32>,
    grad_corners: Buffer<f32>,
    /// `[H, W, 3]`.
    pub rgb: Buffer<f32>,
    /// `[H, W]`.
    pub alpha: Buffer<f32>,
}

/// Tiles of any image of `max_pixels`, which may be a single row.
fn max_tiles(max_pixels: usize) -> usize {
    max_pixels.div_ceil(TILE as usize) + 1
}

impl SoftRasterizer {
    /// `list_capacity` bounds the tile lists together; see [`SoftRasterizer::list_capacity`].
    pub fn new(gpu: &Gpu, corners: &Arc<Corners>, max_pixels: usize, list_capacity: usize) -> Self {
        let n_faces = corners.n_faces();
        let n_tiles = max_tiles(max_pixels);
        let tile = [("TILE", format!("{TILE}u"))];
        // A subgroup's width there.
        let lanes = if gpu.info().software { "8u" } else { "32u" };
        Self {
            setup: kernel!(gpu, "soft_rasterize/setup", &tile),
            scan: kernel!(gpu, "soft_rasterize/scan"),
            fill: kernel!(gpu, "soft_rasterize/fill", &tile),
            forward: kernel!(gpu, "soft_rasterize/forward", &[tile[0].clone(), ("LANES", lanes.to_owned())]),
            pixels_pass: kernel!(gpu, "soft_rasterize/pixels"),
            backward: kernel!(gpu, "soft_rasterize/backward"),
            records: gpu.zeros("soft_rasterize/records", n_faces * 16),
            boxes: gpu.zeros("soft_rasterize/boxes", n_faces),
            counts: gpu.zeros("soft_rasterize/counts", n_tiles),
            starts: gpu.zeros("soft_rasterize/starts", n_tiles + 1),
            cursors: gpu.zeros("soft_rasterize/cursors", n_tiles),
            entries: gpu.zeros("soft_rasterize/entries", list_capacity),
            state: gpu.zeros("soft_rasterize/state", max_pixels * 2),
            pixels: gpu.zeros("soft_rasterize/pixels", max_pixels * 8),
            gates: gpu.zeros("soft_rasterize/gates", max_pixels),
            grad_corners: gpu.zeros("soft_rasterize/grad_corners", n_faces * 9),
            rgb: gpu.zeros("soft_rasterize/rgb", max_pixels * 3),
            alpha: gpu.zeros("soft_rasterize/alpha", max_pixels),
            corners: corners.clone(),
            max_pixels,
        }
    }

    /// Entries that serve `n_faces` faces of a few pixels, when colours reach `reach_px` over their borders
    /// ([`SoftRasterizeParams::reach_px`]).
    pub fn list_capacity(n_faces: usize, reach_px: f64) -> usize {
        let tiles = (2.0 * reach_px + 7.0) / f64::from(TILE);
        (n_faces as f64 * tiles * tiles) as usize + 4096
    }

    fn params(&self, params: &SoftRasterizeParams, camera: &Camera) -> Params {
        let &Camera { width, height, .. } = camera;
        assert!(
            camera.n_pixels() <= self.max_pixels,
            "soft_rasterize: {camera:?} has more than {} pixels",
            self.max_pixels
        );
        assert!(width < 1 << 16 && height < 1 << 16, "soft_rasterize: {camera:?} is too long");
        let tiles_x = width.div_ceil(TILE);
        let n_tiles = tiles_x * height.div_ceil(TILE);
        assert!(
            n_tiles as usize <= self.counts.len(),
            "soft_rasterize: {camera:?} has more than {} tiles",
            self.counts.len()
        );
        Params {
            n_faces: self.corners.n_faces() as u32,
            width,
            height,
            tiles_x,
            n_tiles,
            capacity: self.entries.len() as u32,
            fx: camera.fx as f32,
            fy: camera.fy as f32,
            cx: camera.cx as f32,
            cy: camera.cy as f32,
            norm_px: params.norm_px as f32,
            sigma: params.sigma as f32,
            gamma: params.gamma as f32,
            eps: params.eps as f32,
            near: params.near as f32,
            far: params.far as f32,
            cut: params.cut as f32,
            background: params.background.map(|x| x as f32),
        }
    }

    /// Records the image into `rgb` and `alpha`.
    ///
    /// # Panics
    /// When the image is larger than this rasteriser was made for, or a buffer does not fit the mesh.
    pub fn forward(
        &self,
        recorder: &mut Recorder<'_>,
        params: &SoftRasterizeParams,
        camera: &Camera,
        view: &Buffer<f32>,
        face_colours: &Buffer<f32>,
    ) {
        assert_eq!(view.len(), self.corners.n_vertices() * 3, "{}: length", view.label());
        assert_eq!(face_colours.len(), self.corners.n_faces() * 3, "{}: length", face_colours.label());
        let params = self.params(params, camera);
        let Self { records, boxes, counts, starts, cursors, entries, .. } = self;
        let by_face = linear_groups(self.corners.n_faces(), 64);
        let by_tile = linear_groups(params.n_tiles as usize, 1);
        recorder.dispatch(&self.setup, &params, &[view, &self.corners.faces, records, boxes, counts], by_face);
        recorder.dispatch(&self.scan, &params, &[counts, starts, cursors], [1, 1, 1]);
        recorder.dispatch(&self.fill, &params, &[boxes, cursors, entries], by_face);
        let buffers: [&dyn AnyBuffer; 7] =
            [records, face_colours, starts, entries, &self.rgb, &self.alpha, &self.state];
        recorder.dispatch(&self.forward, &params, &buffers, by_tile);
    }

    /// Records `grad_view +=` and `grad_face_colours +=` the gradients through the last image.
    ///
    /// # Panics
    /// As [`SoftRasterizer::forward`], and when a gradient is shorter than the image.
    #[expect(clippy::too_many_arguments, reason = "the contract's buffers, in its order")]
    pub fn backward(
        &self,
        recorder: &mut Recorder<'_>,
        params: &SoftRasterizeParams,
        camera: &Camera,
        face_colours: &Buffer<f32>,
        grad_rgb: &Buffer<f32>,
        grad_alpha: &Buffer<f32>,
        grad_view: &Buffer<f32>,
        grad_face_colours: &Buffer<f32>,
    ) {
        let n_pixels = camera.n_pixels();
        assert!(grad_rgb.len() >= n_pixels * 3, "{}: length", grad_rgb.label());
        assert!(grad_alpha.len() >= n_pixels, "{}: length", grad_alpha.label());
        assert_eq!(face_colours.len(), self.corners.n_faces() * 3, "{}: length", face_colours.label());
        assert_eq!(grad_face_colours.len(), face_colours.len(), "{}: length", grad_face_colours.label());
        let params = self.params(params, camera);
        let Self { records, boxes, pixels, gates, grad_corners, .. } = self;
        let buffers: [&dyn AnyBuffer; 6] = [&self.state, &self.rgb, grad_rgb, grad_alpha, pixels, gates];
        recorder.dispatch(&self.pixels_pass, &params, &buffers, linear_groups(n_pixels, 64));
        let buffers: [&dyn AnyBuffer; 7] =
            [records, boxes, face_colours, pixels, gates, grad_corners, grad_face_colours];
        recorder.dispatch(&self.backward, &params, &buffers, linear_groups(self.corners.n_faces(), 64));
        self.corners.gather(recorder, grad_corners, grad_view);
    }

    /// Entries that the last image's tile lists needed, against the capacity. Reads back: for diagnosis, not for a loop.
    pub fn list_length(&self, gpu: &Gpu, camera: &Camera) -> Result<(usize, usize), GpuError> {
        let n_tiles = camera.width.div_ceil(TILE) * camera.height.div_ceil(TILE);
        Ok((gpu.read(&self.starts)?[n_tiles as usize] as usize, self.entries.len()))
    }
}
