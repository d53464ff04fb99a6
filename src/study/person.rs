//! A made person with truth, ready to be fitted by the variants of a study.

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context as _, Result};
use glam::Vec3;
use image::RgbImage;

use super::Context;
use super::made_clip::{self, MadeOf};
use super::painter::on_white;
use crate::avatar::ply::Mesh;
use crate::avatar::{AvatarModel, RenderSpec, Renderer, Shading, Tracer, vertex_normals};
use crate::body::Body;
use crate::camera::Camera;
use crate::capture::Capture;
use crate::eval::{EvalOptions, Novel, Report, Subject, evaluate};
use crate::fit::config::{DIRECT_OFFSET_RATE, FrameSampling, Phase, Preconditioner};
use crate::fit::stage0::{self, Stage0Options};
use crate::fit::{self, Control, FitConfig, FitState, Flow, Inputs, StepReport};
use crate::gpu::Gpu;
use crate::picture::Background;
use crate::synth::SynthOptions;

/// A made clip in memory.
pub(super) struct Person {
    pub gpu: Arc<Gpu>,
    pub body: Body,
    pub capture: Capture,
    /// The clip's folder
    pub folder: PathBuf,
}

/// A fit's parameters and the camera that they belong to.
#[derive(Clone)]
pub(super) struct Fitted {
    pub camera: Camera,
    pub state: FitState,
}

/// The same for all variants of a study: no light is told from the albedo, since the light is even; frames count alike; D
/// steps along its diffused gradient.
pub(super) fn comparable(mut config: FitConfig) -> FitConfig {
    config.light = false;
    config.fill_unseen = false;
    config.frame_sampling = FrameSampling::Uniform;
    step_directly(&mut config, diffused);
    config
}

/// Steps of D itself instead of large steps' coordinates.
pub(super) fn step_directly(config: &mut FitConfig, preconditioner: fn(&Phase) -> Preconditioner) {
    config.rates.offsets = DIRECT_OFFSET_RATE;
    for phase in config.geometry.phases.iter_mut().chain(&mut config.texture.phases) {
        phase.preconditioner = preconditioner(phase);
    }
}

/// 10 pairs of diffusion steps at half and 4 at full resolution: what served best.
pub(super) fn diffused(phase: &Phase) -> Preconditioner {
    Preconditioner::Diffusion { pairs: if phase.level == 0 { 4 } else { 10 } }
}

struct Silent;

impl Control for Silent {
    fn after_step(&mut self, _report: &StepReport<'_>) -> Flow {
        Flow::Continue
    }
}

impl Person {
    /// Makes the clip where it is not there yet, and reads it as a job would.
    pub fn new(context: &Context<'_>, options: &SynthOptions) -> Result<Self> {
        let folder = context.clip(options)?;
        let capture = made_clip::load(&folder)?;
        Ok(Self { gpu: context.gpu.clone(), body: context.load_body()?, capture, folder })
    }

    /// Poses and shape as stage 0 finds them in keypoints and masks. The fits that follow see the keypoints as it has
    /// understood them.
    pub fn start(&mut self, config: &FitConfig) -> Result<Fitted> {
        // Silhouettes alone shall not start from what colours tell.
        let options = Stage0Options { use_pictures: false, ..Stage0Options::default() };
        let start = stage0::solve(&self.body, &self.capture, &options, &mut |_| true)?;
        start.reread(&mut self.capture);
        let state = FitState::new(&self.body, start.betas, &start.poses, &start.transl, config.field, config.seed);
        Ok(Fitted { camera: start.camera, state })
    }

    /// Shape, poses and places of the truth.
    pub fn true_start(&self, config: &FitConfig) -> Result<Fitted> {
        let MadeOf { betas, offsets, poses, transl } = MadeOf::read(&self.folder, &self.body)?;
        let mut state = FitState::new(&self.body, betas, &poses, &transl, config.field, config.seed);
        state.offsets = offsets.into_flattened();
        Ok(Fitted { camera: self.capture.camera.clone(), state })
    }

    /// `[24]`: the joints of frame 0, world space, metres.
    pub fn first_joints(&self) -> Result<Vec<[f64; 3]>> {
        Subject::open(&self.folder)?.joints.into_iter().next().context("a made clip has joints")
    }

