//! What the device's thread can do. The real one owns the device; tests bring their own.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::pipeline::{self, Observer, Outcome, PipelineError, PipelineInput};
use super::renders::Draughtsman;
use crate::gpu::{DeviceSelect, Gpu, GpuError};
use crate::jobs::render::{RenderError, RenderRequest};

/// A job's run, as folders.
#[derive(Clone, Debug)]
pub struct FitTask {
    pub input: PipelineInput,
    /// Where the bodies are.
    pub data_dir: PathBuf,
    /// Checkpoints; outlives the attempt.
    pub work_dir: PathBuf,
    /// The results of this attempt.
    pub out_dir: PathBuf,
}

/// Fits and draws, one thing at a time.
pub trait Engine: Send + 'static {
    fn fit(&mut self, task: &FitTask, observer: &mut dyn Observer) -> Result<Outcome, PipelineError>;

    /// Writes the picture or mesh to `to`.
    fn draw(&mut self, request: &RenderRequest, to: &Path) -> Result<(), RenderError>;
}

/// The engine on a graphics device, which is opened when it is first needed and anew after it failed.
#[derive(Default)]
pub struct DeviceEngine {
    gpu: Option<Arc<Gpu>>,
    draughtsman: Draughtsman,
}

impl DeviceEngine {
    fn gpu(&mut self) -> Result<Arc<Gpu>, GpuError> {
        if self.gpu.as_ref().is_none_or(|gpu| gpu.check().is_err()) {
            self.draughtsman.forget();
            self.gpu = Some(Gpu::open(&DeviceSelect::Auto)?);
        }
        // Just set where it was missing.
        self.gpu.clone().ok_or_else(|| GpuError::NoAdapter("none".into()))
    }
}

impl Engine for DeviceEngine {
    fn fit(&mut self, task: &FitTask, observer: &mut dyn Observer) -> Result<Outcome, PipelineError> {
        let gpu = self.gpu()?;
        // The models in the cache take memory that the fit may need.
        self.draughtsman.forget();
        let run = || pipeline::run(&gpu, &task.input, &task.data_dir, &task.work_dir, &task.out_dir, observer);
        // A device that fails shows as an error or a panic wherever its absence is met first: its own word counts.
        match (catch_unwind(AssertUnwindSafe(run)), gpu.check()) {
            (Err(_) | Ok(Err(PipelineError::Internal(_))), Err(fault)) => Err(fault.into()),
            (Ok(end), _) => end,
            (Err(panic), Ok(())) => resume_unwind(panic),
        }
    }

    fn draw(&mut self, request: &RenderRequest, to: &Path) -> Result<(), RenderError> {
        let gpu = self.gpu().map_err(|error| RenderError::Failed(error.to_string()))?;
        self.draughtsman.draw(&gpu, request, to)
    }
}
