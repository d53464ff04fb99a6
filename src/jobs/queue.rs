//! The queue as its users see it: the API, the workers and the reaper.

use std::collections::BTreeMap;
use std::time::Duration;

use futures_util::future::BoxFuture;
use uuid::Uuid;

use super::{Avatar, Event, Insertion, Job, JobError, Losses, NewAvatar, NewJob, Remembered, State, Timestamp};

/// The numbers that rule leases and repeats.
#[derive(Clone, Debug)]
pub struct Policy {
    /// A worker that is silent for longer has lost its job.
    pub lease: Duration,
    /// Attempts of a job before it fails.
    pub max_attempts: u32,
    /// Wait before the second attempt; doubles with each further one, plus up to a quarter by chance.
    pub backoff: Duration,
    /// No wait is longer.
    pub backoff_max: Duration,
    /// How long a job is kept after its end; None = for ever.
    pub retention: Option<Duration>,
    /// So many jobs may wait; more are refused.
    pub max_queued: u64,
    /// How long the answer to a client's key is kept.
    pub remember: Duration,
}

impl Default for Policy {
    fn default() -> Self {
        Policy {
            lease: Duration::from_secs(60),
            max_attempts: 3,
            backoff: Duration::from_secs(2),
            backoff_max: Duration::from_secs(600),
            retention: None,
            max_queued: 1000,
            remember: Duration::from_secs(24 * 3600),
        }
    }
}

impl Policy {
    /// The wait after `attempt` attempts (≥ 1); `unit` is uniform in [0, 1).
    pub fn backoff_after(&self, attempt: u32, unit: f64) -> Duration {
        let doublings = attempt.saturating_sub(1).min(30);
        let wait = self.backoff.saturating_mul(1 << doublings).min(self.backoff_max);
        wait.mul_f64(1.0 + 0.25 * unit)
    }
}

/// Why the queue could not do what was asked; but for [`QueueError::Quota`], that is the server's fault.
#[derive(Debug, thiserror::Error)]
pub enum QueueError {
    #[error("the job database: {0}")]
    Database(#[from] sqlx::Error),
    #[error("the job database could not be brought to this version: {0}")]
    Migrate(#[from] sqlx::migrate::MigrateError),
    /// More than a key allows.
    #[error("the key allows {limit} {what}")]
    Quota { what: &'static str, limit: u64 },
    #[error("the job database holds something unreadable in {column}: {reason}")]
    Corrupt { column: &'static str, reason: String },
}

/// SQLite's codes of a disk without room: SQLITE_FULL in all its forms, and SQLITE_IOERR_SHMSIZE, with which a database is not opened.
const FULL: u32 = 13;
const SHARED_MEMORY_SIZE: u32 = 4874;
/// SQLITE_PERM, SQLITE_READONLY and SQLITE_CANTOPEN, in all their forms.
const REFUSED: [u32; 3] = [3, 8, 14];

impl QueueError {
    /// SQLite's extended code, where the error is SQLite's.
    fn code(&self) -> Option<u32> {
        let (QueueError::Database(error) | QueueError::Migrate(sqlx::migrate::MigrateError::Execute(error))) = self
        else {
            return None;
        };
        error.as_database_error()?.code()?.parse().ok()
    }

    /// Whether it was for want of room on the disk.
    pub fn is_disk_full(&self) -> bool {
        self.code().is_some_and(|code| code & 0xff == FULL || code == SHARED_MEMORY_SIZE)
    }

    /// Whether the files are another user's, or in a folder that is.
    pub fn is_refused(&self) -> bool {
        self.code().is_some_and(|code| REFUSED.contains(&(code & 0xff)))
    }
}

/// A worker's right to a job: every write names it, and none succeeds once the epoch has moved on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lease {
    pub job: Uuid,
    pub epoch: i64,
}

/// How a lease stands after a look or a write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standing {
    /// The job is this worker's.
    Held,
    /// It is, and a user wants it to stop.
    Canceling,
    /// Somebody else has the job, or nobody, or it is gone: stop, write nothing.
    Lost,
}

/// Answer to a user's wish.
#[derive(Clone, Debug)]
pub enum Change {
    /// The job as it is now.
    Done(Job),
    /// Its state does not allow it.
    Refused(Job),
    /// As many jobs wait as may.
    Full,
    Unknown,
}

/// Answer to a wish to delete a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Deletion {
    /// The rows are gone; the files are the caller's to remove.
    Gone,
    /// A worker has the job: it is asked to stop, and the reaper deletes it then.
    Pending,
    Unknown,
}

/// What comes after an attempt that ended badly.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Repeat {
    /// The job has failed: another attempt would end the same way.
    Never,
    /// Another attempt after a wait, if one is left.
    Counted,
    /// The same, but an attempt whose checkpoint moved on is not counted: it was killed, and it got somewhere.
    Killed,
}

