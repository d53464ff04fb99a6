//! Worker processes whose fits follow a script: this test program starts itself again in a worker's place, with all of
//! the worker but the device. A job's video is its script.

use std::time::Duration;

use effigy::jobs::render::{RenderError, RenderRequest};
use effigy::worker::pipeline::{Observer, Outcome, PipelineError, Progress, Stage};
use effigy::worker::{DeviceThread, Engine, FitTask, Owner, Reaper, Supervisor, SupervisorSettings, Worker};
use effigy::worker::{WorkerSettings, channel};
use serde::{Deserialize, Serialize};
use tokio::sync::watch;

use super::*;

/// What a fit does.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Script {
    pub steps: u32,
    pub step_ms: u64,
    /// A checkpoint after so many steps; 0 = never.
    pub save_every: u32,
    /// The process kills itself after so many steps of an attempt; 0 = never.
    pub kill_after: u32,
    /// The first attempt hangs after so many steps; 0 = never.
    pub hang_after: u32,
}

pub struct ScriptedEngine {
    queue: Arc<SqliteQueue>,
    runtime: tokio::runtime::Handle,
}

impl ScriptedEngine {
    /// Waits until the queue has heard of a checkpoint at `saved`, as it has long before most kills of a true fit.
    fn until_known(&self, task: &FitTask, saved: f32) {
        let id = task.work_dir.parent().and_then(|job| job.file_name()?.to_str()).unwrap().parse().unwrap();
        let known = || self.runtime.block_on(self.queue.get(id)).unwrap().unwrap().saved;
        while known() < f64::from(saved) {
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

impl Engine for ScriptedEngine {
    fn fit(&mut self, task: &FitTask, observer: &mut dyn Observer) -> Result<Outcome, PipelineError> {
        // A clip that came over HTTP is no script.
        let script = serde_json::from_slice(&std::fs::read(&task.input.files.video).unwrap());
        let script = script.unwrap_or(Script { steps: 6, step_ms: 20, save_every: 1, ..Script::default() });
        let checkpoint = task.work_dir.join("checkpoint");
        let begin = std::fs::read_to_string(&checkpoint).map_or(0, |text| text.parse::<u32>().unwrap());
        let mut saved = 0.0;
        for step in begin..script.steps {
            if let Some(reason) = observer.stop() {
                return Err(PipelineError::Stopped(reason));
            }
            std::thread::sleep(Duration::from_millis(script.step_ms));
            let done = step + 1;
            let progress = done as f32 / script.steps as f32;
            let told = Progress {
                stage: Stage::Geometry,
                step: done,
                steps: script.steps,
                progress,
                eta_secs: None,
                losses: BTreeMap::new(),
            };
            observer.progress(&told);
            if script.save_every > 0 && done % script.save_every == 0 {
                effigy::atomic_file::write(&checkpoint, done.to_string().as_bytes()).unwrap();
                observer.saved(progress);
                saved = progress;
            }
            let of_this_attempt = done - begin;
            let again = task.work_dir.join("hung");
            if of_this_attempt == script.hang_after && !again.exists() {
                std::fs::write(again, "").unwrap();
                loop {
                    std::thread::park();
                }
            }
            if of_this_attempt == script.kill_after {
                self.until_known(task, saved);
                // SAFETY: a signal to this very process.
                unsafe { libc::kill(libc::getpid(), libc::SIGKILL) };
            }
        }
        std::fs::write(task.out_dir.join("avatar.glb"), task.out_dir.to_string_lossy().as_bytes()).unwrap();
        let camera = json!({ "width": 64, "height": 48, "fx": 60.0, "fy": 60.0, "cx": 32.0, "cy": 24.0 });
        Ok(Outcome { frames: 5, camera: serde_json::from_value(camera).unwrap(), metrics: json!({}) })
    }

    fn draw(&mut self, _: &RenderRequest, _: &std::path::Path) -> Result<(), RenderError> {
        Err(RenderError::Failed("nothing is drawn here".into()))
    }
}

/// The worker's process. Its last argument is the data folder (to the test program, a filter that matches nothing).
#[test]
#[ignore = "started by other tests"]
fn worker_process() {
    let data = PathBuf::from(std::env::args().next_back().unwrap());
    if !data.is_absolute() {
        return;
    }
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    let ended = runtime.block_on(async {
        let store = Arc::new(Store::open(&data).unwrap());
        let env = Env::system();
        let lease_ms = std::env::var("EFFIGY_TEST_LEASE_MS").map_or(60_000, |text| text.parse().unwrap());
        let (backoff, lease) = (Duration::from_millis(1), Duration::from_millis(lease_ms));
        let policy = Policy { backoff, lease, ..Policy::default() };
        let queue = Arc::new(SqliteQueue::open(&store.database(), env.clone(), policy).await.unwrap());
        let engine = ScriptedEngine { queue: queue.clone(), runtime: tokio::runtime::Handle::current() };
        let device = DeviceThread::start(engine).unwrap();
        let (shutdown, stopped) = watch::channel(false);
        let drawing = device.clone();
        std::thread::spawn(move || {
            let _ = channel::serve(std::io::stdin().lock(), &drawing);
            shutdown.send_replace(true);
        });
        let owner = Owner::new(&store.workers(), env.new_id()).unwrap();
        let (poll, stall) = (Duration::from_millis(20), Duration::from_secs(4));
        let settings = WorkerSettings { poll, stall, ..WorkerSettings::default() };
        Worker { queue, store, device, owner, settings }.run(stopped).await
    });
    // SAFETY: ends the process, as `effigy worker` does when its device's thread hangs.
    unsafe { libc::_exit(if ended.is_ok() { 0 } else { 1 }) };
}

/// The command line of [`worker_process`].
pub fn worker_arguments(data: &std::path::Path) -> Vec<String> {
    let role = "service::rehearsal::worker_process".to_string();
    let data = data.to_str().unwrap().to_string();
    vec!["--exact".into(), role, "--ignored".into(), "--nocapture".into(), "--test-threads=1".into(), data]
}

/// A server's half on a bench: the supervisor with one worker, and the reaper.
pub fn supervise(bench: &Bench) -> Arc<Supervisor> {
    let program = std::env::current_exe().unwrap();
    let mut settings = SupervisorSettings::new(program, worker_arguments(bench.store.root()), bench.store.renders());
    settings.backoff = Duration::from_millis(1);
    settings.backoff_max = Duration::from_millis(1);
    let supervisor = Supervisor::new(settings);
    tokio::spawn(supervisor.clone().run());
    let reaper = Reaper { queue: bench.queue.clone(), store: bench.store.clone() };
    tokio::spawn(async move {
        loop {
            reaper.round().await.unwrap();
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    });
    supervisor
}

impl Bench {
    /// Queues a job that follows the script.
    pub async fn add_script(&self, script: &Script, options: JobOptions) -> Uuid {
        let id = self.env.new_id();
        std::fs::create_dir_all(self.store.inputs(id)).unwrap();
        std::fs::write(self.store.inputs(id).join("video"), serde_json::to_vec(script).unwrap()).unwrap();
        let inputs = BTreeMap::from([("video".to_string(), Part { bytes: 4 })]);
        let clip = Clip { frames: 5, width: 64, height: 48, fps: 30.0, warnings: Vec::new() };
        let new = NewJob { id, key: None, options, inputs, clip, remember: None };
        self.queue.insert(new).await.unwrap().queued().unwrap();
        id
    }

    /// Waits for the end of a job.
    pub async fn end_of(&self, id: Uuid) -> effigy::jobs::Job {
        loop {
            let job = self.queue.get(id).await.unwrap().unwrap();
            if job.state.is_final() {
                return job;
            }
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_that_kills_its_process_gets_its_attempts_and_the_others_go_on() {
    let bench = Bench::new().await;
    let good = Script { steps: 3, step_ms: 1, ..Script::default() };
    let killer = Script { steps: 9, kill_after: 1, ..good.clone() };
    let moving = Script { steps: 9, kill_after: 2, save_every: 2, ..good.clone() };
    let hanging = Script { hang_after: 1, ..good.clone() };
    let mut ids = Vec::new();
    for script in [&killer, &moving, &hanging, &good, &good] {
        ids.push(bench.add_script(script, JobOptions::default()).await);
    }
    let supervisor = supervise(&bench);
    let mut jobs = Vec::new();
    for id in ids {
        jobs.push(bench.end_of(id).await);
    }
    use effigy::jobs::State::{Failed, Succeeded};
    let ends: Vec<_> = jobs.iter().map(|job| (job.state, job.attempt, job.excused)).collect();
    // The moving one was killed after its steps 2, 4, 6 and 8.
    assert_eq!(ends, [(Failed, 3, 0), (Succeeded, 5, 4), (Succeeded, 2, 0), (Succeeded, 1, 0), (Succeeded, 1, 0)]);
    assert_eq!(jobs[0].error.as_ref().unwrap().kind, "lease-lost");
    assert_eq!(jobs[2].error, None);
    supervisor.stop();
}
