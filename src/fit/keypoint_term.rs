//! The keypoint loss of a frame, in pixels of the full-resolution image: limbs and nose (paper §3.5), and hips where asked
//! for. Under clothes nothing else tells how high the hips lie.

use super::scene::Scene;
use crate::body::{Body, KeypointSet};
use crate::camera::Camera;
use crate::capture::Capture;
use crate::gpu::{Buffer, Gpu, Recorder};
use crate::keypoints::{Part, points_of};
use crate::ops::LossSlot;
use crate::ops::keypoints::{KeypointGather, KeypointLoss};

/// Geman & McClure's scale, as a part of the image's longer side: a wrong detection must not pull a limb away.
const RHO: f32 = 0.02;

/// The operators and targets of the loss.
pub struct KeypointTerm {
    gather: KeypointGather,
    loss: KeypointLoss,
    camera: Camera,
    /// `[N, K, 3]`: x, y, confidence
    targets: Buffer<f32>,
    points: Buffer<f32>,
    view: Buffer<f32>,
    screen: Buffer<f32>,
    grad_points: Buffer<f32>,
    grad_screen: Buffer<f32>,
    /// Turns the sum into a mean over the points, in squares of a hundredth of the image side.
    unit: f32,
}

impl KeypointTerm {
    pub fn new(gpu: &Gpu, body: &Body, capture: &Capture, camera: &Camera, with_hips: bool) -> Option<Self> {
        use Part::{Ankle, Elbow, Hip, Knee, Nose, Wrist};
        let counts = |part| matches!(part, Nose | Elbow | Wrist | Knee | Ankle) || with_hips && part == Hip;
        let set: &KeypointSet = body.keypoint_set(&capture.keypoint_format)?;
        let used: Vec<bool> = points_of(&capture.keypoint_format)?.iter().map(|&(part, _)| counts(part)).collect();
        let n = set.points.len();
        let mut targets = Vec::with_capacity(capture.frames.len() * n * 3);
        for frame in &capture.frames {
            for (k, &[x, y, confidence]) in frame.keypoints.iter().enumerate() {
                targets.extend([x, y, if used.get(k) == Some(&true) { confidence } else { 0.0 }]);
            }
        }
        let side = camera.width.max(camera.height) as f32;
        let zeros = |name: &str, len: usize| gpu.zeros(&format!("fit/keypoints/{name}"), len);
        Some(Self {
            gather: KeypointGather::new(gpu, set),
            loss: KeypointLoss::new(gpu, Some(RHO * side)),
            camera: camera.clone(),
            targets: gpu.upload("fit/keypoints/targets", &targets),
            points: zeros("points", 3 * n),
            view: zeros("view", 3 * n),
            screen: zeros("screen", 2 * n),
            grad_points: zeros("grad_points", 3 * n),
            grad_screen: zeros("grad_screen", 2 * n),
            unit: 1.0 / (used.iter().filter(|used| **used).count() as f32 * (0.01 * side).powi(2)),
        })
    }

    /// Records value and gradient of the posed frame; adds to the scene's `grad_vertices` and `grad_joints`.
    pub fn record(&self, recorder: &mut Recorder<'_>, scene: &Scene, frame: usize, weight: f32, slot: LossSlot<'_>) {
        let Self { points, view, screen, grad_points, grad_screen, .. } = self;
        self.gather.forward(recorder, &scene.posed.vertices, &scene.posed.joints, points);
        scene.project.forward(recorder, &self.camera, points, view, screen);
        self.loss.forward(recorder, screen, &self.targets, frame, slot);
        recorder.clear(grad_points);
        recorder.clear(grad_screen);
        self.loss.backward(recorder, screen, &self.targets, frame, weight * self.unit, grad_screen);
        scene.project.screen_backward(recorder, &self.camera, points, grad_screen, grad_points);
        self.gather.backward(recorder, grad_points, &scene.grad_vertices, &scene.grad_joints);
    }
}
