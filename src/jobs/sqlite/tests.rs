//! The conformance suite on SQLite, and what only this database can get wrong.

use std::sync::Arc;
use std::time::Duration;

use super::super::conformance::{Bench, new_job, suite};
use super::super::{Env, ListFilter, ManualClock, Policy, Queue, Timestamp};
use super::SqliteQueue;

pub(super) async fn open() -> Bench {
    let folder = tempfile::tempdir().unwrap();
    let clock = ManualClock::new(Timestamp(1_700_000_000_000));
    let env = Env::new(clock.clone(), 7);
    let policy = Policy { retention: Some(Duration::from_secs(3600)), ..Policy::default() };
    let queue = SqliteQueue::open(&folder.path().join("effigy.db"), env.clone(), policy).await.unwrap();
    Bench { queue: Arc::new(queue), clock, env, keep: Box::new(folder) }
}

suite!(open());

#[tokio::test]
async fn a_reopened_file_holds_what_was_acknowledged() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("effigy.db");
    let env = Env::system();
    let first = SqliteQueue::open(&path, env.clone(), Policy::default()).await.unwrap();
    let job = first.insert(new_job(&env)).await.unwrap().queued().unwrap();
    first.close().await;
    let second = SqliteQueue::open(&path, env, Policy::default()).await.unwrap();
    assert_eq!(second.get(job.id).await.unwrap().unwrap().created_at, job.created_at);
}

#[tokio::test]
async fn two_processes_share_one_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("effigy.db");
    let env = Env::system();
    let one = Arc::new(SqliteQueue::open(&path, env.clone(), Policy::default()).await.unwrap());
    let two = Arc::new(SqliteQueue::open(&path, env.clone(), Policy::default()).await.unwrap());
    let mut tasks = Vec::new();
    for queue in [&one, &two] {
        for _ in 0..10 {
            let (queue, env) = (queue.clone(), env.clone());
            tasks.push(tokio::spawn(async move { queue.insert(new_job(&env)).await.unwrap().queued().unwrap().id }));
        }
    }
    for task in tasks {
        let id = task.await.unwrap();
        assert!(one.get(id).await.unwrap().is_some() && two.get(id).await.unwrap().is_some());
    }
}

#[tokio::test]
async fn the_schema_refuses_states_without_their_times() {
    let bench = open().await;
    let job = bench.queue.insert(new_job(&bench.env)).await.unwrap().queued().unwrap();
    let folder = bench.keep.downcast_ref::<tempfile::TempDir>().unwrap();
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(folder.path().join("effigy.db"));
    let pool = sqlx::SqlitePool::connect_with(options).await.unwrap();
    for wrong in [
        "UPDATE jobs SET state = 'running'",
        "UPDATE jobs SET state = 'succeeded', finished_at = 1",
        "UPDATE jobs SET state = 'failed', finished_at = 1",
        "UPDATE jobs SET state = 'canceled', finished_at = 1",
        "UPDATE jobs SET owner = 'me'",
        "UPDATE jobs SET finished_at = 1",
        "UPDATE jobs SET progress = 1.5",
        "UPDATE jobs SET state = 'lost'",
    ] {
        let error = sqlx::query(wrong).execute(&pool).await.expect_err(wrong);
        assert!(error.to_string().contains("CHECK constraint"), "{wrong}: {error}");
    }
    assert_eq!(bench.queue.get(job.id).await.unwrap().unwrap().version, 1);
}

#[tokio::test]
async fn readers_never_wait_for_a_writer() {
    use sqlx::Connection;
    let bench = open().await;
    let job = bench.queue.insert(new_job(&bench.env)).await.unwrap().queued().unwrap();
    let folder = bench.keep.downcast_ref::<tempfile::TempDir>().unwrap();
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(folder.path().join("effigy.db"));
    let mut other = sqlx::SqliteConnection::connect_with(&options).await.unwrap();
    let mut transaction = other.begin_with("BEGIN IMMEDIATE").await.unwrap();
    sqlx::query("UPDATE jobs SET priority = 5").execute(&mut *transaction).await.unwrap();
    // Were any of these to wait, they would wait for ever.
    assert_eq!(bench.queue.get(job.id).await.unwrap().unwrap().priority, 0);
    assert_eq!(bench.queue.list(ListFilter { limit: 10, ..ListFilter::default() }).await.unwrap().len(), 1);
    assert_eq!(bench.queue.events(job.id, 0, 10).await.unwrap().len(), 1);
    assert!(bench.queue.avatar(job.id).await.unwrap().is_none());
    bench.queue.counts().await.unwrap();
    transaction.rollback().await.unwrap();
}
