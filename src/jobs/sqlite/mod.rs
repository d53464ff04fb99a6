//! The queue on SQLite.
//!
//! WAL with `synchronous=FULL`: what was acknowledged survives a power cut. One connection writes, each transaction a
//! `BEGIN IMMEDIATE`, so that writers queue up here and between processes wait at most `busy_timeout`; readers have a
//! pool of their own and never wait for a writer.

mod api;
pub mod backup;
mod clock;
mod keys;
mod reaper;
mod rows;
#[cfg(test)]
mod state_machine;
#[cfg(test)]
mod tests;
mod webhooks;
mod worker;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Mutex;
use std::time::Duration;

use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePoolOptions, SqliteSynchronous};
use sqlx::{Sqlite, SqlitePool, Transaction};
use uuid::Uuid;

use super::queue::QueueFuture;
use super::{
    Avatar, Change, Deletion, Env, Event, Figures, Insertion, Job, JobError, Lease, ListFilter, NewAvatar, NewJob,
    Policy, ProgressReport, Queue, QueueError, Reaped, Remembered, Repeat, StageTime, Standing, State,
};

/// How long a writer waits for another process's transaction.
const BUSY_TIMEOUT: Duration = Duration::from_secs(15);
const READERS: u32 = 4;

/// [`Queue`] in one SQLite file.
pub struct SqliteQueue {
    writer: SqlitePool,
    readers: SqlitePool,
    env: Env,
    policy: Policy,
    /// How the wall clock stood when it was last looked at.
    clock: Mutex<Option<clock::Known>>,
}

type Tx = Transaction<'static, Sqlite>;

impl SqliteQueue {
    /// Opens or makes the database and brings its schema to this version.
    pub async fn open(path: &Path, env: Env, policy: Policy) -> Result<Self, QueueError> {
        let options = SqliteConnectOptions::new()
            .filename(path)
            .create_if_missing(true)
            .journal_mode(SqliteJournalMode::Wal)
            .synchronous(SqliteSynchronous::Full)
            .foreign_keys(true)
            .busy_timeout(BUSY_TIMEOUT);
        let writer = SqlitePoolOptions::new().max_connections(1).connect_with(options.clone()).await?;
        sqlx::migrate!("./migrations").run(&writer).await?;
        // What this user may only read, SQLite opens all the same.
        writer.begin_with("BEGIN IMMEDIATE").await?.rollback().await?;
        let readers = SqlitePoolOptions::new().max_connections(READERS).connect_with(options.read_only(true)).await?;
        Ok(SqliteQueue { writer, readers, env, policy, clock: Mutex::default() })
    }

    /// Closes the connections, after which the file may be moved.
    pub async fn close(&self) {
        self.readers.close().await;
        self.writer.close().await;
    }

    /// A transaction that writes. Times in it are taken after this call.
    async fn write(&self) -> Result<Tx, QueueError> {
        self.settle().await?;
        self.begin().await
    }

    async fn begin(&self) -> Result<Tx, QueueError> {
        match self.writer.begin_with("BEGIN IMMEDIATE").await {
            // A full disk makes SQLite itself roll back, which sqlx does not learn: to it the connection is in that
            // transaction for ever. A new connection knows better.
            Err(sqlx::Error::InvalidSavePointStatement) => {
                self.writer.acquire().await?.close().await?;
                Ok(self.writer.begin_with("BEGIN IMMEDIATE").await?)
            }
            begun => Ok(begun?),
        }
    }
}

