//! Pictures of the avatar in the making.

use std::time::Duration;

use effigy::http::Openness;
use effigy::jobs::ProgressReport;
use effigy::jobs::keys::Quota;
use effigy::worker::{DeviceEngine, DeviceThread, Owner, Worker, WorkerSettings};
use tokio::sync::watch;

use super::access::USER;
use super::events::Server;
use super::*;

impl Bench {
    /// As a worker does.
    pub async fn show(&self, lease: &Lease, nth: u32, jpeg: &[u8]) {
        let name = Store::preview_name(lease.epoch, nth);
        self.store.put_preview(lease.job, &name, jpeg).unwrap();
        let at = ProgressReport {
            stage: "geometry".into(),
            step: 3,
            steps: 9,
            progress: 0.25,
            eta_secs: None,
            losses: BTreeMap::new(),
        };
        self.queue.show(lease, &name, &at).await.unwrap();
        self.store.drop_previews_before(lease.job, &name).unwrap();
    }
}

#[tokio::test]
async fn the_newest_picture_is_served_and_told_of() {
    let server = Server::start().await;
    let bench = &server.bench;
    let id = bench.add_job().await;
    let (job, path) = (format!("/v1/jobs/{id}"), format!("/v1/jobs/{id}/preview"));
    let lease = bench.claim().await;
    assert_eq!(bench.get(&path).await.problem(404)["detail"].as_str().unwrap().matches("preview").count(), 1);
    assert_eq!(bench.get(&job).await.json()["preview_url"], Value::Null);
    bench.get(&format!("/v1/jobs/{}/preview", Uuid::new_v4())).await.problem(404);

    bench.show(&lease, 1, b"first").await;
    let first = bench.get(&path).await;
    assert_eq!((first.status.as_u16(), first.header("content-type")), (200, "image/jpeg"));
    assert_eq!(first.body, b"first");
    assert_eq!(bench.get(&job).await.json()["preview_url"], path.as_str());
    let known = [("if-none-match", first.header("etag"))];
    assert_eq!(bench.call(Method::GET, &path, &known, Body::empty()).await.status, 304);

    bench.show(&lease, 2, b"second").await;
    let second = bench.call(Method::GET, &path, &known, Body::empty()).await;
    assert_eq!((second.status.as_u16(), second.body.as_slice()), (200, b"second".as_slice()));
    assert_eq!(std::fs::read_dir(bench.store.previews(id)).unwrap().count(), 1, "older ones are removed");

    let mut stream = server.follow(id, None).await;
    let mut told = Vec::new();
    while told.len() < 2 {
        let event = stream.next().await.unwrap();
        if event.kind == "preview" {
            told.push(event);
        }
    }
    assert_eq!((&told[1].data["url"], &told[1].data["progress"]), (&json!(path), &json!(0.25)));

    bench.end_with(&lease, &[("avatar.glb", b"glTF")]).await;
    assert_eq!(bench.get(&path).await.body, b"second", "it stays as long as the files");
    assert_eq!(bench.call(Method::DELETE, &job, &[], Body::empty()).await.status, 204);
    bench.get(&path).await.problem(404);
    assert!(bench.store.job_folders().unwrap().is_empty());
}

#[tokio::test]
async fn another_keys_picture_is_unknown() {
    let (bench, _) = Bench::guarded(Openness::Keys, &[]).await;
    let (owner, other) =
        (bench.key("owner", &USER, Quota::default()).await, bench.key("other", &USER, Quota::default()).await);
    let id = bench.job_of(&owner).await;
    let lease = bench.claim().await;
    bench.show(&lease, 1, b"mine").await;
    let path = format!("/v1/jobs/{id}/preview");
    assert_eq!(owner.get(&path).await.body, b"mine");
    other.get(&path).await.problem(404);
    bench.get(&path).await.problem(401);
}

/// The whole way: a fit of the small body on the device, a worker around it, the event stream, the picture.
#[tokio::test(flavor = "multi_thread")]
async fn the_avatar_is_seen_while_it_emerges() {
    let Some(gpu) = crate::fit::gpu("the_avatar_is_seen_while_it_emerges") else { return };
    let input = crate::fit::input(crate::fit::clip(&gpu));
    let server = Server::start().await;
    let bench = &server.bench;
    let id = bench.env.new_id();
    std::fs::create_dir_all(bench.store.inputs(id)).unwrap();
    let parts = [("video", &input.files.video), ("masks", &input.files.masks), ("keypoints", &input.files.keypoints)];
    let parts = parts.into_iter().chain(input.files.camera.as_ref().map(|camera| ("camera", camera)));
    let inputs = parts.map(|(name, path)| {
        let bytes = std::fs::copy(path, bench.store.inputs(id).join(name)).unwrap();
        (name.to_string(), Part { bytes })
    });
    let clip = Clip { frames: 12, width: 96, height: 96, fps: 30.0, warnings: Vec::new() };
    let options = JobOptions { max_frames: Some(4), ..input.options.clone() };
    let new = NewJob { id, key: None, options, inputs: inputs.collect(), clip, remember: None };
    bench.queue.insert(new).await.unwrap().queued().unwrap();

    let (shutdown, stopped) = watch::channel(false);
    let owner = Owner::new(&bench.store.workers(), bench.env.new_id()).unwrap();
    let settings = WorkerSettings { poll: Duration::from_millis(20), ..WorkerSettings::default() };
    let device = DeviceThread::start(DeviceEngine::default()).unwrap();
    let worker = Worker { queue: bench.queue.clone(), store: bench.store.clone(), device, owner, settings };
    let worker = tokio::spawn(worker.run(stopped));

    let mut stream = server.follow(id, None).await;
    let mut stages = Vec::new();
    while let Some(event) = stream.next().await {
        if event.kind != "preview" {
            continue;
        }
        stages.push(event.data["stage"].as_str().unwrap().to_string());
        // The next one may have come meanwhile; there is always one.
        let seen = bench.get(event.data["url"].as_str().unwrap()).await;
        assert_eq!(seen.status, 200);
        let picture = image::load_from_memory(&seen.body).unwrap().to_rgb8();
        assert!(picture.pixels().filter(|p| p.0.iter().all(|&c| c < 230)).count() > 1000, "a person is to be seen");
    }
    assert_eq!((stages.first().unwrap().as_str(), stages.last().unwrap().as_str()), ("pose", "texture"));
    let job = bench.end_of(id).await;
    assert_eq!(job.state, effigy::jobs::State::Succeeded, "{:?}", job.error);
    assert_eq!(std::fs::read_dir(bench.store.previews(id)).unwrap().count(), 1);
    shutdown.send_replace(true);
    worker.await.unwrap().unwrap();
}
