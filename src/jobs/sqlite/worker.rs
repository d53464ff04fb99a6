//! A worker's side: every statement after the claim says `WHERE id = ? AND epoch = ?`.

use serde_json::json;
use sqlx::sqlite::SqliteArguments;
use sqlx::{Row, Sqlite};

use super::super::{EventKind, Job, JobError, Lease, NewAvatar, ProgressReport, QueueError, Repeat, Standing, State};
use super::rows::{self, add_event, add_state_event, to_json};
use super::{SqliteQueue, Tx};

/// `claimable!("?n")`: the jobs that may be claimed at the time ?n. Those of a key that has as many with workers as it
/// may are passed over.
macro_rules! claimable {
    ($now:literal) => {
        concat!(
            "FROM jobs j WHERE state = 'queued' AND run_at <= ",
            $now,
            " AND (deadline_at IS NULL OR deadline_at > ",
            $now,
            ") AND (key_id IS NULL OR NOT EXISTS (SELECT 1 FROM api_keys k WHERE k.id = j.key_id AND k.max_running <= \
             (SELECT count(*) FROM jobs r WHERE r.key_id = k.id AND r.owner IS NOT NULL)))"
        )
    };
}

pub(super) const WAITING: &str = concat!("SELECT EXISTS (SELECT 1 ", claimable!("?1"), ")");
pub(super) const CLAIM: &str = concat!(
    "UPDATE jobs SET state = 'running', epoch = epoch + 1, attempt = attempt + 1, owner = ?1, lease_until = ?2, \
     saved_at_claim = saved, started_at = COALESCE(started_at, ?3), updated_at = ?3, version = version + 1 \
     WHERE id = (SELECT id ",
    claimable!("?3"),
    " ORDER BY priority DESC, id LIMIT 1) RETURNING id, epoch"
);

impl SqliteQueue {
    pub(super) async fn claim(&self, owner: &str) -> Result<Option<(Lease, Job)>, QueueError> {
        // An idle worker looks often: the look must not take the writer's lock.
        let waiting: bool = sqlx::query_scalar(WAITING).bind(self.env.now().0).fetch_one(&self.readers).await?;
        if !waiting {
            return Ok(None);
        }
        let mut tx = self.write().await?;
        let now = self.env.now();
        let claimed = sqlx::query(CLAIM)
            .bind(owner)
            .bind(now.plus(self.policy.lease).0)
            .bind(now.0)
            .fetch_optional(&mut *tx)
            .await?;
        let Some(claimed) = claimed else { return Ok(None) };
        let lease = Lease { job: rows::id(&claimed, "id")?, epoch: claimed.try_get("epoch")? };
        let job = rows::read(&mut tx, lease.job).await?.ok_or(sqlx::Error::RowNotFound)?;
        add_state_event(&mut tx, &job).await?;
        tx.commit().await?;
        Ok(Some((lease, job)))
    }

    pub(super) async fn standing(&self, lease: &Lease) -> Result<Standing, QueueError> {
        let state: Option<String> = sqlx::query_scalar("SELECT state FROM jobs WHERE id = ? AND epoch = ?")
            .bind(lease.job.to_string())
            .bind(lease.epoch)
            .fetch_optional(&self.readers)
            .await?;
        Ok(standing(state.as_deref()))
    }

    pub(super) async fn heartbeat(&self, lease: &Lease) -> Result<Standing, QueueError> {
        let mut tx = self.write().await?;
        let held = held(
            &mut tx,
            sqlx::query(
                "UPDATE jobs SET lease_until = ?3 WHERE id = ?1 AND epoch = ?2 AND owner IS NOT NULL RETURNING state",
            ),
            lease,
            |query| query.bind(self.env.now().plus(self.policy.lease).0),
        )
        .await?;
        tx.commit().await?;
        Ok(held)
    }

