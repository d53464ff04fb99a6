//! What every [`Queue`] must do, whatever lies beneath. A database joins by `suite!(open())`.

use std::any::Any;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use serde_json::json;
use uuid::Uuid;

use super::*;
use crate::camera::Camera;

/// A fresh queue with the default policy, except for a retention of one hour.
pub struct Bench {
    pub queue: Arc<dyn Queue>,
    pub clock: Arc<ManualClock>,
    pub env: Env,
    /// What must outlive the queue.
    pub keep: Box<dyn Any + Send>,
}

pub fn new_job(env: &Env) -> NewJob {
    NewJob {
        id: env.new_id(),
        key: None,
        options: JobOptions::default(),
        inputs: BTreeMap::from([("video".to_string(), Part { bytes: 10 })]),
        clip: Clip { frames: 5, width: 64, height: 48, fps: 30.0, warnings: Vec::new() },
        remember: None,
    }
}

fn report(progress: f64) -> ProgressReport {
    let losses = BTreeMap::from([("rgb".to_string(), 0.5)]);
    ProgressReport { stage: "geometry".into(), step: 3, steps: 9, progress, eta_secs: Some(60.0), losses }
}

pub fn avatar() -> NewAvatar {
    let camera = json!({ "width": 64, "height": 48, "fx": 60.0, "fy": 60.0, "cx": 32.0, "cy": 24.0 });
    NewAvatar {
        body: "test".into(),
        frames: 5,
        camera: serde_json::from_value::<Camera>(camera).unwrap(),
        metrics: json!({ "iou": 0.95 }),
        files: vec![AvatarFile { name: "avatar.glb".into(), bytes: 4, sha256: "a".repeat(64) }],
    }
}

impl Bench {
    async fn add(&self) -> Uuid {
        self.clock.advance(Duration::from_millis(1));
        self.queue.insert(new_job(&self.env)).await.unwrap().queued().unwrap().id
    }

    async fn claim(&self) -> Option<Lease> {
        self.queue.claim("worker-1").await.unwrap().map(|(lease, _)| lease)
    }

    async fn job(&self, id: Uuid) -> Job {
        self.queue.get(id).await.unwrap().unwrap()
    }

    async fn states(&self, id: Uuid) -> Vec<String> {
        let events = self.queue.events(id, 0, 1000).await.unwrap();
        let states = events.iter().filter(|e| e.kind == EventKind::State);
        states.map(|e| e.data["state"].as_str().unwrap().to_string()).collect()
    }
}

pub async fn a_job_goes_through_its_life(b: Bench) {
    let id = b.add().await;
    assert_eq!((b.job(id).await.state, b.job(id).await.queue_position), (State::Queued, Some(1)));
    let (lease, job) = b.queue.claim("w").await.unwrap().unwrap();
    assert_eq!((job.id, job.state, job.attempt, job.epoch), (id, State::Running, 1, 1));
    assert_eq!(b.queue.report(&lease, &report(0.4)).await.unwrap(), Standing::Held);
    let job = b.job(id).await;
    assert_eq!((job.stage.as_deref(), job.step, job.steps, job.progress), (Some("geometry"), 3, 9, 0.4));
    assert_eq!((job.eta_secs, job.losses["rgb"]), (Some(60.0), 0.5));
    assert!(b.queue.avatar(id).await.unwrap().is_none());
    assert_eq!(b.queue.succeed(&lease, avatar()).await.unwrap(), Standing::Held);
    let job = b.job(id).await;
    assert_eq!((job.state, job.progress, job.owner), (State::Succeeded, 1.0, None));
    assert!(job.finished_at.is_some() && job.expires_at.is_some());
    let avatar = b.queue.avatar(id).await.unwrap().unwrap();
    assert_eq!((avatar.epoch, avatar.frames, avatar.files[0].name.as_str()), (1, 5, "avatar.glb"));
    assert_eq!(b.states(id).await, ["queued", "running", "succeeded"]);
    assert_eq!(b.queue.counts().await.unwrap()[&State::Succeeded], 1);
}

