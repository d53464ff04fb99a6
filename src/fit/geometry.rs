//! Stage 1 (paper §3.6): β, D, θᵢ, Rᵢ, tᵢ and one colour a face, so that the mesh comes to lie where image and silhouette
//! have it.

use std::path::Path;

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_pcg::Pcg32;

use super::FitError;
use super::colours::mean_face_colours;
use super::config::{FitConfig, Phase};
use super::control::{Control, Flow, Pace, StepReport};
use super::groups::{Group, VertexGroup};
use super::keypoint_term::KeypointTerm;
use super::losses::Losses;
use super::mesh_losses::{MeshLosses, MeshSlots};
use super::motion::Motion;
use super::scene::Scene;
use super::silhouette::SilhouetteTerm;
use super::soft::{SoftTerm, soft_params};
use super::state::{FitState, Stage};
use crate::body::Body;
use crate::camera::Camera;
use crate::capture::Capture;
use crate::gpu::{Buffer, Recorder};
use crate::ops::Topology;
use crate::ops::adam::AdamConfig;
use crate::ops::diffuse::Diffuse;
use crate::ops::edge_gradient::RgbGradient;
use crate::ops::rgb_l1::RgbL1;
use crate::ops::skinning::PoseAt;

/// The slots of the losses buffer.
const NAMES: [&str; 7] = ["rgb", "rgb_soft", "silhouette", "keypoints", "normal_consistency", "face_area", "laplacian"];
const RGB: usize = 0;
const RGB_SOFT: usize = 1;
const SILHOUETTE: usize = 2;
const KEYPOINTS: usize = 3;
const MESH: MeshSlots = MeshSlots { normal_consistency: 4, face_area: 5, laplacian: 6 };

/// The groups of the stage.
struct Groups {
    betas: Group,
    poses: Group,
    transl: Group,
    offsets: VertexGroup,
    face_colours: Group,
}

impl Groups {
    fn new(scene: &Scene, state: &FitState) -> Self {
        let (gpu, config) = (&scene.gpu, AdamConfig::default());
        Self {
            betas: Group::whole(gpu, "betas", &state.betas, config),
            poses: Group::per_frame(gpu, "poses", &state.poses, 72, config),
            transl: Group::per_frame(gpu, "transl", &state.transl, 3, config),
            offsets: VertexGroup::new(gpu, "offsets", &state.offsets, config),
            face_colours: Group::whole(gpu, "face_colours", &state.face_colours, config),
        }
    }

    fn at(&self, frame: usize) -> PoseAt<'_> {
        PoseAt { poses: &self.poses.values, transl: &self.transl.values, frame }
    }

    fn grad_at(&self, frame: usize) -> PoseAt<'_> {
        PoseAt { poses: &self.poses.grads, transl: &self.transl.grads, frame }
    }

    fn clear(&self, recorder: &mut Recorder<'_>) {
        for group in [&self.betas, &self.poses, &self.transl, &self.face_colours] {
            group.clear(recorder);
        }
        self.offsets.clear(recorder);
    }

    fn read_into(&self, scene: &Scene, state: &mut FitState) -> Result<(), FitError> {
        let gpu = &scene.gpu;
        state.betas = self.betas.read(gpu)?;
        state.poses = self.poses.read(gpu)?;
        state.transl = self.transl.read(gpu)?;
        state.offsets = self.offsets.read(gpu)?;
        state.face_colours = self.face_colours.read(gpu)?;
        Ok(())
    }
}

/// The operators of the stage with their scratch.
struct Terms {
    rgb: RgbL1,
    silhouette: SilhouetteTerm,
    motion: Motion,
    soft: SoftTerm,
    keypoints: Option<KeypointTerm>,
    mesh: MeshLosses,
    diffuse: Diffuse,
    image: Buffer<f32>,
    grad_image: Buffer<f32>,
    losses: Losses,
}

