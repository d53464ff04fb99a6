//! A job as clients see it.

use std::collections::BTreeMap;

use serde::Serialize;
use uuid::Uuid;

use crate::jobs::{Clip, Job, JobError, JobOptions, Losses, Part, State, Timestamp};

/// A clip on its way to an avatar. Times are RFC 3339 in UTC.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct JobView {
    pub id: Uuid,
    pub state: State,
    /// decode, pose, geometry, texture, bake or export; null before the first.
    pub stage: Option<String>,
    /// Steps of the stage that are done.
    pub step: u32,
    /// Steps of the stage.
    pub steps: u32,
    /// Of the whole job, 0 to 1.
    pub progress: f64,
    /// Estimated time to the end.
    pub eta_secs: Option<f64>,
    /// Attempts begun.
    pub attempt: u32,
    pub max_attempts: u32,
    /// Attempts that do not count against `max_attempts`: a hard kill ended them after their checkpoint had moved on.
    pub excused_attempts: u32,
    /// 1 = the next to be taken; null unless queued.
    pub queue_position: Option<u64>,
    /// The last value of each loss.
    pub losses: Losses,
    pub options: JobOptions,
    /// The uploaded parts.
    pub inputs: BTreeMap<String, Part>,
    pub clip: Clip,
    pub created_at: String,
    /// First taken by a worker.
    pub started_at: Option<String>,
    pub cancel_requested_at: Option<String>,
    pub finished_at: Option<String>,
    pub updated_at: String,
    /// When the job fails if it has not ended.
    pub deadline_at: Option<String>,
    /// When the job's files will be removed.
    pub expires_at: Option<String>,
    /// The newest picture of the avatar in the making; null before the first.
    pub preview_url: Option<String>,
    /// Id of the avatar, once the job has succeeded: `/v1/avatars/{avatar}`.
    pub avatar: Option<Uuid>,
    /// Why the last attempt ended badly.
    pub error: Option<JobError>,
}

impl From<Job> for JobView {
    fn from(job: Job) -> Self {
        let text = |time: Option<Timestamp>| time.map(Timestamp::rfc3339);
        JobView {
            id: job.id,
            state: job.state,
            stage: job.stage,
            step: job.step,
            steps: job.steps,
            progress: job.progress,
            eta_secs: job.eta_secs,
            attempt: job.attempt,
            max_attempts: job.max_attempts,
            excused_attempts: job.excused,
            queue_position: job.queue_position,
            losses: job.losses,
            options: job.options,
            inputs: job.inputs,
            clip: job.clip,
            created_at: job.created_at.rfc3339(),
            started_at: text(job.started_at),
            cancel_requested_at: text(job.cancel_requested_at),
            finished_at: text(job.finished_at),
            updated_at: job.updated_at.rfc3339(),
            deadline_at: text(job.deadline_at),
            expires_at: text(job.expires_at),
            preview_url: job.preview.map(|_| preview_url(job.id)),
            avatar: (job.state == State::Succeeded).then_some(job.id),
            error: job.error,
        }
    }
}

/// Where the newest picture of a job's avatar is.
pub(super) fn preview_url(job: Uuid) -> String {
    format!("/v1/jobs/{job}/preview")
}
