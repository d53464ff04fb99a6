//! Host side of `shaders/soft_rasterize/`.

use std::sync::Arc;

use super::SoftRasterizeParams;
use crate::camera::Camera;
use crate::gpu::{AnyBuffer, Buffer, Gpu, GpuError, Kernel, Recorder, linear_groups};
use crate::ops::Corners;
use crate::ops::fill::Fill;

/// Side of a tile in pixels.
const TILE: u32 = 4;
/// Classes of sizes: `SIZES` of `shaders/shared/soft_face.wgsl`.
pub(super) const SIZES: usize = 64;

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
    scale: f32,
    depth_scale: f32,
    background: [f32; 3],
}

/// The passes that depend on what is wanted.
struct Passes {
    setup: Arc<Kernel>,
    fill: Arc<Kernel>,
    forward: Arc<Kernel>,
    pixels: Arc<Kernel>,
    backward: Arc<Kernel>,
}

impl Passes {
    /// Hidden faces have a share in the coverage, so `limits` serve colours alone.
    fn new(gpu: &Gpu, coverage: bool) -> Self {
        let wide = gpu.info().wide;
        let tile = ("TILE", format!("{TILE}u"));
        let covers = ("COVERAGE", coverage.to_string());
        let lists = [tile.clone(), ("LIMITED", (!coverage).to_string())];
        Self {
            setup: kernel!(gpu, "soft_rasterize/setup", &lists),
            fill: kernel!(gpu, "soft_rasterize/fill", &lists),
            forward: match wide {
                true => kernel!(gpu, "soft_rasterize/forward_spread", &[tile.clone(), covers.clone()]),
                false => kernel!(gpu, "soft_rasterize/forward", &[tile.clone(), covers.clone()]),
            },
            pixels: kernel!(gpu, "soft_rasterize/pixels", &[tile, covers.clone()]),
            backward: match wide {
                true => kernel!(gpu, "soft_rasterize/backward_spread", &[covers]),
                false => kernel!(gpu, "soft_rasterize/backward", &[covers]),
            },
        }
    }
}