    /// The fit from `start` on.
    pub fn fit(&self, config: &FitConfig, start: &Fitted) -> Result<Fitted> {
        let folder = tempfile::tempdir()?;
        let (path, state) = (folder.path().join("checkpoint.npz"), start.state.clone());
        let Self { gpu, body, capture, .. } = self;
        let inputs = Inputs { body, capture, camera: &start.camera, config };
        let state = fit::run(gpu, &inputs, state, &path, &mut Silent)?;
        Ok(Fitted { state, camera: start.camera.clone() })
    }

    pub fn avatar(&self, fitted: &Fitted, config: &FitConfig) -> AvatarModel {
        let state = &fitted.state;
        AvatarModel {
            body: self.body.clone(),
            betas: state.betas.clone(),
            offsets: state.offsets.as_chunks().0.to_vec(),
            texcoords: state.texcoords.as_chunks().0.to_vec(),
            texture_config: config.field,
            texture: state.field.clone(),
            face_colours: state.face_colours.as_chunks().0.to_vec(),
            light: state.light,
            poses: state.poses.as_chunks().0.to_vec(),
            transl: state.transl.as_chunks().0.to_vec(),
            pelvis_moved: [0.0; 3],
            frames: self.capture.frames.iter().map(|f| f.index).collect(),
            fps: self.capture.fps,
            camera: fitted.camera.clone(),
        }
    }

    /// The truth of the clip's surfaces and, with `views`, of its held-out views.
    pub fn truth(&self, views: bool) -> Result<Subject> {
        let whole = Subject::open(&self.folder)?;
        let mut truth = Subject::default();
        truth.surfaces = whole.surfaces;
        if views {
            truth.views = whole.views;
        }
        Ok(truth)
    }

    /// Docs' metrics of an avatar against `truth`.
    pub fn evaluate(&self, avatar: AvatarModel, truth: &Subject) -> Result<Report> {
        Ok(evaluate(&Renderer::new(&self.gpu, &Arc::new(avatar))?, truth, &EvalOptions::default(), |_| {})?)
    }

    /// A mesh of this body in grey under a raking light, `size_px` a side.
    pub fn lit(&self, mesh: &Mesh, camera: &Camera, size_px: u32) -> Result<RgbImage> {
        // From the left, above and before the person; y runs down.
        let light = Vec3::new(-0.8, -0.45, -0.4).normalize();
        let tracer = Tracer::new(&self.gpu, &mesh.faces, &mesh.vertices);
        let normals = vertex_normals(&mesh.vertices, &mesh.faces);
        let shade = |point: &crate::avatar::SurfacePoint| {
            let corners = mesh.faces[point.face as usize];
            let normal: Vec3 = (0..3).map(|k| Vec3::from(normals[corners[k] as usize]) * point.bary[k]).sum();
            [0.5 + 0.45 * normal.normalize_or_zero().dot(light); 3]
        };
        let picture =
            tracer.trace(&mesh.vertices, &camera.scaled(size_px, size_px), 3, Shading::Samples, |points| {
                Ok(points.iter().map(shade).collect())
            })?;
        Ok(on_white(&picture))
    }

    /// A held-out view of the avatar on white; `scale` is the truth's over ours.
    pub fn view(&self, avatar: AvatarModel, novel: &Novel, scale: f64) -> Result<RgbImage> {
        let avatar = Arc::new(avatar);
        let mut camera = novel.camera.clone();
        camera.translation = camera.translation.map(|t| t / scale);
        let spec = RenderSpec { camera, background: Background::Colour([255; 3]), ..RenderSpec::of_frame(&avatar, 0) };
        Ok(image::DynamicImage::ImageRgba8(Renderer::new(&self.gpu, &avatar)?.render(&spec)?).into_rgb8())
    }

    /// The surface of the first frame that has one, and that frame.
    pub fn first_surface(&self, truth: &Subject) -> Result<(Mesh, u32)> {
        let frame = truth.surfaces.first().context("a made clip has surfaces")?.0;
        Ok((truth.surface(0)?, frame))
    }
}

/// The middle of a picture, `share` of its width wide.
pub(super) fn middle(picture: &RgbImage, share: f64) -> RgbImage {
    let (width, height) = picture.dimensions();
    let kept = (share * width as f64) as u32;
    image::imageops::crop_imm(picture, (width - kept) / 2, 0, kept, height).to_image()
}
