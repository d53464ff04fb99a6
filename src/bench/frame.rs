//! The operators on one frame.

use std::sync::Arc;

use super::Case;
use super::person::{Person, extent};
use super::scale::{Counts, Scale, count_fragments};
use crate::avatar::RenderError;
use crate::body::{Body, N_JOINTS, N_POSE};
use crate::camera::Camera;
use crate::fit::FitConfig;
use crate::gpu::{Buffer, Gpu, GpuError, Recorder};
use crate::ops::hard_rasterize::{HardRasterizeConfig, HardRasterizer};
use crate::ops::interpolate::{Interpolate, Sampling};
use crate::ops::skinning::{PoseAt, PoseState, ShapeState, SkinningBody};
use crate::ops::soft_rasterize::{SoftRasterizeParams, SoftRasterizer};
use crate::ops::texture_field::{TextureField, TextureFieldConfig, TextureFieldError, TextureFieldParams};
use crate::ops::{Corners, Topology};

/// Metres around the person that the soft rasteriser's depths span.
const DEPTH_M: [f64; 2] = [1.5, 4.5];

/// The most pixels that the texture is asked for at once: what the smallest allowed binding of its activations holds.
const MAX_LISTED: usize = 1 << 20;

/// Where a gradient goes or comes from; what it holds does not matter to the time, but zeros would be skipped.
struct Gradients {
    vertices: Buffer<f32>,
    joints: Buffer<f32>,
    poses: Buffer<f32>,
    transl: Buffer<f32>,
    betas: Buffer<f32>,
    offsets: Buffer<f32>,
    face_colours: Buffer<f32>,
    image: Buffer<f32>,
    rgb: Buffer<f32>,
    coords: Buffer<f32>,
    texcoords: Buffer<f32>,
}

/// One frame of a fit at a [`Scale`] on the device: each operator with the inputs that it has there, so that it can be timed alone.
pub struct Frame {
    camera: Camera,
    soft_params: SoftRasterizeParams,
    skinning: SkinningBody,
    shape: ShapeState,
    posed: PoseState,
    corners: Arc<Corners>,
    hard: HardRasterizer,
    soft: SoftRasterizer,
    interpolate: Interpolate,
    texture: TextureField,
    betas: Buffer<f32>,
    offsets: Buffer<f32>,
    poses: Buffer<f32>,
    transl: Buffer<f32>,
    face_colours: Buffer<f32>,
    texcoords: Buffer<f32>,
    image: Buffer<f32>,
    grad: Gradients,
    scale: Scale,
}

impl Frame {
    /// `body` seen by a camera of `size` × `size` pixels. Runs each operator once.
    pub fn new(gpu: &Gpu, body: &Body, size: u32) -> Result<Self, FrameError> {
        let Person { camera, pose, transl } = Person::new(body, size);
        let n_pixels = camera.n_pixels();
        let topology = Topology::new(body.n_vertices(), &body.faces);
        let corners = Arc::new(Corners::new(gpu, &body.faces, &topology));
        let skinning = SkinningBody::new(gpu, body);
        let texture_config = TextureFieldConfig::default();
        let texture_params = TextureFieldParams::random(&texture_config, 1);
        let n_listed = n_pixels.min(MAX_LISTED);
        let soft_params = soft_params(size);
        let list_capacity = SoftRasterizer::list_capacity(body.n_faces(), n_pixels);
        let mut frame = Self {
            shape: skinning.shape_state(gpu),
            posed: skinning.pose_state(gpu),
            hard: HardRasterizer::new(gpu, &corners, n_pixels, HardRasterizeConfig::default()),
            soft: SoftRasterizer::new(gpu, &corners, n_pixels, list_capacity),
            interpolate: Interpolate::new(gpu, n_pixels, n_listed, body.n_vertices()),
            texture: TextureField::new(gpu, texture_config, &texture_params, n_listed)?,
            betas: gpu.zeros("bench/betas", body.n_betas),
            offsets: gpu.zeros("bench/offsets", 3 * body.n_vertices()),
            poses: gpu.upload("bench/poses", &pose),
            transl: gpu.upload("bench/transl", &transl),
            face_colours: gpu.upload("bench/face_colours", &vec![0.5; 3 * body.n_faces()]),
            texcoords: gpu.upload("bench/texcoords", &unit_box(body)),
            image: gpu.zeros("bench/image", 3 * n_pixels),
            grad: gradients(gpu, body, n_pixels),
            scale: scale(body, n_pixels, &texture_config),
            camera,
            soft_params,
            skinning,
            corners,
        };
        // Each operator reads what those before it left.
        let mut recorder = gpu.recorder("bench/frame");
        for case in frame.cases() {
            (case.record)(&mut recorder);
        }
        recorder.submit()?;
        frame.scale.covered = f64::from(gpu.read(&frame.interpolate.count)?[0]);
        let view = gpu.read(&frame.posed.vertices)?;
        [frame.scale.hard_fragments, frame.scale.soft_fragments] =
            count_fragments(&view, &body.faces, &frame.camera, frame.soft_params.reach_px());
        Ok(frame)
    }