/// A rasteriser for one mesh and images of up to `max_pixels`. A call uses the start of each image buffer.
pub struct SoftRasterizer {
    corners: Arc<Corners>,
    max_pixels: usize,
    limits_pass: Arc<Kernel>,
    scan: Arc<Kernel>,
    order: Arc<Kernel>,
    /// The lists in order, where many cores put them there; else they are put in order where they are.
    ordered: Option<Buffer<u32>>,
    /// With coverage; colours alone.
    with_coverage: Passes,
    colours_alone: Passes,
    records: Buffer<f32>,
    boxes: Buffer<[u32; 2]>,
    counts: Buffer<u32>,
    starts: Buffer<u32>,
    cursors: Buffer<u32>,
    entries: Buffer<u32>,
    limits: Buffer<f32>,
    /// Tiles with a list, faces with a box: how many, then which, those with most to do first; and their workgroups.
    busy: Buffer<u32>,
    drawn: Buffer<u32>,
    workgroups: Buffer<u32>,
    state: Buffer<f32>,
    pixels: Buffer<f32>,
    pixels_rest: Buffer<f32>,
    fill: Fill,
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
        let wide = gpu.info().wide;
        let scan_lanes = format!("{}u", if wide { gpu.info().max_workgroup.min(1024) } else { 256 });
        Self {
            limits_pass: kernel!(gpu, "soft_rasterize/limits", &[("TILE", format!("{TILE}u"))]),
            scan: kernel!(gpu, "soft_rasterize/scan", &[("LANES", scan_lanes)]),
            order: if wide { kernel!(gpu, "soft_rasterize/rank") } else { kernel!(gpu, "soft_rasterize/order") },
            ordered: wide.then(|| gpu.zeros("soft_rasterize/ordered", list_capacity)),
            with_coverage: Passes::new(gpu, true),
            colours_alone: Passes::new(gpu, false),
            records: gpu.zeros("soft_rasterize/records", n_faces * 16),
            boxes: gpu.zeros("soft_rasterize/boxes", n_faces),
            counts: gpu.zeros("soft_rasterize/counts", n_tiles + SIZES),
            starts: gpu.zeros("soft_rasterize/starts", n_tiles + 1),
            cursors: gpu.zeros("soft_rasterize/cursors", n_tiles + SIZES),
            entries: gpu.zeros("soft_rasterize/entries", list_capacity),
            state: gpu.zeros("soft_rasterize/state", max_pixels * 2),
            limits: gpu.zeros("soft_rasterize/limits", n_tiles),
            busy: gpu.zeros("soft_rasterize/busy", n_tiles + 1),
            drawn: gpu.zeros("soft_rasterize/drawn", n_faces + 1),
            workgroups: gpu.zeros("soft_rasterize/workgroups", 12),
            pixels: gpu.zeros("soft_rasterize/pixels", max_pixels * 4),
            pixels_rest: gpu.zeros("soft_rasterize/pixels_rest", max_pixels * 2),
            fill: Fill::new(gpu),
            grad_corners: gpu.zeros("soft_rasterize/grad_corners", n_faces * 9),
            rgb: gpu.zeros("soft_rasterize/rgb", max_pixels * 3),
            alpha: gpu.zeros("soft_rasterize/alpha", max_pixels),
            corners: corners.clone(),
            max_pixels,
        }
    }

    /// Entries that serve `n_faces` faces of a person who fills a picture of `n_pixels`, with room to spare: a reach is a part of
    /// the picture, and so are faces. Counted a face, of a made person in a picture of this side: `paper` 20 at 1080 and 66 to 72 at
    /// 2160, the coarse phase of `standard` 33 at 2160 and 77 to 86 at 3600.
    pub fn list_capacity(n_faces: usize, n_pixels: usize) -> usize {
        n_faces * (64 + (n_pixels >> 14)) + 4096
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
            n_tiles as usize <= self.limits.len(),
            "soft_rasterize: {camera:?} has more than {} tiles",
            self.limits.len()
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
            scale: params.sigma.powf(-0.5) as f32,
            depth_scale: ((params.far - params.near) * params.gamma).recip() as f32,
            background: params.background.map(|x| x as f32),
        }
    }

    /// Where in `workgroups` those of the tiles with a list and of the drawn faces stand: where many cores run side by side one
    /// takes an item, else 64 do.
    fn workgroups_at(&self) -> [usize; 2] {
        if self.ordered.is_some() { [0, 3] } else { [6, 9] }
    }

    fn passes(&self, coverage: bool) -> &Passes {
        if coverage { &self.with_coverage } else { &self.colours_alone }
    }

    /// Records the image into `rgb` and `alpha`; with `surface`, the `zbuf` of the hard image of the same view, `rgb`
    /// alone.
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
        surface: Option<&Buffer<f32>>,
    ) {
        assert_eq!(view.len(), self.corners.n_vertices() * 3, "{}: length", view.label());
        assert_eq!(face_colours.len(), self.corners.n_faces() * 3, "{}: length", face_colours.label());
        let params = self.params(params, camera);
        let Self { records, boxes, counts, starts, cursors, entries, limits, busy, drawn, workgroups, .. } = self;
        let passes = self.passes(surface.is_none());
        let by_face = linear_groups(self.corners.n_faces(), 64);
        // Where no face is near.
        self.fill.record(recorder, camera.n_pixels(), params.background, &self.rgb);
        match surface {
            Some(zbuf) => {
                assert!(zbuf.len() >= camera.n_pixels(), "{}: length", zbuf.label());
                let groups = linear_groups(params.n_tiles as usize, 64);
                recorder.dispatch(&self.limits_pass, &params, &[zbuf, limits], groups);
            }
            None => recorder.clear(&self.alpha),
        }
        let buffers: [&dyn AnyBuffer; 6] = [view, &self.corners.faces, records, boxes, counts, limits];
        recorder.dispatch(&passes.setup, &params, &buffers, by_face);
        let buffers: [&dyn AnyBuffer; 6] = [counts, starts, cursors, busy, drawn, workgroups];
        recorder.dispatch(&self.scan, &params, &buffers, [1, 1, 1]);
        recorder.dispatch(&passes.fill, &params, &[boxes, cursors, entries, records, limits, drawn], by_face);
        let at = self.workgroups_at()[0];
        let entries = match &self.ordered {
            Some(ordered) => {
                let buffers: [&dyn AnyBuffer; 4] = [starts, busy, entries, ordered];
                recorder.dispatch_indirect(&self.order, &params, &buffers, workgroups, at);
                ordered
            }
            None => {
                recorder.dispatch_indirect(&self.order, &params, &[starts, busy, entries], workgroups, at);
                entries
            }
        };
        let buffers: [&dyn AnyBuffer; 8] =
            [records, face_colours, starts, entries, &self.rgb, &self.alpha, &self.state, busy];
        recorder.dispatch_indirect(&passes.forward, &params, &buffers, workgroups, at);
    }

    /// Records `grad_view +=` and `grad_face_colours +=` the gradients through the last image. Without `grad_alpha`, or
    /// after an image of colours alone, through its colours.
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
        grad_alpha: Option<&Buffer<f32>>,
        grad_view: &Buffer<f32>,
        grad_face_colours: &Buffer<f32>,
    ) {
        let n_pixels = camera.n_pixels();
        assert!(grad_rgb.len() >= n_pixels * 3, "{}: length", grad_rgb.label());
        assert!(grad_alpha.is_none_or(|g| g.len() >= n_pixels), "soft_rasterize: length of grad_alpha");
        assert_eq!(face_colours.len(), self.corners.n_faces() * 3, "{}: length", face_colours.label());
        assert_eq!(grad_face_colours.len(), face_colours.len(), "{}: length", grad_face_colours.label());
        let params = self.params(params, camera);
        let Self { records, boxes, pixels, pixels_rest, busy, drawn, workgroups, grad_corners, .. } = self;
        let passes = self.passes(grad_alpha.is_some());
        // Without a gradient the kernel reads nothing there.
        let grad_alpha = grad_alpha.unwrap_or(grad_rgb);
        let buffers: [&dyn AnyBuffer; 7] = [&self.state, &self.rgb, grad_rgb, grad_alpha, pixels, pixels_rest, busy];
        recorder.dispatch_indirect(&passes.pixels, &params, &buffers, workgroups, 0);
        recorder.clear(grad_corners);
        let buffers: [&dyn AnyBuffer; 8] =
            [records, boxes, face_colours, pixels, pixels_rest, drawn, grad_corners, grad_face_colours];
        recorder.dispatch_indirect(&passes.backward, &params, &buffers, workgroups, self.workgroups_at()[1]);
        self.corners.gather(recorder, grad_corners, grad_view);
    }

    /// Entries that the last image's tile lists needed, against the capacity. Reads back: for diagnosis, not for a loop.
    pub fn list_length(&self, gpu: &Gpu, camera: &Camera) -> Result<(usize, usize), GpuError> {
        let n_tiles = camera.width.div_ceil(TILE) * camera.height.div_ceil(TILE);
        Ok((gpu.read(&self.starts)?[n_tiles as usize] as usize, self.entries.len()))
    }
}
