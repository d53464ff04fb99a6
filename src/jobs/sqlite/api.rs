//! The API's side: users' wishes and reads.

use std::collections::BTreeMap;
use std::time::Duration;

use sqlx::{QueryBuilder, Row, Sqlite, SqliteConnection};
use uuid::Uuid;

use super::super::{
    Avatar, Change, Deletion, Event, Figures, Insertion, Job, ListFilter, NewJob, QueueError, Remember, Remembered,
    StageTime, State, Timestamp,
};
use super::SqliteQueue;
use super::rows::{self, add_state_event, select_jobs, to_json};
use super::webhooks;

/// A page of the list. Conditions that are not asked for are left out, not made true: no index serves `? IS NULL OR …`.
pub(super) fn list(filter: &ListFilter) -> QueryBuilder<Sqlite> {
    let mut query = QueryBuilder::new(select_jobs!("WHERE TRUE"));
    if let Some(state) = filter.state {
        query.push(" AND j.state = ").push_bind(state.name());
    }
    if let Some(before) = filter.before {
        query.push(" AND j.id < ").push_bind(before.to_string());
    }
    if let Some(from) = filter.created_from {
        query.push(" AND j.created_at >= ").push_bind(from.0);
    }
    if let Some(before) = filter.created_before {
        query.push(" AND j.created_at < ").push_bind(before.0);
    }
    if let Some(key) = filter.key {
        query.push(" AND j.key_id = ").push_bind(key.to_string());
    }
    query.push(" ORDER BY j.id DESC LIMIT ").push_bind(filter.limit);
    query
}

/// Fits whose device memory still counts for the figures.
const RECENT: Duration = Duration::from_secs(86_400);

impl SqliteQueue {
    pub(super) async fn insert(&self, new: NewJob) -> Result<Insertion, QueueError> {
        let mut tx = self.write().await?;
        let now = self.env.now();
        if let Some(remember) = &new.remember
            && let Some(known) = rows::remembered(&mut tx, &remember.key).await?
        {
            return Ok(Insertion::Known(known));
        }
        if self.is_full_in(&mut tx).await? {
            return Ok(Insertion::Full);
        }
        if let Some(key) = new.key {
            self.check_quota(&mut tx, key, new.inputs.values().map(|part| part.bytes).sum()).await?;
        }
        sqlx::query(
            "INSERT INTO jobs (id, state, options, inputs, clip, priority, created_at, run_at, updated_at, max_attempts, \
             deadline_at, key_id) VALUES (?1, 'queued', ?2, ?3, ?4, ?5, ?6, ?6, ?6, ?7, ?8, ?9)",
        )
        .bind(new.id.to_string())
        .bind(to_json(&new.options))
        .bind(to_json(&new.inputs))
        .bind(to_json(&new.clip))
        .bind(new.options.priority)
        .bind(now.0)
        .bind(self.policy.max_attempts)
        .bind(new.options.deadline_secs.map(|secs| now.plus(Duration::from_secs(secs)).0))
        .bind(new.key.map(|key| key.to_string()))
        .execute(&mut *tx)
        .await?;
        let job = rows::read(&mut tx, new.id).await?.ok_or(sqlx::Error::RowNotFound)?;
        add_state_event(&mut tx, &job).await?;
        if let Some(Remember { key, fingerprint, answer }) = new.remember {
            sqlx::query("INSERT INTO idempotency_keys (key, fingerprint, answer, created_at) VALUES (?, ?, ?, ?)")
                .bind(key)
                .bind(fingerprint)
                .bind(answer(&job))
                .bind(now.0)
                .execute(&mut *tx)
                .await?;
        }
        tx.commit().await?;
        Ok(Insertion::Queued(Box::new(job)))
    }

    pub(super) async fn is_full(&self) -> Result<bool, QueueError> {
        self.is_full_in(&mut *self.readers.acquire().await?).await
    }

    async fn is_full_in(&self, connection: &mut SqliteConnection) -> Result<bool, QueueError> {
        let queued: i64 =
            sqlx::query_scalar("SELECT count(*) FROM jobs WHERE state = 'queued'").fetch_one(connection).await?;
        Ok(queued as u64 >= self.policy.max_queued)
    }

    pub(super) async fn remembered(&self, key: &str) -> Result<Option<Remembered>, QueueError> {
        rows::remembered(&mut *self.readers.acquire().await?, key).await
    }

    pub(super) async fn get(&self, id: Uuid) -> Result<Option<Job>, QueueError> {
        rows::read(&mut *self.readers.acquire().await?, id).await
    }

