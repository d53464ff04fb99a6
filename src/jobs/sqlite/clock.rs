//! Leaps of the wall clock. All times in the database are the wall clock's, so that people can read them; a clock that is
//! set forward or back would end leases, deadlines and retention at once, or never. The time since the machine's start,
//! which nobody sets, tells how much time has really passed: when the two disagree, whatever is still to come is moved by
//! the difference, once, in one transaction, before anything else is written.
//!
//! Where the machine was started anew, a clock that stands before the last time seen was set back by at least that much.
//! One that stands after it may be right: how long the machine was off, it cannot tell.

use sqlx::Row;

use super::super::leaps::LEAP_MS;
use super::super::{QueueError, Steady};
use super::{SqliteQueue, Tx};

/// The time seen is written down at least this often.
const SEEN_MS: i64 = 60_000;

/// What this process knows of the table `clock`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Known {
    /// Wall clock minus time since the machine's start.
    offset_ms: i64,
    /// In time since the machine's start.
    seen_ms: i64,
}

impl SqliteQueue {
    /// Moves what is to come, if the wall clock has leapt.
    pub(super) async fn settle(&self) -> Result<(), QueueError> {
        // A system that does not tell has the wall clock alone.
        let Some(Steady { boot, ms }) = self.env.steady() else { return Ok(()) };
        let now = self.env.now().0;
        let offset_ms = now - ms;
        let known = *self.clock.lock().unwrap();
        if known.is_some_and(|k| (offset_ms - k.offset_ms).abs() < LEAP_MS && ms - k.seen_ms < SEEN_MS) {
            return Ok(());
        }
        let mut tx = self.begin().await?;
        let stored = sqlx::query("SELECT boot, offset_ms, seen_at FROM clock").fetch_optional(&mut *tx).await?;
        let (leap_ms, mut kept_ms) = match stored {
            None => (0, offset_ms),
            Some(row) if row.try_get::<String, _>("boot")? == boot => {
                let before: i64 = row.try_get("offset_ms")?;
                (offset_ms - before, before)
            }
            Some(row) => ((now - row.try_get::<i64, _>("seen_at")?).min(0), offset_ms),
        };
        if leap_ms.abs() >= LEAP_MS {
            tracing::warn!(secs = leap_ms as f64 / 1000.0, "the wall clock has leapt: what is to come moves with it");
            move_what_is_to_come(&mut tx, leap_ms).await?;
            kept_ms = offset_ms;
        }
        sqlx::query(
            "INSERT INTO clock (id, boot, offset_ms, seen_at) VALUES (1, ?1, ?2, ?3) \
             ON CONFLICT (id) DO UPDATE SET boot = ?1, offset_ms = ?2, seen_at = ?3",
        )
        .bind(boot)
        .bind(kept_ms)
        .bind(now)
        .execute(&mut *tx)
        .await?;
        tx.commit().await?;
        *self.clock.lock().unwrap() = Some(Known { offset_ms: kept_ms, seen_ms: ms });
        Ok(())
    }
}

