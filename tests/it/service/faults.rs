//! What fails under a fit: the device, the disk. The program itself, its worker process, and the small body.

use std::path::Path;
use std::time::{Duration, Instant};

use super::limits::Disk;
use super::process::Serve;
use super::*;

/// A service with a worker, and the small body as its default one.
pub struct Rig {
    pub serve: Serve,
    pub client: reqwest::blocking::Client,
}

impl Rig {
    pub fn start(data: &Path, arguments: &[&str], variables: &[(&str, &str)]) -> Rig {
        std::fs::create_dir_all(data.join("bodies")).unwrap();
        effigy::body::Body::test_body().save(&data.join("bodies/default.body.npz")).unwrap();
        Rig { serve: Serve::start_with(data, arguments, variables), client: blocking_client() }
    }

    /// Sends the small clip; the job's address.
    fn post(&self) -> String {
        self.post_with(json!({ "preset": "draft", "max_frames": 4 }))
    }

    pub fn post_with(&self, options: Value) -> String {
        let gpu = crate::fit::gpu("faults").unwrap();
        let files = crate::fit::input(crate::fit::clip(&gpu)).files;
        let mut form = reqwest::blocking::multipart::Form::new().text("options", options.to_string());
        for (name, path) in [("video", &files.video), ("masks", &files.masks), ("keypoints", &files.keypoints)] {
            form = form.file(name, path).unwrap();
        }
        form = form.file("camera", files.camera.unwrap()).unwrap();
        let job = self.client.post(format!("{}/v1/jobs", self.serve.url)).multipart(form).send().unwrap();
        assert_eq!(job.status(), 202);
        let job: Value = job.json().unwrap();
        format!("{}/v1/jobs/{}", self.serve.url, job["id"].as_str().unwrap())
    }

    pub fn ask(&self, job: &str) -> Value {
        self.client.get(job).send().unwrap().json().unwrap()
    }