pub async fn a_picture_is_told_of_and_stays_until_the_files_go(b: Bench) {
    let id = b.add().await;
    let lease = b.claim().await.unwrap();
    assert_eq!(b.job(id).await.preview, None);
    let before = b.job(id).await.version;
    assert_eq!(b.queue.show(&lease, "1-1.jpg", &report(0.2)).await.unwrap(), Standing::Held);
    assert_eq!(b.queue.show(&lease, "1-2.jpg", &report(0.4)).await.unwrap(), Standing::Held);
    let job = b.job(id).await;
    assert_eq!((job.preview.as_deref(), job.version), (Some("1-2.jpg"), before + 2));
    let events = b.queue.events(id, 0, 1000).await.unwrap();
    let told: Vec<_> = events.iter().filter(|event| event.kind == EventKind::Preview).collect();
    assert_eq!((told.len(), &told[1].data["progress"], &told[1].data["stage"]), (2, &json!(0.4), &json!("geometry")));
    b.queue.succeed(&lease, avatar()).await.unwrap();
    assert_eq!(b.queue.show(&lease, "1-3.jpg", &report(0.9)).await.unwrap(), Standing::Lost);
    assert_eq!(b.job(id).await.preview.as_deref(), Some("1-2.jpg"), "a thumbnail of the avatar");
    b.clock.advance(Duration::from_secs(2 * 3600));
    b.queue.reap().await.unwrap();
    assert_eq!((b.job(id).await.state, b.job(id).await.preview), (State::Expired, None));
}

pub async fn older_jobs_go_first(b: Bench) {
    let ids = [b.add().await, b.add().await, b.add().await];
    for (i, id) in ids.iter().enumerate() {
        assert_eq!(b.job(*id).await.queue_position, Some(i as u64 + 1));
    }
    for id in ids {
        assert_eq!(b.claim().await.unwrap().job, id);
    }
    assert_eq!(b.claim().await, None);
}

pub async fn concurrent_claims_give_each_job_once(b: Bench) {
    let mut added = BTreeSet::new();
    for _ in 0..20 {
        added.insert(b.add().await);
    }
    let claims = (0..30).map(|i| {
        let queue = b.queue.clone();
        tokio::spawn(async move { queue.claim(&format!("w{i}")).await.unwrap().map(|(lease, _)| lease.job) })
    });
    let mut claimed = Vec::new();
    for claim in claims.collect::<Vec<_>>() {
        claimed.extend(claim.await.unwrap());
    }
    assert_eq!(claimed.len(), 20);
    assert_eq!(claimed.into_iter().collect::<BTreeSet<_>>(), added);
}

pub async fn a_stale_epoch_writes_nothing(b: Bench) {
    let id = b.add().await;
    let stale = b.claim().await.unwrap();
    b.clock.advance(Duration::from_secs(61));
    assert_eq!(b.queue.reap().await.unwrap().reclaimed, [id]);
    b.clock.advance(Duration::from_secs(10));
    let fresh = b.claim().await.unwrap();
    assert_eq!((fresh.job, fresh.epoch), (id, 2));
    let before = b.job(id).await.version;
    assert_eq!(b.queue.standing(&stale).await.unwrap(), Standing::Lost);
    assert_eq!(b.queue.heartbeat(&stale).await.unwrap(), Standing::Lost);
    assert_eq!(b.queue.report(&stale, &report(0.9)).await.unwrap(), Standing::Lost);
    assert_eq!(b.queue.saved(&stale, 0.9).await.unwrap(), Standing::Lost);
    assert_eq!(b.queue.add_stage_time(&stale, "bake", 1.0).await.unwrap(), Standing::Lost);
    assert_eq!(b.queue.succeed(&stale, avatar()).await.unwrap(), Standing::Lost);
    assert_eq!(b.queue.fail(&stale, JobError::new("internal", "x"), Repeat::Counted).await.unwrap(), Standing::Lost);
    assert_eq!(b.queue.give_back(&stale).await.unwrap(), Standing::Lost);
    assert_eq!(b.queue.confirm_cancel(&stale).await.unwrap(), Standing::Lost);
    assert_eq!(b.job(id).await.version, before);
    assert!(b.queue.avatar(id).await.unwrap().is_none() && b.queue.stage_times().await.unwrap().is_empty());
    assert_eq!(b.queue.succeed(&fresh, avatar()).await.unwrap(), Standing::Held);
    assert_eq!(b.queue.avatar(id).await.unwrap().unwrap().epoch, 2);
}

