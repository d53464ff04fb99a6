//! One colour a face (paper §3.6, stage 1): too coarse to hide what the geometry has wrong.

use super::{Appearance, Lit, cast_shadows, solve_face_colours};
use crate::fit::checkpointed::{Checkpointed, Checkpointer};
use crate::fit::config::{Phase, Rates};
use crate::fit::frame_step::{BACKGROUND, FrameStep};
use crate::fit::groups::Group;
use crate::fit::losses::Losses;
use crate::fit::poses::PoseGroups;
use crate::fit::scene::Scene;
use crate::fit::schedule::Step;
use crate::fit::state::FitState;
use crate::fit::{FitError, Inputs};
use crate::gpu::{Buffer, Recorder};
use crate::ops::adam::AdamConfig;
use crate::ops::edge_gradient::RgbGradient;
use crate::ops::light::Write;
use crate::ops::rgb_l1::{Pixels, RgbL1};

/// Face colours with their image.
pub struct FaceColours {
    faces: Vec<[u32; 3]>,
    /// Under a light the albedo.
    colours: Group,
    lit: Option<LitFaces>,
    rgb: RgbL1,
    image: Buffer<f32>,
    grad_image: Buffer<f32>,
    /// Whether any image of the colours is compared; else nothing moves them.
    compared: bool,
    /// Whether a phase starts from colours in closed form.
    solved: bool,
}

/// The faces under a light.
struct LitFaces {
    lit: Lit,
    /// `[F, 3]`
    shaded: Buffer<f32>,
    grad_shaded: Buffer<f32>,
}

impl FaceColours {
    pub fn new(scene: &Scene, inputs: &Inputs<'_>, state: &FitState) -> Self {
        let (gpu, n, config) = (&scene.gpu, scene.max_pixels, inputs.config);
        let faces = &inputs.body.faces;
        let lit = || LitFaces {
            lit: Lit::new(gpu, faces, &scene.topology, scene.frames.len(), state.light),
            shaded: gpu.zeros("fit/shaded_colours", state.face_colours.len()),
            grad_shaded: gpu.zeros("fit/grad_shaded_colours", state.face_colours.len()),
        };
        Self {
            faces: faces.to_vec(),
            lit: config.light.then(lit),
            colours: Group::whole(gpu, "face_colours", &state.face_colours, AdamConfig::default()),
            rgb: RgbL1::new(gpu, n),
            image: gpu.zeros("fit/image", n * 3),
            grad_image: gpu.zeros("fit/grad_image", n * 3),
            compared: config.geometry.weights.compare_colours(),
            solved: config.solve_face_colours,
        }
    }
}

impl Checkpointed for FaceColours {
    fn checkpoint(&mut self, checkpointer: &mut Checkpointer<'_>, name: &str) -> Result<(), FitError> {
        self.colours.checkpoint(checkpointer, &format!("{name}.face_colours"))
    }
}

impl Appearance for FaceColours {
    /// Solves the colours anew where that is wished.
    fn start_phase(&mut self, scene: &Scene, poses: &PoseGroups, phase: &Phase) -> Result<(), FitError> {
        if self.compared && self.solved {
            let lit = self.lit.as_mut().map(|faces| &mut faces.lit);
            let albedos = solve_face_colours(scene, &self.faces, lit, poses, phase.level)?;
            scene.gpu.write(&self.colours.values, 0, &albedos.colours);
        }
        Ok(())
    }

    fn cast_shadows(&mut self, scene: &Scene, poses: &PoseGroups) -> Result<(), FitError> {
        if let Some(LitFaces { lit, .. }) = &mut self.lit {
            cast_shadows(scene, &self.faces, lit, poses)?;
        }
        Ok(())
    }

    fn start_step(&self, recorder: &mut Recorder<'_>, _scene: &Scene) {
        self.colours.clear(recorder);
    }

    fn start_frame(&self, recorder: &mut Recorder<'_>, scene: &Scene, frame: usize) {
        if let Some(LitFaces { lit, shaded, grad_shaded }) = &self.lit {
            lit.start_frame(recorder, scene, frame);
            lit.faces(recorder, &self.colours.values, shaded, Write::Cut);
            recorder.clear(grad_shaded);
        }
    }

    /// Within a face nothing changes, so the faces' insides do not move the mesh.
    fn hard(&self, recorder: &mut Recorder<'_>, scene: &Scene, frame: &FrameStep<'_>, _moves: bool, losses: &Losses) {
        let (camera, n, target) = (&frame.level.camera, frame.level.camera.n_pixels(), frame.target());
        let Self { image, grad_image, .. } = self;
        let (colours, grad_colours) = self.face_colours();
        scene.hard.shade(recorder, camera, colours, BACKGROUND, image);
        let (slot, weight) = (losses.rgb_slot(frame.frame), frame.per_pixel(frame.weights.rgb));
        self.rgb.forward_backward(recorder, n, image, target, Pixels::All, slot, weight, grad_image);
        scene.hard.shade_backward(recorder, camera, &scene.view, grad_image, grad_colours);
    }

    fn borders(&self, _frame: &FrameStep<'_>) -> Option<RgbGradient<'_>> {
        Some(RgbGradient { image: &self.image, grad_image: &self.grad_image })
    }

    fn face_colours(&self) -> (&Buffer<f32>, &Buffer<f32>) {
        match &self.lit {
            Some(faces) => (&faces.shaded, &faces.grad_shaded),
            None => (&self.colours.values, &self.colours.grads),
        }
    }

    fn end_frame(&self, recorder: &mut Recorder<'_>) {
        if let Some(LitFaces { lit, grad_shaded, .. }) = &self.lit {
            lit.faces(recorder, grad_shaded, &self.colours.grads, Write::Add);
        }
    }

    fn step(&mut self, recorder: &mut Recorder<'_>, rates: &Rates, step: &Step<'_>) {
        if self.compared {
            self.colours.step(recorder, &[0], rates.face_colours * step.rate);
        }
    }

    fn read_into(&self, scene: &Scene, state: &mut FitState) -> Result<(), FitError> {
        state.face_colours = self.colours.read(&scene.gpu)?;
        if let Some(faces) = &self.lit {
            state.light = faces.lit.light;
        }
        Ok(())
    }
}
