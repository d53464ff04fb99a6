//! The conformance suite on SQLite, and what only this database can get wrong.

use std::sync::Arc;
use std::time::Duration;

use super::super::conformance::{Bench, avatar, new_job, suite};
use super::super::{Env, ListFilter, ManualClock, Policy, State, Timestamp};
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

/// How SQLite will go about a statement, step by step.
async fn plan(queue: &SqliteQueue, statement: &str) -> Vec<String> {
    use sqlx::Row;
    let explained = sqlx::query(sqlx::AssertSqlSafe(format!("EXPLAIN QUERY PLAN {statement}")));
    let steps = explained.fetch_all(&queue.writer).await.unwrap();
    steps.iter().map(|step| step.get("detail")).collect()
}

/// None of these becomes slower with the history of jobs and messages: each looks at the rows of an index that it is about.
#[tokio::test]
async fn what_is_asked_often_does_not_read_the_history() {
    let folder = tempfile::tempdir().unwrap();
    let queue = SqliteQueue::open(&folder.path().join("effigy.db"), Env::system(), Policy::default()).await.unwrap();
    let (key, before) = (Some(uuid::Uuid::nil()), Some(uuid::Uuid::nil()));
    let state = Some(State::Succeeded);
    let list = |filter: ListFilter| super::api::list(&filter).sql().as_str().to_string();
    for (statement, step) in [
        (super::reaper::OWNERS.to_string(), "COVERING INDEX jobs_held"),
        (super::worker::WAITING.to_string(), "SEARCH r USING COVERING INDEX jobs_held (key_id=?"),
        (super::worker::CLAIM.to_string(), "SEARCH r USING COVERING INDEX jobs_held (key_id=?"),
        (super::webhooks::FORGET.to_string(), "INDEX deliveries_over (created_at<?)"),
        (list(ListFilter { key, ..ListFilter::default() }), "SEARCH j USING INDEX jobs_of_key (key_id=?)"),
        (list(ListFilter { key, before, ..ListFilter::default() }), "INDEX jobs_of_key (key_id=? AND id<?)"),
        (list(ListFilter { before, ..ListFilter::default() }), "SEARCH j USING INDEX sqlite_autoindex_jobs_1 (id<?)"),
        (list(ListFilter { state, ..ListFilter::default() }), "SEARCH j USING INDEX jobs_state (state=?)"),
        (list(ListFilter { state, before, ..ListFilter::default() }), "INDEX jobs_state (state=? AND id<?)"),
    ] {
        let plan = plan(&queue, &statement).await;
        assert!(plan.iter().any(|found| found.contains(step)), "{statement}: {plan:#?}");
        // The held ones' own index may be read whole.
        let reads_all =
            |step: &&String| step.starts_with("SCAN") && !step.contains("jobs_held") && *step != "SCAN CONSTANT ROW";
        assert_eq!(plan.iter().find(reads_all), None, "{statement}");
        let sorts = plan.iter().any(|step| step.contains("TEMP B-TREE FOR ORDER BY"));
        assert!(!sorts || !statement.contains("ORDER BY j.id DESC"), "{statement}: {plan:#?}");
    }
}

#[tokio::test]
async fn another_retention_applies_to_what_has_ended() {
    let folder = tempfile::tempdir().unwrap();
    let clock = ManualClock::new(Timestamp(1_700_000_000_000));
    let env = Env::new(clock.clone(), 7);
    let day = Duration::from_secs(86_400);
    // As a server that starts with this setting.
    let start = async |days: Option<u32>| {
        let policy = Policy { retention: days.map(|days| day * days), ..Policy::default() };
        let queue = SqliteQueue::open(&folder.path().join("effigy.db"), env.clone(), policy).await.unwrap();
        let changed = queue.apply_retention().await.unwrap();
        (queue, changed)
    };
    let (queue, _) = start(None).await;
    let mut ended = Vec::new();
    for _ in 0..3 {
        queue.insert(new_job(&env)).await.unwrap();
        let (lease, _) = queue.claim("w").await.unwrap().unwrap();
        queue.succeed(&lease, avatar()).await.unwrap();
        ended.push(lease.job);
        clock.advance(day * 10);
    }
    let open = queue.insert(new_job(&env)).await.unwrap().queued().unwrap();
    let [old, middle, young] = ended[..] else { unreachable!() };
    let before = queue.get(young).await.unwrap().unwrap();
    assert_eq!((before.state, before.expires_at), (State::Succeeded, None));

    let (queue, changed) = start(Some(25)).await;
    assert_eq!(changed, 3);
    let job = queue.get(young).await.unwrap().unwrap();
    assert_eq!((job.expires_at, job.version), (Some(before.finished_at.unwrap().plus(day * 25)), before.version + 1));
    assert_eq!(queue.reap().await.unwrap().expired, [old]);
    assert_eq!(start(Some(25)).await.1, 0, "what is right stays as it is");

    // Shorter, longer, none; what has expired is left alone.
    assert_eq!(start(Some(15)).await.0.reap().await.unwrap().expired, [middle]);
    let (queue, changed) = start(Some(40)).await;
    assert_eq!(changed, 1);
    let expires_at = queue.get(young).await.unwrap().unwrap().expires_at;
    assert_eq!(expires_at, Some(before.finished_at.unwrap().plus(day * 40)));
    let (queue, changed) = start(None).await;
    assert_eq!((changed, queue.get(young).await.unwrap().unwrap().expires_at), (1, None));
    clock.advance(day * 100);
    assert!(queue.reap().await.unwrap().expired.is_empty());
    let open = queue.get(open.id).await.unwrap().unwrap();
    assert_eq!((open.state, open.expires_at, open.version), (State::Queued, None, 1));
}

#[tokio::test]
async fn another_retention_minds_leaps_of_the_clock() {
    let folder = tempfile::tempdir().unwrap();
    // A machine that learns the time after a job has ended.
    let clock = ManualClock::new(Timestamp(0));
    let env = Env::new(clock.clone(), 7);
    let day = Duration::from_secs(86_400);
    let start = async |days: Option<u32>| {
        let policy = Policy { retention: days.map(|days| day * days), ..Policy::default() };
        let queue = SqliteQueue::open(&folder.path().join("effigy.db"), env.clone(), policy).await.unwrap();
        queue.apply_retention().await.unwrap();
        queue
    };
    for before in [None, Some(10)] {
        let queue = start(before).await;
        queue.insert(new_job(&env)).await.unwrap();
        let (lease, _) = queue.claim("w").await.unwrap().unwrap();
        queue.succeed(&lease, avatar()).await.unwrap();
        let end = env.now();
        clock.leap(day * 20_000, true);
        assert!(start(Some(5)).await.reap().await.unwrap().expired.is_empty());
        let job = start(Some(5)).await.get(lease.job).await.unwrap().unwrap();
        assert_eq!(job.expires_at, Some(end.plus(day * 20_005)), "it has five days from now");
        clock.advance(day * 5);
        assert_eq!(start(Some(5)).await.reap().await.unwrap().expired, [lease.job]);
        clock.leap(day * 20_005, false);
    }
}