pub async fn a_finished_lease_writes_nothing(b: Bench) {
    b.add().await;
    let lease = b.claim().await.unwrap();
    b.queue.succeed(&lease, avatar()).await.unwrap();
    assert_eq!(b.queue.heartbeat(&lease).await.unwrap(), Standing::Lost);
    assert_eq!(b.queue.succeed(&lease, avatar()).await.unwrap(), Standing::Lost);
    assert_eq!(b.queue.fail(&lease, JobError::new("internal", "x"), Repeat::Counted).await.unwrap(), Standing::Lost);
}

pub async fn heartbeats_and_progress_keep_the_lease(b: Bench) {
    let id = b.add().await;
    let lease = b.claim().await.unwrap();
    for _ in 0..3 {
        b.clock.advance(Duration::from_secs(50));
        assert_eq!(b.queue.heartbeat(&lease).await.unwrap(), Standing::Held);
        b.clock.advance(Duration::from_secs(50));
        assert_eq!(b.queue.report(&lease, &report(0.1)).await.unwrap(), Standing::Held);
        assert_eq!(b.queue.reap().await.unwrap(), Reaped::default());
    }
    assert_eq!(b.job(id).await.attempt, 1);
}

pub async fn a_job_that_kills_its_worker_fails_after_its_attempts(b: Bench) {
    let id = b.add().await;
    for attempt in 1..=3 {
        let lease = b.claim().await.unwrap_or_else(|| panic!("attempt {attempt} is claimable"));
        assert_eq!((b.job(id).await.attempt, lease.epoch), (attempt, i64::from(attempt)));
        b.clock.advance(Duration::from_secs(60));
        assert_eq!(b.queue.reap().await.unwrap().reclaimed, [id]);
        b.clock.advance(Duration::from_secs(600));
    }
    assert_eq!(b.claim().await, None);
    let job = b.job(id).await;
    assert_eq!((job.state, job.attempt, job.error.unwrap().kind.as_str()), (State::Failed, 3, "lease-lost"));
    assert_eq!(b.states(id).await, ["queued", "running", "queued", "running", "queued", "running", "failed"]);
}

pub async fn a_killed_attempt_that_moved_on_is_not_counted(b: Bench) {
    let id = b.add().await;
    for attempt in 1..=5 {
        let lease = b.claim().await.unwrap();
        assert_eq!(b.queue.saved(&lease, f64::from(attempt) / 10.0).await.unwrap(), Standing::Held);
        // By a death and by silence.
        if attempt % 2 == 0 {
            assert_eq!(b.queue.release_owner("worker-1").await.unwrap(), [id]);
        } else {
            b.clock.advance(Duration::from_secs(60));
            assert_eq!(b.queue.reap().await.unwrap().reclaimed, [id]);
        }
        let job = b.job(id).await;
        assert_eq!((job.state, job.attempt, job.excused), (State::Queued, attempt, attempt));
        b.clock.advance(Duration::from_secs(600));
    }
    // The same place once more is no progress, and neither is less.
    for attempt in 6..=8 {
        let lease = b.claim().await.unwrap();
        b.queue.saved(&lease, [0.5, 0.3, f64::NAN][attempt as usize - 6]).await.unwrap();
        b.queue.release_owner("worker-1").await.unwrap();
        assert_eq!((b.job(id).await.attempt, b.job(id).await.excused), (attempt, 5));
        b.clock.advance(Duration::from_secs(600));
    }
    assert_eq!(b.job(id).await.state, State::Failed);
    assert!(matches!(b.queue.retry(id).await.unwrap(), Change::Done(job) if job.attempt == 0 && job.excused == 0));
}

