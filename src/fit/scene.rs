//! What both stages share on the device: the body, the clip, the forward path from parameters to pixels.

use std::sync::Arc;

use super::Inputs;
use super::frames::{DeviceFrame, FrameLevel};
use crate::camera::Camera;
use crate::gpu::{Buffer, Gpu, Recorder};
use crate::ops::hard_rasterize::{HardRasterizeConfig, HardRasterizer};
use crate::ops::project::Project;
use crate::ops::skinning::{PoseAt, PoseState, ShapeState, SkinningBody};
use crate::ops::{Corners, Topology};

/// Half the depth that a person with stretched arms may need around the pelvis, with room to move.
const REACH_M: f64 = 1.5;

fn depth_range(camera: &Camera, transl: &[f32]) -> (f64, f64) {
    let [_, _, z] = camera.view([0, 1, 2].map(|k| f64::from(transl[k])));
    ((z - REACH_M).max(0.05), z.max(0.1) + REACH_M)
}

/// Body, clip and the operators between them. One frame is in work at a time.
pub struct Scene {
    pub gpu: Arc<Gpu>,
    pub frames: Vec<DeviceFrame>,
    pub topology: Topology,
    pub corners: Arc<Corners>,
    pub skinning: SkinningBody,
    pub shape: ShapeState,
    pub posed: PoseState,
    pub project: Project,
    pub hard: HardRasterizer,
    /// `[V, 3]` camera space, `[V, 2]` pixels of the crop.
    pub view: Buffer<f32>,
    pub screen: Buffer<f32>,
    pub grad_view: Buffer<f32>,
    pub grad_vertices: Buffer<f32>,
    pub grad_joints: Buffer<f32>,
    /// Pixels of the largest crop.
    pub max_pixels: usize,
    /// `[N]`: nearest and farthest camera-space z of a person at the frame's starting place, metres.
    pub depth_ranges: Vec<(f64, f64)>,
    /// Half the longer side of the full image at level 0: SoftRas' unit.
    pub norm_px: f64,
}

impl Scene {
    /// `transl [N, 3]` is where the person stands at the start.
    pub fn new(gpu: &Arc<Gpu>, inputs: &Inputs<'_>, frames: Vec<DeviceFrame>, transl: &[f32]) -> Self {
        let (body, camera) = (inputs.body, inputs.camera);
        let topology = Topology::new(body.n_vertices(), &body.faces);
        let corners = Arc::new(Corners::new(gpu, &body.faces, &topology));
        let skinning = SkinningBody::new(gpu, body);
        let levels = frames.iter().flat_map(|f| &f.levels);
        let max_pixels = levels.map(|l| (l.width * l.height) as usize).max().unwrap_or(1);
        let points = |name: &str| gpu.zeros(&format!("fit/{name}"), body.n_vertices() * 3);
        Self {
            shape: skinning.shape_state(gpu),
            posed: skinning.pose_state(gpu),
            project: Project::new(gpu),
            hard: HardRasterizer::new(gpu, &corners, max_pixels, HardRasterizeConfig::default()),
            view: points("view"),
            screen: gpu.zeros("fit/screen", body.n_vertices() * 2),
            grad_view: points("grad_view"),
            grad_vertices: points("grad_vertices"),
            grad_joints: gpu.zeros("fit/grad_joints", crate::body::N_JOINTS * 3),
            skinning,
            topology,
            corners,
            frames,
            max_pixels,
            depth_ranges: transl.chunks_exact(3).map(|t| depth_range(camera, t)).collect(),
            norm_px: camera.width.max(camera.height) as f64 / 2.0,
            gpu: gpu.clone(),
        }
    }

    /// Records posing, projection and hard rasterisation of a frame.
    pub fn forward(&self, recorder: &mut Recorder<'_>, level: &FrameLevel, at: PoseAt<'_>) {
        self.skinning.pose_forward(recorder, &self.shape, at, &self.posed);
        self.project.forward(recorder, &level.camera, &self.posed.vertices, &self.view, &self.screen);
        self.hard.forward(recorder, &level.camera, &self.view);
    }

    /// Records the clearing of one frame's gradients.
    pub fn clear_frame_gradients(&self, recorder: &mut Recorder<'_>) {
        recorder.clear(&self.grad_view);
        recorder.clear(&self.grad_vertices);
        recorder.clear(&self.grad_joints);
    }

    /// Records the way back from `grad_view`, `grad_vertices` and `grad_joints` to the frame's pose and to the shape.
    pub fn backward(&self, recorder: &mut Recorder<'_>, level: &FrameLevel, at: PoseAt<'_>, grad: PoseAt<'_>) {
        self.project.view_backward(recorder, &level.camera, &self.grad_view, &self.grad_vertices);
        let Self { skinning, shape, posed, .. } = self;
        skinning.pose_backward(recorder, shape, at, posed, &self.grad_vertices, &self.grad_joints, grad);
    }
}
