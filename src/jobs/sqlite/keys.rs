//! Keys and secrets in the same file.

use std::collections::BTreeSet;

use sqlx::Row;
use sqlx::sqlite::SqliteRow;
use uuid::Uuid;

use super::super::keys::{Key, Keys, NewKey, Quota, Token};
use super::super::queue::QueueFuture;
use super::super::{QueueError, Timestamp};
use super::{SqliteQueue, Tx, rows};

/// Of a row of `api_keys`, `?1` the present time. [`Key::is_alive`] says the same of what was read.
pub(super) const ALIVE: &str = "revoked_at IS NULL AND (expires_at IS NULL OR expires_at > ?1)";

impl SqliteQueue {
    async fn create_key(&self, new: &NewKey, token: &Token) -> Result<Option<Key>, QueueError> {
        let mut tx = self.write().await?;
        let taken: bool =
            sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM api_keys WHERE name = ? AND revoked_at IS NULL)")
                .bind(&new.name)
                .fetch_one(&mut *tx)
                .await?;
        if taken {
            return Ok(None);
        }
        let row = sqlx::query(
            "INSERT INTO api_keys (id, name, token_sha256, scopes, max_queued, max_running, max_bytes, per_minute, \
             created_at, expires_at) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?) RETURNING *",
        )
        .bind(self.env.new_id().to_string())
        .bind(&new.name)
        .bind(token.sha256().to_vec())
        .bind(rows::to_json(&new.scopes))
        .bind(new.quota.max_queued)
        .bind(new.quota.max_running)
        .bind(new.quota.max_bytes.map(|bytes| bytes as i64))
        .bind(new.quota.per_minute)
        .bind(self.env.now().0)
        .bind(new.expires_at.map(|time| time.0))
        .fetch_one(&mut *tx)
        .await?;
        tx.commit().await?;
        key(&row).map(Some)
    }

    async fn living(&self, condition: &str, bind: impl Into<Needle>) -> Result<Option<Key>, QueueError> {
        let sql = format!("SELECT * FROM api_keys WHERE {ALIVE} AND {condition}");
        let query = sqlx::query(sqlx::AssertSqlSafe(sql)).bind(self.env.now().0);
        let query = match bind.into() {
            Needle::Text(text) => query.bind(text),
            Needle::Bytes(bytes) => query.bind(bytes),
        };
        query.fetch_optional(&self.readers).await?.as_ref().map(key).transpose()
    }

    async fn revoke_key(&self, name_or_id: &str) -> Result<Option<Key>, QueueError> {
        let mut tx = self.write().await?;
        let row = sqlx::query(
            "UPDATE api_keys SET revoked_at = ?1 WHERE revoked_at IS NULL AND (name = ?2 OR id = ?2) RETURNING *",
        )
        .bind(self.env.now().0)
        .bind(name_or_id)
        .fetch_optional(&mut *tx)
        .await?;
        tx.commit().await?;
        row.as_ref().map(key).transpose()
    }

    async fn kept_bytes(&self, owner: Uuid) -> Result<u64, QueueError> {
        kept(&mut *self.readers.acquire().await?, owner).await
    }

    async fn queued_jobs(&self, owner: Uuid) -> Result<u64, QueueError> {
        queued(&mut *self.readers.acquire().await?, owner).await
    }

    async fn secret(&self, name: &str, fresh: [u8; 32]) -> Result<Vec<u8>, QueueError> {
        let mut tx = self.write().await?;
        sqlx::query("INSERT INTO secrets (name, value, created_at) VALUES (?, ?, ?) ON CONFLICT DO NOTHING")
            .bind(name)
            .bind(fresh.to_vec())
            .bind(self.env.now().0)
            .execute(&mut *tx)
            .await?;
        let value =
            sqlx::query_scalar("SELECT value FROM secrets WHERE name = ?").bind(name).fetch_one(&mut *tx).await?;
        tx.commit().await?;
        Ok(value)
    }

    /// Refuses a job that would take its key beyond its quota. Part of the transaction that puts the job in.
    pub(super) async fn check_quota(&self, tx: &mut Tx, owner: Uuid, bytes: u64) -> Result<(), QueueError> {
        let row =
            sqlx::query("SELECT * FROM api_keys WHERE id = ?").bind(owner.to_string()).fetch_one(&mut **tx).await?;
        let quota = key(&row)?.quota;
        if let Some(limit) = quota.max_queued.map(u64::from)
            && queued(tx, owner).await? >= limit
        {
            return Err(QueueError::Quota { what: "queued jobs", limit });
        }
        if let Some(limit) = quota.max_bytes {
            let kept = kept(tx, owner).await?;
            if kept.saturating_add(bytes) > limit {
                return Err(QueueError::Quota { what: "bytes kept", limit });
            }
        }
        Ok(())
    }
}