    pub fn scale(&self) -> Scale {
        self.scale
    }

    pub fn cases(&self) -> Vec<Case<'_>> {
        let mut cases = Vec::from(self.skinning_cases());
        cases.extend(self.raster_cases());
        cases.extend(self.interpolate_cases());
        cases.extend(self.texture_cases());
        cases
    }

    fn skinning_cases(&self) -> [Case<'_>; 2] {
        let at = PoseAt { poses: &self.poses, transl: &self.transl, frame: 0 };
        let grad = PoseAt { poses: &self.grad.poses, transl: &self.grad.transl, frame: 0 };
        let forward = self.scale.skinning();
        let backward = Counts { flops: 2.0 * forward.flops, ..forward };
        [
            case("skinning/forward", forward, move |recorder| {
                self.skinning.shape_forward(recorder, &self.betas, &self.offsets, &self.shape);
                self.skinning.pose_forward(recorder, &self.shape, at, &self.posed);
            }),
            case("skinning/backward", backward, move |recorder| {
                let (shape, g) = (&self.shape, &self.grad);
                self.skinning.pose_backward(recorder, shape, at, &self.posed, &g.vertices, &g.joints, grad);
                self.skinning.shape_backward(recorder, shape, &g.betas, &g.offsets);
            }),
        ]
    }

    fn raster_cases(&self) -> [Case<'_>; 4] {
        let (view, scale) = (&self.posed.vertices, self.scale);
        let (soft, params, colours, grad) = (&self.soft, &self.soft_params, &self.face_colours, &self.grad);
        [
            case("hard_rasterize/forward", scale.hard_forward(), move |recorder| {
                self.hard.forward(recorder, &self.camera, view);
            }),
            case("hard_rasterize/backward", scale.hard_backward(), move |recorder| {
                self.hard.backward(recorder, &self.camera, view, &grad.image, None, &grad.vertices);
            }),
            case("soft_rasterize/forward", scale.soft_forward(), move |recorder| {
                soft.forward(recorder, params, &self.camera, view, colours, Some(&self.hard.zbuf));
            }),
            case("soft_rasterize/backward", scale.soft_backward(), move |recorder| {
                let (g_view, g_colours) = (&grad.vertices, &grad.face_colours);
                soft.backward(recorder, params, &self.camera, colours, &grad.image, None, g_view, g_colours);
            }),
        ]
    }

    fn interpolate_cases(&self) -> [Case<'_>; 4] {
        let (n, scale) = (self.camera.n_pixels(), self.scale);
        let (op, faces, grad) = (&self.interpolate, &self.corners.faces, &self.grad);
        let (pix_to_face, bary) = (&self.hard.pix_to_face, &self.hard.bary_coords);
        [
            case("interpolate/forward", scale.interpolate_forward(), move |recorder| {
                op.forward(recorder, n, pix_to_face, bary, faces, &self.texcoords, Sampling::ALL);
            }),
            case("interpolate/scatter", scale.interpolate_scatter(), move |recorder| {
                op.scatter(recorder, n, &self.texture.rgb, [1.0; 3], &self.image);
            }),
            case("interpolate/gather", scale.interpolate_gather(), move |recorder| {
                op.gather(recorder, n, &grad.image, &grad.rgb);
            }),
            case("interpolate/backward", scale.interpolate_backward(), move |recorder| {
                op.backward(recorder, n, pix_to_face, bary, faces, &grad.coords, &grad.texcoords);
            }),
        ]
    }

    fn texture_cases(&self) -> [Case<'_>; 2] {
        let (op, list, grad) = (&self.texture, &self.interpolate, &self.grad);
        let n = list.n_max(self.camera.n_pixels());
        [
            case("texture_field/forward", self.scale.texture_forward(), move |recorder| {
                op.forward(recorder, &list.coords, &list.count, n);
            }),
            case("texture_field/backward", self.scale.texture_backward(), move |recorder| {
                op.backward(recorder, &list.coords, &list.count, n, &grad.rgb, &grad.coords);
                op.settle(recorder);
            }),
        ]
    }
}