/// Times that are compared with the present: of jobs, of clients' keys, of messages. What has happened keeps its time, and
/// so does what somebody set to a date (the end of an API key, of a link).
async fn move_what_is_to_come(tx: &mut Tx, leap_ms: i64) -> Result<(), QueueError> {
    for statement in [
        "UPDATE jobs SET lease_until = lease_until + ?1, run_at = run_at + ?1, deadline_at = deadline_at + ?1, \
         version = version + 1 WHERE finished_at IS NULL",
        "UPDATE jobs SET expires_at = expires_at + ?1, leapt_ms = leapt_ms + ?1, version = version + 1 \
         WHERE finished_at IS NOT NULL AND state != 'expired'",
        "UPDATE idempotency_keys SET created_at = created_at + ?1",
        "UPDATE deliveries SET next_at = next_at + ?1 WHERE next_at IS NOT NULL",
    ] {
        sqlx::query(statement).bind(leap_ms).execute(&mut **tx).await?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::time::Duration;

    use super::super::super::conformance::{avatar, new_job};
    use super::super::super::{Env, Job, Lease, ManualClock, Policy, Remember, State, Timestamp};
    use super::*;

    const DAY: Duration = Duration::from_secs(86_400);
    const HOUR: Duration = Duration::from_secs(3600);

    struct Bench {
        folder: tempfile::TempDir,
        clock: Arc<ManualClock>,
        env: Env,
        queue: SqliteQueue,
    }

    impl Bench {
        async fn new() -> Bench {
            let folder = tempfile::tempdir().unwrap();
            let clock = ManualClock::new(Timestamp(1_700_000_000_000));
            let env = Env::new(clock.clone(), 7);
            let queue = open(&folder, &env).await;
            Bench { folder, clock, env, queue }
        }

        async fn running(&self) -> Lease {
            self.queue.insert(new_job(&self.env)).await.unwrap();
            self.queue.claim("w").await.unwrap().unwrap().0
        }

        async fn job(&self, lease: &Lease) -> Job {
            self.queue.get(lease.job).await.unwrap().unwrap()
        }
    }

    /// As each process does.
    async fn open(folder: &tempfile::TempDir, env: &Env) -> SqliteQueue {
        let policy = Policy { retention: Some(HOUR), ..Policy::default() };
        SqliteQueue::open(&folder.path().join("effigy.db"), env.clone(), policy).await.unwrap()
    }

    #[tokio::test]
    async fn a_leap_forward_ends_nothing_before_its_time() {
        let b = Bench::new().await;
        let done = b.running().await;
        b.queue.succeed(&done, avatar()).await.unwrap();
        let remember = Remember { key: "/again".into(), fingerprint: "f".repeat(64), answer: |_| "{}".into() };
        let mut with_deadline = new_job(&b.env);
        with_deadline.options.deadline_secs = Some(600);
        with_deadline.remember = Some(remember);
        b.queue.insert(with_deadline).await.unwrap();
        let (lease, _) = b.queue.claim("w").await.unwrap().unwrap();
        let (expires_at, lease_until) = (b.job(&done).await.expires_at.unwrap(), b.lease_until(&lease).await);

        b.clock.leap(DAY, true);
        assert_eq!(b.queue.reap().await.unwrap(), Default::default());
        assert_eq!(b.job(&lease).await.state, State::Running);
        assert!(
            b.queue.avatar(done.job).await.unwrap().is_some() && b.queue.remembered("/again").await.unwrap().is_some()
        );
        assert_eq!(
            b.job(&done).await.expires_at,
            Some(expires_at.plus(DAY)),
            "it is told by the clock that people see"
        );
        assert_eq!(b.lease_until(&lease).await, lease_until + DAY.as_millis() as i64);

        // And ends it at its time.
        b.clock.advance(Duration::from_secs(61));
        assert_eq!(b.queue.reap().await.unwrap().reclaimed, [lease.job]);
        b.clock.advance(Duration::from_secs(540));
        assert_eq!(b.queue.reap().await.unwrap().late, [lease.job]);
        b.clock.advance(Duration::from_secs(2998));
        assert_eq!(b.queue.reap().await.unwrap(), Default::default());
        b.clock.advance(Duration::from_secs(1));
        assert_eq!(b.queue.reap().await.unwrap().expired, [done.job]);
        b.clock.advance(DAY);
        b.queue.reap().await.unwrap();
        assert!(b.queue.remembered("/again").await.unwrap().is_none());
    }

    #[tokio::test]
    async fn a_leap_back_holds_nothing_beyond_its_time() {
        let b = Bench::new().await;
        let done = b.running().await;
        b.queue.succeed(&done, avatar()).await.unwrap();
        let lease = b.running().await;
        b.clock.leap(DAY, false);
        assert_eq!(b.queue.reap().await.unwrap(), Default::default());
        b.clock.advance(Duration::from_secs(61));
        assert_eq!(b.queue.reap().await.unwrap().reclaimed, [lease.job]);
        // Its wait is over after seconds, not after a day.
        b.clock.advance(Duration::from_secs(5));
        assert_eq!(b.queue.claim("w").await.unwrap().unwrap().0.job, lease.job);
        b.clock.advance(HOUR);
        assert_eq!(b.queue.reap().await.unwrap().expired, [done.job]);
    }

    #[tokio::test]
    async fn a_worker_that_writes_before_the_reaper_looks_keeps_its_lease() {
        for forward in [true, false] {
            let b = Bench::new().await;
            let lease = b.running().await;
            b.clock.leap(DAY, forward);
            b.queue.heartbeat(&lease).await.unwrap();
            assert_eq!(b.lease_until(&lease).await, b.env.now().0 + 60_000);
            assert_eq!(b.queue.reap().await.unwrap(), Default::default());
        }
    }

    #[tokio::test]
    async fn processes_move_what_is_to_come_once_together() {
        let b = Bench::new().await;
        let lease = b.running().await;
        let other = open(&b.folder, &b.env).await;
        other.heartbeat(&lease).await.unwrap();
        let before = b.lease_until(&lease).await;
        b.clock.leap(DAY, true);
        for queue in [&b.queue, &other, &b.queue] {
            queue.settle().await.unwrap();
        }
        // One that was not there when it happened.
        open(&b.folder, &b.env).await.settle().await.unwrap();
        assert_eq!(b.lease_until(&lease).await, before + DAY.as_millis() as i64);
    }

    #[tokio::test]
    async fn a_machine_that_starts_in_the_past_and_learns_the_time_keeps_its_avatars() {
        let b = Bench::new().await;
        let done = b.running().await;
        b.queue.succeed(&done, avatar()).await.unwrap();
        b.queue.reap().await.unwrap();
        // No battery behind its clock.
        b.clock.restart(Timestamp(0));
        assert_eq!(b.queue.reap().await.unwrap(), Default::default());
        let lease = b.running().await;
        b.clock.advance(Duration::from_secs(10));
        b.clock.leap(Duration::from_millis(1_700_000_000_000), true);
        assert_eq!(b.queue.reap().await.unwrap(), Default::default());
        assert_eq!(b.job(&lease).await.state, State::Running);
        b.clock.advance(HOUR);
        assert_eq!(b.queue.reap().await.unwrap().expired, [done.job]);
        // A clock that is ahead after a start may be right: the machine may have been off for a day.
        let last = b.running().await;
        b.clock.restart(b.env.now().plus(DAY));
        assert_eq!(b.queue.reap().await.unwrap().reclaimed, [last.job]);
    }

    #[tokio::test]
    async fn small_steps_are_left_alone_until_they_add_up() {
        let b = Bench::new().await;
        let lease = b.running().await;
        b.queue.settle().await.unwrap();
        let before = b.lease_until(&lease).await;
        for step in 1..=5 {
            b.clock.leap(Duration::from_secs(1), true);
            b.queue.settle().await.unwrap();
            let moved = if step == 5 { 5000 } else { 0 };
            assert_eq!(b.lease_until(&lease).await, before + moved, "step {step}");
        }
    }

    impl Bench {
        async fn lease_until(&self, lease: &Lease) -> i64 {
            sqlx::query_scalar("SELECT lease_until FROM jobs WHERE id = ?")
                .bind(lease.job.to_string())
                .fetch_one(&self.queue.readers)
                .await
                .unwrap()
        }
    }
}
