//! The operators on one frame: a body in the T-pose three metres before the camera, as large as the image allows.

use std::f32::consts::PI;
use std::sync::Arc;

use anyhow::Result;
use effigy::body::{Body, N_JOINTS};
use effigy::camera::Camera;
use effigy::gpu::{Buffer, Gpu};
use effigy::ops::hard_rasterize::{HardRasterizeConfig, HardRasterizer};
use effigy::ops::interpolate::{Interpolate, Sampling};
use effigy::ops::skinning::{PoseAt, PoseState, ShapeState, SkinningBody};
use effigy::ops::soft_rasterize::{SoftRasterizeParams, SoftRasterizer};
use effigy::ops::texture_field::{TextureField, TextureFieldConfig, TextureFieldParams};
use effigy::ops::{Corners, Topology};

use super::Case;

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
    alpha: Buffer<f32>,
    rgb: Buffer<f32>,
    coords: Buffer<f32>,
    texcoords: Buffer<f32>,
}

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
    covered: usize,
}

impl Frame {
    pub fn new(gpu: &Gpu, body: &Body, size: u32) -> Result<Self> {
        let s = f64::from(size);
        let camera = Camera::pinhole(size, size, [1.5 * s, 1.5 * s, 0.5 * s, 0.5 * s]);
        let n_pixels = camera.n_pixels();
        let topology = Topology::new(body.n_vertices(), &body.faces);
        let corners = Arc::new(Corners::new(gpu, &body.faces, &topology));
        let skinning = SkinningBody::new(gpu, body);
        // Half a turn about x: from +Y up, facing +Z, to y down, facing the camera.
        let mut poses = vec![0.0; 3 * N_JOINTS];
        poses[0] = PI;
        let texture_config = TextureFieldConfig::default();
        let texture_params = TextureFieldParams::random(&texture_config, 1);
        let mut frame = Self {
            soft_params: SoftRasterizeParams::new(size, size),
            shape: skinning.shape_state(gpu),
            posed: skinning.pose_state(gpu),
            hard: HardRasterizer::new(gpu, &corners, n_pixels, HardRasterizeConfig::default()),
            soft: SoftRasterizer::new(gpu, &corners, n_pixels, 32 * body.n_faces()),
            interpolate: Interpolate::new(gpu, n_pixels, n_pixels),
            texture: TextureField::new(gpu, texture_config, &texture_params, n_pixels)?,
            betas: gpu.zeros("bench/betas", body.n_betas),
            offsets: gpu.zeros("bench/offsets", 3 * body.n_vertices()),
            poses: gpu.upload("bench/poses", &poses),
            transl: gpu.upload("bench/transl", &centred(body, 3.0)),
            face_colours: gpu.upload("bench/face_colours", &vec![0.5; 3 * body.n_faces()]),
            texcoords: gpu.upload("bench/texcoords", &unit_box(body)),
            image: gpu.zeros("bench/image", 3 * n_pixels),
            grad: gradients(gpu, body, n_pixels),
            covered: 0,
            camera,
            skinning,
            corners,
        };
        // Each operator reads what those before it left.
        let mut recorder = gpu.recorder("bench/frame");
        for case in frame.cases() {
            (case.record)(&mut recorder);
        }
        recorder.submit()?;
        frame.covered = gpu.read(&frame.interpolate.count)?[0] as usize;
        Ok(frame)
    }

    /// Pixels with a face.
    pub fn covered(&self) -> usize {
        self.covered
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
        let (v, b) = (self.skinning.n_vertices as f64, self.skinning.n_betas as f64);
        // The directions of shape, four joints with weights, and five points a vertex; blending of four transforms.
        let (bytes, flops) = (v * (12.0 * b + 32.0 + 60.0), v * (6.0 * b + 4.0 * 24.0 + 18.0));
        [
            case("skinning/forward", bytes, Some(flops), move |recorder| {
                self.skinning.shape_forward(recorder, &self.betas, &self.offsets, &self.shape);
                self.skinning.pose_forward(recorder, &self.shape, at, &self.posed);
            }),
            case("skinning/backward", bytes, Some(2.0 * flops), move |recorder| {
                let (shape, g) = (&self.shape, &self.grad);
                self.skinning.pose_backward(recorder, shape, at, &self.posed, &g.vertices, &g.joints, grad);
                self.skinning.shape_backward(recorder, shape, &g.betas, &g.offsets);
            }),
        ]
    }

    fn raster_cases(&self) -> [Case<'_>; 4] {
        let (f, p) = (self.corners.n_faces() as f64, self.camera.n_pixels() as f64);
        let view = &self.posed.vertices;
        let (soft, params, colours, grad) = (&self.soft, &self.soft_params, &self.face_colours, &self.grad);
        [
            case("hard_rasterize/forward", 48.0 * f + 24.0 * p, None, move |recorder| {
                self.hard.forward(recorder, &self.camera, view);
            }),
            case("hard_rasterize/backward", 120.0 * f + 16.0 * p, None, move |recorder| {
                self.hard.backward(recorder, &self.camera, view, &grad.image, None, &grad.vertices);
            }),
            case("soft_rasterize/forward", 60.0 * f + 16.0 * p, None, move |recorder| {
                soft.forward(recorder, params, &self.camera, view, colours);
            }),
            case("soft_rasterize/backward", 108.0 * f + 32.0 * p, None, move |recorder| {
                let (g_view, g_colours) = (&grad.vertices, &grad.face_colours);
                soft.backward(recorder, params, &self.camera, colours, &grad.image, &grad.alpha, g_view, g_colours);
            }),
        ]
    }

