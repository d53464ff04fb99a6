//! Processes killed and stopped at random, many workers at once. Short here; `make torture` takes longer
//! (`EFFIGY_TORTURE_CYCLES`, `EFFIGY_TORTURE_JOBS`).

use std::collections::{BTreeSet, HashMap};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use effigy::jobs::{Job, State};
use effigy::worker::pipeline::{Observer, Outcome, PipelineError};
use effigy::worker::{DeviceThread, Engine, FitTask, Owner, Reaper, Worker, WorkerSettings};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use sha2::{Digest, Sha256};
use tokio::sync::watch;

use super::process::Serve;
use super::rehearsal::{Script, worker_arguments};
use super::*;

fn from_environment(name: &str, short: u32) -> u32 {
    std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(short)
}

/// A worker process on a script (see [`super::rehearsal`]).
struct WorkerProcess(Child);

impl WorkerProcess {
    fn start(data: &Path) -> WorkerProcess {
        Self::start_with(data, &[])
    }

    fn start_with(data: &Path, variables: &[(&str, &str)]) -> WorkerProcess {
        let child = Command::new(std::env::current_exe().unwrap())
            .args(worker_arguments(data))
            .envs(variables.iter().copied())
            // Open for as long as this lives: its end would end the worker.
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        WorkerProcess(child)
    }

    fn signal(&self, signal: libc::c_int) {
        // SAFETY: a signal to a child that was not waited for.
        assert_eq!(unsafe { libc::kill(self.0.id() as libc::pid_t, signal) }, 0);
    }
}

