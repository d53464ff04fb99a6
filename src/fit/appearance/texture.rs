//! A texture over the surface (paper §3.2), trained through the hard image. Where the shape stands, the soft image is drawn
//! with the face colours as they stand; where it is fitted too, each face has the texture's colour in its middle, without
//! a gradient (the paper's `sg(φ)`).

use super::facing::facing_pixels;
use super::mean_colours::{FaceAlbedos, well_inside};
use super::model::TextureModel;
use super::unseen::{self, Unseen};
use super::{Appearance, Lit, cast_shadows, solve_face_colours};
use crate::fit::checkpointed::{Checkpointed, Checkpointer};
use crate::fit::config::{Phase, Rates};
use crate::fit::frame_step::{BACKGROUND, FrameStep};
use crate::fit::frames::{DeviceFrame, FrameLevel};
use crate::fit::groups::Group;
use crate::fit::losses::Losses;
use crate::fit::poses::PoseGroups;
use crate::fit::scene::Scene;
use crate::fit::schedule::Step;
use crate::fit::state::FitState;
use crate::fit::{FitError, Inputs};
use crate::gpu::{Buffer, Gpu, Recorder};
use crate::ops::PixelList;
use crate::ops::adam::AdamConfig;
use crate::ops::edge_gradient::RgbGradient;
use crate::ops::interpolate::{Interpolate, Sampling};
use crate::ops::light::Write;
use crate::ops::rgb_l1::{Pixels, RgbL1};

/// A texture, its coordinates, and the way from them to pixels and back.
pub struct Texture {
    model: TextureModel,
    /// Coordinates that the model takes at once
    capacity: usize,
    steps: u32,
    /// `[U, 3]`: a row a vertex, or a row a corner of a texel map's layout
    texcoords: Group,
    /// `[F, 3]`: the layout's corners; absent, those of the mesh
    uv_faces: Option<Buffer<u32>>,
    /// Whether the coordinates are learned.
    learned: bool,
    faces: Vec<[u32; 3]>,
    /// `[V]` both: the body's
    mirror: Vec<u32>,
    template: Vec<[f32; 3]>,
    lit: Option<LitTexture>,
    interpolate: Interpolate,
    rgb: RgbL1,
    /// Under a light the albedo.
    face_colours: Buffer<f32>,
    /// Scratch: the soft image does not move the colours.
    grad_face_colours: Buffer<f32>,
    moves_shape: bool,
    /// Present where the face colours follow the texture: for the soft image of a shape that is fitted.
    middles: Option<Middles>,
    image: Buffer<f32>,
    grad_image: Buffer<f32>,
    grad_rgb: Buffer<f32>,
    grad_coords: Buffer<f32>,
    grad_bary: Buffer<f32>,
    /// `[N][level]`, see [`trusted_pixels`].
    trusted: Vec<Vec<PixelList>>,
    pixel_rate: f32,
    /// That a step looks at in one frame, as expected of a random sample.
    most_pixels: usize,
    facing: bool,
    /// Whether what no frame shows is filled, and that, once a phase has begun.
    fills: bool,
    unseen: Option<Unseen>,
    /// Of the frames' colours.
    rgb_weight: f32,
}

/// The most pixels that a step lists in one frame: what the smallest allowed binding holds of the field's activations.
const MAX_LISTED: usize = 1 << 20;

/// The length of a list for so many expected pixels. A random sample may be a little larger than is expected of it, and the body
/// larger than what is trusted of its mask; pixels that find no place would always be those at the bottom of the picture.
const fn listed(expected: usize) -> usize {
    expected * 5 / 4
}

/// The most pixels that may be expected: `listed` of it is [`MAX_LISTED`].
const MOST_EXPECTED: usize = MAX_LISTED * 4 / 5;

/// Part of a frame's pixels that a step looks at, of which `trusted` are to be learned from: `pixel_rate`, but at most
/// `most_pixels` on the mean.
fn sampled(pixel_rate: f32, most_pixels: usize, trusted: usize) -> f32 {
    pixel_rate.min(most_pixels as f32 / trusted.max(1) as f32)
}

/// The texture under a light: its colours are the albedo.
struct LitTexture {
    lit: Lit,
    /// `[F, 3]`: the face colours in the light of the frame
    shaded_faces: Buffer<f32>,
    /// `[P, 2]`: of the shade
    parts: Buffer<f32>,
    /// `[P, 3]` both
    shaded: Buffer<f32>,
    grad_shaded: Buffer<f32>,
}

/// The middles of all faces, as an image with a pixel a face.
struct Middles {
    interpolate: Interpolate,
    pix_to_face: Buffer<i32>,
    bary_coords: Buffer<f32>,
    n_faces: usize,
}

