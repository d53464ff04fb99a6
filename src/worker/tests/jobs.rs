//! Jobs through a worker.

use std::fs;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use super::super::pipeline::StopReason;
use super::*;
use crate::gpu::GpuError;
use crate::jobs::{Change, Deletion};

#[tokio::test]
async fn a_fit_becomes_an_avatar() {
    let bench = Bench::new().await;
    let id = bench.add().await;
    let (shutdown, worker) = bench.worker(|task, observer| {
        assert_eq!(fs::read(&task.input.files.video).unwrap(), b"clip");
        assert!(task.input.files.camera.is_none());
        observer.progress(&progress(Stage::Decode, 1));
        observer.progress(&progress(Stage::Export, 9));
        fs::write(task.work_dir.join("checkpoint"), b"half").unwrap();
        fs::write(task.out_dir.join("avatar.glb"), b"glTF").unwrap();
        Ok(outcome())
    });
    let job = bench.until(id, State::Succeeded).await;
    assert_eq!((job.attempt, job.progress), (1, 1.0));
    let avatar = bench.queue.avatar(id).await.unwrap().unwrap();
    assert_eq!((avatar.frames, avatar.body.as_str(), avatar.files.len()), (5, "default", 1));
    assert_eq!((avatar.files[0].name.as_str(), avatar.files[0].bytes), ("avatar.glb", 4));
    let times = bench.queue.stage_times().await.unwrap();
    assert_eq!(times.iter().map(|t| t.stage.as_str()).collect::<Vec<_>>(), ["decode", "export"]);
    shutdown.send(true).unwrap();
    worker.await.unwrap().unwrap();
    assert!(!bench.store.work(id).exists(), "checkpoints of a finished job are removed");
    assert_eq!(fs::read(bench.store.results(id, avatar.epoch).join("avatar.glb")).unwrap(), b"glTF");
}

#[tokio::test]
async fn a_diverged_fit_fails_with_its_losses_and_publishes_nothing() {
    let bench = Bench::new().await;
    let id = bench.add().await;
    let (_shutdown, _worker) = bench.worker(|task, _| {
        fs::write(task.out_dir.join("avatar.glb"), b"NaN").unwrap();
        let losses = BTreeMap::from([("rgb".to_string(), 7.5), ("mask".to_string(), f64::NAN)]);
        Err(PipelineError::Diverged { detail: "offsets are not finite".into(), losses })
    });
    let job = bench.until(id, State::Failed).await;
    let error = job.error.unwrap();
    assert_eq!((error.kind.as_str(), job.attempt), ("diverged", 1));
    assert_eq!(error.losses, BTreeMap::from([("rgb".to_string(), 7.5)]));
    assert!(bench.queue.avatar(id).await.unwrap().is_none());
}

#[tokio::test]
async fn failures_of_the_moment_are_repeated_from_the_checkpoint() {
    let bench = Bench::new().await;
    let id = bench.add().await;
    let (_shutdown, _worker) = bench.worker(|task, _| {
        let checkpoint = task.work_dir.join("checkpoint");
        let done = fs::read_to_string(&checkpoint).map_or(0, |text| text.parse::<u32>().unwrap());
        fs::write(&checkpoint, (done + 1).to_string()).unwrap();
        match done {
            0 => panic!("a bug"),
            1 => Err(PipelineError::Internal(anyhow::anyhow!("a full disk"))),
            _ => {
                fs::write(task.out_dir.join("report.json"), done.to_string()).unwrap();
                Ok(outcome())
            }
        }
    });
    let job = bench.until(id, State::Succeeded).await;
    assert_eq!((job.attempt, job.epoch), (3, 3));
    assert_eq!(fs::read(bench.store.results(id, 3).join("report.json")).unwrap(), b"2");
}

#[tokio::test]
async fn a_job_that_always_fails_ends_after_its_attempts() {
    let bench = Bench::new().await;
    let (bad, good) = (bench.add().await, bench.add().await);
    let runs = Arc::new(AtomicU32::new(0));
    let count = runs.clone();
    let (_shutdown, _worker) = bench.worker(move |task, _| {
        if task.out_dir.to_string_lossy().contains(&bad.to_string()) {
            count.fetch_add(1, Ordering::Relaxed);
            panic!("this one always");
        }
        fs::write(task.out_dir.join("avatar.glb"), b"glTF").unwrap();
        Ok(outcome())
    });
    let job = bench.until(bad, State::Failed).await;
    assert_eq!((job.attempt, runs.load(Ordering::Relaxed)), (3, 3));
    let error = job.error.unwrap();
    assert_eq!(error.kind, "internal");
    assert!(!error.detail.contains("this one always"), "causes are for the log: {}", error.detail);
    bench.until(good, State::Succeeded).await;
}