    fn interpolate_cases(&self) -> [Case<'_>; 4] {
        let (n, p) = (self.camera.n_pixels(), self.covered as f64);
        let (op, faces, grad) = (&self.interpolate, &self.corners.faces, &self.grad);
        let (pix_to_face, bary) = (&self.hard.pix_to_face, &self.hard.bary_coords);
        [
            case("interpolate/forward", 4.0 * n as f64 + 76.0 * p, Some(18.0 * p), move |recorder| {
                op.forward(recorder, n, pix_to_face, bary, faces, &self.texcoords, Sampling::ALL);
            }),
            case("interpolate/scatter", 12.0 * (n as f64 + p), None, move |recorder| {
                op.scatter(recorder, n, &self.texture.rgb, [1.0; 3], &self.image);
            }),
            case("interpolate/gather", 28.0 * p, None, move |recorder| {
                op.gather(recorder, n, &grad.image, &grad.rgb);
            }),
            case("interpolate/backward", 116.0 * p, Some(18.0 * p), move |recorder| {
                op.backward(recorder, n, pix_to_face, bary, faces, &grad.coords, &grad.texcoords);
            }),
        ]
    }

    fn texture_cases(&self) -> [Case<'_>; 2] {
        let config = self.texture.config();
        let (e, h, l) = (config.encoded_width() as f64, config.hidden_width as f64, config.n_levels as f64);
        let (n, p) = (self.camera.n_pixels(), self.covered as f64);
        let mlp = 2.0 * (e * h + h * h + 3.0 * h);
        let (op, list, grad) = (&self.texture, &self.interpolate, &self.grad);
        // Eight entries of two features a level; the activations pass between the kernels.
        let forward_bytes = p * (24.0 + 64.0 * l + 4.0 * (2.0 * e + 2.0 * h));
        let backward_bytes = p * (48.0 + 3.0 * 64.0 * l + 4.0 * (3.0 * e + 6.0 * h));
        [
            case("texture_field/forward", forward_bytes, Some(p * (mlp + 32.0 * l)), move |recorder| {
                op.forward(recorder, &list.coords, &list.count, n);
            }),
            case("texture_field/backward", backward_bytes, Some(p * (2.0 * mlp + 96.0 * l)), move |recorder| {
                op.backward(recorder, &list.coords, &list.count, n, &grad.rgb, &grad.coords);
            }),
        ]
    }
}

fn case<'a>(
    name: &'static str,
    bytes: f64,
    flops: Option<f64>,
    record: impl Fn(&mut effigy::gpu::Recorder<'_>) + 'a,
) -> Case<'a> {
    Case { name, bytes, flops, record: Box::new(record) }
}

/// Extent of the template along each axis: low, high.
fn bounds(body: &Body) -> [[f32; 2]; 3] {
    [0, 1, 2].map(|axis| {
        let values = body.v_template.iter().map(|v| v[axis]);
        values.fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], x| [low.min(x), high.max(x)])
    })
}

/// The translation that puts the middle of the body, turned about x, on the optical axis.
fn centred(body: &Body, distance: f32) -> [f32; 3] {
    let middle = bounds(body).map(|[low, high]| 0.5 * (low + high));
    let pelvis = body.j_template[0];
    [-middle[0], middle[1] - 2.0 * pelvis[1], distance]
}

/// The template scaled into the unit cube.
fn unit_box(body: &Body) -> Vec<f32> {
    let bounds = bounds(body);
    let side = bounds.iter().map(|[low, high]| high - low).fold(0.0, f32::max);
    body.v_template.iter().flat_map(|v| [0, 1, 2].map(|axis| (v[axis] - bounds[axis][0]) / side)).collect()
}

fn gradients(gpu: &Gpu, body: &Body, n_pixels: usize) -> Gradients {
    let ones = |name: &str, len: usize| gpu.upload(&format!("bench/grad_{name}"), &vec![1.0f32; len]);
    let (v, f) = (body.n_vertices(), body.n_faces());
    Gradients {
        vertices: ones("vertices", 3 * v),
        joints: ones("joints", 3 * N_JOINTS),
        poses: ones("poses", 3 * N_JOINTS),
        transl: ones("transl", 3),
        betas: ones("betas", body.n_betas),
        offsets: ones("offsets", 3 * v),
        face_colours: ones("face_colours", 3 * f),
        image: ones("image", 3 * n_pixels),
        alpha: ones("alpha", n_pixels),
        rgb: ones("rgb", 3 * n_pixels),
        coords: ones("coords", 3 * n_pixels),
        texcoords: ones("texcoords", 3 * v),
    }
}