impl Middles {
    fn new(gpu: &Gpu, n_faces: usize) -> Self {
        let faces: Vec<i32> = (0..n_faces as i32).collect();
        Self {
            interpolate: Interpolate::new(gpu, n_faces, n_faces, 0),
            pix_to_face: gpu.upload("fit/middles/pix_to_face", &faces),
            bary_coords: gpu.upload("fit/middles/bary_coords", &vec![1.0 / 3.0; 3 * n_faces]),
            n_faces,
        }
    }
}

/// The pixels that the texture learns from.
fn trusted_pixels(gpu: &Gpu, level: &FrameLevel) -> Result<PixelList, FitError> {
    let pixels: Vec<[u8; 4]> = gpu.read(&level.target)?.into_iter().map(u32::to_le_bytes).collect();
    Ok(PixelList::new(gpu, "fit/trusted", well_inside(&pixels, level.width as usize)))
}

impl Texture {
    pub fn new(scene: &Scene, inputs: &Inputs<'_>, state: &FitState) -> Result<Self, FitError> {
        let (gpu, n, n_faces) = (&scene.gpu, scene.max_pixels, scene.corners.n_faces());
        let (config, faces) = (inputs.config, &inputs.body.faces);
        let follows = config.texture.shape && config.texture.weights.rgb_soft != 0.0;
        let levels = |frame: &DeviceFrame| frame.levels.iter().map(|level| trusted_pixels(gpu, level)).collect();
        let trusted = scene.frames.iter().map(levels);
        let zeros = |name: &str| gpu.zeros::<f32>(&format!("fit/{name}"), n * 3);
        let lit = || LitTexture {
            lit: Lit::new(gpu, faces, &scene.topology, scene.frames.len(), state.light).standing(config.light_stands),
            shaded_faces: gpu.zeros("fit/shaded_faces", n_faces * 3),
            parts: gpu.zeros("fit/pixel_parts", 2 * n),
            shaded: zeros("shaded"),
            grad_shaded: zeros("grad_shaded"),
        };
        let texels = state.texels.as_ref();
        let coords = texels.map_or(state.texcoords.clone(), |t| t.uvs.iter().flat_map(|&[u, v]| [u, v, 0.0]).collect());
        let most_pixels = config.most_pixels.unwrap_or(MOST_EXPECTED).min(MOST_EXPECTED);
        let listed = n.min(listed(most_pixels));
        let capacity = listed.max(n_faces);
        Ok(Self {
            model: TextureModel::new(gpu, config, state, capacity)?,
            capacity,
            steps: 0,
            texcoords: Group::whole(gpu, "texcoords", &coords, AdamConfig::default()),
            uv_faces: texels.map(|t| gpu.upload("fit/uv_faces", t.uv_faces.as_flattened())),
            learned: texels.is_none() && config.rates.texcoords != 0.0,
            faces: faces.clone(),
            mirror: inputs.body.mirror.clone(),
            template: inputs.body.v_template.clone(),
            lit: config.light.then(lit),
            interpolate: Interpolate::new(gpu, n, listed, coords.len() / 3),
            rgb: RgbL1::new(gpu, n),
            face_colours: gpu.upload("fit/face_colours", &state.face_colours),
            grad_face_colours: gpu.zeros("fit/grad_face_colours", state.face_colours.len()),
            moves_shape: config.texture.shape,
            middles: follows.then(|| Middles::new(gpu, n_faces)),
            image: zeros("image"),
            grad_image: zeros("grad_image"),
            grad_rgb: zeros("grad_rgb"),
            grad_coords: zeros("grad_coords"),
            grad_bary: zeros("grad_bary"),
            trusted: trusted.collect::<Result<_, FitError>>()?,
            pixel_rate: config.pixel_rate,
            most_pixels,
            facing: config.facing,
            fills: config.fill_unseen,
            unseen: None,
            rgb_weight: config.texture.weights.rgb,
        })
    }

    /// Of the frame, as [`sampled`].
    fn rate(&self, frame: &FrameStep<'_>) -> f32 {
        sampled(self.pixel_rate, self.most_pixels, self.trusted(frame).len())
    }

    fn trusted(&self, frame: &FrameStep<'_>) -> &PixelList {
        &self.trusted[frame.frame][frame.phase.level]
    }

    fn faces<'a>(&'a self, scene: &'a Scene) -> &'a Buffer<u32> {
        self.uv_faces.as_ref().unwrap_or(&scene.corners.faces)
    }

