//! The hash texture with its learned coordinates (paper §3.2), trained through the hard image. The soft image is drawn with
//! the face colours as they stand.

use super::Look;
use crate::fit::FitError;
use crate::fit::config::{FitConfig, Phase, Rates};
use crate::fit::frame_step::{BACKGROUND, FrameStep};
use crate::fit::frames::FrameLevel;
use crate::fit::groups::{Group, PoseGroups};
use crate::fit::losses::{Losses, Term};
use crate::fit::scene::Scene;
use crate::fit::schedule::Step;
use crate::fit::state::FitState;
use crate::gpu::{Buffer, Recorder};
use crate::ops::adam::{Adam, AdamConfig};
use crate::ops::edge_gradient::RgbGradient;
use crate::ops::interpolate::{Interpolate, Sampling};
use crate::ops::rgb_l1::RgbL1;
use crate::ops::texture_field::TextureField;

/// Adam for the field (Müller et al. 2022).
const FIELD_ADAM: AdamConfig = AdamConfig { beta1: 0.9, beta2: 0.99, eps: 1e-15 };

/// The field, its coordinates, and the way from them to pixels and back.
pub struct FieldTexture {
    field: TextureField,
    table: Adam,
    weights: Adam,
    field_steps: u32,
    texcoords: Group,
    interpolate: Interpolate,
    rgb: RgbL1,
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
    pixel_rate: f32,
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

impl FieldTexture {
    pub fn new(scene: &Scene, config: &FitConfig, state: &FitState) -> Result<Self, FitError> {
        let (gpu, n) = (&scene.gpu, scene.max_pixels);
        let trusted = scene.frames.iter().map(|frame| -> Result<_, FitError> {
            let level = &frame.levels[0];
            Ok(gpu.upload("fit/trusted", &trusted_pixels(level, &gpu.read(&level.target)?)))
        });
        let trusted = trusted.collect::<Result<Vec<_>, _>>()?;
        let field = TextureField::new(gpu, config.field, &state.field, n)?;
        let zeros = |name: &str| gpu.zeros::<f32>(&format!("fit/{name}"), n * 3);
        Ok(Self {
            table: Adam::new(gpu, "table", field.table.len(), FIELD_ADAM),
            weights: Adam::new(gpu, "weights", field.weights.len(), FIELD_ADAM),
            field,
            field_steps: 0,
            texcoords: Group::whole(gpu, "texcoords", &state.texcoords, AdamConfig::default()),
            interpolate: Interpolate::new(gpu, n, n),
            rgb: RgbL1::new(gpu, n),
            face_colours: gpu.upload("fit/face_colours", &state.face_colours),
            grad_face_colours: gpu.zeros("fit/grad_face_colours", state.face_colours.len()),
            image: zeros("image"),
            grad_image: zeros("grad_image"),
            grad_rgb: zeros("grad_rgb"),
            grad_coords: zeros("grad_coords"),
            grad_bary: zeros("grad_bary"),
            trusted,
            pixel_rate: config.pixel_rate,
        })
    }
}

impl Look for FieldTexture {
    fn start_phase(&mut self, _scene: &Scene, _poses: &PoseGroups, _phase: &Phase) -> Result<(), FitError> {
        Ok(())
    }

    fn start_step(&self, recorder: &mut Recorder<'_>, _scene: &Scene) {
        self.texcoords.clear(recorder);
        self.field.clear_gradients(recorder);
    }

    fn hard(&self, recorder: &mut Recorder<'_>, scene: &Scene, frame: &FrameStep<'_>, moves: bool, losses: &Losses) {
        let Self { field, interpolate, image, grad_image, grad_rgb, grad_coords, grad_bary, .. } = self;
        let (camera, n, target) = (&frame.level.camera, frame.level.camera.n_pixels(), frame.target());
        let (hard, faces, texcoords) = (&scene.hard, &scene.corners.faces, &self.texcoords.values);
        let seed = frame.number.wrapping_mul(0x9e37_79b9) ^ frame.frame as u32;
        let sampling = Sampling { rate: self.pixel_rate as f64, seed };
        interpolate.forward(recorder, n, &hard.pix_to_face, &hard.bary_coords, faces, texcoords, sampling);
        let n_max = interpolate.n_max(n);
        field.forward(recorder, &interpolate.coords, &interpolate.count, n_max);
        interpolate.scatter(recorder, n, &field.rgb, BACKGROUND, image);

        let weight = frame.per_pixel(frame.weights.rgb) / self.pixel_rate;
        let trusted = Some(&self.trusted[frame.frame]);
        self.rgb.forward(recorder, n, image, target, trusted, losses.slot(Term::Rgb));
        recorder.clear(grad_image);
        self.rgb.backward(recorder, n, image, target, trusted, weight, grad_image);
        interpolate.gather(recorder, n, grad_image, grad_rgb);
        recorder.clear(grad_coords);
        field.backward(recorder, &interpolate.coords, &interpolate.count, n_max, grad_rgb, grad_coords);
        let grad_texcoords = &self.texcoords.grads;
        interpolate.backward(recorder, n, &hard.pix_to_face, &hard.bary_coords, faces, grad_coords, grad_texcoords);
        if moves {
            recorder.clear(grad_bary);
            interpolate.backward_bary(recorder, n, &hard.pix_to_face, faces, texcoords, grad_coords, grad_bary);
            hard.backward(recorder, camera, &scene.view, grad_bary, None, &scene.grad_view);
        }
    }

    fn borders(&self) -> Option<RgbGradient<'_>> {
        None
    }

    fn face_colours(&self) -> (&Buffer<f32>, &Buffer<f32>) {
        (&self.face_colours, &self.grad_face_colours)
    }

    fn step(&mut self, recorder: &mut Recorder<'_>, rates: &Rates, step: &Step<'_>) {
        self.field_steps += 1;
        let (field, n, rate) = (&self.field, self.field_steps, rates.field * step.rate);
        let (table, weights) = (0..field.table.len(), 0..field.weights.len());
        self.table.step(recorder, &field.table, &field.grad_table, table, rate, n);
        self.weights.step(recorder, &field.weights, &field.grad_weights, weights, rate, n);
        self.texcoords.step(recorder, &[0], rates.texcoords * step.rate);
    }

    fn read_into(&self, scene: &Scene, state: &mut FitState) -> Result<(), FitError> {
        state.texcoords = self.texcoords.read(&scene.gpu)?;
        state.field = self.field.params(&scene.gpu)?;
        Ok(())
    }
}