/// As after an upgrade: what another program had saved is no measure for what this one saves.
pub async fn a_killed_attempt_that_began_anew_and_moved_on_is_not_counted(b: Bench) {
    let id = b.add().await;
    let lease = b.claim().await.unwrap();
    b.queue.saved(&lease, 0.9).await.unwrap();
    b.queue.give_back(&lease).await.unwrap();
    for attempt in 1..=3 {
        let lease = b.claim().await.unwrap();
        if attempt == 1 {
            assert_eq!(b.queue.begun_anew(&lease).await.unwrap(), Standing::Held);
        }
        b.queue.saved(&lease, 0.2 * f64::from(attempt)).await.unwrap();
        b.queue.release_owner("worker-1").await.unwrap();
        assert_eq!((b.job(id).await.attempt, b.job(id).await.excused), (attempt, attempt));
        b.clock.advance(Duration::from_secs(600));
    }
    let stale = Lease { job: id, epoch: 1 };
    assert_eq!(b.queue.begun_anew(&stale).await.unwrap(), Standing::Lost);
}

pub async fn an_attempt_that_fails_by_itself_is_counted_wherever_it_got(b: Bench) {
    let id = b.add().await;
    for attempt in 1..=3 {
        let lease = b.claim().await.unwrap();
        b.queue.saved(&lease, f64::from(attempt) / 10.0).await.unwrap();
        b.queue.fail(&lease, JobError::new("device", "lost"), Repeat::Counted).await.unwrap();
        b.clock.advance(Duration::from_secs(600));
    }
    let job = b.job(id).await;
    assert_eq!((job.state, job.attempt, job.excused), (State::Failed, 3, 0));
}

pub async fn a_job_that_passes_its_deadline_fails(b: Bench) {
    let mut ids = Vec::new();
    for _ in 0..3 {
        let mut new = new_job(&b.env);
        new.options.deadline_secs = Some(30);
        ids.push(b.queue.insert(new).await.unwrap().queued().unwrap().id);
    }
    let endless = b.add().await;
    let running = b.claim().await.unwrap();
    b.claim().await.unwrap();
    b.queue.cancel(ids[1]).await.unwrap();
    b.clock.advance(Duration::from_millis(29_000));
    assert!(b.queue.reap().await.unwrap().late.is_empty());
    b.clock.advance(Duration::from_millis(1_000));
    assert_eq!(b.claim().await.unwrap().job, endless, "what has passed its deadline is not begun");
    assert_eq!(b.queue.reap().await.unwrap().late, [ids[0], ids[2]]);
    for id in [ids[0], ids[2]] {
        let job = b.job(id).await;
        assert_eq!((job.state, job.error.unwrap().kind.as_str()), (State::Failed, "deadline"));
    }
    assert_eq!(b.job(ids[1]).await.state, State::Canceling, "the user's wish comes first");
    assert_eq!(b.queue.standing(&running).await.unwrap(), Standing::Lost);
    assert_eq!(b.queue.succeed(&running, avatar()).await.unwrap(), Standing::Lost);
    // A retry has the whole time again.
    let Change::Done(job) = b.queue.retry(ids[2]).await.unwrap() else { panic!() };
    assert_eq!(job.deadline_at, Some(b.env.now().plus(Duration::from_secs(30))));
    assert_eq!(b.job(endless).await.deadline_at, None);
}

pub async fn a_higher_priority_goes_first(b: Bench) {
    let mut ids = Vec::new();
    for priority in [0, -5, 7, 7] {
        b.clock.advance(Duration::from_millis(1));
        let mut new = new_job(&b.env);
        new.options.priority = priority;
        ids.push(b.queue.insert(new).await.unwrap().queued().unwrap().id);
    }
    for (id, position) in ids.iter().zip([3, 4, 1, 2]) {
        assert_eq!(b.job(*id).await.queue_position, Some(position));
    }
    for i in [2, 3, 0, 1] {
        assert_eq!(b.claim().await.unwrap().job, ids[i]);
    }
}

