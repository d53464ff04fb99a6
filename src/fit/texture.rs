//! Stage 2 (paper §3.6): D, β and the face colours stand; the hash texture with its learned coordinates is trained through
//! the hard image, while the poses are refined through the soft image of the fixed face colours and through the texture
//! itself.

use std::path::Path;

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_pcg::Pcg32;

use super::FitError;
use super::config::{FitConfig, Phase};
use super::control::{Control, Flow, Pace, StepReport};
use super::frames::FrameLevel;
use super::groups::Group;
use super::losses::Losses;
use super::motion::Motion;
use super::scene::Scene;
use super::silhouette::SilhouetteTerm;
use super::soft::{SoftTerm, soft_params};
use super::state::{FitState, Stage};
use crate::gpu::{Buffer, Recorder};
use crate::ops::adam::{Adam, AdamConfig};
use crate::ops::interpolate::{Interpolate, Sampling};
use crate::ops::rgb_l1::RgbL1;
use crate::ops::skinning::PoseAt;
use crate::ops::texture_field::TextureField;

const NAMES: [&str; 3] = ["rgb", "rgb_soft", "silhouette"];
const RGB: usize = 0;
const RGB_SOFT: usize = 1;
const SILHOUETTE: usize = 2;

/// Adam for the field (Müller et al. 2022).
const FIELD_ADAM: AdamConfig = AdamConfig { beta1: 0.9, beta2: 0.99, eps: 1e-15 };

struct Groups {
    poses: Group,
    transl: Group,
    texcoords: Group,
    table: Adam,
    weights: Adam,
    field_steps: u32,
}

impl Groups {
    fn new(scene: &Scene, state: &FitState, field: &TextureField) -> Self {
        let (gpu, config) = (&scene.gpu, AdamConfig::default());
        Self {
            poses: Group::per_frame(gpu, "poses", &state.poses, 72, config),
            transl: Group::per_frame(gpu, "transl", &state.transl, 3, config),
            texcoords: Group::whole(gpu, "texcoords", &state.texcoords, config),
            table: Adam::new(gpu, "table", field.table.len(), FIELD_ADAM),
            weights: Adam::new(gpu, "weights", field.weights.len(), FIELD_ADAM),
            field_steps: 0,
        }
    }

    fn read_into(&self, scene: &Scene, field: &TextureField, state: &mut FitState) -> Result<(), FitError> {
        let gpu = &scene.gpu;
        state.poses = self.poses.read(gpu)?;
        state.transl = self.transl.read(gpu)?;
        state.texcoords = self.texcoords.read(gpu)?;
        state.field = field.params(gpu)?;
        Ok(())
    }
}

struct Terms {
    field: TextureField,
    interpolate: Interpolate,
    rgb: RgbL1,
    silhouette: SilhouetteTerm,
    motion: Motion,
    soft: SoftTerm,
    /// Fixed in this stage.
    face_colours: Buffer<f32>,
    /// Scratch: the face colours do not move.
    grad_face_colours: Buffer<f32>,
    image: Buffer<f32>,
    grad_image: Buffer<f32>,
    grad_rgb: Buffer<f32>,
    grad_coords: Buffer<f32>,
    grad_bary: Buffer<f32>,
    /// `[N]`: weights of the pixels at level 0, see [`trusted_pixels`].
    trusted: Vec<Buffer<f32>>,
    losses: Losses,
}