    pub(super) async fn list(&self, filter: ListFilter) -> Result<Vec<Job>, QueueError> {
        let found = list(&filter).build().fetch_all(&self.readers).await?;
        found.iter().map(rows::job).collect()
    }

    pub(super) async fn cancel(&self, id: Uuid) -> Result<Change, QueueError> {
        let mut tx = self.write().await?;
        let now = self.env.now();
        let changed = sqlx::query(
            "UPDATE jobs SET state = CASE state WHEN 'queued' THEN 'canceled' ELSE 'canceling' END, \
             finished_at = CASE state WHEN 'queued' THEN ?1 END, \
             expires_at = CASE state WHEN 'queued' THEN ?2 END, \
             cancel_requested_at = ?1, updated_at = ?1, version = version + 1 \
             WHERE id = ?3 AND state IN ('queued', 'running')",
        )
        .bind(now.0)
        .bind(self.expiry(now))
        .bind(id.to_string())
        .execute(&mut *tx)
        .await?
        .rows_affected();
        let Some(job) = rows::read(&mut tx, id).await? else { return Ok(Change::Unknown) };
        if changed > 0 {
            add_state_event(&mut tx, &job).await?;
        }
        tx.commit().await?;
        Ok(match job.state {
            State::Canceling | State::Canceled => Change::Done(job),
            _ => Change::Refused(job),
        })
    }

    pub(super) async fn retry(&self, id: Uuid) -> Result<Change, QueueError> {
        let mut tx = self.write().await?;
        let now = self.env.now();
        let is_full = self.is_full_in(&mut tx).await?;
        let within_quota = match rows::owner(&mut tx, id).await? {
            Some(Some(key)) => self.check_quota(&mut tx, key, 0).await,
            _ => Ok(()),
        };
        let changed = sqlx::query(
            "UPDATE jobs SET state = 'queued', attempt = 0, excused = 0, saved = 0, run_at = ?1, error = NULL, finished_at = NULL, leapt_ms = 0, \
             deadline_at = ?1 + 1000 * json_extract(options, '$.deadline_secs'), expires_at = NULL, cancel_requested_at = NULL, updated_at = ?1, version = version + 1 \
             WHERE id = ?2 AND state IN ('failed', 'canceled') AND delete_requested_at IS NULL",
        )
        .bind(now.0)
        .bind(id.to_string())
        .execute(&mut *tx)
        .await?
        .rows_affected();
        let Some(job) = rows::read(&mut tx, id).await? else { return Ok(Change::Unknown) };
        if changed == 0 {
            return Ok(Change::Refused(job));
        }
        within_quota?;
        if is_full {
            return Ok(Change::Full);
        }
        add_state_event(&mut tx, &job).await?;
        tx.commit().await?;
        Ok(Change::Done(job))
    }

    pub(super) async fn delete(&self, id: Uuid) -> Result<Deletion, QueueError> {
        let mut tx = self.write().await?;
        let now = self.env.now();
        let Some(job) = rows::read(&mut tx, id).await? else { return Ok(Deletion::Unknown) };
        if !matches!(job.state, State::Running | State::Canceling) {
            // Whoever heard of it waiting hears that it will not run.
            if job.state == State::Queued {
                webhooks::tell(&mut tx, &Job { state: State::Canceled, updated_at: now, ..job }).await?;
            }
            sqlx::query("DELETE FROM jobs WHERE id = ?").bind(id.to_string()).execute(&mut *tx).await?;
            tx.commit().await?;
            return Ok(Deletion::Gone);
        }
        sqlx::query(
            "UPDATE jobs SET state = 'canceling', cancel_requested_at = COALESCE(cancel_requested_at, ?1), \
             delete_requested_at = COALESCE(delete_requested_at, ?1), updated_at = ?1, version = version + 1 \
             WHERE id = ?2",
        )
        .bind(now.0)
        .bind(id.to_string())
        .execute(&mut *tx)
        .await?;
        let Some(job) = rows::read(&mut tx, id).await? else { return Ok(Deletion::Unknown) };
        add_state_event(&mut tx, &job).await?;
        tx.commit().await?;
        Ok(Deletion::Pending)
    }

    pub(super) async fn events(&self, job: Uuid, after: i64, limit: u32) -> Result<Vec<Event>, QueueError> {
        let found = sqlx::query("SELECT * FROM events WHERE job_id = ? AND id > ? ORDER BY id LIMIT ?")
            .bind(job.to_string())
            .bind(after)
            .bind(limit)
            .fetch_all(&self.readers)
            .await?;
        found.iter().map(rows::event).collect()
    }