impl Terms {
    fn new(
        scene: &Scene,
        body: &Body,
        topology: &Topology,
        capture: &Capture,
        camera: &Camera,
        config: &FitConfig,
    ) -> Self {
        let gpu = &scene.gpu;
        let n = scene.max_pixels;
        Self {
            rgb: RgbL1::new(gpu, n),
            silhouette: SilhouetteTerm::new(scene, config.silhouette_gradient),
            motion: Motion::new(gpu),
            soft: SoftTerm::new(scene),
            keypoints: KeypointTerm::new(gpu, body, capture, camera),
            mesh: MeshLosses::new(gpu, body, topology),
            diffuse: Diffuse::new(gpu, &topology.neighbours.starts, &topology.neighbours.items),
            image: gpu.zeros("fit/image", n * 3),
            grad_image: gpu.zeros("fit/grad_image", n * 3),
            losses: Losses::new(scene, Stage::Geometry, &NAMES),
        }
    }
}

/// Runs the stage from `state.step` on.
#[expect(clippy::too_many_arguments, reason = "a stage reads the clip, its settings and its controls")]
pub(super) fn run(
    scene: &Scene,
    body: &Body,
    topology: &Topology,
    capture: &Capture,
    camera: &Camera,
    config: &FitConfig,
    state: &mut FitState,
    checkpoint: &Path,
    control: &mut dyn Control,
) -> Result<(), FitError> {
    let n_frames = scene.frames.len();
    let mut terms = Terms::new(scene, body, topology, capture, camera, config);
    let mut groups = Groups::new(scene, state);
    let mut pace = Pace::new();
    let batches = n_frames.div_ceil(config.batch) as u32;
    let steps: u32 = config.geometry.iter().map(|p| p.epochs * batches).sum();
    let mut step = 0;
    for (number, phase) in config.geometry.iter().enumerate() {
        let phase_steps = phase.epochs * batches;
        if step + phase_steps <= state.step {
            step += phase_steps;
            continue;
        }
        start_phase(scene, body, &mut groups, phase)?;
        for epoch in 0..phase.epochs {
            // The order depends on the epoch alone, so that a resumed fit sees the frames as it would have.
            let mut order: Vec<usize> = (0..n_frames).collect();
            order.shuffle(&mut Pcg32::seed_from_u64(config.seed ^ ((number as u64) << 32 | epoch as u64)));
            for batch in order.chunks(config.batch) {
                step += 1;
                if step <= state.step {
                    continue;
                }
                let rate = phase.rate * decay(step, steps);
                record_step(scene, &terms, &mut groups, config, phase, batch, rate)?;
                terms.losses.count(batch.len());
                state.step = step;
                let due = pace.losses_due() || step == steps;
                let losses = if due { Some(terms.losses.read(scene, step)?) } else { None };
                if pace.checkpoint_due() {
                    groups.read_into(scene, state)?;
                    state.save(checkpoint)?;
                }
                let report = StepReport { stage: Stage::Geometry, step, steps, losses: losses.as_ref() };
                if control.after_step(&report) == Flow::Stop {
                    groups.read_into(scene, state)?;
                    state.save(checkpoint)?;
                    return Err(FitError::Stopped);
                }
            }
        }
    }
    groups.read_into(scene, state)?;
    Ok(())
}

/// Learning rates fall to a tenth over the stage.
fn decay(step: u32, steps: u32) -> f32 {
    0.1f32.powf(step as f32 / steps.max(1) as f32)
}

/// Solves the face colours anew for the geometry as it is.
fn start_phase(scene: &Scene, body: &Body, groups: &mut Groups, phase: &Phase) -> Result<(), FitError> {
    let mut recorder = scene.gpu.recorder("fit/start_phase");
    scene.skinning.shape_forward(&mut recorder, &groups.betas.values, &groups.offsets.values, &scene.shape);
    recorder.submit()?;
    let (colours, _) = mean_face_colours(scene, &body.faces, &groups.poses.values, &groups.transl.values, phase.level)?;
    scene.gpu.write(&groups.face_colours.values, 0, &colours);
    Ok(())
}