/// 1 for pixels well inside the mask, 0 elsewhere: the mask's border mixes the person with the background, and the texture
/// must not learn that.
fn trusted_pixels(level: &FrameLevel, pixels: &[u32]) -> Vec<f32> {
    let (width, height) = (level.width as usize, level.height as usize);
    let inside = |x: usize, y: usize| x < width && y < height && pixels[y * width + x] >> 24 >= 128;
    let trusted = |(x, y): (usize, usize)| {
        let around = [(1, 1), (0, 1), (2, 1), (1, 0), (1, 2)];
        around.iter().all(|&(dx, dy)| inside((x + dx).wrapping_sub(1), (y + dy).wrapping_sub(1))) as u8 as f32
    };
    (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(trusted).collect()
}

impl Terms {
    fn new(scene: &Scene, config: &FitConfig, state: &FitState) -> Result<Self, FitError> {
        let (gpu, n) = (&scene.gpu, scene.max_pixels);
        let trusted = scene.frames.iter().map(|frame| -> Result<_, FitError> {
            let level = &frame.levels[0];
            Ok(gpu.upload("fit/trusted", &trusted_pixels(level, &gpu.read(&level.target)?)))
        });
        let trusted = trusted.collect::<Result<Vec<_>, _>>()?;
        Ok(Self {
            trusted,
            field: TextureField::new(gpu, config.field, &state.field, n)?,
            interpolate: Interpolate::new(gpu, n, n),
            rgb: RgbL1::new(gpu, n),
            silhouette: SilhouetteTerm::new(scene, config.silhouette_gradient),
            motion: Motion::new(gpu),
            soft: SoftTerm::new(scene),
            face_colours: gpu.upload("fit/face_colours", &state.face_colours),
            grad_face_colours: gpu.zeros("fit/grad_face_colours", state.face_colours.len()),
            image: gpu.zeros("fit/image", n * 3),
            grad_image: gpu.zeros("fit/grad_image", n * 3),
            grad_rgb: gpu.zeros("fit/grad_rgb", n * 3),
            grad_coords: gpu.zeros("fit/grad_coords", n * 3),
            grad_bary: gpu.zeros("fit/grad_bary", n * 3),
            losses: Losses::new(scene, Stage::Texture, &NAMES),
        })
    }
}

/// Runs the stage from `state.step` on.
pub(super) fn run(
    scene: &Scene,
    config: &FitConfig,
    state: &mut FitState,
    checkpoint: &Path,
    control: &mut dyn Control,
) -> Result<(), FitError> {
    let n_frames = scene.frames.len();
    let mut terms = Terms::new(scene, config, state)?;
    let mut groups = Groups::new(scene, state, &terms.field);
    let mut pace = Pace::new();
    let batches = n_frames.div_ceil(config.batch) as u32;
    let steps: u32 = config.texture.iter().map(|p| p.epochs * batches).sum();
    let shape = (scene.gpu.upload("fit/betas", &state.betas), scene.gpu.upload("fit/offsets", &state.offsets));
    let mut recorder = scene.gpu.recorder("fit/shape");
    scene.skinning.shape_forward(&mut recorder, &shape.0, &shape.1, &scene.shape);
    recorder.submit()?;
    let mut step = 0;
    for (number, phase) in config.texture.iter().enumerate() {
        for epoch in 0..phase.epochs {
            let mut order: Vec<usize> = (0..n_frames).collect();
            let seed = config.seed ^ (1 << 63 | (number as u64) << 32 | epoch as u64);
            order.shuffle(&mut Pcg32::seed_from_u64(seed));
            for batch in order.chunks(config.batch) {
                step += 1;
                if step <= state.step {
                    continue;
                }
                let rate = phase.rate * 0.1f32.powf(step as f32 / steps.max(1) as f32);
                record_step(scene, &terms, &mut groups, config, phase, batch, rate, step)?;
                terms.losses.count(batch.len());
                state.step = step;
                let due = pace.losses_due() || step == steps;
                let losses = if due { Some(terms.losses.read(scene, step)?) } else { None };
                if pace.checkpoint_due() {
                    groups.read_into(scene, &terms.field, state)?;
                    state.save(checkpoint)?;
                }
                let report = StepReport { stage: Stage::Texture, step, steps, losses: losses.as_ref() };
                if control.after_step(&report) == Flow::Stop {
                    groups.read_into(scene, &terms.field, state)?;
                    state.save(checkpoint)?;
                    return Err(FitError::Stopped);
                }
            }
        }
    }
    groups.read_into(scene, &terms.field, state)
}

#[expect(clippy::too_many_arguments, reason = "what one step depends on")]
fn record_step(
    scene: &Scene,
    terms: &Terms,
    groups: &mut Groups,
    config: &FitConfig,
    phase: &Phase,
    batch: &[usize],
    rate: f32,
    step: u32,
) -> Result<(), FitError> {
    let mut recorder = scene.gpu.recorder("fit/texture");
    groups.poses.clear(&mut recorder);
    groups.transl.clear(&mut recorder);
    groups.texcoords.clear(&mut recorder);
    terms.field.clear_gradients(&mut recorder);
    scene.shape.clear_gradients(&mut recorder);
    for &frame in batch {
        record_frame(scene, terms, groups, config, phase, frame, 1.0 / batch.len() as f32, step, &mut recorder);
    }
    let frame_weight = config.weights.motion / batch.len() as f32;
    terms.motion.record(&mut recorder, frame_weight, &groups.poses, &groups.transl);
    let rates = &config.rates;
    groups.field_steps += 1;
    let n = groups.field_steps;
    let field = &terms.field;
    let (table, weights) = (0..field.table.len(), 0..field.weights.len());
    groups.table.step(&mut recorder, &field.table, &field.grad_table, table, rates.field * rate, n);
    groups.weights.step(&mut recorder, &field.weights, &field.grad_weights, weights, rates.field * rate, n);
    groups.texcoords.step(&mut recorder, &[0], rates.texcoords * rate);
    groups.poses.step(&mut recorder, batch, rates.pose * rate * phase.pose_rate);
    groups.transl.step(&mut recorder, batch, rates.transl * rate * phase.pose_rate);
    Ok(recorder.submit()?)
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
    step: u32,
    recorder: &mut Recorder<'_>,
) {
    let level = &scene.frames[frame].levels[0];
    let at = PoseAt { poses: &groups.poses.values, transl: &groups.transl.values, frame };
    let grad_at = PoseAt { poses: &groups.poses.grads, transl: &groups.transl.grads, frame };
    let pixels = level.n_foreground.max(1) as f32;
    let background = [0.0; 3];
    scene.clear_frame_gradients(recorder);
    scene.forward(recorder, level, at);
    let n = level.camera.n_pixels();

    let Terms { field, interpolate, image, grad_image, grad_rgb, grad_coords, grad_bary, .. } = terms;
    let hard = &scene.hard;
    let faces = &scene.corners.faces;
    let texcoords = &groups.texcoords.values;
    let sampling = Sampling { rate: config.pixel_rate as f64, seed: step.wrapping_mul(0x9e37_79b9) ^ frame as u32 };
    interpolate.forward(recorder, n, &hard.pix_to_face, &hard.bary_coords, faces, texcoords, sampling);
    let n_max = interpolate.n_max(n);
    field.forward(recorder, &interpolate.coords, &interpolate.count, n_max);
    interpolate.scatter(recorder, n, &field.rgb, background, image);
    let weight = part * config.weights.rgb / (pixels * config.pixel_rate);
    let weights = Some(&terms.trusted[frame]);
    let target = level.masked(background);
    terms.rgb.forward(recorder, n, image, target, weights, terms.losses.slot(RGB));
    recorder.clear(grad_image);
    terms.rgb.backward(recorder, n, image, target, weights, weight, grad_image);
    interpolate.gather(recorder, n, grad_image, grad_rgb);
    recorder.clear(grad_coords);
    field.backward(recorder, &interpolate.coords, &interpolate.count, n_max, grad_rgb, grad_coords);
    interpolate.backward(
        recorder,
        n,
        &hard.pix_to_face,
        &hard.bary_coords,
        faces,
        grad_coords,
        &groups.texcoords.grads,
    );
    if phase.pose_rate == 0.0 {
        return;
    }
    recorder.clear(grad_bary);
    interpolate.backward_bary(recorder, n, &hard.pix_to_face, faces, texcoords, grad_coords, grad_bary);
    hard.backward(recorder, &level.camera, &scene.view, grad_bary, None, &scene.grad_view);

    // Near faces outweigh the background as far as the blur reaches, so outside the mask the soft colours would only pull
    // the mesh inwards, against the silhouette.
    let inside = Some(&level.inside);
    let params = soft_params(scene, phase, frame, background);
    let rgb_weight = part * config.weights.rgb / pixels;
    terms.soft.forward(recorder, &params, &level.camera, scene, &terms.face_colours);
    terms.soft.clear_gradients(recorder);
    terms.rgb.forward(recorder, n, terms.soft.rgb(), target, inside, terms.losses.slot(RGB_SOFT));
    terms.rgb.backward(recorder, n, terms.soft.rgb(), target, inside, rgb_weight, &terms.soft.grad_rgb);
    let weight = part * config.weights.silhouette;
    terms.silhouette.record(recorder, scene, level, target, weight, None, terms.losses.slot(SILHOUETTE));
    terms.soft.backward(recorder, &params, &level.camera, scene, &terms.face_colours, &terms.grad_face_colours);
    scene.backward(recorder, level, at, grad_at);
}