/// Why a frame could not be set up.
#[derive(Debug, thiserror::Error)]
pub enum FrameError {
    #[error(transparent)]
    Gpu(#[from] GpuError),
    #[error(transparent)]
    Texture(#[from] TextureFieldError),
    #[error(transparent)]
    Render(#[from] RenderError),
}

fn case<'a>(name: &'static str, needs: Counts, record: impl Fn(&mut Recorder<'_>) + 'a) -> Case<'a> {
    Case { name, needs, record: Box::new(record) }
}

/// Those of the fits' last geometry phase.
fn soft_params(size: u32) -> SoftRasterizeParams {
    let phases = FitConfig::standard(0).geometry.phases;
    let phase = phases.last().expect("standard has phases");
    let [near, far] = DEPTH_M;
    SoftRasterizeParams {
        sigma: phase.sigma.into(),
        gamma: f64::from(phase.depth_softness_m) / (far - near),
        cut: phase.cut.into(),
        near,
        far,
        ..SoftRasterizeParams::new(size, size)
    }
}

/// What is known before anything is drawn.
fn scale(body: &Body, n_pixels: usize, texture: &TextureFieldConfig) -> Scale {
    Scale {
        vertices: body.n_vertices() as f64,
        faces: body.n_faces() as f64,
        betas: body.n_betas as f64,
        pixels: n_pixels as f64,
        covered: 0.0,
        hard_fragments: 0.0,
        soft_fragments: 0.0,
        levels: texture.n_levels as f64,
        encoded: texture.encoded_width() as f64,
        hidden: texture.hidden_width as f64,
    }
}

/// The template scaled into the unit cube.
pub(super) fn unit_box(body: &Body) -> Vec<f32> {
    let bounds = [0, 1, 2].map(|axis| extent(&body.v_template, axis));
    let side = bounds.iter().map(|[low, high]| high - low).fold(0.0, f32::max);
    body.v_template.iter().flat_map(|v| [0, 1, 2].map(|axis| (v[axis] - bounds[axis][0]) / side)).collect()
}

fn gradients(gpu: &Gpu, body: &Body, n_pixels: usize) -> Gradients {
    let ones = |name: &str, len: usize| gpu.upload(&format!("bench/grad_{name}"), &vec![1.0f32; len]);
    let (v, f) = (body.n_vertices(), body.n_faces());
    Gradients {
        vertices: ones("vertices", 3 * v),
        joints: ones("joints", 3 * N_JOINTS),
        poses: ones("poses", N_POSE),
        transl: ones("transl", 3),
        betas: ones("betas", body.n_betas),
        offsets: ones("offsets", 3 * v),
        face_colours: ones("face_colours", 3 * f),
        image: ones("image", 3 * n_pixels),
        rgb: ones("rgb", 3 * n_pixels),
        coords: ones("coords", 3 * n_pixels),
        texcoords: ones("texcoords", 3 * v),
    }
}