    pub(super) async fn last_event(&self) -> Result<i64, QueueError> {
        Ok(sqlx::query_scalar("SELECT COALESCE(max(id), 0) FROM events").fetch_one(&self.readers).await?)
    }

    pub(super) async fn avatar(&self, id: Uuid) -> Result<Option<Avatar>, QueueError> {
        // One transaction, so that the files belong to the row.
        let mut tx = self.readers.begin().await?;
        let sql = "SELECT a.*, j.clip, j.expires_at FROM avatars a JOIN jobs j ON j.id = a.id WHERE a.id = ?";
        let Some(row) = sqlx::query(sql).bind(id.to_string()).fetch_optional(&mut *tx).await? else {
            return Ok(None);
        };
        let files = rows::avatar_files(&mut tx, id).await?;
        Ok(Some(Avatar {
            id,
            epoch: row.try_get("epoch")?,
            clip: rows::json_column(&row, "clip")?,
            body: row.try_get("body")?,
            frames: row.try_get("frames")?,
            camera: rows::json_column(&row, "camera")?,
            metrics: rows::json_column(&row, "metrics")?,
            created_at: Timestamp(row.try_get("created_at")?),
            expires_at: rows::time(&row, "expires_at")?,
            files,
        }))
    }

    pub(super) async fn counts(&self) -> Result<BTreeMap<State, u64>, QueueError> {
        let mut counts: BTreeMap<State, u64> = State::ALL.into_iter().map(|state| (state, 0)).collect();
        let found =
            sqlx::query("SELECT state, count(*) AS n FROM jobs GROUP BY state").fetch_all(&self.readers).await?;
        for row in found {
            if let Some(state) = State::from_name(row.try_get("state")?) {
                counts.insert(state, row.try_get::<i64, _>("n")? as u64);
            }
        }
        Ok(counts)
    }

    pub(super) async fn stage_times(&self) -> Result<Vec<StageTime>, QueueError> {
        let found = sqlx::query(
            "SELECT stage, count(*) AS jobs, sum(secs) AS secs FROM stage_times GROUP BY stage ORDER BY stage",
        )
        .fetch_all(&self.readers)
        .await?;
        let times = found.iter().map(|row| {
            Ok(StageTime {
                stage: row.try_get("stage")?,
                jobs: row.try_get::<i64, _>("jobs")? as u64,
                secs: row.try_get("secs")?,
            })
        });
        times.collect()
    }

    pub(super) async fn figures(&self) -> Result<Figures, QueueError> {
        // One transaction, so that the figures belong together.
        let mut tx = self.readers.begin().await?;
        let failed = sqlx::query(
            "SELECT COALESCE(error ->> '$.type', 'unknown') AS kind, count(*) AS n FROM jobs WHERE state = 'failed' \
             GROUP BY kind ORDER BY kind",
        )
        .fetch_all(&mut *tx)
        .await?;
        let failed = failed.iter().map(|row| Ok((row.try_get("kind")?, row.try_get::<i64, _>("n")? as u64)));
        let (started, waited_ms): (i64, i64) = sqlx::query_as(
            "SELECT count(*), COALESCE(sum(started_at - created_at), 0) FROM jobs WHERE started_at IS NOT NULL",
        )
        .fetch_one(&mut *tx)
        .await?;
        let oldest: Option<i64> =
            sqlx::query_scalar("SELECT min(run_at) FROM jobs WHERE state = 'queued'").fetch_one(&mut *tx).await?;
        let device_peak: Option<i64> = sqlx::query_scalar(
            "SELECT max(json_extract(metrics, '$.peak_device_bytes')) FROM avatars WHERE created_at >= ?",
        )
        .bind(self.env.now().0 - RECENT.as_millis() as i64)
        .fetch_one(&mut *tx)
        .await?;
        let deliveries: i64 =
            sqlx::query_scalar("SELECT count(*) FROM deliveries WHERE next_at IS NOT NULL").fetch_one(&mut *tx).await?;
        Ok(Figures {
            failed: failed.collect::<Result<_, sqlx::Error>>()?,
            started: started as u64,
            waited_secs: waited_ms as f64 / 1000.0,
            oldest_secs: oldest.map_or(0.0, |at| (self.env.now().0 - at).max(0) as f64 / 1000.0),
            device_peak_bytes: device_peak.map(|bytes| bytes as u64),
            deliveries: deliveries as u64,
        })
    }

    /// When a job that ends now is to be removed.
    pub(super) fn expiry(&self, now: Timestamp) -> Option<i64> {
        self.policy.retention.map(|keep| now.plus(keep).0)
    }
}
