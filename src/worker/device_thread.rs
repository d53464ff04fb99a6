//! The thread that owns the device: everything that touches it happens here, one thing at a time. While a fit runs,
//! renders are drawn between its iterations.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;

use tokio::sync::{oneshot, watch};

use super::engine::{Engine, FitTask};
use super::fit_observer::FitObserver;
use super::pipeline::{Outcome, PipelineError};
use super::running_fit::RunningFit;
use crate::gpu::GpuError;
use crate::jobs::render::{RenderError, RenderRequest};

pub(super) type Answer = Box<dyn FnOnce(Result<(), RenderError>) + Send>;

/// What the thread is asked for.
pub(super) enum Task {
    Open(oneshot::Sender<Result<(), GpuError>>),
    Fit { task: Box<FitTask>, running: Arc<RunningFit>, done: oneshot::Sender<Result<Outcome, PipelineError>> },
    Draw(Box<Drawing>),
}

/// A picture, and who waits for it.
pub(super) struct Drawing {
    pub request: RenderRequest,
    pub to: PathBuf,
    pub answer: Answer,
}

/// The way to the device.
#[derive(Clone)]
pub struct DeviceThread {
    tasks: Sender<Task>,
    /// Why there is no device.
    trouble: watch::Receiver<Option<String>>,
}

impl DeviceThread {
    /// Starts the thread. It ends when the last handle is gone.
    pub fn start(engine: impl Engine) -> std::io::Result<DeviceThread> {
        let (tasks, inbox) = channel();
        let (told, trouble) = watch::channel(None);
        thread::Builder::new().name("device".into()).spawn(move || serve(engine, &inbox, &told))?;
        Ok(DeviceThread { tasks, trouble })
    }

    /// Opens the device, where it is not open or has failed; the receiver learns whether it is.
    pub fn open(&self) -> oneshot::Receiver<Result<(), GpuError>> {
        let (done, opened) = oneshot::channel();
        let _ = self.tasks.send(Task::Open(done));
        opened
    }

    /// Why the device did not open when that was last tried.
    pub fn trouble(&self) -> watch::Receiver<Option<String>> {
        self.trouble.clone()
    }

    /// Runs a fit; the receiver gets its end.
    pub fn fit(&self, task: FitTask, running: Arc<RunningFit>) -> oneshot::Receiver<Result<Outcome, PipelineError>> {
        let (done, end) = oneshot::channel();
        // A thread that is gone drops the sender, which the receiver sees.
        let _ = self.tasks.send(Task::Fit { task: Box::new(task), running, done });
        end
    }

    /// Has something drawn; `answer` is called from the device's thread.
    pub fn draw(
        &self,
        request: RenderRequest,
        to: PathBuf,
        answer: impl FnOnce(Result<(), RenderError>) + Send + 'static,
    ) {
        let answer: Answer = Box::new(answer);
        if let Err(error) = self.tasks.send(Task::Draw(Box::new(Drawing { request, to, answer })))
            && let Task::Draw(drawing) = error.0
        {
            (drawing.answer)(Err(RenderError::Unavailable("the device's thread has ended".into())));
        }
    }
}

fn serve(mut engine: impl Engine, inbox: &Receiver<Task>, trouble: &watch::Sender<Option<String>>) {
    while let Ok(task) = inbox.recv() {
        match task {
            Task::Open(done) => {
                let opened = catch_unwind(AssertUnwindSafe(|| engine.open()));
                let opened = opened.unwrap_or_else(|panic| Err(GpuError::Failed(panicked(panic.as_ref()).to_string())));
                let now = opened.as_ref().err().map(ToString::to_string);
                trouble.send_if_modified(|trouble| std::mem::replace(trouble, now.clone()) != now);
                let _ = done.send(opened);
            }
            Task::Fit { task, running, done } => {
                let mut observer = FitObserver::new(running, inbox);
                let run = catch_unwind(AssertUnwindSafe(|| engine.fit(&task, &mut observer)));
                observer.end_stage();
                // Nobody may be waiting any more; the end is the same.
                let _ = done.send(run.unwrap_or_else(|panic| Err(panicked(panic.as_ref()))));
            }
            Task::Draw(drawing) => answer_with(*drawing, |request, to| engine.draw(request, to)),
        }
    }
}

/// Draws, and answers also where drawing panics.
pub(super) fn answer_with(drawing: Drawing, draw: impl FnOnce(&RenderRequest, &Path) -> Result<(), RenderError>) {
    let drawn = catch_unwind(AssertUnwindSafe(|| draw(&drawing.request, &drawing.to)));
    let failed = |panic: Box<dyn std::any::Any + Send>| Err(RenderError::Failed(panicked(panic.as_ref()).to_string()));
    (drawing.answer)(drawn.unwrap_or_else(failed));
}

fn panicked(panic: &(dyn std::any::Any + Send)) -> PipelineError {
    let message = panic.downcast_ref::<String>().map(String::as_str);
    let message = message.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no message");
    PipelineError::Internal(anyhow::anyhow!("panicked: {message}"))
}
