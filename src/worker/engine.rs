//! What the device's thread can do. The real one owns the device; tests bring their own.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::pipeline::{self, Observer, Outcome, PipelineError, PipelineInput};
use super::renders::CachedRenderers;
use crate::gpu::{DeviceInfo, DeviceSelect, Gpu, GpuError};
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
    /// Sees to it that there is a device to fit on, before somebody's job depends on it.
    fn open(&mut self) -> Result<(), GpuError> {
        Ok(())
    }

    fn fit(&mut self, task: &FitTask, observer: &mut dyn Observer) -> Result<Outcome, PipelineError>;

    /// Writes the picture or mesh to `to`.
    fn draw(&mut self, request: &RenderRequest, to: &Path) -> Result<(), RenderError>;
}

/// The engine on a graphics device, which is opened before the first job or picture and anew after it failed.
#[derive(Default)]
pub struct DeviceEngine {
    gpu: Option<Arc<Gpu>>,
    renderers: CachedRenderers,
    /// Whether this process had a graphics processor.
    had_hardware: bool,
}

impl DeviceEngine {
    fn gpu(&mut self) -> Result<Arc<Gpu>, GpuError> {
        if let Some(gpu) = self.gpu.as_ref().filter(|gpu| gpu.check().is_ok()) {
            return Ok(gpu.clone());
        }
        // What it holds the next one may need.
        self.renderers.forget();
        self.gpu = None;
        let gpu = Gpu::open(&DeviceSelect::Auto)?;
        suits(gpu.info(), self.had_hardware)?;
        self.had_hardware = !gpu.info().software;
        Ok(self.gpu.insert(gpu).clone())
    }
}

/// A graphics processor that was lost comes back within seconds or needs somebody to look after it; a service that goes on without,
/// many times slower, would tell nobody.
fn suits(info: &DeviceInfo, had_hardware: bool) -> Result<(), GpuError> {
    if had_hardware && info.software {
        let reason = "it computes on the CPU, and this worker had a graphics processor".into();
        return Err(GpuError::Open { adapter: info.name.clone(), reason });
    }
    Ok(())
}

impl Engine for DeviceEngine {
    fn open(&mut self) -> Result<(), GpuError> {
        self.gpu().map(drop)
    }

    fn fit(&mut self, task: &FitTask, observer: &mut dyn Observer) -> Result<Outcome, PipelineError> {
        let gpu = self.gpu()?;
        // The models in the cache take memory that the fit may need.
        self.renderers.forget();
        let run = || pipeline::run(&gpu, &task.input, &task.data_dir, &task.work_dir, &task.out_dir, observer);
        // A device that fails shows as an error or a panic wherever its absence is met first: its own word counts.
        match (catch_unwind(AssertUnwindSafe(run)), gpu.check()) {
            (Err(_) | Ok(Err(PipelineError::Internal(_))), Err(fault)) => Err(fault.into()),
            (Ok(end), _) => end,
            (Err(panic), Ok(())) => resume_unwind(panic),
        }
    }

    fn draw(&mut self, request: &RenderRequest, to: &Path) -> Result<(), RenderError> {
        let gpu = self.gpu().map_err(|error| RenderError::Unavailable(error.to_string()))?;
        self.renderers.draw(&gpu, request, to)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lost_graphics_processor_is_not_replaced_by_the_cpu() {
        let info = |software| DeviceInfo {
            name: "one".into(),
            backend: "vulkan".into(),
            driver: String::new(),
            software,
            wide_atomics: false,
            wide_sums: false,
            wide: false,
            clock: false,
            max_binding_bytes: 0,
            max_workgroup: 0,
        };
        for (software, had_hardware, suitable) in
            [(true, false, true), (false, false, true), (false, true, true), (true, true, false)]
        {
            assert_eq!(suits(&info(software), had_hardware).is_ok(), suitable, "{software} {had_hardware}");
        }
    }
}
