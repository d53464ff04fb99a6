//! Backup while the service runs, restore elsewhere, and the way forward from the first schema.

use std::path::Path;
use std::process::Output;
use std::sync::atomic::{AtomicBool, Ordering};

use effigy::jobs::{Change, State};

use super::process::Serve;
use super::*;

fn effigy(command: &str, folder: &Path, data: &Path) -> Output {
    let mut effigy = crate::program::effigy();
    effigy.arg(command).arg(folder).arg("--data-dir").arg(data).output().unwrap()
}

#[track_caller]
fn refused(output: &Output, why: &str) {
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && said.contains(why), "{said}");
}

impl Bench {
    /// A job whose parts really lie in the store.
    async fn add_whole_job(&self) -> Uuid {
        let id = self.env.new_id();
        std::fs::create_dir_all(self.store.inputs(id)).unwrap();
        std::fs::write(self.store.inputs(id).join("video"), b"clip").unwrap();
        let inputs = BTreeMap::from([("video".to_string(), Part { bytes: 4 })]);
        let clip = Clip { frames: 5, width: 64, height: 48, fps: 30.0, warnings: Vec::new() };
        let new = NewJob { id, key: None, options: JobOptions::default(), inputs, clip, remember: None };
        self.queue.insert(new).await.unwrap();
        id
    }
}

#[tokio::test]
async fn a_backup_of_a_busy_service_is_restored_whole() {
    let bench = Bench::new().await;
    let done = bench.add_whole_job().await;
    let lease = bench.claim().await;
    let files: [(&str, &[u8]); 2] = [("avatar.glb", b"glTF binary"), ("report.json", b"{}")];
    bench.end_with(&lease, &files).await;
    let running = bench.add_whole_job().await;
    let held = bench.claim().await;
    std::fs::create_dir_all(bench.store.work(running)).unwrap();
    std::fs::write(bench.store.work(running).join("checkpoint"), b"half").unwrap();
    // What an attempt has not published is no part of a backup.
    std::fs::create_dir_all(bench.store.results(running, held.epoch)).unwrap();
    std::fs::write(bench.store.results(running, held.epoch).join("avatar.glb"), b"not yet").unwrap();

    // Neither are uploads that no job has used: their clients send them again. Nor is the ballast.
    let open = effigy::storage::AboutUpload { bytes: 9, metadata: None, owner: None };
    bench.store.begin_resumable(Uuid::new_v4(), &open).unwrap();
    bench.store.load_ballast().unwrap();

    // Jobs come and go while the backup is made.
    let place = tempfile::tempdir().unwrap();
    let (backup, elsewhere) = (place.path().join("backup"), place.path().join("elsewhere"));
    let stop = Arc::new(AtomicBool::new(false));
    let bench = Arc::new(bench);
    let busy = tokio::spawn({
        let (bench, stop) = (bench.clone(), stop.clone());
        async move {
            while !stop.load(Ordering::Relaxed) {
                let id = bench.add_whole_job().await;
                bench.queue.delete(id).await.unwrap();
                bench.store.delete_job(id).unwrap();
            }
        }
    });
    let made = tokio::task::spawn_blocking({
        let (backup, data) = (backup.clone(), bench.store.root().to_path_buf());
        move || effigy("backup", &backup, &data)
    });
    let made = made.await.unwrap();
    stop.store(true, Ordering::Relaxed);
    busy.await.unwrap();
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    refused(&effigy("backup", &backup, bench.store.root()), "is not empty");

    let restored = effigy("restore", &backup, &elsewhere);
    for folder in [&backup, &elsewhere] {
        assert_eq!(std::fs::read_dir(folder.join("uploads")).unwrap().count(), 0);
        assert!(!folder.join("ballast").exists());
    }
    assert!(restored.status.success(), "{}", String::from_utf8_lossy(&restored.stderr));
    refused(&effigy("restore", &backup, &elsewhere), "effigy.db exists: move effigy.db, effigy.db-wal");
    let serve = Serve::start(&elsewhere, &["--workers", "0"]);
    let get = |path: String| async move { client().get(path).send().await.unwrap().bytes().await.unwrap() };
    let glb = get(format!("{}/v1/avatars/{done}/avatar.glb", serve.url)).await;
    assert_eq!(glb, b"glTF binary"[..]);
    let job: Value = serde_json::from_slice(&get(format!("{}/v1/jobs/{running}", serve.url)).await).unwrap();
    assert_eq!((&job["state"], &job["attempt"]), (&json!("queued"), &json!(0)), "nobody runs it there");
    let jobs = elsewhere.join("jobs").join(running.to_string());
    assert_eq!(std::fs::read(jobs.join("work/checkpoint")).unwrap(), b"half");
    assert!(!jobs.join("results").exists());
    let list: Value = serde_json::from_slice(&get(format!("{}/v1/jobs", serve.url)).await).unwrap();
    for job in list["jobs"].as_array().unwrap() {
        let video = elsewhere.join("jobs").join(job["id"].as_str().unwrap()).join("inputs/video");
        assert_eq!(std::fs::read(&video).unwrap(), b"clip", "each job in the backup has its files");
    }
    assert_eq!(bench.queue.get(running).await.unwrap().unwrap().state, State::Running, "the service went on");
}