    pub(super) async fn report(&self, lease: &Lease, report: &ProgressReport) -> Result<Standing, QueueError> {
        let mut tx = self.write().await?;
        let now = self.env.now();
        let update = sqlx::query(
            "UPDATE jobs SET stage = ?3, step = ?4, steps = ?5, progress = ?6, eta_secs = ?7, losses = ?8, \
             lease_until = ?9, updated_at = ?10, version = version + 1 \
             WHERE id = ?1 AND epoch = ?2 AND owner IS NOT NULL RETURNING state",
        );
        // A loss that is no number has no JSON: it is left out, and the fit's own check ends the job.
        let losses: super::super::Losses =
            report.losses.iter().filter(|(_, v)| v.is_finite()).map(|(k, v)| (k.clone(), *v)).collect();
        let progress = if report.progress.is_finite() { report.progress.clamp(0.0, 1.0) } else { 0.0 };
        let eta_secs = report.eta_secs.filter(|secs| secs.is_finite());
        let held = held(&mut tx, update, lease, |query| {
            query
                .bind(report.stage.clone())
                .bind(report.step)
                .bind(report.steps)
                .bind(progress)
                .bind(eta_secs)
                .bind(to_json(&losses))
                .bind(now.plus(self.policy.lease).0)
                .bind(now.0)
        })
        .await?;
        if held != Standing::Lost {
            let data = json!({
                "stage": report.stage, "step": report.step, "steps": report.steps,
                "progress": progress, "eta_secs": eta_secs, "losses": losses,
            });
            add_event(&mut tx, lease.job, now, EventKind::Progress, data).await?;
        }
        tx.commit().await?;
        Ok(held)
    }

    pub(super) async fn begun_anew(&self, lease: &Lease) -> Result<Standing, QueueError> {
        let mut tx = self.write().await?;
        let update = sqlx::query(
            "UPDATE jobs SET saved = 0, saved_at_claim = 0 \
             WHERE id = ?1 AND epoch = ?2 AND owner IS NOT NULL RETURNING state",
        );
        let held = held(&mut tx, update, lease, |query| query).await?;
        tx.commit().await?;
        Ok(held)
    }

    pub(super) async fn saved(&self, lease: &Lease, progress: f64) -> Result<Standing, QueueError> {
        let mut tx = self.write().await?;
        let update = sqlx::query(
            "UPDATE jobs SET saved = max(saved, ?3) WHERE id = ?1 AND epoch = ?2 AND owner IS NOT NULL RETURNING state",
        );
        let progress = if progress.is_finite() { progress.clamp(0.0, 1.0) } else { 0.0 };
        let held = held(&mut tx, update, lease, |query| query.bind(progress)).await?;
        tx.commit().await?;
        Ok(held)
    }

    pub(super) async fn show(&self, lease: &Lease, preview: &str, at: &ProgressReport) -> Result<Standing, QueueError> {
        let mut tx = self.write().await?;
        let now = self.env.now();
        let update = sqlx::query(
            "UPDATE jobs SET preview = ?3, updated_at = ?4, version = version + 1 \
             WHERE id = ?1 AND epoch = ?2 AND owner IS NOT NULL RETURNING state",
        );
        let held = held(&mut tx, update, lease, |query| query.bind(preview.to_string()).bind(now.0)).await?;
        if held != Standing::Lost {
            let data = json!({ "stage": at.stage, "step": at.step, "steps": at.steps, "progress": at.progress });
            add_event(&mut tx, lease.job, now, EventKind::Preview, data).await?;
        }
        tx.commit().await?;
        Ok(held)
    }

    pub(super) async fn add_stage_time(&self, lease: &Lease, stage: &str, secs: f64) -> Result<Standing, QueueError> {
        let mut tx = self.write().await?;
        let held = self.current(&mut tx, lease).await?;
        if held.is_some() {
            sqlx::query(
                "INSERT INTO stage_times (job_id, stage, secs) VALUES (?, ?, ?) \
                 ON CONFLICT (job_id, stage) DO UPDATE SET secs = secs + excluded.secs",
            )
            .bind(lease.job.to_string())
            .bind(stage)
            .bind(secs.max(0.0))
            .execute(&mut *tx)
            .await?;
        }
        tx.commit().await?;
        Ok(standing(held.map(|job| job.state.name())))
    }