enum Needle {
    Text(String),
    Bytes(Vec<u8>),
}

impl From<Uuid> for Needle {
    fn from(id: Uuid) -> Self {
        Needle::Text(id.to_string())
    }
}

impl From<[u8; 32]> for Needle {
    fn from(hash: [u8; 32]) -> Self {
        Needle::Bytes(hash.to_vec())
    }
}

async fn queued(connection: &mut sqlx::SqliteConnection, owner: Uuid) -> Result<u64, QueueError> {
    let jobs: i64 = sqlx::query_scalar("SELECT count(*) FROM jobs WHERE key_id = ? AND state = 'queued'")
        .bind(owner.to_string())
        .fetch_one(connection)
        .await?;
    Ok(jobs as u64)
}

async fn kept(connection: &mut sqlx::SqliteConnection, owner: Uuid) -> Result<u64, QueueError> {
    let bytes: i64 = sqlx::query_scalar(
        "SELECT COALESCE((SELECT sum(part.value ->> '$.bytes') FROM jobs j, json_each(j.inputs) part \
         WHERE j.key_id = ?1 AND j.state != 'expired'), 0) \
         + COALESCE((SELECT sum(f.bytes) FROM jobs j JOIN avatar_files f ON f.avatar_id = j.id WHERE j.key_id = ?1), 0)",
    )
    .bind(owner.to_string())
    .fetch_one(connection)
    .await?;
    Ok(bytes as u64)
}

fn key(row: &SqliteRow) -> Result<Key, QueueError> {
    Ok(Key {
        id: rows::id(row, "id")?,
        name: row.try_get("name")?,
        scopes: rows::json_column::<BTreeSet<_>>(row, "scopes")?,
        quota: Quota {
            max_queued: row.try_get("max_queued")?,
            max_running: row.try_get("max_running")?,
            max_bytes: row.try_get::<Option<i64>, _>("max_bytes")?.map(|bytes| bytes as u64),
            per_minute: row.try_get("per_minute")?,
        },
        created_at: Timestamp(row.try_get("created_at")?),
        expires_at: rows::time(row, "expires_at")?,
        revoked_at: rows::time(row, "revoked_at")?,
    })
}

impl Keys for SqliteQueue {
    fn create_key<'a>(&'a self, key: &'a NewKey, token: &'a Token) -> QueueFuture<'a, Option<Key>> {
        Box::pin(self.create_key(key, token))
    }

    fn list_keys(&self) -> QueueFuture<'_, Vec<Key>> {
        Box::pin(async {
            let rows = sqlx::query("SELECT * FROM api_keys ORDER BY id").fetch_all(&self.readers).await?;
            rows.iter().map(key).collect()
        })
    }

    fn revoke_key<'a>(&'a self, name_or_id: &'a str) -> QueueFuture<'a, Option<Key>> {
        Box::pin(self.revoke_key(name_or_id))
    }

    fn key_of<'a>(&'a self, token: &'a Token) -> QueueFuture<'a, Option<Key>> {
        Box::pin(self.living("token_sha256 = ?2", token.sha256()))
    }

    fn living_key(&self, id: Uuid) -> QueueFuture<'_, Option<Key>> {
        Box::pin(self.living("id = ?2", id))
    }

    fn any_living_key(&self) -> QueueFuture<'_, bool> {
        Box::pin(async {
            let sql = format!("SELECT EXISTS (SELECT 1 FROM api_keys WHERE {ALIVE})");
            let query = sqlx::query_scalar(sqlx::AssertSqlSafe(sql)).bind(self.env.now().0);
            Ok(query.fetch_one(&self.readers).await?)
        })
    }

    fn any_key(&self) -> QueueFuture<'_, bool> {
        Box::pin(async {
            Ok(sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM api_keys)").fetch_one(&self.readers).await?)
        })
    }

    fn owner_of(&self, job: Uuid) -> QueueFuture<'_, Option<Option<Uuid>>> {
        Box::pin(async move { rows::owner(&mut *self.readers.acquire().await?, job).await })
    }

    fn kept_bytes(&self, key: Uuid) -> QueueFuture<'_, u64> {
        Box::pin(self.kept_bytes(key))
    }

    fn queued_jobs(&self, key: Uuid) -> QueueFuture<'_, u64> {
        Box::pin(self.queued_jobs(key))
    }

    fn secret<'a>(&'a self, name: &'a str, fresh: [u8; 32]) -> QueueFuture<'a, Vec<u8>> {
        Box::pin(self.secret(name, fresh))
    }
}
