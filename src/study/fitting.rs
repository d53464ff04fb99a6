//! Fits of one clip with any configuration, in this process, from one start.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context as _, Result};

use super::Context;
use crate::avatar::{AvatarModel, Renderer};
use crate::body::Body;
use crate::capture::{Capture, CaptureInputs, CaptureOptions};
use crate::eval::{self, Subject, evaluate};
use crate::fit::stage0::{self, Stage0Options, Stage0Result};
use crate::fit::{self, Control, FitConfig, FitState, Flow, StepReport};

/// A clip with the poses and the shape that stage 0 found, from keypoints and masks alone.
pub struct Clip {
    pub body: Body,
    pub capture: Capture,
    pub start: Stage0Result,
    folder: PathBuf,
}

/// What a fit gave.
pub struct Fitted {
    pub renderer: Renderer,
    /// Stages 1 and 2.
    pub secs: f64,
}

impl Clip {
    /// Reads the clip of a folder as [`eval::synthesise`] lays it out, and finds poses and shape.
    pub fn open(context: &Context<'_>, folder: &Path) -> Result<Self> {
        (context.say)("finding poses and shape");
        let body = context.load_body()?;
        let inputs = CaptureInputs {
            video: folder.join("video.mp4"),
            masks: folder.join("masks.zip"),
            keypoints: folder.join("keypoints.json"),
            camera: Some(folder.join("camera.json")),
            poses: None,
        };
        let capture = Capture::load(&inputs, &CaptureOptions { max_frames: 120, max_side_px: 1080 })?;
        let start = stage0::solve(&body, &capture, &Stage0Options::default(), &mut |_| true)?;
        Ok(Self { body, capture, start, folder: folder.to_owned() })
    }

    /// Runs stages 1 and 2.
    pub fn fit(&self, context: &Context<'_>, config: &FitConfig) -> Result<Fitted> {
        let (body, start) = (&self.body, &self.start);
        let state = FitState::new(body, start.betas.clone(), &start.poses, &start.transl, config.field, config.seed);
        let scratch = tempfile::tempdir_in(&context.work)?;
        let checkpoint = scratch.path().join("checkpoint.npz");
        let (started, camera) = (Instant::now(), &start.camera);
        let state = fit::run(&context.gpu, body, &self.capture, camera, config, state, &checkpoint, &mut ToTheEnd)?;
        let secs = started.elapsed().as_secs_f64();
        let model = self.model(config, &state);
        Ok(Fitted { renderer: Renderer::new(&context.gpu, &Arc::new(model))?, secs })
    }

    fn model(&self, config: &FitConfig, state: &FitState) -> AvatarModel {
        AvatarModel {
            body: self.body.clone(),
            betas: state.betas.clone(),
            offsets: state.offsets.as_chunks().0.to_vec(),
            texcoords: state.texcoords.as_chunks().0.to_vec(),
            texture_config: config.field,
            texture: state.field.clone(),
            light: state.light,
            face_colours: state.face_colours.as_chunks().0.to_vec(),
            poses: state.poses.as_chunks().0.to_vec(),
            transl: state.transl.as_chunks().0.to_vec(),
            frames: self.capture.frames.iter().map(|frame| frame.index).collect(),
            fps: self.capture.fps,
            camera: self.start.camera.clone(),
        }
    }

    /// The scores of an avatar against the folder's truth.
    pub fn score(&self, fitted: &Fitted) -> Result<eval::Summary> {
        let subject = Subject::open(&self.folder).with_context(|| self.folder.display().to_string())?;
        Ok(evaluate(&fitted.renderer, &subject, None, |_| {})?.summary)
    }
}

/// Nobody stops a study's fit.
struct ToTheEnd;

impl Control for ToTheEnd {
    fn after_step(&mut self, _: &StepReport<'_>) -> Flow {
        Flow::Continue
    }
}