#[tokio::test]
async fn a_wish_to_cancel_stops_the_fit() {
    let bench = Bench::new().await;
    let id = bench.add().await;
    let (_shutdown, _worker) = bench.worker(endless);
    bench.until(id, State::Running).await;
    assert!(matches!(bench.queue.cancel(id).await.unwrap(), Change::Done(_)));
    bench.until(id, State::Canceled).await;
}

#[tokio::test]
async fn a_deleted_running_job_vanishes_with_its_files() {
    let bench = Bench::new().await;
    let id = bench.add().await;
    let (_shutdown, _worker) = bench.worker(endless);
    bench.until(id, State::Running).await;
    assert_eq!(bench.queue.delete(id).await.unwrap(), Deletion::Pending);
    let reaper = Reaper { queue: bench.queue.clone(), store: bench.store.clone() };
    while bench.queue.get(id).await.unwrap().is_some() {
        reaper.round().await.unwrap();
        tokio::task::yield_now().await;
    }
    assert!(bench.store.job_folders().unwrap().is_empty());
}

#[tokio::test]
async fn a_shutdown_gives_the_job_back_to_the_next_worker() {
    let bench = Bench::new().await;
    let id = bench.add().await;
    let (shutdown, worker) = bench.worker(|task, observer| {
        let end = endless(task, observer);
        fs::write(task.work_dir.join("checkpoint"), b"half").unwrap();
        end
    });
    bench.until(id, State::Running).await;
    shutdown.send(true).unwrap();
    worker.await.unwrap().unwrap();
    let job = bench.until(id, State::Queued).await;
    assert_eq!(job.attempt, 0, "a shutdown is no attempt");
    let (_shutdown, _worker) = bench.worker(|task, _| {
        assert_eq!(fs::read(task.work_dir.join("checkpoint")).unwrap(), b"half");
        fs::write(task.out_dir.join("avatar.glb"), b"glTF").unwrap();
        Ok(outcome())
    });
    bench.until(id, State::Succeeded).await;
}

#[tokio::test]
async fn a_worker_that_lost_its_lease_stops_and_writes_nothing() {
    let bench = Bench::new().await;
    let id = bench.add().await;
    let reason = Arc::new(Mutex::new(None));
    let (stopped, mut ended) = signal();
    let seen = reason.clone();
    let (_shutdown, _worker) = bench.worker(move |task, observer| {
        if task.out_dir.ends_with("1") {
            fs::write(task.out_dir.join("avatar.glb"), b"stale").unwrap();
            let end = endless(task, observer);
            if let Err(PipelineError::Stopped(why)) = &end {
                *seen.lock().unwrap() = Some(*why);
            }
            stopped.send(()).unwrap();
            return end;
        }
        fs::write(task.out_dir.join("avatar.glb"), b"fresh").unwrap();
        Ok(outcome())
    });
    let owner = bench.until(id, State::Running).await.owner.unwrap();
    // As the reaper does when time has run out.
    bench.queue.release_owner(&owner).await.unwrap();
    ended.recv().await.unwrap();
    assert_eq!(*reason.lock().unwrap(), Some(StopReason::LostLease));
    bench.until(id, State::Succeeded).await;
    let avatar = bench.queue.avatar(id).await.unwrap().unwrap();
    assert_eq!(avatar.epoch, 2);
    assert_eq!(fs::read(bench.store.results(id, 2).join("avatar.glb")).unwrap(), b"fresh");
}

#[tokio::test]
async fn a_worker_that_lost_its_lease_leaves_the_next_attempt_alone() {
    let bench = Bench::new().await;
    let id = bench.add().await;
    let (go_on, waits) = std::sync::mpsc::channel::<()>();
    let waits = Mutex::new(waits);
    let (shutdown, late) = bench.worker(move |_, _| {
        waits.lock().unwrap().recv().unwrap();
        Err(PipelineError::Unfit("nobody is there".into()))
    });
    let owner = bench.until(id, State::Running).await.owner.unwrap();
    shutdown.send(true).unwrap();
    bench.queue.release_owner(&owner).await.unwrap();
    let (_shutdown, _worker) = bench.worker(|task, _| {
        fs::write(task.out_dir.join("avatar.glb"), b"fresh").unwrap();
        Ok(outcome())
    });
    bench.until(id, State::Succeeded).await;
    go_on.send(()).unwrap();
    late.await.unwrap().unwrap();
    assert_eq!(fs::read(bench.store.results(id, 2).join("avatar.glb")).unwrap(), b"fresh");
    assert!(!bench.store.results(id, 1).exists());
}