impl Drop for WorkerProcess {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A second look at a data folder that others work on.
async fn look_at(data: &Path) -> Bench {
    Bench::on(data.to_path_buf()).await
}

async fn until_all_end(bench: &Bench, ids: &[Uuid], patience: Duration) -> HashMap<Uuid, Job> {
    let begun = Instant::now();
    let mut ended = HashMap::new();
    while ended.len() < ids.len() {
        for id in ids {
            let job = bench.queue.get(*id).await.unwrap().unwrap_or_else(|| panic!("{id} is lost"));
            if job.state.is_final() {
                ended.insert(*id, job);
            }
        }
        assert!(begun.elapsed() < patience, "{} of {} jobs have ended", ended.len(), ids.len());
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    ended
}

/// Everything that an avatar's row names lies there as it was published, and nothing else does.
async fn check_published(bench: &Bench, job: &Job) {
    let avatar = bench.queue.avatar(job.id).await.unwrap().unwrap();
    assert_eq!(avatar.epoch, job.epoch);
    for file in &avatar.files {
        let content = std::fs::read(bench.store.results(job.id, avatar.epoch).join(&file.name)).unwrap();
        let hash: String = Sha256::digest(&content).iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!((content.len() as u64, hash), (file.bytes, file.sha256.clone()), "{}", file.name);
    }
    let told = bench.queue.events(job.id, 0, 100_000).await.unwrap();
    let ends = told.iter().filter(|event| event.data["state"] == "succeeded").count();
    assert_eq!(ends, 1, "one end");
}

#[tokio::test(flavor = "multi_thread")]
async fn kills_at_random_lose_no_job_and_double_none() {
    let cycles = from_environment("EFFIGY_TORTURE_CYCLES", 12);
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().to_path_buf();
    let mut serve = Serve::start(&data, &["--workers", "0"]);
    let bench = look_at(&data).await;
    let mut workers: Vec<_> = (0..2).map(|_| WorkerProcess::start(&data)).collect();
    let mut random = Pcg64Mcg::seed_from_u64(u64::from(cycles));
    let client = client_builder().timeout(Duration::from_secs(20)).build().unwrap();
    let (mut ids, mut unanswered, mut kills) = (Vec::new(), 0, [0, 0]);
    for _ in 0..cycles {
        let script = Script { steps: 12, step_ms: 20, save_every: 1, ..Script::default() };
        ids.push(bench.add_script(&script, JobOptions::default()).await);
        let upload = client.post(format!("{}/v1/jobs", serve.url)).header("content-type", Form::TYPE);
        let upload = tokio::spawn(upload.body(Form::clip().body()).send());
        tokio::time::sleep(Duration::from_millis(random.random_range(0..400))).await;
        if random.random_range(0..2) == 0 {
            kills[0] += 1;
            drop(serve);
            serve = Serve::start(&data, &["--workers", "0"]);
        } else {
            kills[1] += 1;
            let n = random.random_range(0..workers.len());
            workers[n] = WorkerProcess::start(&data);
        }
        match upload.await.unwrap() {
            Ok(answer) => {
                assert_eq!(answer.status(), 202);
                ids.push(answer.json::<Value>().await.unwrap()["id"].as_str().unwrap().parse().unwrap());
            }
            Err(_) => unanswered += 1,
        }
    }
    let patience = Duration::from_secs(120 + u64::from(cycles));
    let mut jobs = until_all_end(&bench, &ids, patience).await;
    let excused: u32 = jobs.values().map(|job| job.excused).sum();
    // A kill before an attempt's first checkpoint counts, since the job itself may be what kills: the third such one ends it. It
    // is not lost by that: it tells why, and whoever wants it still has but to say so.
    let spent: Vec<Uuid> = jobs.values().filter(|job| job.state != State::Succeeded).map(|job| job.id).collect();
    for id in &spent {
        let job = &jobs[id];
        let kind = job.error.as_ref().map(|error| error.kind.as_str());
        let ended = (job.state, kind, job.attempt - job.excused);
        assert_eq!(ended, (State::Failed, Some("lease-lost"), job.max_attempts), "{job:?}");
        let again = client.post(format!("{}/v1/jobs/{id}/retry", serve.url)).send().await.unwrap();
        assert!(again.status().is_success(), "{}", again.status());
    }
    jobs.extend(until_all_end(&bench, &spent, patience).await);
    for job in jobs.values() {
        assert_eq!(job.state, State::Succeeded, "{job:?}");
        check_published(&bench, job).await;
    }
    drop(workers);
    drop(serve);
    // The next start removes what the kills left half-written; every other folder is a job's.
    let serve = Serve::start(&data, &["--workers", "0"]);
    assert_eq!(std::fs::read_dir(data.join("tmp")).unwrap().count(), 0);
    for id in bench.store.job_folders().unwrap() {
        assert!(bench.queue.get(id).await.unwrap().is_some(), "{id} has no row");
    }
    bench.check_integrity().await;
    eprintln!(
        "{cycles} cycles: {} kills of the server, {} of workers; {} acknowledged jobs succeeded, {} of them after their three \
         attempts were killed at their beginning and a retry; {excused} attempts excused, {unanswered} uploads unanswered",
        kills[0],
        kills[1],
        jobs.len(),
        spent.len(),
    );
    assert!(serve.terminate().success());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_that_sleeps_past_its_lease_publishes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().to_path_buf();
    let bench = look_at(&data).await;
    let script = Script { steps: 60, step_ms: 25, save_every: 10, ..Script::default() };
    let id = bench.add_script(&script, JobOptions::default()).await;
    let sleeper = WorkerProcess::start_with(&data, &[("EFFIGY_TEST_LEASE_MS", "4000")]);
    while bench.queue.get(id).await.unwrap().unwrap().step < 5 {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    sleeper.signal(libc::SIGSTOP);
    let reaper = Reaper { queue: bench.queue.clone(), store: bench.store.clone() };
    while bench.queue.get(id).await.unwrap().unwrap().state == State::Running {
        reaper.round().await.unwrap();
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    // It lives and holds its lock: only time took its lease.
    let _other = WorkerProcess::start(&data);
    while bench.queue.get(id).await.unwrap().unwrap().epoch < 2 {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    sleeper.signal(libc::SIGCONT);
    let jobs = until_all_end(&bench, &[id], Duration::from_secs(60)).await;
    assert_eq!((jobs[&id].state, jobs[&id].epoch), (State::Succeeded, 2));
    check_published(&bench, &jobs[&id]).await;
    let file = std::fs::read_to_string(bench.store.results(id, 2).join("avatar.glb")).unwrap();
    assert!(file.ends_with("results/2"), "{file}");
    let begun = Instant::now();
    while bench.store.results(id, 1).exists() {
        assert!(begun.elapsed() < Duration::from_secs(10), "what the sleeper made stays");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// Does nothing, and counts.
struct Nothing(Arc<Mutex<BTreeMap<PathBuf, u32>>>);

impl Engine for Nothing {
    fn fit(&mut self, task: &FitTask, _: &mut dyn Observer) -> Result<Outcome, PipelineError> {
        *self.0.lock().unwrap().entry(task.work_dir.clone()).or_default() += 1;
        let camera = json!({ "width": 64, "height": 48, "fx": 60.0, "fy": 60.0, "cx": 32.0, "cy": 24.0 });
        Ok(Outcome { frames: 5, camera: serde_json::from_value(camera).unwrap(), metrics: json!({}) })
    }

    fn draw(&mut self, _: &RenderRequest, _: &Path) -> Result<(), RenderError> {
        Err(RenderError::Failed("nothing is drawn here".into()))
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn eight_workers_do_each_job_once() {
    let count = from_environment("EFFIGY_TORTURE_JOBS", 200);
    let folder = tempfile::tempdir().unwrap();
    let bench = look_at(folder.path()).await;
    let mut ids = Vec::new();
    for _ in 0..count {
        ids.push(bench.add_job().await);
    }
    let runs = Arc::new(Mutex::new(BTreeMap::new()));
    let (shutdown, stopped) = watch::channel(false);
    let begun = Instant::now();
    let mut workers = Vec::new();
    for _ in 0..8 {
        // Connections of its own, as another process has.
        let own = look_at(folder.path()).await;
        let worker = Worker {
            queue: own.queue.clone(),
            store: own.store.clone(),
            device: DeviceThread::start(Nothing(runs.clone())).unwrap(),
            owner: Owner::new(&own.store.workers(), Uuid::new_v4()).unwrap(),
            settings: WorkerSettings { poll: Duration::from_millis(10), ..WorkerSettings::default() },
        };
        workers.push(tokio::spawn(worker.run(stopped.clone())));
    }
    while bench.queue.counts().await.unwrap()[&State::Succeeded] < u64::from(count) {
        assert!(begun.elapsed() < Duration::from_secs(120 + u64::from(count) / 10));
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    let secs = begun.elapsed().as_secs_f64();
    shutdown.send(true).unwrap();
    for worker in workers {
        worker.await.unwrap().unwrap();
    }
    {
        let runs = runs.lock().unwrap();
        assert_eq!(runs.len(), count as usize);
        assert!(runs.values().all(|n| *n == 1), "a job ran twice");
    }
    for id in &ids {
        let job = bench.queue.get(*id).await.unwrap().unwrap();
        assert_eq!((job.attempt, job.epoch), (1, 1));
    }
    let distinct: BTreeSet<_> = ids.iter().collect();
    assert_eq!(distinct.len(), ids.len());
    bench.check_integrity().await;
    eprintln!("{count} jobs by 8 workers in {secs:.1} s: {:.0} a second", f64::from(count) / secs);
}
