//! Webhooks in the same file: a change of a job and the messages about it are one transaction.

use serde_json::json;
use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};
use uuid::Uuid;

use super::super::queue::QueueFuture;
use super::super::webhooks::{
    Attempt, Delivery, Due, KEPT, MOST_OF_A_KEY, NewWebhook, Places, SCHEDULE, TOLD, Webhook, Webhooks, event_type,
};
use super::super::{Job, QueueError, State, Timestamp};
use super::keys::ALIVE;
use super::{SqliteQueue, rows};

/// Part of every attempt.
pub(super) const FORGET: &str = "DELETE FROM deliveries WHERE next_at IS NULL AND created_at < ?";

/// Of a webhook `w`: it is nobody's, or its key is alive.
fn heard() -> String {
    format!("NOT EXISTS (SELECT 1 FROM api_keys WHERE id = w.key_id AND NOT ({ALIVE}))")
}

/// Writes the messages about a job that has just come to its state. Webhooks of a key that is revoked or has expired hear nothing.
pub(super) async fn tell(connection: &mut SqliteConnection, job: &Job) -> Result<(), QueueError> {
    if !TOLD.contains(&job.state) {
        return Ok(());
    }
    let kind = event_type(job.state);
    let payload = json!({
        "type": kind,
        "timestamp": job.updated_at.rfc3339(),
        "data": {
            "job": job.id,
            "state": job.state,
            "attempt": job.attempt,
            "avatar": (job.state == State::Succeeded).then_some(job.id),
            "error": job.error,
        },
    });
    let insert = format!(
        "INSERT INTO deliveries (id, webhook_id, payload, created_at, next_at) \
         SELECT 'msg_' || lower(hex(randomblob(16))), w.id, ?2, ?1, ?1 FROM webhooks w \
         WHERE w.disabled_at IS NULL AND w.key_id IS (SELECT key_id FROM jobs WHERE id = ?3) \
         AND EXISTS (SELECT 1 FROM json_each(w.events) WHERE value = ?4) AND {}",
        heard()
    );
    sqlx::query(sqlx::AssertSqlSafe(insert))
        .bind(job.updated_at.0)
        .bind(payload.to_string())
        .bind(job.id.to_string())
        .bind(kind)
        .execute(connection)
        .await?;
    Ok(())
}

impl SqliteQueue {
    async fn create_webhook(&self, new: NewWebhook) -> Result<Webhook, QueueError> {
        let mut tx = self.write().await?;
        let key = new.key.map(|key| key.to_string());
        let others: i64 = sqlx::query_scalar("SELECT count(*) FROM webhooks WHERE key_id IS ?")
            .bind(&key)
            .fetch_one(&mut *tx)
            .await?;
        if others as u64 >= MOST_OF_A_KEY {
            return Err(QueueError::Quota { what: "webhooks", limit: MOST_OF_A_KEY });
        }
        let row = sqlx::query(
            "INSERT INTO webhooks (id, key_id, url, secret, events, created_at) VALUES (?, ?, ?, ?, ?, ?) RETURNING *",
        )
        .bind(self.env.new_id().to_string())
        .bind(key)
        .bind(new.url)
        .bind(new.secret)
        .bind(rows::to_json(&new.events))
        .bind(self.env.now().0)
        .fetch_one(&mut *tx)
        .await?;
        tx.commit().await?;
        webhook(&row)
    }

    async fn find_webhooks(&self, id: Option<Uuid>, only: Option<Uuid>) -> Result<Vec<Webhook>, QueueError> {
        let found = sqlx::query(
            "SELECT * FROM webhooks WHERE (?1 IS NULL OR id = ?1) AND (?2 IS NULL OR key_id = ?2) ORDER BY id DESC",
        )
        .bind(id.map(|id| id.to_string()))
        .bind(only.map(|key| key.to_string()))
        .fetch_all(&self.readers)
        .await?;
        found.iter().map(webhook).collect()
    }

    async fn delete_webhook(&self, id: Uuid, only: Option<Uuid>) -> Result<bool, QueueError> {
        let mut tx = self.write().await?;
        let gone = sqlx::query("DELETE FROM webhooks WHERE id = ?1 AND (?2 IS NULL OR key_id = ?2)")
            .bind(id.to_string())
            .bind(only.map(|key| key.to_string()))
            .execute(&mut *tx)
            .await?;
        tx.commit().await?;
        Ok(gone.rows_affected() > 0)
    }

    async fn deliveries(&self, id: Uuid, limit: u32) -> Result<Vec<Delivery>, QueueError> {
        let found =
            sqlx::query("SELECT * FROM deliveries WHERE webhook_id = ? ORDER BY created_at DESC, rowid DESC LIMIT ?")
                .bind(id.to_string())
                .bind(limit)
                .fetch_all(&self.readers)
                .await?;
        found.iter().map(delivery).collect()
    }

