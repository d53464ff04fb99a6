//! A copy of the database, made while the service runs.

use std::path::Path;

use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Row, SqliteConnection};
use uuid::Uuid;

use super::super::{AvatarFile, QueueError, State};
use super::{BUSY_TIMEOUT, rows};

/// A job of a copy, and the files that belong to it.
#[derive(Clone, Debug)]
pub struct Kept {
    pub id: Uuid,
    pub state: State,
    /// Uploaded parts: name and size.
    pub inputs: Vec<(String, u64)>,
    /// The published results, with the epoch that made them.
    pub results: Option<(i64, Vec<AvatarFile>)>,
}

async fn connect(path: &Path) -> Result<SqliteConnection, QueueError> {
    let options = SqliteConnectOptions::new().filename(path).foreign_keys(true).busy_timeout(BUSY_TIMEOUT);
    Ok(options.connect().await?)
}

/// Copies the database as it is at one moment. Writers go on meanwhile. Nothing runs in the copy: a job that a worker has
/// is queued there, its attempt given back, and one that was to stop is canceled. Their preview is replaced while the files
/// are copied, so that the copy names none.
pub async fn copy(database: &Path, to: &Path, now: super::super::Timestamp) -> Result<(), QueueError> {
    let mut live = connect(database).await?;
    sqlx::query("VACUUM INTO ?").bind(to.to_string_lossy()).execute(&mut live).await?;
    let mut copy = connect(to).await?;
    sqlx::query(
        "UPDATE jobs SET state = 'queued', owner = NULL, lease_until = NULL, attempt = attempt - 1, run_at = ?1, \
         preview = NULL, eta_secs = NULL, updated_at = ?1, version = version + 1 WHERE state = 'running'",
    )
    .bind(now.0)
    .execute(&mut copy)
    .await?;
    sqlx::query(
        "UPDATE jobs SET state = 'canceled', owner = NULL, lease_until = NULL, finished_at = ?1, preview = NULL, \
         eta_secs = NULL, updated_at = ?1, version = version + 1 WHERE state = 'canceling'",
    )
    .bind(now.0)
    .execute(&mut copy)
    .await?;
    Ok(())
}

/// The jobs of a database that nobody uses, with the files that belong to them.
pub async fn contents(database: &Path) -> Result<Vec<Kept>, QueueError> {
    let mut connection = connect(database).await?;
    let mut kept = Vec::new();
    let jobs = sqlx::query("SELECT j.id, j.state, j.inputs, a.epoch FROM jobs j LEFT JOIN avatars a ON a.id = j.id")
        .fetch_all(&mut connection)
        .await?;
    for row in jobs {
        let id = rows::id(&row, "id")?;
        let inputs: std::collections::BTreeMap<String, super::super::Part> = rows::json_column(&row, "inputs")?;
        let results = match row.try_get::<Option<i64>, _>("epoch")? {
            Some(epoch) => Some((epoch, rows::avatar_files(&mut connection, id).await?)),
            None => None,
        };
        kept.push(Kept {
            id,
            state: rows::state(&row)?,
            inputs: inputs.into_iter().map(|(name, part)| (name, part.bytes)).collect(),
            results,
        });
    }
    Ok(kept)
}

/// Takes jobs out of a copy whose files were deleted while it was made.
pub async fn forget(database: &Path, jobs: &[Uuid]) -> Result<(), QueueError> {
    let mut connection = connect(database).await?;
    for job in jobs {
        sqlx::query("DELETE FROM jobs WHERE id = ?").bind(job.to_string()).execute(&mut connection).await?;
    }
    Ok(())
}

/// How a database is, without changing it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Health {
    /// `ok`, or what SQLite found.
    pub integrity: String,
    /// The newest migration that was applied, and the newest that this program knows.
    pub version: i64,
    pub known: i64,
}

/// Checks a database, in use or not. A damaged file may also end in an error.
pub async fn examine(database: &Path) -> Result<Health, QueueError> {
    let mut connection = connect(database).await?;
    let found: Vec<String> = sqlx::query_scalar("PRAGMA quick_check(5)").fetch_all(&mut connection).await?;
    let version =
        sqlx::query_scalar("SELECT COALESCE(max(version), 0) FROM _sqlx_migrations").fetch_one(&mut connection);
    let version = version.await?;
    let known = sqlx::migrate!("./migrations").iter().map(|migration| migration.version).max().unwrap_or(0);
    Ok(Health { integrity: found.join("; "), version, known })
}