    /// Records the colours of some of the `n` pixels of the scene's last hard image, in the frame's light; others are the background.
    fn show(&self, recorder: &mut Recorder<'_>, scene: &Scene, frame: usize, n: usize, sampling: Sampling) {
        let Self { model, interpolate, .. } = self;
        let (hard, faces, texcoords) = (&scene.hard, self.faces(scene), &self.texcoords.values);
        interpolate.forward(recorder, n, &hard.pix_to_face, &hard.bary_coords, faces, texcoords, sampling);
        model.forward(recorder, &interpolate.coords, &interpolate.count, interpolate.n_max(n));
        let shown = match &self.lit {
            Some(LitTexture { lit, parts, shaded, .. }) => {
                lit.pixel_parts(recorder, scene, frame, interpolate, n, parts);
                lit.pixels(recorder, interpolate, n, parts, model.rgb(), shaded, Write::Cut);
                shaded
            }
            None => model.rgb(),
        };
        interpolate.scatter(recorder, n, shown, BACKGROUND, &self.image);
    }

    /// `[P, 3]`: what a frame looks like. Of a texture whose configuration limits its pixels not all of them are drawn. Waits.
    pub fn draw(&self, scene: &Scene, poses: &PoseGroups, frame: usize) -> Result<Vec<[f32; 3]>, FitError> {
        let level = &scene.frames[frame].levels[0];
        let mut recorder = scene.gpu.recorder("fit/draw");
        scene.forward(&mut recorder, level, poses.at(frame));
        self.start_frame(&mut recorder, scene, frame);
        self.show(&mut recorder, scene, frame, level.camera.n_pixels(), Sampling::ALL);
        recorder.submit()?;
        let mut image = scene.gpu.read(&self.image)?.as_chunks().0.to_vec();
        image.truncate(level.camera.n_pixels());
        Ok(image)
    }
}

impl Checkpointed for Texture {
    fn checkpoint(&mut self, checkpointer: &mut Checkpointer<'_>, name: &str) -> Result<(), FitError> {
        checkpointer.counts(&format!("{name}.steps"), std::slice::from_mut(&mut self.steps))?;
        self.texcoords.checkpoint(checkpointer, &format!("{name}.texcoords"))?;
        self.model.checkpoint(checkpointer, name)
    }
}

impl Appearance for Texture {
    /// Solves light, where it does not stand, and face colours anew for the geometry as it is, and finds out what no frame shows.
    fn start_phase(&mut self, scene: &Scene, poses: &PoseGroups, phase: &Phase) -> Result<(), FitError> {
        if self.facing {
            for frame in 0..scene.frames.len() {
                self.trusted[frame][phase.level] = facing_pixels(scene, &self.faces, poses, frame, phase.level)?;
            }
        }
        if self.lit.is_none() && !self.fills {
            return Ok(());
        }
        let lit = self.lit.as_mut().map(|texture| &mut texture.lit);
        let FaceAlbedos { mut colours, counts } = solve_face_colours(scene, &self.faces, lit, poses, phase.level)?;
        if self.lit.is_some() {
            scene.gpu.write(&self.face_colours, 0, &colours);
        }
        if self.fills {
            let known = unseen::known(&self.faces, &self.template, &counts);
            unseen::fill(&self.faces, &self.mirror, &known, &mut colours);
            let faces: Vec<u32> = (0..known.len() as u32).filter(|&f| !known[f as usize]).collect();
            self.unseen = Unseen::new(&scene.gpu, &faces, &colours, self.capacity);
        }
        Ok(())
    }

    fn cast_shadows(&mut self, scene: &Scene, poses: &PoseGroups) -> Result<(), FitError> {
        if let Some(LitTexture { lit, .. }) = &mut self.lit {
            cast_shadows(scene, &self.faces, lit, poses)?;
        }
        Ok(())
    }

    fn start_step(&self, recorder: &mut Recorder<'_>, scene: &Scene) {
        self.model.clear(recorder);
        if self.learned {
            self.texcoords.clear(recorder);
        }
        if let Some(Middles { interpolate, pix_to_face, bary_coords, n_faces }) = &self.middles {
            let (faces, texcoords) = (self.faces(scene), &self.texcoords.values);
            interpolate.forward(recorder, *n_faces, pix_to_face, bary_coords, faces, texcoords, Sampling::ALL);
            self.model.forward(recorder, &interpolate.coords, &interpolate.count, *n_faces);
            interpolate.scatter(recorder, *n_faces, self.model.rgb(), BACKGROUND, &self.face_colours);
        }
        if let Some(unseen) = &self.unseen {
            unseen.record(
                recorder,
                &self.model,
                self.faces(scene),
                &self.texcoords.values,
                self.rgb_weight,
                self.steps,
            );
        }
    }

