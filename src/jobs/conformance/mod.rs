//! What every [`Queue`] must do, whatever lies beneath. A database joins by `suite!(open())`.

mod attempts;
mod leases;
mod order;
mod wishes;

use std::any::Any;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use serde_json::json;
use uuid::Uuid;

pub use self::attempts::*;
pub use self::leases::*;
pub use self::order::*;
pub use self::wishes::*;
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

/// One `#[tokio::test]` for each rule of these files, on the queue that the expression opens.
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
            a_job_that_was_given_back_tells_no_time_left
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
