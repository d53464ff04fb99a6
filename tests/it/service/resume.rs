//! A real fit over HTTP whose worker is killed: it goes on from its checkpoint.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::time::Duration;

use effigy::body::Body;
use effigy::jobs::{Event, State, Timestamp};
use effigy::npz::Npz;
use effigy::synth::{SynthOptions, synthesise};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use reqwest::blocking::{Response, multipart};

use super::process::Serve;
use super::*;

/// A made clip of the test body, of so many frames and pixels; false where there is no device.
pub fn make_clip(test: &str, folder: &Path, frames: usize, size_px: u32) -> bool {
    let Some(gpu) = crate::fit::gpu(test) else { return false };
    let options = SynthOptions { frames, size_px, truths: 1, seed: 3, ..SynthOptions::default() };
    synthesise(&gpu, &Body::test_body(), &options, folder, |_, _| {}).unwrap();
    true
}

pub fn upload(url: &str, clip: &Path, preset: &str) -> Value {
    let options = json!({ "preset": preset, "body": "test" });
    let mut form = multipart::Form::new().text("options", options.to_string());
    for (part, file) in
        [("video", "video.mp4"), ("masks", "masks.zip"), ("keypoints", "keypoints.json"), ("camera", "camera.json")]
    {
        form = form.file(part, clip.join(file)).unwrap();
    }
    let answer = blocking_client().post(format!("{url}/v1/jobs")).multipart(form).send().unwrap();
    let status = answer.status();
    let job: Value = answer.json().unwrap();
    assert_eq!(status, 202, "{job}");
    job
}

/// The events of a job, as they come.
struct Events(std::io::Lines<BufReader<Response>>);

impl Events {
    fn of(job_url: &str) -> Events {
        let client = blocking_client_builder().timeout(None).build().unwrap();
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
    if !make_clip("a_killed_fit_goes_on", &clip, 6, 64) {
        return;
    }
    std::fs::create_dir_all(data.join("bodies")).unwrap();
    Body::test_body().save(&data.join("bodies/test.body.npz")).unwrap();

    let serve = Serve::start(&data, &[]);
    let job = upload(&serve.url, &clip, "draft");
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
    let job: Value = blocking_client().get(format!("{}/v1/jobs/{id}", serve.url)).send().unwrap().json().unwrap();
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
    let job: Value = blocking_client().get(&job_url).send().unwrap().json().unwrap();
    assert!((2..=3).contains(&job["attempt"].as_u64().unwrap()), "{job}");
    let report: Value =
        blocking_client().get(format!("{}/v1/avatars/{id}/report.json", serve.url)).send().unwrap().json().unwrap();
    for entry in report["losses"].as_array().unwrap() {
        let again = entry["stage"] == "geometry" && (stage > 1.0 || entry["step"].as_f64().unwrap() <= step);
        assert!(!again, "the checkpoint had stage {stage}, step {step}, and this came after it: {entry}");
    }
    let avatar: Value = blocking_client().get(format!("{}/v1/avatars/{id}", serve.url)).send().unwrap().json().unwrap();
    assert_eq!(avatar["frames"], 6, "{avatar}");
    let glb = blocking_client()
        .get(format!("{}{}", serve.url, avatar["files"]["avatar.glb"].as_str().unwrap()))
        .send()
        .unwrap();
    assert_eq!(&glb.bytes().unwrap()[..4], b"glTF");
    assert!(serve.terminate().success());
}

/// The stage, as checkpoints number it, and the step that a line of a job's history tells.
fn step_of(event: &Event) -> Option<(f64, f64)> {
    let stage = ["geometry", "texture"].iter().position(|stage| event.data["stage"] == *stage)?;
    // The beginning of a stage is told as a step of its own.
    let step = event.data["step"].as_f64().filter(|step| *step > 0.0)?;
    Some((stage as f64 + 1.0, step))
}

/// `EFFIGY_TORTURE_FIT_KILLS` kills, each later than a fit may go without a checkpoint.
#[test]
fn a_kill_repeats_at_most_30_seconds_of_fitting() {
    const MOST: Duration = Duration::from_secs(30);
    let kills = std::env::var("EFFIGY_TORTURE_FIT_KILLS").map_or(1, |text| text.parse::<u64>().unwrap());
    let folder = tempfile::tempdir().unwrap();
    let (clip, data) = (folder.path().join("clip"), folder.path().join("data"));
    // As long a fit as a test can wait for on a slow machine: it is not to end before the kills do.
    if !make_clip("a_kill_repeats_at_most_30_seconds_of_fitting", &clip, 60, 192) {
        return;
    }
    std::fs::create_dir_all(data.join("bodies")).unwrap();
    Body::test_body().save(&data.join("bodies/test.body.npz")).unwrap();
    let serve = Serve::start(&data, &[]);
    let start = || -> Uuid { upload(&serve.url, &clip, "paper")["id"].as_str().unwrap().parse().unwrap() };
    let mut id = start();
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let bench = runtime.block_on(Bench::on(data.clone()));
    let state = |id: Uuid| runtime.block_on(bench.queue.get(id)).unwrap().unwrap().state;
    // The steps of a job that were told after this time.
    let steps = |id: Uuid, since: Timestamp| -> Vec<(Timestamp, (f64, f64))> {
        let events = runtime.block_on(bench.queue.events(id, 0, 100_000)).unwrap();
        let steps = events.iter().filter_map(|event| Some((event.at, step_of(event)?)));
        steps.filter(|(at, _)| *at > since).collect()
    };
    let mut random = Pcg64Mcg::seed_from_u64(kills);
    let (mut since, mut most) = (Timestamp(0), Duration::ZERO);
    let mut kill = 0;
    while kill < kills {
        while steps(id, since).is_empty() && !state(id).is_final() {
            std::thread::sleep(Duration::from_millis(100));
        }
        std::thread::sleep(
            MOST + Duration::from_secs(1) + Duration::from_millis(random.random_range(0..20_000) * kill.min(1)),
        );
        if state(id).is_final() {
            assert_eq!(state(id), State::Succeeded);
            if since == Timestamp(0) {
                // On a quick device a whole fit takes less than a kill may cost.
                eprintln!("a fit has ended before a first kill");
                return;
            }
            (id, since) = (start(), Timestamp(0));
            continue;
        }
        kill += 1;
        serve.kill_worker();
        let killed = bench.env.now();
        let saved = Npz::open(&data.join("jobs").join(id.to_string()).join("work/checkpoint.npz")).unwrap();
        let saved = (saved.scalar("stage").unwrap(), saved.scalar("step").unwrap());
        // The next stage's beginning is the end of the one before; steps are told once a second.
        let told = steps(id, since);
        let (at, _) = told.iter().rev().find(|(_, step)| *step <= saved).unwrap_or(&told[0]);
        let repeated = Duration::from_millis((killed.0 - at.0) as u64);
        eprintln!("kill {kill}: the checkpoint has {saved:?}, {:?} were told; {repeated:.1?} repeated", told.last());
        assert!(repeated <= MOST, "{repeated:?} of fitting are repeated");
        (since, most) = (killed, most.max(repeated));
    }
    eprintln!("{kills} kills repeated at most {most:.1?} of fitting");
    assert!(blocking_client().delete(format!("{}/v1/jobs/{id}", serve.url)).send().unwrap().status().is_success());
}