/// A page of the list, newest first.
#[derive(Clone, Debug, Default)]
pub struct ListFilter {
    pub state: Option<State>,
    /// Only jobs created at this time or later.
    pub created_from: Option<Timestamp>,
    /// Only jobs created before this time.
    pub created_before: Option<Timestamp>,
    /// Only jobs of this key.
    pub key: Option<Uuid>,
    /// Only jobs older than this one.
    pub before: Option<Uuid>,
    pub limit: u32,
}

/// What a worker tells about a fit.
#[derive(Clone, Debug, PartialEq)]
pub struct ProgressReport {
    pub stage: String,
    pub step: u32,
    pub steps: u32,
    /// Of the whole job, 0 to 1.
    pub progress: f64,
    pub eta_secs: Option<f64>,
    pub losses: Losses,
}

/// What the reaper did.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Reaped {
    /// Leases taken back.
    pub reclaimed: Vec<Uuid>,
    /// Jobs failed because their deadline passed.
    pub late: Vec<Uuid>,
    /// Jobs whose retention ended; their files are the caller's to remove.
    pub expired: Vec<Uuid>,
    /// Jobs deleted as wished; their files are the caller's to remove.
    pub deleted: Vec<Uuid>,
}

/// Time that jobs spent in a stage.
#[derive(Clone, Debug, PartialEq)]
pub struct StageTime {
    pub stage: String,
    pub jobs: u64,
    pub secs: f64,
}

/// How the service fares, for those who watch it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Figures {
    /// Failed jobs that are kept, by the type of their error.
    pub failed: Vec<(String, u64)>,
    /// Jobs that are kept and were ever claimed, and how long they waited for that, all together.
    pub started: u64,
    pub waited_secs: f64,
    /// How long the oldest waiting job has waited, since it was queued or queued again; 0 without any.
    pub oldest_secs: f64,
    /// The most device memory that a fit of the last day took.
    pub device_peak_bytes: Option<u64>,
    /// Webhook messages that wait for an attempt.
    pub deliveries: u64,
}

/// What the traits of this module give back: they are used as objects, which `async fn` does not allow.
pub(super) type QueueFuture<'a, T> = BoxFuture<'a, Result<T, QueueError>>;

