//! What a step of a stage does (paper §3.6). Stage 1 fits β, D, θᵢ, Rᵢ, tᵢ and one colour a face, so that the mesh comes to
//! lie where image and silhouette have it. In stage 2 the texture is trained while shape and poses are refined through it;
//! or, as the paper has it, shape and face colours stand and the poses see the soft image too. A fit without a first stage is
//! the paper's naive way.

use super::appearance::{Appearance, FaceColours, Texture};
use super::checkpointed::{Checkpointed, Checkpointer};
use super::config::{FitConfig, Phase, StageConfig};
use super::frame_step::{BACKGROUND, FrameStep};
use super::keypoint_term::KeypointTerm;
use super::losses::{Losses, Term};
use super::motion::Motion;
use super::poses::PoseGroups;
use super::scene::Scene;
use super::schedule::{Step, Work};
use super::shape::Shape;
use super::silhouette::SilhouetteTerm;
use super::soft::{SoftTerm, soft_params};
use super::state::{FitState, Stage};
use super::{FitError, Inputs};
use crate::gpu::Recorder;
use crate::ops::rgb_l1::{Pixels, RgbL1};

/// Parameters and terms of a stage. What the stage does not weigh or move is absent.
pub(super) struct StageWork<'a> {
    scene: &'a Scene,
    config: &'a FitConfig,
    stage: &'a StageConfig,
    poses: PoseGroups,
    shape: Option<Shape>,
    appearance: Box<dyn Appearance>,
    soft: Option<(SoftTerm, RgbL1)>,
    silhouette: SilhouetteTerm,
    keypoints: Option<KeypointTerm>,
    motion: Motion,
    losses: Losses,
}

impl<'a> StageWork<'a> {
    /// The work of `state.stage`.
    pub fn new(scene: &'a Scene, inputs: &Inputs<'a>, state: &FitState) -> Result<Self, FitError> {
        let (gpu, config) = (&scene.gpu, inputs.config);
        let (stage, appearance): (_, Box<dyn Appearance>) = match state.stage {
            Stage::Geometry => (&config.geometry, Box::new(FaceColours::new(scene, inputs, state))),
            _ => (&config.texture, Box::new(Texture::new(scene, inputs, state)?)),
        };
        let weights = &stage.weights;
        let shape = stage.shape.then(|| Shape::new(scene, inputs, state));
        if shape.is_none() {
            Shape::stand(scene, state)?;
        }
        let keypoints = || KeypointTerm::new(gpu, inputs.body, inputs.capture, inputs.camera, config.hip_keypoints);
        let times: Vec<f64> = inputs.capture.frames.iter().map(|frame| frame.index.into()).collect();
        Ok(Self {
            scene,
            config,
            stage,
            poses: PoseGroups::new(gpu, config, state),
            shape,
            appearance,
            soft: (weights.rgb_soft != 0.0).then(|| (SoftTerm::new(scene), RgbL1::new(gpu, scene.max_pixels))),
            silhouette: SilhouetteTerm::new(scene, config.silhouette_gradient),
            keypoints: if weights.keypoints != 0.0 { keypoints() } else { None },
            motion: Motion::new(gpu, &state.stage_poses, &state.stage_transl, &times, config.held),
            losses: Losses::new(scene, state.stage),
        })
    }

    /// For steps without a phase's start, which would solve the light anew.
    pub fn cast_shadows(&mut self) -> Result<(), FitError> {
        self.appearance.cast_shadows(self.scene, &self.poses)
    }

    /// One frame's images, losses and gradients.
    fn record_frame(&self, recorder: &mut Recorder<'_>, frame: &FrameStep<'_>) {
        let (scene, weights) = (self.scene, frame.weights);
        let moves = self.moves(frame.phase);
        let coloured = weights.rgb != 0.0;
        scene.clear_frame_gradients(recorder);
        scene.forward(recorder, frame.level, self.poses.at(frame.frame));
        self.appearance.start_frame(recorder, scene, frame.frame);
        if coloured {
            self.appearance.hard(recorder, scene, frame, moves, &self.losses);
        }
        if !moves {
            self.appearance.end_frame(recorder);
            return;
        }
        let borders = if coloured { self.appearance.borders(frame) } else { None };
        self.silhouette.record(recorder, scene, frame, borders, &self.losses);
        self.record_soft(recorder, frame);
        self.appearance.end_frame(recorder);
        if let Some(keypoints) = &self.keypoints {
            let weight = frame.part * weights.keypoints;
            keypoints.record(recorder, scene, frame.frame, weight, self.losses.slot(Term::Keypoints));
        }
        scene.backward(recorder, frame.level, self.poses.at(frame.frame), self.poses.grad_at(frame.frame));
    }