pub async fn a_key_queues_one_job(b: Bench) {
    let remember = |fingerprint: char| {
        let fingerprint = fingerprint.to_string().repeat(64);
        Some(Remember { key: "/k".into(), fingerprint, answer: |job| json!({ "id": job.id }).to_string() })
    };
    let posts = (0..20).map(|_| {
        let (queue, new) = (b.queue.clone(), NewJob { remember: remember('a'), ..new_job(&b.env) });
        tokio::spawn(async move { queue.insert(new).await.unwrap() })
    });
    let (mut queued, mut known) = (Vec::new(), Vec::new());
    for post in posts.collect::<Vec<_>>() {
        match post.await.unwrap() {
            Insertion::Queued(job) => queued.push(json!({ "id": job.id }).to_string()),
            Insertion::Known(remembered) => known.push(remembered.answer),
            Insertion::Full => panic!(),
        }
    }
    assert_eq!((queued.len(), known.len()), (1, 19));
    assert!(known.iter().all(|answer| *answer == queued[0]));
    // Whatever became of the job, and whatever comes under the key.
    let job = b.claim().await.unwrap().job;
    assert!(matches!(b.queue.delete(job).await.unwrap(), Deletion::Pending));
    let other = NewJob { remember: remember('b'), ..new_job(&b.env) };
    let Insertion::Known(first) = b.queue.insert(other.clone()).await.unwrap() else { panic!() };
    assert_eq!(first.fingerprint, "a".repeat(64));
    b.clock.advance(Duration::from_secs(24 * 3600 - 1));
    b.queue.reap().await.unwrap();
    assert_eq!(b.queue.remembered("/k").await.unwrap(), Some(first));
    b.clock.advance(Duration::from_secs(1));
    b.queue.reap().await.unwrap();
    assert_eq!(b.queue.remembered("/k").await.unwrap(), None);
    assert!(matches!(b.queue.insert(other).await.unwrap(), Insertion::Queued(_)));
}

pub async fn a_full_queue_takes_no_more(b: Bench) {
    let mut last = b.add().await;
    for _ in 1..1000 {
        last = b.add().await;
    }
    assert!(b.queue.is_full().await.unwrap());
    assert!(matches!(b.queue.insert(new_job(&b.env)).await.unwrap(), Insertion::Full));
    b.queue.cancel(last).await.unwrap();
    assert!(!b.queue.is_full().await.unwrap());
    b.add().await;
    // A retried job waits like any other.
    assert!(matches!(b.queue.retry(last).await.unwrap(), Change::Full));
    assert_eq!(b.queue.get(last).await.unwrap().unwrap().state, State::Canceled, "it may be retried later");
    // Running jobs do not wait.
    b.claim().await.unwrap();
    assert!(matches!(b.queue.retry(last).await.unwrap(), Change::Done(_)));
}

pub async fn repeats_wait_longer_each_time(b: Bench) {
    let id = b.add().await;
    let mut waits = Vec::new();
    for _ in 0..2 {
        let lease = b.claim().await.unwrap();
        b.queue.fail(&lease, JobError::new("device", "lost"), Repeat::Counted).await.unwrap();
        assert_eq!(b.claim().await, None, "a repeated job waits");
        let job = b.job(id).await;
        assert_eq!((job.state, job.error.unwrap().kind.as_str()), (State::Queued, "device"));
        waits.push(job.run_at.0 - b.env.now().0);
        b.clock.advance(Duration::from_millis(*waits.last().unwrap() as u64));
    }
    assert!((2000..=2500).contains(&waits[0]), "{waits:?}");
    assert!((4000..=5000).contains(&waits[1]), "{waits:?}");
    let lease = b.claim().await.unwrap();
    b.queue.fail(&lease, JobError::new("device", "lost"), Repeat::Counted).await.unwrap();
    assert_eq!(b.job(id).await.state, State::Failed);
}

pub async fn a_final_error_is_not_repeated(b: Bench) {
    let id = b.add().await;
    let lease = b.claim().await.unwrap();
    let mut error = JobError::new("diverged", "the loss is no number");
    error.losses.insert("rgb".into(), 1e9);
    b.queue.fail(&lease, error.clone(), Repeat::Never).await.unwrap();
    let job = b.job(id).await;
    assert_eq!((job.state, job.error), (State::Failed, Some(error)));
    assert!(job.finished_at.is_some());
}