    async fn due(&self, places: Places) -> Result<Vec<Due>, QueueError> {
        let select = format!(
            "SELECT id, key_id, payload, attempts, url, secret FROM ( \
               SELECT *, row_number() OVER (PARTITION BY key_id ORDER BY turn, next_at, row) AS turn_of_key FROM ( \
                 SELECT d.id, w.key_id, d.payload, d.attempts, w.url, w.secret, d.next_at, d.rowid AS row, \
                 row_number() OVER (PARTITION BY d.webhook_id ORDER BY d.next_at, d.rowid) AS turn \
                 FROM deliveries d JOIN webhooks w ON w.id = d.webhook_id \
                 WHERE d.next_at <= ?1 AND w.disabled_at IS NULL AND {} \
               ) WHERE turn <= ?2 \
             ) WHERE turn_of_key <= ?3 ORDER BY turn_of_key, next_at, row LIMIT ?4",
            heard()
        );
        let found = sqlx::query(sqlx::AssertSqlSafe(select))
            .bind(self.env.now().0)
            .bind(places.of_webhook)
            .bind(places.of_key)
            .bind(places.all)
            .fetch_all(&self.readers)
            .await?;
        let due = found.iter().map(|row| {
            Ok(Due {
                id: row.try_get("id")?,
                key: rows::optional_id(row, "key_id")?,
                url: row.try_get("url")?,
                secret: row.try_get("secret")?,
                payload: row.try_get("payload")?,
                attempts: row.try_get("attempts")?,
            })
        });
        due.collect()
    }

    async fn attempted(&self, id: &str, attempt: &Attempt) -> Result<(), QueueError> {
        let mut tx = self.write().await?;
        let now = self.env.now();
        let made: Option<u32> = sqlx::query_scalar(
            "UPDATE deliveries SET attempts = attempts + 1, last_status = ?2, last_error = ?3 WHERE id = ?1 \
             RETURNING attempts",
        )
        .bind(id)
        .bind(if let Attempt::Answered(status) = attempt { Some(*status) } else { None })
        .bind(if let Attempt::Failed(error) = attempt { Some(error.as_str()) } else { None })
        .fetch_optional(&mut *tx)
        .await?;
        // The webhook was deleted meanwhile.
        let Some(made) = made else { return Ok(()) };
        let taken = matches!(attempt, Attempt::Answered(200..=299));
        let gone = *attempt == Attempt::Answered(410);
        // A little chance, so that what failed together does not come back together.
        let wait = SCHEDULE.get(made as usize - 1).map(|wait| wait.mul_f64(1.0 + 0.1 * self.env.unit()));
        let next = wait.filter(|_| !taken && !gone).map(|wait| now.plus(wait).0);
        sqlx::query("UPDATE deliveries SET next_at = ?2, delivered_at = ?3 WHERE id = ?1")
            .bind(id)
            .bind(next)
            .bind(taken.then_some(now.0))
            .execute(&mut *tx)
            .await?;
        if gone {
            sqlx::query(
                "UPDATE webhooks SET disabled_at = ?2 WHERE id = (SELECT webhook_id FROM deliveries WHERE id = ?1)",
            )
            .bind(id)
            .bind(now.0)
            .execute(&mut *tx)
            .await?;
        }
        // Also of attempts that were on their way when another one's answer was that.
        sqlx::query(
            "UPDATE deliveries SET next_at = NULL, last_error = 'the receiver wants no more' WHERE next_at IS NOT NULL \
             AND webhook_id = (SELECT w.id FROM webhooks w JOIN deliveries d ON d.webhook_id = w.id \
             WHERE d.id = ? AND w.disabled_at IS NOT NULL)",
        )
        .bind(id)
        .execute(&mut *tx)
        .await?;
        sqlx::query(FORGET).bind(now.0.saturating_sub(KEPT.as_millis() as i64)).execute(&mut *tx).await?;
        tx.commit().await?;
        Ok(())
    }
}

fn webhook(row: &SqliteRow) -> Result<Webhook, QueueError> {
    Ok(Webhook {
        id: rows::id(row, "id")?,
        key: rows::optional_id(row, "key_id")?,
        url: row.try_get("url")?,
        events: rows::json_column(row, "events")?,
        created_at: Timestamp(row.try_get("created_at")?),
        disabled_at: rows::time(row, "disabled_at")?,
    })
}

fn delivery(row: &SqliteRow) -> Result<Delivery, QueueError> {
    Ok(Delivery {
        id: row.try_get("id")?,
        payload: row.try_get("payload")?,
        created_at: Timestamp(row.try_get("created_at")?),
        attempts: row.try_get("attempts")?,
        next_at: rows::time(row, "next_at")?,
        delivered_at: rows::time(row, "delivered_at")?,
        last_status: row.try_get("last_status")?,
        last_error: row.try_get("last_error")?,
    })
}

impl Webhooks for SqliteQueue {
    fn create_webhook(&self, new: NewWebhook) -> QueueFuture<'_, Webhook> {
        Box::pin(self.create_webhook(new))
    }

    fn webhooks(&self, only: Option<Uuid>) -> QueueFuture<'_, Vec<Webhook>> {
        Box::pin(self.find_webhooks(None, only))
    }

    fn webhook(&self, id: Uuid, only: Option<Uuid>) -> QueueFuture<'_, Option<Webhook>> {
        Box::pin(async move { Ok(self.find_webhooks(Some(id), only).await?.pop()) })
    }

    fn delete_webhook(&self, id: Uuid, only: Option<Uuid>) -> QueueFuture<'_, bool> {
        Box::pin(self.delete_webhook(id, only))
    }

    fn deliveries(&self, webhook: Uuid, limit: u32) -> QueueFuture<'_, Vec<Delivery>> {
        Box::pin(self.deliveries(webhook, limit))
    }

    fn due(&self, places: Places) -> QueueFuture<'_, Vec<Due>> {
        Box::pin(self.due(places))
    }

    fn attempted<'a>(&'a self, delivery: &'a str, attempt: &'a Attempt) -> QueueFuture<'a, ()> {
        Box::pin(self.attempted(delivery, attempt))
    }
}