    fn start_frame(&self, recorder: &mut Recorder<'_>, scene: &Scene, frame: usize) {
        if let Some(LitTexture { lit, shaded_faces, .. }) = &self.lit {
            lit.start_frame(recorder, scene, frame);
            lit.faces(recorder, &self.face_colours, shaded_faces, Write::Cut);
        }
    }

    fn hard(&self, recorder: &mut Recorder<'_>, scene: &Scene, frame: &FrameStep<'_>, moves: bool, losses: &Losses) {
        let Self { model, interpolate, image, grad_image, grad_rgb, grad_coords, grad_bary, .. } = self;
        let (camera, n, target) = (&frame.level.camera, frame.level.camera.n_pixels(), frame.target());
        let (hard, faces, texcoords) = (&scene.hard, self.faces(scene), &self.texcoords.values);
        let seed = frame.number.wrapping_mul(0x9e37_79b9) ^ frame.frame as u32;
        let (trusted, rate) = (self.trusted(frame), self.rate(frame));
        let sampling = Sampling { rate: f64::from(rate), seed };
        let n_max = interpolate.n_max(n);
        self.show(recorder, scene, frame.frame, n, sampling);

        let weight = frame.per_pixel(frame.weights.rgb);
        let slot = losses.rgb_slot(frame.frame);
        let pixels = Pixels::Sampled(trusted, sampling);
        self.rgb.forward_backward(recorder, n, image, target, pixels, slot, weight, grad_image);
        match &self.lit {
            Some(LitTexture { lit, parts, grad_shaded, .. }) => {
                interpolate.gather(recorder, n, grad_image, grad_shaded);
                lit.pixels(recorder, interpolate, n, parts, grad_shaded, grad_rgb, Write::Over);
            }
            None => interpolate.gather(recorder, n, grad_image, grad_rgb),
        }
        recorder.clear(grad_coords);
        model.backward(recorder, &interpolate.coords, &interpolate.count, n_max, grad_rgb, grad_coords);
        if self.learned {
            let grad_texcoords = &self.texcoords.grads;
            interpolate.backward(recorder, n, &hard.pix_to_face, &hard.bary_coords, faces, grad_coords, grad_texcoords);
        }
        if moves {
            recorder.clear(grad_bary);
            interpolate.backward_bary(recorder, n, &hard.pix_to_face, faces, texcoords, grad_coords, grad_bary);
            hard.backward(recorder, camera, &scene.view, grad_bary, None, &scene.grad_view);
        }
    }

    /// Only while the shape is fitted; and a sample of the pixels has no borders.
    fn borders(&self, frame: &FrameStep<'_>) -> Option<RgbGradient<'_>> {
        let whole = self.moves_shape && self.rate(frame) == 1.0;
        whole.then_some(RgbGradient { image: &self.image, grad_image: &self.grad_image })
    }

    fn face_colours(&self) -> (&Buffer<f32>, &Buffer<f32>) {
        let shown = self.lit.as_ref().map_or(&self.face_colours, |texture| &texture.shaded_faces);
        (shown, &self.grad_face_colours)
    }

    fn end_frame(&self, _recorder: &mut Recorder<'_>) {}

    fn step(&mut self, recorder: &mut Recorder<'_>, rates: &Rates, step: &Step<'_>) {
        self.steps += 1;
        self.model.step(recorder, rates.field * step.rate, self.steps);
        if self.learned {
            self.texcoords.step(recorder, &[0], rates.texcoords * step.rate);
        }
    }

    fn read_into(&self, scene: &Scene, state: &mut FitState) -> Result<(), FitError> {
        if self.learned {
            state.texcoords = self.texcoords.read(&scene.gpu)?;
        }
        if let Some(texture) = &self.lit {
            state.light = texture.lit.light;
        }
        if self.middles.is_some() || self.lit.is_some() {
            state.face_colours = scene.gpu.read(&self.face_colours)?;
        }
        self.model.read_into(&scene.gpu, state)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_expected_finds_a_place() {
        assert_eq!(sampled(0.5, MOST_EXPECTED, 60_000), 0.5);
        assert_eq!(sampled(1.0, 30_000, 60_000), 0.5);
        assert_eq!(sampled(1.0, MOST_EXPECTED, 0), 1.0);
        // Somebody who fills a picture of 4096 pixels in height.
        let covered = 3_000_000;
        for rate in [0.5, 1.0] {
            let on_the_mean = f64::from(sampled(rate, MOST_EXPECTED, covered)) * covered as f64;
            assert!(on_the_mean <= 0.81 * MAX_LISTED as f64, "{on_the_mean} of {MAX_LISTED}");
        }
        assert!(listed(MOST_EXPECTED) <= MAX_LISTED);
    }
}