pub async fn cancel_of_a_queued_job_is_immediate(b: Bench) {
    let id = b.add().await;
    let Change::Done(job) = b.queue.cancel(id).await.unwrap() else { panic!() };
    assert_eq!(job.state, State::Canceled);
    assert!(job.finished_at.is_some());
    assert!(matches!(b.queue.cancel(id).await.unwrap(), Change::Done(_)), "twice is once");
    assert_eq!(b.states(id).await, ["queued", "canceled"]);
    assert_eq!(b.claim().await, None);
}

pub async fn cancel_of_a_running_job_reaches_its_worker(b: Bench) {
    let id = b.add().await;
    let lease = b.claim().await.unwrap();
    let Change::Done(job) = b.queue.cancel(id).await.unwrap() else { panic!() };
    assert_eq!(job.state, State::Canceling);
    assert_eq!(b.queue.standing(&lease).await.unwrap(), Standing::Canceling);
    assert_eq!(b.queue.heartbeat(&lease).await.unwrap(), Standing::Canceling);
    assert_eq!(b.queue.report(&lease, &report(0.5)).await.unwrap(), Standing::Canceling);
    b.queue.confirm_cancel(&lease).await.unwrap();
    assert_eq!(b.job(id).await.state, State::Canceled);
    assert_eq!(b.states(id).await, ["queued", "running", "canceling", "canceled"]);
}

pub async fn a_canceling_job_whose_worker_dies_is_canceled(b: Bench) {
    let id = b.add().await;
    b.claim().await.unwrap();
    b.queue.cancel(id).await.unwrap();
    b.clock.advance(Duration::from_secs(61));
    b.queue.reap().await.unwrap();
    assert_eq!(b.job(id).await.state, State::Canceled);
}

pub async fn cancel_that_comes_too_late_is_refused(b: Bench) {
    let id = b.add().await;
    let lease = b.claim().await.unwrap();
    b.queue.cancel(id).await.unwrap();
    assert_eq!(b.queue.succeed(&lease, avatar()).await.unwrap(), Standing::Held, "the work was done");
    assert!(matches!(b.queue.cancel(id).await.unwrap(), Change::Refused(job) if job.state == State::Succeeded));
    assert!(matches!(b.queue.cancel(Uuid::nil()).await.unwrap(), Change::Unknown));
}

pub async fn retry_gives_all_attempts_again(b: Bench) {
    let id = b.add().await;
    assert!(matches!(b.queue.retry(id).await.unwrap(), Change::Refused(_)), "a queued job needs none");
    let lease = b.claim().await.unwrap();
    b.queue.fail(&lease, JobError::new("bad-input", "no person"), Repeat::Never).await.unwrap();
    let Change::Done(job) = b.queue.retry(id).await.unwrap() else { panic!() };
    assert_eq!((job.state, job.attempt, job.error, job.finished_at), (State::Queued, 0, None, None));
    let again = b.claim().await.unwrap();
    assert_eq!(again.epoch, 2, "epochs never fall");
    assert!(matches!(b.queue.retry(Uuid::nil()).await.unwrap(), Change::Unknown));
}

pub async fn a_shutdown_gives_the_attempt_back(b: Bench) {
    let id = b.add().await;
    for epoch in 1..=5 {
        let lease = b.claim().await.unwrap();
        assert_eq!((lease.epoch, b.job(id).await.attempt), (epoch, 1));
        assert_eq!(b.queue.give_back(&lease).await.unwrap(), Standing::Held);
        assert_eq!(b.job(id).await.state, State::Queued);
    }
}

pub async fn a_dead_workers_jobs_are_released_at_once(b: Bench) {
    let (one, two) = (b.add().await, b.add().await);
    b.queue.claim("dead").await.unwrap().unwrap();
    b.queue.claim("alive").await.unwrap().unwrap();
    let mut owners = b.queue.owners().await.unwrap();
    owners.sort();
    assert_eq!(owners, ["alive", "dead"]);
    assert_eq!(b.queue.release_owner("dead").await.unwrap(), [one]);
    assert_eq!(b.job(one).await.state, State::Queued);
    assert_eq!(b.job(two).await.state, State::Running);
}