    /// Asks until the job is as wished.
    #[track_caller]
    pub fn until(&self, job: &str, wished: impl Fn(&Value) -> bool) -> Value {
        let begun = Instant::now();
        loop {
            let now = self.ask(job);
            if wished(&now) {
                return now;
            }
            assert!(begun.elapsed() < Duration::from_secs(240), "{now:#}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    #[track_caller]
    fn end(&self, job: &str) -> Value {
        self.until(job, |job| ["succeeded", "failed", "canceled"].contains(&job["state"].as_str().unwrap()))
    }
}

/// Without a device there is nothing that could fail.
fn no_device(test: &str) -> bool {
    crate::fit::gpu(test).is_none()
}

#[test]
fn a_fault_of_the_device_costs_an_attempt_and_a_fresh_device_goes_on() {
    if no_device("a_fault_of_the_device_costs_an_attempt_and_a_fresh_device_goes_on") {
        return;
    }
    for (fault, cause) in [("lost@40", "lost"), ("memory@60", "memory"), ("shader@6", "no WGSL")] {
        let data = tempfile::tempdir().unwrap();
        let rig = Rig::start(data.path(), &[], &[("EFFIGY_TEST_DEVICE_FAULT", fault)]);
        let job = rig.post();
        let waiting = rig.until(&job, |job| !job["error"].is_null());
        assert_eq!(waiting["error"]["type"], "device", "{fault}: {waiting:#}");
        let detail = waiting["error"]["detail"].as_str().unwrap();
        assert!(detail.contains(cause), "{fault}: {detail}");
        let end = rig.end(&job);
        eprintln!("{fault}: {detail:?}, then {} in attempt {}", end["state"], end["attempt"]);
        assert_eq!((&end["state"], &end["attempt"], &end["error"]), (&json!("succeeded"), &json!(2), &Value::Null));
        assert!(rig.serve.terminate().success());
    }
}

#[test]
fn a_device_that_always_fails_fails_the_job_and_not_the_server() {
    if no_device("a_device_that_always_fails_fails_the_job_and_not_the_server") {
        return;
    }
    let data = tempfile::tempdir().unwrap();
    let rig = Rig::start(data.path(), &[], &[("EFFIGY_TEST_DEVICE_FAULT", "lost@10*3")]);
    let job = rig.post();
    let end = rig.end(&job);
    assert_eq!(
        (&end["state"], &end["attempt"], &end["error"]["type"]),
        (&json!("failed"), &json!(3), &json!("device"))
    );
    let next = rig.post();
    let next = rig.end(&next);
    assert_eq!(next["state"], "succeeded", "{next:#}");
    assert_eq!(rig.client.get(format!("{}/readyz", rig.serve.url)).send().unwrap().status(), 200);
}

#[test]
fn a_picture_that_the_device_has_no_memory_for_costs_no_attempt() {
    if no_device("a_picture_that_the_device_has_no_memory_for_costs_no_attempt") {
        return;
    }
    let data = tempfile::tempdir().unwrap();
    // In the first preview, then in the first render.
    let rig = Rig::start(data.path(), &[], &[("EFFIGY_TEST_DEVICE_FAULT", "picture@3*2")]);
    let job = rig.post();
    let end = rig.end(&job);
    assert_eq!((&end["state"], &end["attempt"], &end["error"]), (&json!("succeeded"), &json!(1), &Value::Null));
    assert_eq!(end["preview_url"], Value::Null, "the attempt went on without");
    let render = || {
        let url = format!("{}/renders", job.replace("/jobs/", "/avatars/"));
        rig.client.post(url).json(&json!({ "frame": 0 })).send().unwrap().status()
    };
    assert_eq!((render(), render()), (500.try_into().unwrap(), 200.try_into().unwrap()));
}

#[test]
fn without_a_device_jobs_wait_and_the_service_says_so() {
    if no_device("without_a_device_jobs_wait_and_the_service_says_so") {
        return;
    }
    let data = tempfile::tempdir().unwrap();
    let rig = Rig::start(data.path(), &[], &[("EFFIGY_DEVICE", "one that is out for repair")]);
    let begun = Instant::now();
    loop {
        let ready = rig.client.get(format!("{}/readyz", rig.serve.url)).send().unwrap();
        let (status, told) = (ready.status(), ready.text().unwrap());
        if told.contains("out for repair") {
            assert_eq!(status, 503);
            break;
        }
        assert!(begun.elapsed() < Duration::from_secs(60), "{told}");
        std::thread::sleep(Duration::from_millis(50));
    }
    let job = rig.post();
    std::thread::sleep(Duration::from_secs(3));
    let waiting = rig.ask(&job);
    assert_eq!(
        (&waiting["state"], &waiting["attempt"], &waiting["error"]),
        (&json!("queued"), &json!(0), &Value::Null)
    );
    assert!(rig.serve.terminate().success());
    // Another start with a device loses nothing.
    let rig = Rig::start(data.path(), &[], &[]);
    let end = rig.end(&format!("{}{}", rig.serve.url, &job[job.find("/v1/").unwrap()..]));
    assert_eq!((&end["state"], &end["attempt"]), (&json!("succeeded"), &json!(1)), "{end:#}");
}

/// Bytes of the files below a folder whose paths contain the word.
fn bytes_of(folder: &Path, word: &str) -> u64 {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let bytes = |path: std::path::PathBuf| match path.is_dir() {
        true => bytes_of(&path, word),
        false if path.to_string_lossy().contains(word) => path.metadata().map_or(0, |meta| meta.len()),
        false => 0,
    };
    entries.map(bytes).sum()
}

#[test]
fn a_disk_that_fills_under_a_fit_makes_it_wait_for_room() {
    const TEST: &str = "a_disk_that_fills_under_a_fit_makes_it_wait_for_room";
    if no_device(TEST) {
        return;
    }
    let Some(disk) = Disk::mount(256 << 20) else {
        eprintln!("{TEST}: ignored, no disk can be mounted here");
        return;
    };
    let data = disk.0.path();
    let rig = Rig::start(data, &["--disk-reserve-bytes", "33554432"], &[]);
    let filler = data.join("filler");

    // Not a byte left in the first stage: its checkpoint cannot be written, nor can the database say so. The fit is a long one:
    // on a busy machine a short stage may pass between two looks at it.
    let job = rig.post_with(json!({ "preset": "standard", "max_frames": 6 }));
    rig.until(&job, |job| job["stage"] == "geometry" && job["step"].as_u64() > Some(2));
    disk.fill();
    let steps = rig.ask(&job)["step"].clone();
    std::thread::sleep(Duration::from_secs(6));
    let stuck = rig.ask(&job);
    assert!(stuck["state"] == "running" || stuck["state"] == "queued", "{stuck:#}");
    eprintln!("filled at step {steps}; after 6 s {} at step {}", stuck["state"], stuck["step"]);
    std::fs::remove_file(&filler).unwrap();
    let checkpoint = std::cell::Cell::new(0);
    let end = rig.until(&job, |job| {
        checkpoint.set(checkpoint.get().max(bytes_of(&data.join("jobs"), "checkpoint.npz")));
        ["succeeded", "failed"].contains(&job["state"].as_str().unwrap())
    });
    assert_eq!((&end["state"], &end["error"]), (&json!("succeeded"), &Value::Null));
    assert!(end["attempt"].as_u64() <= Some(2), "{end:#}");

    // Room for checkpoints, but not for the avatar's files beside them. Most of the disk is filled beforehand, so that the
    // rest takes no time.
    let results = bytes_of(&data.join("jobs"), "/results/");
    let leave = |room: u64| {
        disk.fill();
        let filled = std::fs::metadata(&filler).unwrap().len();
        std::fs::File::options().write(true).open(&filler).unwrap().set_len(filled - room).unwrap();
    };
    leave(48 << 20);
    let job = rig.post_with(json!({ "preset": "draft" }));
    rig.until(&job, |job| job["stage"] == "geometry");
    // A checkpoint is written beside the one that it replaces or, in the detail, begins from. With the texture in it one of the detail's is
    // half as large as the avatar's files; one of them is left when these come.
    let checkpoint = checkpoint.get();
    let room = results * 3 / 2;
    assert!(
        checkpoint > 0 && room > 2 * checkpoint + (256 << 10),
        "{checkpoint} bytes of checkpoint, {results} of results"
    );
    leave(room);
    let waiting = rig.until(&job, |job| !job["error"].is_null());
    assert_eq!((&waiting["state"], &waiting["attempt"]), (&json!("queued"), &json!(1)), "{waiting:#}");
    let detail = waiting["error"]["detail"].as_str().unwrap();
    eprintln!("less room than the {results} bytes of results: {detail:?} in {}", waiting["stage"]);
    assert_eq!((&waiting["error"]["type"], &waiting["stage"]), (&json!("disk-full"), &json!("bake")), "{waiting:#}");
    // Below the reserve it is not begun again.
    std::thread::sleep(Duration::from_secs(5));
    assert_eq!(rig.ask(&job)["attempt"], 1);
    std::fs::remove_file(&filler).unwrap();
    let end = rig.end(&job);
    assert_eq!((&end["state"], &end["attempt"]), (&json!("succeeded"), &json!(2)), "{end:#}");
    // Where the server keeps things is told nowhere.
    let avatar = rig.ask(&job.replace("/jobs/", "/avatars/"));
    let files = avatar["files"].as_object().unwrap().values().map(|path| path.as_str().unwrap().to_string());
    let places = ["jobs/{id}", "jobs/{id}/events", "avatars/{id}"].map(|path| format!("/v1/{path}"));
    let id = end["id"].as_str().unwrap();
    for path in places.into_iter().map(|path| path.replace("{id}", id)).chain(files) {
        let body = rig.client.get(format!("{}{path}", rig.serve.url)).send().unwrap();
        assert!(body.status().is_success(), "{path}");
        let body = body.bytes().unwrap();
        let place = data.to_str().unwrap().as_bytes();
        assert!(!body.windows(place.len()).any(|bytes| bytes == place), "{path} names {}", data.display());
    }
    assert!(rig.serve.terminate().success());
}
