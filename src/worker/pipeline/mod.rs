//! A job from files to files: decode, fit, bake, export. `effigy fit` runs the same pipeline without a server.

mod closeups;
mod curves;
mod export;
mod fits;
mod made_by;
mod monitor;
mod page;
mod preview;
mod quality;
mod run;
mod score;

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::camera::Camera;
use crate::capture::{CaptureError, CaptureInputs};
use crate::gpu::{Gpu, GpuError};
use crate::jobs::JobOptions;

pub use run::run;

/// The files of a clip and what is asked of its fit.
#[derive(Clone, Debug)]
pub struct PipelineInput {
    pub files: CaptureInputs,
    pub options: JobOptions,
}

/// The stages of a job, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// The clip is read into memory.
    Decode,
    /// Stage 0: pose, shape and place.
    Pose,
    /// Stage 1: geometry and face colours.
    Geometry,
    /// Stage 2: the texture field.
    Texture,
    /// The texture's atlas and all files of the avatar.
    Bake,
    /// Scores and reports.
    Export,
}

impl Stage {
    /// In their order.
    pub const ALL: [Stage; 6] =
        [Stage::Decode, Stage::Pose, Stage::Geometry, Stage::Texture, Stage::Bake, Stage::Export];

    pub fn name(self) -> &'static str {
        match self {
            Stage::Decode => "decode",
            Stage::Pose => "pose",
            Stage::Geometry => "geometry",
            Stage::Texture => "texture",
            Stage::Bake => "bake",
            Stage::Export => "export",
        }
    }
}

/// Where a run stands.
#[derive(Clone, Debug, PartialEq)]
pub struct Progress {
    pub stage: Stage,
    /// Done steps of the stage.
    pub step: u32,
    pub steps: u32,
    /// Of the whole job, 0 to 1.
    pub progress: f32,
    pub eta_secs: Option<f64>,
    /// The last value of each loss.
    pub losses: BTreeMap<String, f64>,
}

/// A picture of the avatar in the making.
#[derive(Clone, Debug, PartialEq)]
pub struct Preview {
    pub jpeg: Vec<u8>,
    /// Where the run stood.
    pub at: Progress,
}

/// Why a run shall stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StopReason {
    /// A user wishes it.
    Cancel,
    /// Somebody else has the job.
    LostLease,
    /// The process ends; another goes on from the checkpoint.
    Shutdown,
}

/// Who started a run, as the run sees it. All calls come from the run's own thread and return quickly.
pub trait Observer {
    fn progress(&mut self, progress: &Progress);

    /// There was a checkpoint, but of another program, clip, body or options: the run begins anew.
    fn begins_anew(&mut self) {}

    /// The checkpoint on the disk now holds so much of the whole job, 0 to 1, but for a step.
    fn saved(&mut self, _progress: f32) {}

    /// Whether pictures of the avatar in the making are wanted.
    fn takes_previews(&self) -> bool {
        false
    }

    /// A picture of the avatar in the making.
    fn preview(&mut self, _preview: Preview) {}

    /// Asked between iterations; `Some` means: write a checkpoint, unless another has the job, and return [`PipelineError::Stopped`].
    fn stop(&mut self) -> Option<StopReason>;

    /// Called between iterations with the device at rest, so that others' renders need not wait for the end.
    fn idle(&mut self, gpu: &Arc<Gpu>);
}

/// What a run made; the files lie in its output folder.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Fitted frames.
    pub frames: u32,
    /// Of the fitted images.
    pub camera: Camera,
    pub metrics: serde_json::Value,
}

/// Why there is no avatar.
#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    #[error("stopped: {0:?}")]
    Stopped(StopReason),
    #[error(transparent)]
    BadInput(#[from] CaptureError),
    /// The clip is well formed, but no person could be fitted to it.
    #[error("{0}")]
    Unfit(String),
    #[error("the fit diverged: {detail}")]
    Diverged { detail: String, losses: BTreeMap<String, f64> },
    #[error(transparent)]
    Device(#[from] GpuError),
    #[error("{0:#}")]
    Internal(#[from] anyhow::Error),
}