#[tokio::test]
async fn only_the_dead_lose_their_leases_at_once() {
    let bench = Bench::new().await;
    let (one, two) = (bench.add().await, bench.add().await);
    let alive = Owner::new(&bench.store.workers(), Uuid::new_v4()).unwrap();
    let dead = Owner::new(&bench.store.workers(), Uuid::new_v4()).unwrap();
    bench.queue.claim(dead.id()).await.unwrap().unwrap();
    bench.queue.claim(alive.id()).await.unwrap().unwrap();
    let reaper = Reaper { queue: bench.queue.clone(), store: bench.store.clone() };
    reaper.round().await.unwrap();
    bench.until(one, State::Running).await;
    drop(dead);
    reaper.round().await.unwrap();
    bench.until(one, State::Queued).await;
    bench.until(two, State::Running).await;
}

#[tokio::test]
async fn locks_go_with_their_workers_also_without_a_job() {
    let bench = Bench::new().await;
    let folder = bench.store.workers();
    let alive = Owner::new(&folder, Uuid::new_v4()).unwrap();
    // As a killed worker leaves it.
    fs::write(folder.join(format!("{}.lock", Uuid::new_v4())), []).unwrap();
    let reaper = Reaper { queue: bench.queue.clone(), store: bench.store.clone() };
    reaper.round().await.unwrap();
    let left: Vec<_> = fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(left, [format!("{}.lock", alive.id()).as_str()]);
    assert!(!Owner::remove_if_dead(&folder, alive.id()).unwrap());
}

#[tokio::test]
async fn a_fit_that_hangs_ends_its_attempt_and_its_process() {
    let bench = Bench::new().await;
    let id = bench.add().await;
    let settings = WorkerSettings {
        poll: Duration::from_millis(5),
        stall: Duration::from_millis(300),
        ..WorkerSettings::default()
    };
    let (_shutdown, worker) = bench.worker_with(settings, |_, observer| {
        observer.progress(&progress(Stage::Geometry, 1));
        loop {
            std::thread::park();
        }
    });
    let hung = worker.await.unwrap().unwrap_err();
    assert!(matches!(hung, Hung::Fit { job, .. } if job == id), "{hung}");
    let job = bench.until(id, State::Queued).await;
    let error = job.error.unwrap();
    assert_eq!((error.kind.as_str(), job.attempt), ("stalled", 1));
    assert!(error.detail.contains("geometry"), "{}", error.detail);
}

#[tokio::test]
async fn a_step_that_takes_long_does_not_keep_a_user_waiting() {
    let bench = Bench::new().await;
    let (slow, next) = (bench.add().await, bench.add().await);
    let (let_go, gate) = std::sync::mpsc::channel::<()>();
    let gate = Mutex::new(gate);
    let (_shutdown, _worker) = bench.worker(move |task, observer| {
        if task.out_dir.to_string_lossy().contains(&slow.to_string()) {
            observer.progress(&progress(Stage::Geometry, 1));
            // One step.
            gate.lock().unwrap().recv().unwrap();
            return Err(PipelineError::Stopped(observer.stop().unwrap()));
        }
        fs::write(task.out_dir.join("avatar.glb"), b"glTF").unwrap();
        Ok(outcome())
    });
    bench.until(slow, State::Running).await;
    let wished = std::time::Instant::now();
    bench.queue.cancel(slow).await.unwrap();
    bench.until(slow, State::Canceled).await;
    assert!(wished.elapsed() < Duration::from_secs(2), "{:?}", wished.elapsed());
    assert_eq!(bench.queue.get(next).await.unwrap().unwrap().state, State::Queued, "the device is still taken");
    let_go.send(()).unwrap();
    bench.until(next, State::Succeeded).await;
    assert!(!bench.store.results(slow, 1).exists());
}