/// A durable queue of jobs and the shelf of their results. Each call is one transaction.
pub trait Queue: Send + Sync + 'static {
    // The API's side.

    /// Puts a job in, queued, unless its key was given before or too many wait.
    fn insert(&self, job: NewJob) -> QueueFuture<'_, Insertion>;
    /// Whether so many jobs wait that no more are taken.
    fn is_full(&self) -> QueueFuture<'_, bool>;
    /// What a key was given for, if it was.
    fn remembered<'a>(&'a self, key: &'a str) -> QueueFuture<'a, Option<Remembered>>;
    fn get(&self, id: Uuid) -> QueueFuture<'_, Option<Job>>;
    fn list(&self, filter: ListFilter) -> QueueFuture<'_, Vec<Job>>;
    /// queued → canceled, running → canceling; a job that is canceling or canceled stays as it is.
    fn cancel(&self, id: Uuid) -> QueueFuture<'_, Change>;
    /// failed, canceled → queued, with all its attempts again. Its checkpoint is still there.
    fn retry(&self, id: Uuid) -> QueueFuture<'_, Change>;
    fn delete(&self, id: Uuid) -> QueueFuture<'_, Deletion>;
    /// Events of a job after the one named, oldest first.
    fn events(&self, job: Uuid, after: i64, limit: u32) -> QueueFuture<'_, Vec<Event>>;
    /// Id of the newest event of all jobs, 0 without any.
    fn last_event(&self) -> QueueFuture<'_, i64>;
    fn avatar(&self, id: Uuid) -> QueueFuture<'_, Option<Avatar>>;
    /// Jobs in each state.
    fn counts(&self) -> QueueFuture<'_, BTreeMap<State, u64>>;
    fn stage_times(&self) -> QueueFuture<'_, Vec<StageTime>>;
    fn figures(&self) -> QueueFuture<'_, Figures>;

    // A worker's side.

    /// Gives the first claimable job to `owner`, if there is one.
    fn claim<'a>(&'a self, owner: &'a str) -> QueueFuture<'a, Option<(Lease, Job)>>;
    /// Reads how the lease stands.
    fn standing<'a>(&'a self, lease: &'a Lease) -> QueueFuture<'a, Standing>;
    /// Renews the lease.
    fn heartbeat<'a>(&'a self, lease: &'a Lease) -> QueueFuture<'a, Standing>;
    /// Writes progress and renews the lease.
    fn report<'a>(&'a self, lease: &'a Lease, report: &'a ProgressReport) -> QueueFuture<'a, Standing>;
    /// Tells that the checkpoint of earlier attempts is of no use to this one: what it held counts as progress no more.
    fn begun_anew<'a>(&'a self, lease: &'a Lease) -> QueueFuture<'a, Standing>;
    /// Tells that a checkpoint was written which holds so much of the whole job, 0 to 1.
    fn saved<'a>(&'a self, lease: &'a Lease, progress: f64) -> QueueFuture<'a, Standing>;
    /// Tells that there is a new picture of the avatar, by the name of its file, made at this point of the fit.
    fn show<'a>(&'a self, lease: &'a Lease, preview: &'a str, at: &'a ProgressReport) -> QueueFuture<'a, Standing>;
    fn add_stage_time<'a>(&'a self, lease: &'a Lease, stage: &'a str, secs: f64) -> QueueFuture<'a, Standing>;
    /// running, canceling → succeeded; the avatar appears in the same transaction. A wish to cancel that came after the
    /// last iteration comes too late.
    fn succeed<'a>(&'a self, lease: &'a Lease, avatar: NewAvatar) -> QueueFuture<'a, Standing>;
    /// The attempt ended badly: canceling → canceled; else failed, or queued again after a wait where `repeat` allows
    /// it and attempts are left.
    fn fail<'a>(&'a self, lease: &'a Lease, error: JobError, repeat: Repeat) -> QueueFuture<'a, Standing>;
    /// running → queued at once, the attempt not counted: the worker shuts down. canceling → canceled.
    fn give_back<'a>(&'a self, lease: &'a Lease) -> QueueFuture<'a, Standing>;
    /// canceling → canceled: the fit has stopped.
    fn confirm_cancel<'a>(&'a self, lease: &'a Lease) -> QueueFuture<'a, Standing>;

    // The reaper's side.

    /// Takes back leases that ran out, fails jobs that passed their deadline, expires what retention has ended, deletes
    /// what was wished away.
    fn reap(&self) -> QueueFuture<'_, Reaped>;
    /// Who holds leases.
    fn owners(&self) -> QueueFuture<'_, Vec<String>>;
    /// Takes back all leases of a worker that is known to be dead.
    fn release_owner<'a>(&'a self, owner: &'a str) -> QueueFuture<'a, Vec<Uuid>>;
}