    pub(super) async fn succeed(&self, lease: &Lease, avatar: NewAvatar) -> Result<Standing, QueueError> {
        let mut tx = self.write().await?;
        if self.current(&mut tx, lease).await?.is_none() {
            return Ok(Standing::Lost);
        }
        let now = self.env.now();
        sqlx::query(
            "INSERT INTO avatars (id, epoch, body, frames, camera, metrics, created_at) VALUES (?, ?, ?, ?, ?, ?, ?)",
        )
        .bind(lease.job.to_string())
        .bind(lease.epoch)
        .bind(avatar.body)
        .bind(avatar.frames)
        .bind(to_json(&avatar.camera))
        .bind(avatar.metrics.to_string())
        .bind(now.0)
        .execute(&mut *tx)
        .await?;
        for file in avatar.files {
            sqlx::query("INSERT INTO avatar_files (avatar_id, name, bytes, sha256) VALUES (?, ?, ?, ?)")
                .bind(lease.job.to_string())
                .bind(file.name)
                .bind(file.bytes as i64)
                .bind(file.sha256)
                .execute(&mut *tx)
                .await?;
        }
        sqlx::query(
            "UPDATE jobs SET state = 'succeeded', owner = NULL, lease_until = NULL, finished_at = ?3, expires_at = ?4, \
             progress = 1, eta_secs = NULL, error = NULL, updated_at = ?3, version = version + 1 \
             WHERE id = ?1 AND epoch = ?2",
        )
        .bind(lease.job.to_string())
        .bind(lease.epoch)
        .bind(now.0)
        .bind(self.expiry(now))
        .execute(&mut *tx)
        .await?;
        self.tell_and_commit(tx, lease).await?;
        Ok(Standing::Held)
    }

    pub(super) async fn fail(&self, lease: &Lease, error: JobError, repeat: Repeat) -> Result<Standing, QueueError> {
        let mut tx = self.write().await?;
        let Some(job) = self.current(&mut tx, lease).await? else { return Ok(Standing::Lost) };
        self.end_attempt(&mut tx, &job, &error, repeat).await?;
        tx.commit().await?;
        Ok(Standing::Held)
    }

    pub(super) async fn give_back(&self, lease: &Lease) -> Result<Standing, QueueError> {
        let mut tx = self.write().await?;
        let Some(job) = self.current(&mut tx, lease).await? else { return Ok(Standing::Lost) };
        if job.state == State::Canceling {
            self.set_canceled(&mut tx, lease).await?;
        } else {
            sqlx::query(
                "UPDATE jobs SET state = 'queued', owner = NULL, lease_until = NULL, attempt = attempt - 1, run_at = ?3, \
                 eta_secs = NULL, updated_at = ?3, version = version + 1 WHERE id = ?1 AND epoch = ?2",
            )
            .bind(lease.job.to_string())
            .bind(lease.epoch)
            .bind(self.env.now().0)
            .execute(&mut *tx)
            .await?;
        }
        self.tell_and_commit(tx, lease).await?;
        Ok(Standing::Held)
    }

    pub(super) async fn confirm_cancel(&self, lease: &Lease) -> Result<Standing, QueueError> {
        let mut tx = self.write().await?;
        match self.current(&mut tx, lease).await? {
            Some(job) if job.state == State::Canceling => {}
            Some(_) => return Ok(Standing::Held),
            None => return Ok(Standing::Lost),
        }
        self.set_canceled(&mut tx, lease).await?;
        self.tell_and_commit(tx, lease).await?;
        Ok(Standing::Held)
    }