    /// Near faces outweigh the background as far as the blur reaches, so outside the mask the soft colours would only pull
    /// the mesh inwards, against the silhouette: they count inside.
    fn record_soft(&self, recorder: &mut Recorder<'_>, frame: &FrameStep<'_>) {
        let Some((soft, rgb)) = &self.soft else { return };
        let (scene, camera, n) = (self.scene, &frame.level.camera, frame.level.camera.n_pixels());
        let (target, inside) = (frame.target(), Pixels::Listed(&frame.level.inside));
        let params = soft_params(scene, frame.phase, frame.frame, BACKGROUND);
        let (colours, grad_colours) = self.appearance.face_colours();
        soft.forward(recorder, &params, camera, scene, colours);
        let (slot, weight) = (self.losses.slot(Term::RgbSoft), frame.per_pixel(frame.weights.rgb_soft));
        rgb.forward_backward(recorder, n, soft.rgb(), target, inside, slot, weight, &soft.grad_rgb);
        soft.backward(recorder, &params, camera, scene, colours, grad_colours);
    }

    /// Whether a phase moves the mesh at all.
    fn moves(&self, phase: &Phase) -> bool {
        self.shape.is_some() || phase.pose_rate != 0.0
    }
}

impl Checkpointed for StageWork<'_> {
    fn checkpoint(&mut self, checkpointer: &mut Checkpointer<'_>, name: &str) -> Result<(), FitError> {
        self.poses.checkpoint(checkpointer, name)?;
        if let Some(shape) = &mut self.shape {
            shape.checkpoint(checkpointer, name)?;
        }
        self.appearance.checkpoint(checkpointer, &format!("{name}.appearance"))?;
        self.losses.checkpoint(checkpointer, &format!("{name}.losses"))
    }
}

impl Work for StageWork<'_> {
    fn start_phase(&mut self, phase: &Phase) -> Result<(), FitError> {
        if let Some(shape) = &mut self.shape {
            shape.start_phase(&self.scene.gpu, phase)?;
            let mut recorder = self.scene.gpu.recorder("fit/start_phase");
            shape.forward(&mut recorder, self.scene);
            recorder.submit()?;
        }
        self.appearance.start_phase(self.scene, &self.poses, phase)
    }

    fn step(&mut self, step: &Step<'_>) -> Result<(), FitError> {
        let (scene, weights, rates) = (self.scene, &self.stage.weights, &self.config.rates);
        let part = 1.0 / step.frames.len() as f32;
        let mut recorder = scene.gpu.recorder("fit/step");
        self.poses.clear(&mut recorder);
        scene.shape.clear_gradients(&mut recorder);
        if let Some(shape) = &self.shape {
            shape.forward(&mut recorder, scene);
        }
        self.appearance.start_step(&mut recorder, scene);
        for &frame in step.frames {
            let level = &scene.frames[frame].levels[step.phase.level];
            let part = part * step.trust[frame];
            let frame = FrameStep { frame, level, phase: step.phase, weights, part, number: step.number };
            self.record_frame(&mut recorder, &frame);
        }
        if let Some(shape) = &mut self.shape {
            shape.backward(&mut recorder, scene, weights, &self.losses);
            shape.step(&mut recorder, rates, step);
        }
        if step.phase.pose_rate != 0.0 {
            // What is recorded for all frames in each step shall weigh a pass over the clip as much as the pictures do.
            self.motion.record(&mut recorder, weights, self.poses.share_of_a_step(step.frames.len()), &self.poses);
            self.poses.step(&mut recorder, rates, step);
        }
        self.appearance.step(&mut recorder, rates, step);
        Ok(recorder.submit()?)
    }

    fn losses(&mut self) -> &mut Losses {
        &mut self.losses
    }

    fn read_into(&self, state: &mut FitState) -> Result<(), FitError> {
        self.poses.read_into(&self.scene.gpu, state)?;
        if let Some(shape) = &self.shape {
            shape.read_into(self.scene, state)?;
        }
        self.appearance.read_into(self.scene, state)
    }
}