pub async fn deletion_waits_for_the_worker(b: Bench) {
    let idle = b.add().await;
    assert_eq!(b.queue.delete(idle).await.unwrap(), Deletion::Gone);
    assert_eq!(b.queue.delete(idle).await.unwrap(), Deletion::Unknown);
    assert!(b.queue.get(idle).await.unwrap().is_none());
    assert!(b.queue.events(idle, 0, 10).await.unwrap().is_empty());

    let busy = b.add().await;
    let lease = b.claim().await.unwrap();
    assert_eq!(b.queue.delete(busy).await.unwrap(), Deletion::Pending);
    assert_eq!(b.queue.standing(&lease).await.unwrap(), Standing::Canceling);
    assert!(b.queue.reap().await.unwrap().deleted.is_empty());
    b.queue.confirm_cancel(&lease).await.unwrap();
    assert!(matches!(b.queue.retry(busy).await.unwrap(), Change::Refused(_)), "it is on its way out");
    assert_eq!(b.queue.reap().await.unwrap().deleted, [busy]);
    assert!(b.queue.get(busy).await.unwrap().is_none());
}

pub async fn retention_removes_the_avatar_and_keeps_the_job(b: Bench) {
    let id = b.add().await;
    let lease = b.claim().await.unwrap();
    b.queue.report(&lease, &report(0.5)).await.unwrap();
    b.queue.succeed(&lease, avatar()).await.unwrap();
    b.clock.advance(Duration::from_secs(3599));
    assert_eq!(b.queue.reap().await.unwrap(), Reaped::default());
    assert!(b.queue.events(id, 0, 100).await.unwrap().iter().any(|event| event.kind != EventKind::State));
    b.clock.advance(Duration::from_secs(1));
    assert_eq!(b.queue.reap().await.unwrap().expired, [id]);
    assert_eq!(b.job(id).await.state, State::Expired);
    assert!(b.queue.avatar(id).await.unwrap().is_none());
    assert!(b.queue.events(id, 0, 100).await.unwrap().iter().all(|event| event.kind == EventKind::State));
    assert_eq!(b.states(id).await, ["queued", "running", "succeeded", "expired"]);
    assert_eq!(b.queue.reap().await.unwrap(), Reaped::default());
    assert!(matches!(b.queue.retry(id).await.unwrap(), Change::Refused(_)), "its inputs are gone");
}

pub async fn events_go_on_after_the_last_one_seen(b: Bench) {
    let id = b.add().await;
    let other = b.add().await;
    let lease = b.claim().await.unwrap();
    for i in 1..=4 {
        b.queue.report(&lease, &report(f64::from(i) / 10.0)).await.unwrap();
    }
    let all = b.queue.events(id, 0, 100).await.unwrap();
    assert_eq!(all.len(), 6);
    assert!(all.windows(2).all(|pair| pair[0].id < pair[1].id));
    let rest = b.queue.events(id, all[2].id, 100).await.unwrap();
    assert_eq!(rest, all[3..]);
    assert_eq!(b.queue.last_event().await.unwrap(), all[5].id);
    assert_eq!(b.queue.events(other, 0, 100).await.unwrap().len(), 1);
}

pub async fn losses_that_are_no_numbers_are_left_out(b: Bench) {
    let id = b.add().await;
    let lease = b.claim().await.unwrap();
    let mut bad = report(f64::NAN);
    bad.losses.insert("mask".into(), f64::INFINITY);
    bad.eta_secs = Some(f64::NAN);
    assert_eq!(b.queue.report(&lease, &bad).await.unwrap(), Standing::Held);
    let job = b.job(id).await;
    assert_eq!((job.progress, job.eta_secs, job.losses.len()), (0.0, None, 1));
}