#[tokio::test]
async fn a_damaged_backup_is_refused_by_the_name_of_the_file() {
    let bench = Bench::new().await;
    let id = bench.add_whole_job().await;
    let lease = bench.claim().await;
    bench.end_with(&lease, &[("avatar.glb", b"glTF")]).await;
    let place = tempfile::tempdir().unwrap();
    let backup = place.path().join("backup");
    assert!(effigy("backup", &backup, bench.store.root()).status.success());
    let glb = backup.join(format!("jobs/{id}/results/1/avatar.glb"));
    // The backup may share its bytes with the store: the damage must not.
    std::fs::remove_file(&glb).unwrap();
    std::fs::write(&glb, b"glTG").unwrap();
    refused(&effigy("restore", &backup, &place.path().join("a")), "avatar.glb does not have its checksum");
    std::fs::remove_file(&glb).unwrap();
    refused(&effigy("restore", &backup, &place.path().join("b")), "avatar.glb is missing");
    std::fs::remove_file(backup.join("backup.json")).unwrap();
    refused(&effigy("restore", &backup, &place.path().join("c")), "no whole backup");
    for folder in ["a", "b", "c"] {
        assert!(!place.path().join(folder).join("effigy.db").exists(), "nothing is restored from it");
    }
}

#[tokio::test]
async fn files_of_jobs_whose_database_is_lost_are_kept() {
    let bench = Bench::new().await;
    let kept = bench.add_whole_job().await;
    let place = tempfile::tempdir().unwrap();
    let backup = place.path().join("backup");
    assert!(effigy("backup", &backup, bench.store.root()).status.success());
    let newer = bench.add_whole_job().await;
    let data = bench.store.root();
    let clip = |job: Uuid| std::fs::read(bench.store.inputs(job).join("video"));

    // A journal of another database would be replayed into the one that is restored.
    let [database, journal, index] = bench.store.database_files();
    for file in [&database, &index] {
        std::fs::remove_file(file).unwrap();
    }
    refused(&effigy("restore", &backup, data), "effigy.db-wal exists");
    std::fs::remove_file(journal).unwrap();
    // An empty database, or an older one, would not know the jobs.
    let mut serve = crate::program::effigy();
    serve.args(["serve", "--listen", "127.0.0.1:0", "--data-dir"]).arg(data);
    refused(&serve.output().unwrap(), "there are files of 2 jobs");
    assert!(!database.exists());
    refused(&effigy("restore", &backup, data), &format!("{newer} is of a job that the backup does not have"));
    assert_eq!((clip(kept).unwrap(), clip(newer).unwrap()), (b"clip".to_vec(), b"clip".to_vec()));

    bench.store.delete_job(newer).unwrap();
    let restored = effigy("restore", &backup, data);
    assert!(restored.status.success(), "{}", String::from_utf8_lossy(&restored.stderr));
}

/// `effigy-0.1.0.db` was made by version 0.1.0, one job in each state (its first, and then only, migration).
#[tokio::test]
async fn a_database_of_the_first_version_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("effigy.db");
    std::fs::write(&path, include_bytes!("../../fixtures/effigy-0.1.0.db")).unwrap();
    let queue = SqliteQueue::open(&path, Env::system(), Policy::default()).await.unwrap();
    let id = |n: u32| format!("018bcfe5-6800-7{n:03}-8000-00000000000{n}").parse::<Uuid>().unwrap();
    let counts = queue.counts().await.unwrap();
    assert!(State::ALL.into_iter().all(|state| counts[&state] == 1), "{counts:?}");
    let running = queue.get(id(2)).await.unwrap().unwrap();
    assert_eq!((running.stage.as_deref(), running.step, running.losses["rgb"]), (Some("geometry"), 3, 0.5));
    assert_eq!((running.options.seed, running.options.height_m), (7, Some(1.7)));
    let failed = queue.get(id(6)).await.unwrap().unwrap().error.unwrap();
    assert_eq!((failed.kind.as_str(), failed.losses["rgb"]), ("diverged", 7.5));
    let avatar = queue.avatar(id(3)).await.unwrap().unwrap();
    assert_eq!(
        (avatar.epoch, avatar.files[0].name.as_str(), avatar.metrics["iou"].as_f64()),
        (1, "avatar.glb", Some(0.95))
    );
    assert_eq!(queue.events(id(2), 0, 10).await.unwrap().len(), 2);
    assert_eq!(queue.stage_times().await.unwrap()[0].secs, 12.5);
    // It is not only read: jobs go on by the rules of today.
    queue.reap().await.unwrap();
    assert_eq!(queue.get(id(4)).await.unwrap().unwrap().state, State::Canceled);
    let (lease, job) = queue.claim("w").await.unwrap().unwrap();
    assert_eq!((job.id, lease.epoch), (id(1), 1));
    assert!(matches!(queue.retry(id(6)).await.unwrap(), Change::Done(job) if job.state == State::Queued));
}
