//! One colour a face (paper §3.6, stage 1): too coarse to hide what the geometry has wrong.

use super::{Look, mean_face_colours};
use crate::fit::FitError;
use crate::fit::config::{FitConfig, Phase, Rates};
use crate::fit::frame_step::{BACKGROUND, FrameStep};
use crate::fit::groups::{Group, PoseGroups};
use crate::fit::losses::Losses;
use crate::fit::scene::Scene;
use crate::fit::schedule::Step;
use crate::fit::state::FitState;
use crate::gpu::{Buffer, Recorder};
use crate::ops::adam::AdamConfig;
use crate::ops::edge_gradient::RgbGradient;
use crate::ops::rgb_l1::RgbL1;

/// Face colours with their image.
pub struct FaceColours {
    faces: Vec<[u32; 3]>,
    colours: Group,
    rgb: RgbL1,
    image: Buffer<f32>,
    grad_image: Buffer<f32>,
    /// Whether any image of the colours is compared; else nothing moves them.
    compared: bool,
    /// Whether a phase starts from colours in closed form.
    solved: bool,
}

impl FaceColours {
    pub fn new(scene: &Scene, faces: &[[u32; 3]], config: &FitConfig, state: &FitState) -> Self {
        let (gpu, n) = (&scene.gpu, scene.max_pixels);
        Self {
            faces: faces.to_vec(),
            colours: Group::whole(gpu, "face_colours", &state.face_colours, AdamConfig::default()),
            rgb: RgbL1::new(gpu, n),
            image: gpu.zeros("fit/image", n * 3),
            grad_image: gpu.zeros("fit/grad_image", n * 3),
            compared: config.geometry.weights.compare_colours(),
            solved: config.solve_face_colours,
        }
    }
}

impl Look for FaceColours {
    /// Solves the colours anew where that is wished.
    fn start_phase(&mut self, scene: &Scene, poses: &PoseGroups, phase: &Phase) -> Result<(), FitError> {
        if self.compared && self.solved {
            let colours = mean_face_colours(scene, &self.faces, poses, phase.level)?;
            scene.gpu.write(&self.colours.values, 0, &colours);
        }
        Ok(())
    }

    fn start_step(&self, recorder: &mut Recorder<'_>, _scene: &Scene) {
        self.colours.clear(recorder);
    }

    /// Within a face nothing changes, so the faces' insides do not move the mesh.
    fn hard(&self, recorder: &mut Recorder<'_>, scene: &Scene, frame: &FrameStep<'_>, _moves: bool, losses: &Losses) {
        let (camera, n, target) = (&frame.level.camera, frame.level.camera.n_pixels(), frame.target());
        let Self { image, grad_image, .. } = self;
        scene.hard.shade(recorder, camera, &self.colours.values, BACKGROUND, image);
        self.rgb.forward(recorder, n, image, target, None, losses.rgb_slot(frame.frame));
        recorder.clear(grad_image);
        self.rgb.backward(recorder, n, image, target, None, frame.per_pixel(frame.weights.rgb), grad_image);
        scene.hard.shade_backward(recorder, camera, &scene.view, grad_image, &self.colours.grads);
    }

    fn borders(&self) -> Option<RgbGradient<'_>> {
        Some(RgbGradient { image: &self.image, grad_image: &self.grad_image })
    }

    fn face_colours(&self) -> (&Buffer<f32>, &Buffer<f32>) {
        (&self.colours.values, &self.colours.grads)
    }

    fn step(&mut self, recorder: &mut Recorder<'_>, rates: &Rates, step: &Step<'_>) {
        if self.compared {
            self.colours.step(recorder, &[0], rates.face_colours * step.rate);
        }
    }

    fn read_into(&self, scene: &Scene, state: &mut FitState) -> Result<(), FitError> {
        state.face_colours = self.colours.read(&scene.gpu)?;
        Ok(())
    }
}
