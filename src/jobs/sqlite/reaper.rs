//! The reaper's side.

use uuid::Uuid;

use super::super::{Job, JobError, QueueError, Reaped, Repeat};
use super::rows::{self, add_state_event, select_jobs};
use super::{SqliteQueue, Tx};

/// Asked in every round.
pub(super) const OWNERS: &str = "SELECT DISTINCT owner FROM jobs WHERE owner IS NOT NULL";

impl SqliteQueue {
    /// Has the policy's retention apply to jobs that ended under another one, or none: how many. What has expired stays so.
    pub async fn apply_retention(&self) -> Result<u64, QueueError> {
        let mut tx = self.write().await?;
        // Without a retention the sum is NULL, and so becomes the end.
        let changed = sqlx::query(
            "UPDATE jobs SET expires_at = finished_at + leapt_ms + ?1, updated_at = ?2, version = version + 1 \
             WHERE finished_at IS NOT NULL AND state != 'expired' AND expires_at IS NOT finished_at + leapt_ms + ?1",
        )
        .bind(self.policy.retention.map(|keep| keep.as_millis() as i64))
        .bind(self.env.now().0)
        .execute(&mut *tx)
        .await?
        .rows_affected();
        tx.commit().await?;
        Ok(changed)
    }

    pub(super) async fn reap(&self) -> Result<Reaped, QueueError> {
        self.settle().await?;
        let now = self.env.now().0;
        let remember = self.policy.remember.as_millis() as i64;
        // Most looks find nothing: they must not take the writer's lock.
        let work: bool = sqlx::query_scalar(
            "SELECT EXISTS (SELECT 1 FROM jobs WHERE lease_until <= ?1) \
             OR EXISTS (SELECT 1 FROM jobs WHERE deadline_at <= ?1 AND finished_at IS NULL AND state != 'canceling') \
             OR EXISTS (SELECT 1 FROM jobs WHERE expires_at <= ?1 AND state != 'expired') \
             OR EXISTS (SELECT 1 FROM jobs WHERE delete_requested_at IS NOT NULL AND owner IS NULL) \
             OR EXISTS (SELECT 1 FROM idempotency_keys WHERE created_at <= ?2)",
        )
        .bind(now)
        .bind(now - remember)
        .fetch_one(&self.readers)
        .await?;
        if !work {
            return Ok(Reaped::default());
        }
        let mut tx = self.write().await?;
        // Anew: a clock that was set back meanwhile has moved all times, and by the old one they would all have come.
        let now = self.env.now().0;
        let late = self.fail_late(&mut tx, now).await?;
        let silent = sqlx::query(select_jobs!("WHERE j.lease_until <= ?")).bind(now).fetch_all(&mut *tx).await?;
        let silent = silent.iter().map(rows::job).collect::<Result<Vec<Job>, _>>()?;
        let reclaimed = self.take_back(&mut tx, &silent, "its worker was silent for longer than the lease").await?;
        let expired = self.expire(&mut tx, now).await?;
        sqlx::query("DELETE FROM idempotency_keys WHERE created_at <= ?")
            .bind(now - remember)
            .execute(&mut *tx)
            .await?;
        let deleted: Vec<String> =
            sqlx::query_scalar("DELETE FROM jobs WHERE delete_requested_at IS NOT NULL AND owner IS NULL RETURNING id")
                .fetch_all(&mut *tx)
                .await?;
        tx.commit().await?;
        let deleted = deleted.iter().filter_map(|id| id.parse().ok()).collect();
        Ok(Reaped { reclaimed, late, expired, deleted })
    }

    pub(super) async fn owners(&self) -> Result<Vec<String>, QueueError> {
        Ok(sqlx::query_scalar(OWNERS).fetch_all(&self.readers).await?)
    }

    pub(super) async fn release_owner(&self, owner: &str) -> Result<Vec<Uuid>, QueueError> {
        let mut tx = self.write().await?;
        let held = sqlx::query(select_jobs!("WHERE j.owner = ?")).bind(owner).fetch_all(&mut *tx).await?;
        let held = held.iter().map(rows::job).collect::<Result<Vec<Job>, _>>()?;
        let released = self.take_back(&mut tx, &held, "its worker died").await?;
        tx.commit().await?;
        Ok(released)
    }

    async fn take_back(&self, tx: &mut Tx, jobs: &[Job], why: &str) -> Result<Vec<Uuid>, QueueError> {
        for job in jobs {
            let detail = format!("attempt {} ended: {why}", job.attempt);
            self.end_attempt(tx, job, &JobError::new("lease-lost", detail), Repeat::Killed).await?;
        }
        Ok(jobs.iter().map(|job| job.id).collect())
    }

    /// A worker that has such a job finds its lease gone and stops.
    async fn fail_late(&self, tx: &mut Tx, now: i64) -> Result<Vec<Uuid>, QueueError> {
        let late =
            sqlx::query(select_jobs!("WHERE j.deadline_at <= ? AND j.finished_at IS NULL AND j.state != 'canceling'"))
                .bind(now)
                .fetch_all(&mut **tx)
                .await?;
        let late = late.iter().map(rows::job).collect::<Result<Vec<Job>, _>>()?;
        for job in &late {
            let secs = job.options.deadline_secs.unwrap_or_default();
            let detail = format!("the job was {} when its deadline of {secs} s passed", job.state.name());
            self.end_attempt(tx, job, &JobError::new("deadline", detail), Repeat::Never).await?;
        }
        Ok(late.iter().map(|job| job.id).collect())
    }

    /// The files go; the row stays and tells what the job was.
    async fn expire(&self, tx: &mut Tx, now: i64) -> Result<Vec<Uuid>, QueueError> {
        let due = sqlx::query(select_jobs!("WHERE j.expires_at <= ? AND j.state != 'expired'"))
            .bind(now)
            .fetch_all(&mut **tx)
            .await?;
        let due = due.iter().map(rows::job).collect::<Result<Vec<Job>, _>>()?;
        for job in &due {
            sqlx::query("DELETE FROM avatars WHERE id = ?").bind(job.id.to_string()).execute(&mut **tx).await?;
            sqlx::query(
                "UPDATE jobs SET state = 'expired', preview = NULL, updated_at = ?, version = version + 1 WHERE id = ?",
            )
            .bind(now)
            .bind(job.id.to_string())
            .execute(&mut **tx)
            .await?;
            let job = rows::read(tx, job.id).await?.ok_or(sqlx::Error::RowNotFound)?;
            // How its fit went on is told with the avatar; what stays is which states the job was in.
            sqlx::query("DELETE FROM events WHERE job_id = ? AND kind != 'state'")
                .bind(job.id.to_string())
                .execute(&mut **tx)
                .await?;
            add_state_event(tx, &job).await?;
        }
        Ok(due.iter().map(|job| job.id).collect())
    }
}