fn record_step(
    scene: &Scene,
    terms: &Terms,
    groups: &mut Groups,
    config: &FitConfig,
    phase: &Phase,
    batch: &[usize],
    rate: f32,
) -> Result<(), FitError> {
    let mut recorder = scene.gpu.recorder("fit/geometry");
    let recorder = &mut recorder;
    groups.clear(recorder);
    scene.shape.clear_gradients(recorder);
    scene.skinning.shape_forward(recorder, &groups.betas.values, &groups.offsets.values, &scene.shape);
    for &frame in batch {
        record_frame(scene, terms, groups, config, phase, frame, 1.0 / batch.len() as f32, recorder);
    }
    terms.mesh.record(
        recorder,
        &config.weights,
        &scene.shape,
        &groups.offsets.values,
        &groups.offsets.grads,
        terms.losses.values(),
        MESH,
    );
    scene.skinning.shape_backward(recorder, &scene.shape, &groups.betas.grads, &groups.offsets.grads);
    let frame_weight = config.weights.motion / batch.len() as f32;
    terms.motion.record(recorder, frame_weight, &groups.poses, &groups.transl);
    let rates = &config.rates;
    groups.betas.step(recorder, &[0], rates.betas * rate);
    groups.poses.step(recorder, batch, rates.pose * rate);
    groups.transl.step(recorder, batch, rates.transl * rate);
    groups.face_colours.step(recorder, &[0], rates.face_colours * rate);
    if phase.offsets {
        terms.diffuse.apply(recorder, &groups.offsets.grads, phase.diffusion);
        groups.offsets.step(recorder, rates.offsets * rate);
    }
    Ok(std::mem::replace(recorder, scene.gpu.recorder("")).submit()?)
}

/// One frame's images, losses and gradients.
#[expect(clippy::too_many_arguments, reason = "what one frame's step depends on")]
fn record_frame(
    scene: &Scene,
    terms: &Terms,
    groups: &Groups,
    config: &FitConfig,
    phase: &Phase,
    frame: usize,
    part: f32,
    recorder: &mut Recorder<'_>,
) {
    let level = &scene.frames[frame].levels[phase.level];
    let weights = &config.weights;
    let pixels = level.n_foreground.max(1) as f32;
    let rgb_weight = part * weights.rgb / pixels;
    let background = [0.0; 3];

    scene.clear_frame_gradients(recorder);
    scene.forward(recorder, level, groups.at(frame));
    let n = level.camera.n_pixels();

    let target = level.masked(background);

    scene.hard.shade(recorder, &level.camera, &groups.face_colours.values, background, &terms.image);
    terms.rgb.forward(recorder, n, &terms.image, target, None, terms.losses.slot(RGB));
    recorder.clear(&terms.grad_image);
    terms.rgb.backward(recorder, n, &terms.image, target, None, rgb_weight, &terms.grad_image);
    scene.hard.shade_backward(recorder, &level.camera, &scene.view, &terms.grad_image, &groups.face_colours.grads);

    let rgb = RgbGradient { image: &terms.image, grad_image: &terms.grad_image };
    let weight = part * weights.silhouette;
    terms.silhouette.record(recorder, scene, level, target, weight, Some(rgb), terms.losses.slot(SILHOUETTE));

    // Near faces outweigh the background as far as the blur reaches, so outside the mask the soft colours would only pull
    // the mesh inwards, against the silhouette.
    let inside = Some(&level.inside);
    let params = soft_params(scene, phase, frame, background);
    terms.soft.forward(recorder, &params, &level.camera, scene, &groups.face_colours.values);
    terms.rgb.forward(recorder, n, terms.soft.rgb(), target, inside, terms.losses.slot(RGB_SOFT));
    terms.soft.clear_gradients(recorder);
    terms.rgb.backward(recorder, n, terms.soft.rgb(), target, inside, rgb_weight, &terms.soft.grad_rgb);
    terms.soft.backward(
        recorder,
        &params,
        &level.camera,
        scene,
        &groups.face_colours.values,
        &groups.face_colours.grads,
    );

    if let Some(keypoints) = &terms.keypoints {
        keypoints.record(recorder, scene, frame, part * weights.keypoints, terms.losses.slot(KEYPOINTS));
    }
    scene.backward(recorder, level, groups.at(frame), groups.grad_at(frame));
}