    /// The one way in which an attempt ends without an avatar, whether its worker says so or is found dead.
    pub(super) async fn end_attempt(
        &self,
        tx: &mut Tx,
        job: &Job,
        error: &JobError,
        repeat: Repeat,
    ) -> Result<(), QueueError> {
        let lease = Lease { job: job.id, epoch: job.epoch };
        let now = self.env.now();
        if job.state == State::Canceling {
            self.set_canceled(tx, &lease).await?;
            let job = rows::read(tx, job.id).await?.ok_or(sqlx::Error::RowNotFound)?;
            return add_state_event(tx, &job).await;
        }
        let excused = job.excused + u32::from(repeat == Repeat::Killed && job.saved > job.saved_at_claim);
        let counted = job.attempt - excused;
        if repeat != Repeat::Never && counted < job.max_attempts {
            let run_at = now.plus(self.policy.backoff_after(counted, self.env.unit()));
            sqlx::query(
                "UPDATE jobs SET state = 'queued', owner = NULL, lease_until = NULL, run_at = ?3, error = ?4, \
                 eta_secs = NULL, updated_at = ?5, excused = ?6, version = version + 1 WHERE id = ?1 AND epoch = ?2",
            )
            .bind(job.id.to_string())
            .bind(job.epoch)
            .bind(run_at.0)
            .bind(to_json(error))
            .bind(now.0)
            .bind(excused)
            .execute(&mut **tx)
            .await?;
        } else {
            sqlx::query(
                "UPDATE jobs SET state = 'failed', owner = NULL, lease_until = NULL, finished_at = ?3, expires_at = ?4, \
                 error = ?5, eta_secs = NULL, updated_at = ?3, version = version + 1 WHERE id = ?1 AND epoch = ?2",
            )
            .bind(job.id.to_string())
            .bind(job.epoch)
            .bind(now.0)
            .bind(self.expiry(now))
            .bind(to_json(error))
            .execute(&mut **tx)
            .await?;
        }
        let job = rows::read(tx, job.id).await?.ok_or(sqlx::Error::RowNotFound)?;
        add_state_event(tx, &job).await
    }

    async fn set_canceled(&self, tx: &mut Tx, lease: &Lease) -> Result<(), QueueError> {
        let now = self.env.now();
        sqlx::query(
            "UPDATE jobs SET state = 'canceled', owner = NULL, lease_until = NULL, finished_at = ?3, expires_at = ?4, \
             eta_secs = NULL, updated_at = ?3, version = version + 1 WHERE id = ?1 AND epoch = ?2",
        )
        .bind(lease.job.to_string())
        .bind(lease.epoch)
        .bind(now.0)
        .bind(self.expiry(now))
        .execute(&mut **tx)
        .await?;
        Ok(())
    }

    /// The job, if the lease still holds it.
    async fn current(&self, tx: &mut Tx, lease: &Lease) -> Result<Option<Job>, QueueError> {
        let job = rows::read(tx, lease.job).await?;
        Ok(job.filter(|job| job.epoch == lease.epoch && job.owner.is_some()))
    }

    async fn tell_and_commit(&self, mut tx: Tx, lease: &Lease) -> Result<(), QueueError> {
        let job = rows::read(&mut tx, lease.job).await?.ok_or(sqlx::Error::RowNotFound)?;
        add_state_event(&mut tx, &job).await?;
        tx.commit().await?;
        Ok(())
    }
}

type Update<'q> = sqlx::query::Query<'q, Sqlite, SqliteArguments>;

/// Runs an `UPDATE … WHERE id = ?1 AND epoch = ?2 … RETURNING state`.
async fn held<'q>(
    tx: &mut Tx,
    update: Update<'q>,
    lease: &Lease,
    bind: impl FnOnce(Update<'q>) -> Update<'q>,
) -> Result<Standing, QueueError> {
    let update = bind(update.bind(lease.job.to_string()).bind(lease.epoch));
    let row = update.fetch_optional(&mut **tx).await?;
    let state = row.map(|row| row.try_get::<String, _>("state")).transpose()?;
    Ok(standing(state.as_deref()))
}

fn standing(state: Option<&str>) -> Standing {
    match state.and_then(State::from_name) {
        Some(State::Running) => Standing::Held,
        Some(State::Canceling) => Standing::Canceling,
        _ => Standing::Lost,
    }
}
