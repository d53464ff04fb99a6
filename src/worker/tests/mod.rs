//! The worker with an engine of the tests' own, on a real queue and store.

mod jobs;
mod supervision;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use serde_json::json;
use tokio::sync::{mpsc, watch};
use uuid::Uuid;

use super::pipeline::{Observer, Outcome, PipelineError, Progress, Stage};
use super::*;
use crate::jobs::render::{RenderError, RenderRequest};
use crate::jobs::sqlite::SqliteQueue;
use crate::jobs::{Clip, Env, Job, JobOptions, NewJob, Part, Policy, Queue, State};
use crate::storage::Store;

/// What a fit does, step by step, and a word to the test at each.
type Script = Arc<dyn Fn(&FitTask, &mut dyn Observer) -> Result<Outcome, PipelineError> + Send + Sync>;

struct ScriptedEngine(Script);

impl Engine for ScriptedEngine {
    fn fit(&mut self, task: &FitTask, observer: &mut dyn Observer) -> Result<Outcome, PipelineError> {
        (self.0)(task, observer)
    }

    fn draw(&mut self, request: &RenderRequest, to: &Path) -> Result<(), RenderError> {
        crate::atomic_file::write(to, format!("{:?}", request.what).as_bytes())
            .map_err(|e| RenderError::Failed(e.to_string()))
    }
}

fn progress(stage: Stage, step: u32) -> Progress {
    let losses = BTreeMap::from([("rgb".to_string(), 1.0 / f64::from(step + 1))]);
    Progress { stage, step, steps: 10, progress: step as f32 / 10.0, eta_secs: Some(1.0), losses }
}

fn outcome() -> Outcome {
    let camera = json!({ "width": 64, "height": 48, "fx": 60.0, "fy": 60.0, "cx": 32.0, "cy": 24.0 });
    Outcome { frames: 5, camera: serde_json::from_value(camera).unwrap(), metrics: json!({ "iou": 0.9 }) }
}

/// Runs until it is told to stop.
fn endless(_task: &FitTask, observer: &mut dyn Observer) -> Result<Outcome, PipelineError> {
    observer.progress(&progress(Stage::Geometry, 1));
    loop {
        if let Some(reason) = observer.stop() {
            return Err(PipelineError::Stopped(reason));
        }
        std::thread::yield_now();
    }
}

struct Bench {
    queue: Arc<dyn Queue>,
    store: Arc<Store>,
    env: Env,
    _folder: tempfile::TempDir,
}

impl Bench {
    async fn new() -> Bench {
        let folder = tempfile::tempdir().unwrap();
        let store = Arc::new(Store::open(folder.path()).unwrap());
        let env = Env::system();
        let policy = Policy { backoff: Duration::ZERO, ..Policy::default() };
        let queue = Arc::new(SqliteQueue::open(&store.database(), env.clone(), policy).await.unwrap());
        Bench { queue, store, env, _folder: folder }
    }

    async fn add(&self) -> Uuid {
        self.add_with(JobOptions::default()).await
    }

    async fn add_with(&self, options: JobOptions) -> Uuid {
        let id = self.env.new_id();
        let upload = self.store.begin_upload().unwrap();
        let mut part = upload.part("video").await.unwrap();
        part.write(b"clip").await.unwrap();
        part.finish().await.unwrap();
        self.store.commit_upload(upload, id).unwrap();
        let inputs = BTreeMap::from([("video".to_string(), Part { bytes: 4 })]);
        let clip = Clip { frames: 5, width: 64, height: 48, fps: 30.0, warnings: Vec::new() };
        self.queue.insert(NewJob { id, key: None, options, inputs, clip, remember: None }).await.unwrap();
        id
    }

    /// Starts a worker on the script; dropping the sender ends nothing, sending true shuts it down.
    fn worker(
        &self,
        script: impl Fn(&FitTask, &mut dyn Observer) -> Result<Outcome, PipelineError> + Send + Sync + 'static,
    ) -> (watch::Sender<bool>, tokio::task::JoinHandle<Result<(), Hung>>) {
        self.worker_with(WorkerSettings { poll: Duration::from_millis(5), ..WorkerSettings::default() }, script)
    }

    fn worker_with(
        &self,
        settings: WorkerSettings,
        script: impl Fn(&FitTask, &mut dyn Observer) -> Result<Outcome, PipelineError> + Send + Sync + 'static,
    ) -> (watch::Sender<bool>, tokio::task::JoinHandle<Result<(), Hung>>) {
        self.worker_on(settings, DeviceThread::start(ScriptedEngine(Arc::new(script))).unwrap())
    }

    fn worker_on(
        &self,
        settings: WorkerSettings,
        device: DeviceThread,
    ) -> (watch::Sender<bool>, tokio::task::JoinHandle<Result<(), Hung>>) {
        let (shutdown, stopped) = watch::channel(false);
        let worker = Worker {
            queue: self.queue.clone(),
            store: self.store.clone(),
            device,
            owner: Owner::new(&self.store.workers(), self.env.new_id()).unwrap(),
            settings,
        };
        (shutdown, tokio::spawn(worker.run(stopped)))
    }

    /// Waits until the job is in a state.
    async fn until(&self, id: Uuid, state: State) -> Job {
        loop {
            let job = self.queue.get(id).await.unwrap().unwrap();
            if job.state == state {
                return job;
            }
            assert!(!job.state.is_final(), "{:?} instead of {state:?}: {:?}", job.state, job.error);
            tokio::task::yield_now().await;
        }
    }
}

/// A channel from a script to its test.
fn signal() -> (mpsc::UnboundedSender<()>, mpsc::UnboundedReceiver<()>) {
    mpsc::unbounded_channel()
}