// Methods of one's own go before those of a trait: each of these calls the one of its name.
impl Queue for SqliteQueue {
    fn insert(&self, job: NewJob) -> QueueFuture<'_, Insertion> {
        Box::pin(self.insert(job))
    }

    fn is_full(&self) -> QueueFuture<'_, bool> {
        Box::pin(self.is_full())
    }

    fn remembered<'a>(&'a self, key: &'a str) -> QueueFuture<'a, Option<Remembered>> {
        Box::pin(self.remembered(key))
    }

    fn get(&self, id: Uuid) -> QueueFuture<'_, Option<Job>> {
        Box::pin(self.get(id))
    }

    fn list(&self, filter: ListFilter) -> QueueFuture<'_, Vec<Job>> {
        Box::pin(self.list(filter))
    }

    fn cancel(&self, id: Uuid) -> QueueFuture<'_, Change> {
        Box::pin(self.cancel(id))
    }

    fn retry(&self, id: Uuid) -> QueueFuture<'_, Change> {
        Box::pin(self.retry(id))
    }

    fn delete(&self, id: Uuid) -> QueueFuture<'_, Deletion> {
        Box::pin(self.delete(id))
    }

    fn events(&self, job: Uuid, after: i64, limit: u32) -> QueueFuture<'_, Vec<Event>> {
        Box::pin(self.events(job, after, limit))
    }

    fn last_event(&self) -> QueueFuture<'_, i64> {
        Box::pin(self.last_event())
    }

    fn avatar(&self, id: Uuid) -> QueueFuture<'_, Option<Avatar>> {
        Box::pin(self.avatar(id))
    }

    fn counts(&self) -> QueueFuture<'_, BTreeMap<State, u64>> {
        Box::pin(self.counts())
    }

    fn stage_times(&self) -> QueueFuture<'_, Vec<StageTime>> {
        Box::pin(self.stage_times())
    }

    fn figures(&self) -> QueueFuture<'_, Figures> {
        Box::pin(self.figures())
    }

    fn claim<'a>(&'a self, owner: &'a str) -> QueueFuture<'a, Option<(Lease, Job)>> {
        Box::pin(self.claim(owner))
    }

    fn standing<'a>(&'a self, lease: &'a Lease) -> QueueFuture<'a, Standing> {
        Box::pin(self.standing(lease))
    }

    fn heartbeat<'a>(&'a self, lease: &'a Lease) -> QueueFuture<'a, Standing> {
        Box::pin(self.heartbeat(lease))
    }

    fn report<'a>(&'a self, lease: &'a Lease, report: &'a ProgressReport) -> QueueFuture<'a, Standing> {
        Box::pin(self.report(lease, report))
    }

    fn begun_anew<'a>(&'a self, lease: &'a Lease) -> QueueFuture<'a, Standing> {
        Box::pin(self.begun_anew(lease))
    }

    fn saved<'a>(&'a self, lease: &'a Lease, progress: f64) -> QueueFuture<'a, Standing> {
        Box::pin(self.saved(lease, progress))
    }

    fn show<'a>(&'a self, lease: &'a Lease, preview: &'a str, at: &'a ProgressReport) -> QueueFuture<'a, Standing> {
        Box::pin(self.show(lease, preview, at))
    }

    fn add_stage_time<'a>(&'a self, lease: &'a Lease, stage: &'a str, secs: f64) -> QueueFuture<'a, Standing> {
        Box::pin(self.add_stage_time(lease, stage, secs))
    }

    fn succeed<'a>(&'a self, lease: &'a Lease, avatar: NewAvatar) -> QueueFuture<'a, Standing> {
        Box::pin(self.succeed(lease, avatar))
    }

    fn fail<'a>(&'a self, lease: &'a Lease, error: JobError, repeat: Repeat) -> QueueFuture<'a, Standing> {
        Box::pin(self.fail(lease, error, repeat))
    }

    fn give_back<'a>(&'a self, lease: &'a Lease) -> QueueFuture<'a, Standing> {
        Box::pin(self.give_back(lease))
    }

    fn confirm_cancel<'a>(&'a self, lease: &'a Lease) -> QueueFuture<'a, Standing> {
        Box::pin(self.confirm_cancel(lease))
    }

    fn reap(&self) -> QueueFuture<'_, Reaped> {
        Box::pin(self.reap())
    }

    fn owners(&self) -> QueueFuture<'_, Vec<String>> {
        Box::pin(self.owners())
    }

    fn release_owner<'a>(&'a self, owner: &'a str) -> QueueFuture<'a, Vec<Uuid>> {
        Box::pin(self.release_owner(owner))
    }
}
