//! The types of the domain; `migrations/` explains each field.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use uuid::Uuid;

use super::{JobOptions, Timestamp};
use crate::camera::Camera;

/// Where a job stands. See the drawing in `migrations/0001_jobs_and_avatars.sql`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum State {
    /// Waits for a worker.
    Queued,
    /// A worker has it.
    Running,
    /// The avatar is there.
    Succeeded,
    /// A worker has it and was asked to stop.
    Canceling,
    /// Stopped because a user wished it.
    Canceled,
    /// Ended for the reason in `error`.
    Failed,
    /// Ended some time ago; its files were removed at the end of their retention.
    Expired,
}

impl State {
    pub const ALL: [State; 7] = [
        State::Queued,
        State::Running,
        State::Succeeded,
        State::Canceling,
        State::Canceled,
        State::Failed,
        State::Expired,
    ];

    /// As stored and as said over HTTP.
    pub fn name(self) -> &'static str {
        match self {
            State::Queued => "queued",
            State::Running => "running",
            State::Succeeded => "succeeded",
            State::Canceling => "canceling",
            State::Canceled => "canceled",
            State::Failed => "failed",
            State::Expired => "expired",
        }
    }

    pub fn from_name(name: &str) -> Option<State> {
        State::ALL.into_iter().find(|state| state.name() == name)
    }

    /// Nothing more happens unless a user asks for it.
    pub fn is_final(self) -> bool {
        matches!(self, State::Succeeded | State::Canceled | State::Failed | State::Expired)
    }
}

/// The last value of each loss.
pub type Losses = BTreeMap<String, f64>;

/// An uploaded part.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Part {
    /// Size of the part as it was uploaded.
    pub bytes: u64,
}

/// What the inspection of the upload found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Clip {
    /// Frames in the video.
    pub frames: u32,
    /// Pixels, after the rotation that the file asks for.
    pub width: u32,
    pub height: u32,
    /// Frames a second.
    pub fps: f64,
    /// What was odd about the upload and does not keep it from being fitted, for people.
    #[serde(default)]
    pub warnings: Vec<String>,
}

/// A job to be put into the queue; its inputs lie in the store already.
#[derive(Clone, Debug)]
pub struct NewJob {
    pub id: Uuid,
    /// Whose it is.
    pub key: Option<Uuid>,
    pub options: JobOptions,
    pub inputs: BTreeMap<String, Part>,
    pub clip: Clip,
    pub remember: Option<Remember>,
}

/// A client's key for a request that it may send again, and what the request said.
#[derive(Clone, Debug)]
pub struct Remember {
    pub key: String,
    /// SHA-256 of the request, lower-case hex.
    pub fingerprint: String,
    /// The answer to the client, as JSON: it is kept with the key.
    pub answer: fn(&Job) -> String,
}

/// A key that was given before.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Remembered {
    pub fingerprint: String,
    pub answer: String,
}

/// What became of a job that was to be put into the queue.
#[derive(Clone, Debug)]
pub enum Insertion {
    Queued(Box<Job>),
    /// Its key was given before; nothing was inserted.
    Known(Remembered),
    /// So many jobs wait that no more are taken.
    Full,
}

impl Insertion {
    pub fn queued(self) -> Option<Job> {
        match self {
            Insertion::Queued(job) => Some(*job),
            _ => None,
        }
    }
}

/// Why an attempt ended badly.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct JobError {
    /// A stable word for programs: `bad-input`, `unfit`, `diverged`, `device`, `stalled`,
    /// `deadline`, `disk-full`, `internal`, `lease-lost`.
    #[serde(rename = "type")]
    pub kind: String,
    /// For people.
    pub detail: String,
    /// The part of the upload that is at fault.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub part: Option<String>,
    /// The frame of the video that is at fault, from 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<u32>,
    /// What would have been right.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expected: Option<String>,
    /// The last losses of a fit that diverged.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub losses: Losses,
}

impl JobError {
    /// Every `type` that a job's error may have.
    pub const KINDS: [&str; 9] =
        ["bad-input", "unfit", "diverged", "device", "stalled", "deadline", "disk-full", "internal", "lease-lost"];

    pub fn new(kind: &str, detail: impl Into<String>) -> Self {
        debug_assert!(Self::KINDS.contains(&kind), "{kind:?} is no documented type");
        JobError {
            kind: kind.into(),
            detail: detail.into(),
            part: None,
            frame: None,
            expected: None,
            losses: Losses::new(),
        }
    }
}

/// A job as it is now.
#[derive(Clone, Debug)]
pub struct Job {
    pub id: Uuid,
    pub state: State,
    pub options: JobOptions,
    pub inputs: BTreeMap<String, Part>,
    pub clip: Clip,
    pub priority: i64,
    pub attempt: u32,
    pub max_attempts: u32,
    /// Attempts that do not count: a hard kill ended them after the checkpoint had moved on.
    pub excused: u32,
    /// How far the checkpoints have come, 0 to 1, and how far they had come at the claim.
    pub saved: f64,
    pub saved_at_claim: f64,
    pub epoch: i64,
    pub owner: Option<String>,
    pub stage: Option<String>,
    pub step: u32,
    pub steps: u32,
    pub progress: f64,
    pub eta_secs: Option<f64>,
    pub losses: Losses,
    pub created_at: Timestamp,
    /// Not claimed before.
    pub run_at: Timestamp,
    pub started_at: Option<Timestamp>,
    pub cancel_requested_at: Option<Timestamp>,
    pub delete_requested_at: Option<Timestamp>,
    pub finished_at: Option<Timestamp>,
    pub expires_at: Option<Timestamp>,
    /// Failed if it has not ended by then.
    pub deadline_at: Option<Timestamp>,
    pub updated_at: Timestamp,
    /// Grows with every change of the job.
    pub version: i64,
    pub error: Option<JobError>,
    /// Name of the newest picture of the avatar in the making.
    pub preview: Option<String>,
    /// 1 = the next to be claimed; only while queued.
    pub queue_position: Option<u64>,
}

/// A line of a job's history.
#[derive(Clone, Debug, PartialEq)]
pub struct Event {
    pub id: i64,
    pub at: Timestamp,
    pub kind: EventKind,
    pub data: serde_json::Value,
}

/// What an event tells of its job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EventKind {
    State,
    Progress,
    /// There is a new picture of the avatar in the making.
    Preview,
}

impl EventKind {
    pub const ALL: [EventKind; 3] = [EventKind::State, EventKind::Progress, EventKind::Preview];

    pub fn name(self) -> &'static str {
        match self {
            EventKind::State => "state",
            EventKind::Progress => "progress",
            EventKind::Preview => "preview",
        }
    }
}

/// A result to be published.
#[derive(Clone, Debug)]
pub struct NewAvatar {
    pub body: String,
    pub frames: u32,
    pub camera: Camera,
    pub metrics: serde_json::Value,
    pub files: Vec<AvatarFile>,
}

/// One of an avatar's files, named within its results folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AvatarFile {
    pub name: String,
    pub bytes: u64,
    /// Lower-case hex.
    pub sha256: String,
}

/// A published result; its id is its job's.
#[derive(Clone, Debug)]
pub struct Avatar {
    pub id: Uuid,
    /// Which results folder of the job is the avatar's.
    pub epoch: i64,
    /// What was uploaded.
    pub clip: Clip,
    pub body: String,
    /// How many of the clip's frames were fitted.
    pub frames: u32,
    pub camera: Camera,
    pub metrics: serde_json::Value,
    pub created_at: Timestamp,
    pub expires_at: Option<Timestamp>,
    /// Sorted by name.
    pub files: Vec<AvatarFile>,
}
