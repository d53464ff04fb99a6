//! A real fit over HTTP whose worker is killed: it goes on from its checkpoint.

use std::io::{BufRead, BufReader};
use std::path::Path;

use effigy::body::Body;
use effigy::eval::{SynthOptions, synthesise};
use effigy::gpu::{DeviceSelect, Gpu};
use effigy::npz::Npz;
use reqwest::blocking::{Client, Response, get, multipart};

use super::process::Serve;
use super::*;

/// A made clip of the test body; false where there is no device.
fn make_clip(folder: &Path) -> bool {
    let gpu = match Gpu::open(&DeviceSelect::Auto) {
        Ok(gpu) => gpu,
        Err(reason) => {
            assert!(std::env::var_os("CI").is_none(), "CI requires a device: {reason}");
            eprintln!("a_killed_fit_goes_on: ignored, {reason}");
            return false;
        }
    };
    let options = SynthOptions { frames: 6, size_px: 64, truths: 1, seed: 3, ..SynthOptions::default() };
    synthesise(&gpu, &Body::test_body(), &options, folder, |_, _| {}).unwrap();
    true
}

fn upload(url: &str, clip: &Path) -> Value {
    let mut form = multipart::Form::new().text("options", r#"{"preset": "draft", "body": "test"}"#);
    for (part, file) in
        [("video", "video.mp4"), ("masks", "masks.zip"), ("keypoints", "keypoints.json"), ("camera", "camera.json")]
    {
        form = form.file(part, clip.join(file)).unwrap();
    }
    let answer = Client::new().post(format!("{url}/v1/jobs")).multipart(form).send().unwrap();
    let status = answer.status();
    let job: Value = answer.json().unwrap();
    assert_eq!(status, 202, "{job}");
    job
}

/// The events of a job, as they come.
struct Events(std::io::Lines<BufReader<Response>>);

impl Events {
    fn of(job_url: &str) -> Events {
        let client = Client::builder().timeout(None).build().unwrap();
        Events(BufReader::new(client.get(format!("{job_url}/events")).send().unwrap()).lines())
    }

    /// Waits for an event.
    #[track_caller]
    fn until(&mut self, wanted: impl Fn(&Value) -> bool) -> Value {
        for line in self.0.by_ref() {
            let line = line.unwrap();
            let Some(data) = line.strip_prefix("data: ") else { continue };
            let event: Value = serde_json::from_str(data).unwrap();
            if wanted(&event) {
                return event;
            }
            assert_ne!(event["state"], "failed", "{event}");
        }
        panic!("the stream ended before the event came");
    }
}

#[test]
fn a_killed_fit_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let (clip, data) = (folder.path().join("clip"), folder.path().join("data"));
    if !make_clip(&clip) {
        return;
    }
    std::fs::create_dir_all(data.join("bodies")).unwrap();
    Body::test_body().save(&data.join("bodies/test.body.npz")).unwrap();

    let serve = Serve::start(&data, &[]);
    let job = upload(&serve.url, &clip);
    let id = job["id"].as_str().unwrap();
    let job_url = format!("{}/v1/jobs/{id}", serve.url);
    // The end of stage 1 leaves the first checkpoint of so short a fit, or the clock on a slow machine.
    let checkpoint = data.join("jobs").join(id).join("work/checkpoint.npz");
    while !checkpoint.exists() {
        std::thread::yield_now();
    }
    serve.kill_worker();
    let saved = Npz::open(&checkpoint).unwrap();
    let (stage, step) = (saved.scalar("stage").unwrap(), saved.scalar("step").unwrap());
    let mut events = Events::of(&job_url);
    events.until(|event| event["state"] == "running" && event["attempt"] == 2);

    // Asked to end, the server has its worker write a checkpoint and give the attempt back.
    events.until(|event| event["stage"] == "geometry" || event["stage"] == "texture");
    let before = std::fs::metadata(&checkpoint).unwrap().modified().unwrap();
    assert!(serve.terminate().success());
    assert!(std::fs::metadata(&checkpoint).unwrap().modified().unwrap() > before, "a checkpoint was written");
    let serve = Serve::start(&data, &["--workers", "0"]);
    let job: Value = get(format!("{}/v1/jobs/{id}", serve.url)).unwrap().json().unwrap();
    assert_eq!((&job["state"], &job["attempt"]), (&json!("queued"), &json!(1)), "{job}");
    drop(serve);
    let serve = Serve::start(&data, &[]);
    let job_url = format!("{}/v1/jobs/{id}", serve.url);
    Events::of(&job_url).until(|event| event["state"] == "running" && event["attempt"] == 2);

    // Killed without warning, the server takes its worker along; the next server's goes on.
    drop(serve);
    let serve = Serve::start(&data, &[]);
    let job_url = format!("{}/v1/jobs/{id}", serve.url);
    Events::of(&job_url).until(|event| event["state"] == "succeeded");
    let job: Value = get(&job_url).unwrap().json().unwrap();
    assert!((2..=3).contains(&job["attempt"].as_u64().unwrap()), "{job}");
    let report: Value = get(format!("{}/v1/avatars/{id}/report.json", serve.url)).unwrap().json().unwrap();
    for entry in report["losses"].as_array().unwrap() {
        let again = entry["stage"] == "geometry" && (stage > 1.0 || entry["step"].as_f64().unwrap() <= step);
        assert!(!again, "the checkpoint had stage {stage}, step {step}, and this came after it: {entry}");
    }
    let avatar: Value = get(format!("{}/v1/avatars/{id}", serve.url)).unwrap().json().unwrap();
    assert_eq!(avatar["frames"], 6, "{avatar}");
    let glb = get(format!("{}{}", serve.url, avatar["files"]["avatar.glb"].as_str().unwrap())).unwrap();
    assert_eq!(&glb.bytes().unwrap()[..4], b"glTF");
    assert!(serve.terminate().success());
}