#[tokio::test]
async fn a_fit_stops_when_its_deadline_has_passed() {
    let bench = Bench::new().await;
    let options = JobOptions { deadline_secs: Some(1), ..JobOptions::default() };
    let id = bench.add_with(options).await;
    let (_shutdown, _worker) = bench.worker(|task, observer| {
        let end = endless(task, observer);
        fs::write(task.out_dir.join("avatar.glb"), b"late").unwrap();
        end
    });
    bench.until(id, State::Running).await;
    let reaper = Reaper { queue: bench.queue.clone(), store: bench.store.clone() };
    let job = loop {
        reaper.round().await.unwrap();
        let job = bench.queue.get(id).await.unwrap().unwrap();
        if job.state == State::Failed {
            break job;
        }
        tokio::task::yield_now().await;
    };
    assert_eq!(job.error.unwrap().kind, "deadline");
    // The worker is free for the next one.
    bench.add_with(JobOptions { deadline_secs: None, ..JobOptions::default() }).await;
    while bench.store.results(id, 1).exists() {
        tokio::task::yield_now().await;
    }
}

#[tokio::test]
async fn jobs_wait_for_a_device_and_lose_nothing() {
    let bench = Bench::new().await;
    let (one, two) = (bench.add().await, bench.add().await);
    let there = Arc::new(AtomicBool::new(false));
    let device = DeviceThread::start(Unsteady { there: there.clone(), loses: Some(one) }).unwrap();
    let mut trouble = device.trouble();
    let settings = WorkerSettings {
        poll: Duration::from_millis(5),
        reopen: Duration::from_millis(5),
        ..WorkerSettings::default()
    };
    let (_shutdown, _worker) = bench.worker_on(settings, device);
    let attempts = async |id| {
        let job = bench.queue.get(id).await.unwrap().unwrap();
        assert_eq!(job.state, State::Queued);
        job.attempt
    };
    // At the start, then again after the device was lost in the first attempt, which counts.
    for attempt in [0, 1] {
        let told = trouble.wait_for(Option::is_some).await.unwrap().clone().unwrap();
        assert!(told.contains("it is taken"), "{told}");
        tokio::time::sleep(Duration::from_millis(50)).await;
        assert_eq!((attempts(one).await, attempts(two).await), (attempt, 0));
        there.store(true, Ordering::Relaxed);
        trouble.wait_for(Option::is_none).await.unwrap();
    }
    assert_eq!(bench.until(one, State::Succeeded).await.attempt, 2);
    assert_eq!(bench.until(two, State::Succeeded).await.attempt, 1);
}

/// Has a device as the test says, and loses it in the first fit of a job.
struct Unsteady {
    there: Arc<AtomicBool>,
    loses: Option<Uuid>,
}

impl Engine for Unsteady {
    fn open(&mut self) -> Result<(), GpuError> {
        match self.there.load(Ordering::Relaxed) {
            true => Ok(()),
            false => Err(GpuError::Open { adapter: "the only one".into(), reason: "it is taken".into() }),
        }
    }

    fn fit(&mut self, task: &FitTask, _: &mut dyn Observer) -> Result<Outcome, PipelineError> {
        if self.loses.take_if(|job| task.out_dir.to_string_lossy().contains(&job.to_string())).is_some() {
            self.there.store(false, Ordering::Relaxed);
            return Err(GpuError::Lost("it fell off".into()).into());
        }
        fs::write(task.out_dir.join("avatar.glb"), b"glTF").unwrap();
        Ok(outcome())
    }

    fn draw(&mut self, _: &RenderRequest, _: &Path) -> Result<(), RenderError> {
        unreachable!()
    }
}

#[tokio::test]
async fn a_device_that_neither_opens_nor_refuses_ends_the_process_and_no_attempt() {
    let bench = Bench::new().await;
    let id = bench.add().await;
    let settings = WorkerSettings { stall: Duration::from_millis(50), ..WorkerSettings::default() };
    let (_shutdown, worker) = bench.worker_on(settings, DeviceThread::start(Stuck).unwrap());
    assert!(matches!(worker.await.unwrap().unwrap_err(), Hung::Opening { .. }));
    assert_eq!(bench.until(id, State::Queued).await.attempt, 0);
}

struct Stuck;

impl Engine for Stuck {
    fn open(&mut self) -> Result<(), GpuError> {
        loop {
            std::thread::park();
        }
    }

    fn fit(&mut self, _: &FitTask, _: &mut dyn Observer) -> Result<Outcome, PipelineError> {
        unreachable!()
    }

    fn draw(&mut self, _: &RenderRequest, _: &Path) -> Result<(), RenderError> {
        unreachable!()
    }
}
