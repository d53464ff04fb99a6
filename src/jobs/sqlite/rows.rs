//! Between rows and the domain's types, and the few statements that all sides share.

use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};
use uuid::Uuid;

use super::super::{AvatarFile, Event, EventKind, Job, QueueError, Remembered, State, Timestamp};

/// `select_jobs!("WHERE …")`: all columns of jobs `j` and the place in the queue.
macro_rules! select_jobs {
    ($rest:literal) => {
        concat!(
            "SELECT j.*, CASE WHEN j.state = 'queued' THEN (SELECT count(*) FROM jobs q WHERE q.state = 'queued' \
             AND (q.priority > j.priority OR (q.priority = j.priority AND q.id <= j.id))) END AS queue_position \
             FROM jobs j ",
            $rest
        )
    };
}
pub(super) use select_jobs;

pub(super) fn job(row: &SqliteRow) -> Result<Job, QueueError> {
    Ok(Job {
        id: id(row, "id")?,
        state: state(row)?,
        options: json_column(row, "options")?,
        inputs: json_column(row, "inputs")?,
        clip: json_column(row, "clip")?,
        priority: row.try_get("priority")?,
        attempt: row.try_get("attempt")?,
        max_attempts: row.try_get("max_attempts")?,
        excused: row.try_get("excused")?,
        saved: row.try_get("saved")?,
        saved_at_claim: row.try_get("saved_at_claim")?,
        epoch: row.try_get("epoch")?,
        owner: row.try_get("owner")?,
        stage: row.try_get("stage")?,
        step: row.try_get("step")?,
        steps: row.try_get("steps")?,
        progress: row.try_get("progress")?,
        eta_secs: row.try_get("eta_secs")?,
        losses: json_column(row, "losses")?,
        created_at: Timestamp(row.try_get("created_at")?),
        run_at: Timestamp(row.try_get("run_at")?),
        started_at: time(row, "started_at")?,
        cancel_requested_at: time(row, "cancel_requested_at")?,
        delete_requested_at: time(row, "delete_requested_at")?,
        finished_at: time(row, "finished_at")?,
        expires_at: time(row, "expires_at")?,
        deadline_at: time(row, "deadline_at")?,
        updated_at: Timestamp(row.try_get("updated_at")?),
        version: row.try_get("version")?,
        error: row.try_get::<Option<String>, _>("error")?.map(|text| parse("error", &text)).transpose()?,
        preview: row.try_get("preview")?,
        queue_position: row.try_get::<Option<i64>, _>("queue_position")?.map(|n| n as u64),
    })
}

pub(super) fn event(row: &SqliteRow) -> Result<Event, QueueError> {
    Ok(Event {
        id: row.try_get("id")?,
        at: Timestamp(row.try_get("at")?),
        kind: named(row, "kind", |name| EventKind::ALL.into_iter().find(|k| k.name() == name))?,
        data: json_column(row, "data")?,
    })
}

pub(super) fn id(row: &SqliteRow, column: &'static str) -> Result<Uuid, QueueError> {
    named(row, column, |text| text.parse().ok())
}

pub(super) fn state(row: &SqliteRow) -> Result<State, QueueError> {
    named(row, "state", State::from_name)
}

/// The files of an avatar, sorted by name.
pub(super) async fn avatar_files(
    connection: &mut SqliteConnection,
    avatar: Uuid,
) -> Result<Vec<AvatarFile>, QueueError> {
    let files = sqlx::query("SELECT name, bytes, sha256 FROM avatar_files WHERE avatar_id = ? ORDER BY name")
        .bind(avatar.to_string())
        .fetch_all(connection)
        .await?;
    let files = files.iter().map(|file| {
        let bytes: i64 = file.try_get("bytes")?;
        Ok(AvatarFile { name: file.try_get("name")?, bytes: bytes as u64, sha256: file.try_get("sha256")? })
    });
    files.collect()
}

pub(super) fn optional_id(row: &SqliteRow, column: &'static str) -> Result<Option<Uuid>, QueueError> {
    let text: Option<&str> = row.try_get(column)?;
    text.map(|text| text.parse().map_err(|_| QueueError::Corrupt { column, reason: format!("{text:?}") })).transpose()
}

pub(super) fn time(row: &SqliteRow, column: &'static str) -> Result<Option<Timestamp>, QueueError> {
    Ok(row.try_get::<Option<i64>, _>(column)?.map(Timestamp))
}

pub(super) fn json_column<T: DeserializeOwned>(row: &SqliteRow, column: &'static str) -> Result<T, QueueError> {
    parse(column, row.try_get::<&str, _>(column)?)
}

fn parse<T: DeserializeOwned>(column: &'static str, text: &str) -> Result<T, QueueError> {
    serde_json::from_str(text).map_err(|e| QueueError::Corrupt { column, reason: e.to_string() })
}

fn named<T>(row: &SqliteRow, column: &'static str, read: impl Fn(&str) -> Option<T>) -> Result<T, QueueError> {
    let text: &str = row.try_get(column)?;
    read(text).ok_or_else(|| QueueError::Corrupt { column, reason: format!("{text:?}") })
}

/// JSON text of a value of ours: maps have string keys and numbers are finite, so this cannot fail.
pub(super) fn to_json(value: &impl serde::Serialize) -> String {
    serde_json::to_string(value).expect("the domain's types are JSON")
}

pub(super) async fn read(connection: &mut SqliteConnection, job_id: Uuid) -> Result<Option<Job>, QueueError> {
    let row = sqlx::query(select_jobs!("WHERE j.id = ?")).bind(job_id.to_string()).fetch_optional(connection).await?;
    row.as_ref().map(job).transpose()
}

/// The key that a job belongs to, if it belongs to one; `None` where there is no such job.
pub(super) async fn owner(connection: &mut SqliteConnection, job_id: Uuid) -> Result<Option<Option<Uuid>>, QueueError> {
    let row =
        sqlx::query("SELECT key_id FROM jobs WHERE id = ?").bind(job_id.to_string()).fetch_optional(connection).await?;
    row.map(|row| optional_id(&row, "key_id")).transpose()
}

pub(super) async fn remembered(connection: &mut SqliteConnection, key: &str) -> Result<Option<Remembered>, QueueError> {
    let row = sqlx::query("SELECT fingerprint, answer FROM idempotency_keys WHERE key = ?")
        .bind(key)
        .fetch_optional(connection)
        .await?;
    row.map(|row| Ok(Remembered { fingerprint: row.try_get("fingerprint")?, answer: row.try_get("answer")? }))
        .transpose()
}

pub(super) async fn add_event(
    connection: &mut SqliteConnection,
    job_id: Uuid,
    at: Timestamp,
    kind: EventKind,
    data: Value,
) -> Result<(), QueueError> {
    sqlx::query("INSERT INTO events (job_id, at, kind, data) VALUES (?, ?, ?, ?)")
        .bind(job_id.to_string())
        .bind(at.0)
        .bind(kind.name())
        .bind(data.to_string())
        .execute(connection)
        .await?;
    Ok(())
}

/// Tells the readers of the event stream, and whom webhooks name, how the job now stands. Part of every transaction that changes a state.
pub(super) async fn add_state_event(connection: &mut SqliteConnection, job: &Job) -> Result<(), QueueError> {
    let data = json!({ "state": job.state, "attempt": job.attempt, "error": job.error });
    add_event(connection, job.id, job.updated_at, EventKind::State, data).await?;
    super::webhooks::tell(connection, job).await
}