pub async fn the_list_pages_from_new_to_old(b: Bench) {
    let ids = [b.add().await, b.add().await, b.add().await];
    b.queue.cancel(ids[1]).await.unwrap();
    let list = |state, before, limit| {
        let queue = b.queue.clone();
        async move {
            let jobs = queue.list(ListFilter { state, before, limit, ..ListFilter::default() }).await.unwrap();
            jobs.into_iter().map(|job| job.id).collect::<Vec<_>>()
        }
    };
    assert_eq!(list(None, None, 2).await, [ids[2], ids[1]]);
    assert_eq!(list(None, Some(ids[1]), 2).await, [ids[0]]);
    assert_eq!(list(Some(State::Canceled), None, 10).await, [ids[1]]);
    assert!(list(Some(State::Failed), None, 10).await.is_empty());
    let middle = b.job(ids[1]).await.created_at;
    let ranged = |created_from, created_before| {
        let queue = b.queue.clone();
        async move {
            let filter = ListFilter { created_from, created_before, limit: 10, ..ListFilter::default() };
            queue.list(filter).await.unwrap().into_iter().map(|job| job.id).collect::<Vec<_>>()
        }
    };
    assert_eq!(ranged(Some(middle), None).await, [ids[2], ids[1]]);
    assert_eq!(ranged(None, Some(middle)).await, [ids[0]]);
    assert!(ranged(Some(middle), Some(middle)).await.is_empty());
    let all = ListFilter {
        state: Some(State::Canceled),
        before: Some(ids[2]),
        created_from: Some(middle),
        created_before: Some(middle.plus(Duration::from_millis(1))),
        key: None,
        limit: 10,
    };
    assert_eq!(b.queue.list(all.clone()).await.unwrap().into_iter().map(|job| job.id).collect::<Vec<_>>(), [ids[1]]);
    assert!(b.queue.list(ListFilter { key: Some(Uuid::nil()), ..all }).await.unwrap().is_empty());
}

pub async fn stage_times_add_up(b: Bench) {
    b.add().await;
    let lease = b.claim().await.unwrap();
    for secs in [1.5, 2.0] {
        b.queue.add_stage_time(&lease, "texture", secs).await.unwrap();
    }
    let times = b.queue.stage_times().await.unwrap();
    assert_eq!(times, [StageTime { stage: "texture".into(), jobs: 1, secs: 3.5 }]);
}

/// One `#[tokio::test]` for each rule above, on the queue that the expression opens.
macro_rules! suite {
    ($open:expr) => {
        crate::jobs::conformance::suite! { $open;
            a_job_goes_through_its_life
            a_picture_is_told_of_and_stays_until_the_files_go
            older_jobs_go_first
            concurrent_claims_give_each_job_once
            a_stale_epoch_writes_nothing
            a_finished_lease_writes_nothing
            heartbeats_and_progress_keep_the_lease
            a_job_that_kills_its_worker_fails_after_its_attempts
            a_killed_attempt_that_moved_on_is_not_counted
            a_killed_attempt_that_began_anew_and_moved_on_is_not_counted
            an_attempt_that_fails_by_itself_is_counted_wherever_it_got
            a_job_that_passes_its_deadline_fails
            a_higher_priority_goes_first
            a_key_queues_one_job
            a_full_queue_takes_no_more
            repeats_wait_longer_each_time
            a_final_error_is_not_repeated
            cancel_of_a_queued_job_is_immediate
            cancel_of_a_running_job_reaches_its_worker
            a_canceling_job_whose_worker_dies_is_canceled
            cancel_that_comes_too_late_is_refused
            retry_gives_all_attempts_again
            a_shutdown_gives_the_attempt_back
            a_dead_workers_jobs_are_released_at_once
            deletion_waits_for_the_worker
            retention_removes_the_avatar_and_keeps_the_job
            events_go_on_after_the_last_one_seen
            losses_that_are_no_numbers_are_left_out
            the_list_pages_from_new_to_old
            stage_times_add_up
        }
    };
    ($open:expr; $($rule:ident)*) => {
        $(#[tokio::test]
        async fn $rule() {
            crate::jobs::conformance::$rule($open.await).await;
        })*
    };
}
pub(crate) use suite;
