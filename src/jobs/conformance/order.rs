//! Which job goes when, and how jobs are told in a list.

use super::*;

pub async fn older_jobs_go_first(b: Bench) {
    let ids = [b.add().await, b.add().await, b.add().await];
    for (i, id) in ids.iter().enumerate() {
        assert_eq!(b.job(*id).await.queue_position, Some(i as u64 + 1));
    }
    for id in ids {
        assert_eq!(b.claim().await.unwrap().job, id);
    }
    assert_eq!(b.claim().await, None);
}

pub async fn concurrent_claims_give_each_job_once(b: Bench) {
    let mut added = BTreeSet::new();
    for _ in 0..20 {
        added.insert(b.add().await);
    }
    let claims = (0..30).map(|i| {
        let queue = b.queue.clone();
        tokio::spawn(async move { queue.claim(&format!("w{i}")).await.unwrap().map(|(lease, _)| lease.job) })
    });
    let mut claimed = Vec::new();
    for claim in claims.collect::<Vec<_>>() {
        claimed.extend(claim.await.unwrap());
    }
    assert_eq!(claimed.len(), 20);
    assert_eq!(claimed.into_iter().collect::<BTreeSet<_>>(), added);
}

pub async fn a_higher_priority_goes_first(b: Bench) {
    let mut ids = Vec::new();
    for priority in [0, -5, 7, 7] {
        b.clock.advance(Duration::from_millis(1));
        let mut new = new_job(&b.env);
        new.options.priority = priority;
        ids.push(b.queue.insert(new).await.unwrap().queued().unwrap().id);
    }
    for (id, position) in ids.iter().zip([3, 4, 1, 2]) {
        assert_eq!(b.job(*id).await.queue_position, Some(position));
    }
    for i in [2, 3, 0, 1] {
        assert_eq!(b.claim().await.unwrap().job, ids[i]);
    }
}

pub async fn a_key_queues_one_job(b: Bench) {
    let remember = |fingerprint: char| {
        let fingerprint = fingerprint.to_string().repeat(64);
        Some(Remember { key: "/k".into(), fingerprint, answer: |job| json!({ "id": job.id }).to_string() })
    };
    let posts = (0..20).map(|_| {
        let (queue, new) = (b.queue.clone(), NewJob { remember: remember('a'), ..new_job(&b.env) });
        tokio::spawn(async move { queue.insert(new).await.unwrap() })
    });
    let (mut queued, mut known) = (Vec::new(), Vec::new());
    for post in posts.collect::<Vec<_>>() {
        match post.await.unwrap() {
            Insertion::Queued(job) => queued.push(json!({ "id": job.id }).to_string()),
            Insertion::Known(remembered) => known.push(remembered.answer),
            Insertion::Full => panic!(),
        }
    }
    assert_eq!((queued.len(), known.len()), (1, 19));
    assert!(known.iter().all(|answer| *answer == queued[0]));
    // Whatever became of the job, and whatever comes under the key.
    let job = b.claim().await.unwrap().job;
    assert!(matches!(b.queue.delete(job).await.unwrap(), Deletion::Pending));
    let other = NewJob { remember: remember('b'), ..new_job(&b.env) };
    let Insertion::Known(first) = b.queue.insert(other.clone()).await.unwrap() else { panic!() };
    assert_eq!(first.fingerprint, "a".repeat(64));
    b.clock.advance(Duration::from_secs(24 * 3600 - 1));
    b.queue.reap().await.unwrap();
    assert_eq!(b.queue.remembered("/k").await.unwrap(), Some(first));
    b.clock.advance(Duration::from_secs(1));
    b.queue.reap().await.unwrap();
    assert_eq!(b.queue.remembered("/k").await.unwrap(), None);
    assert!(matches!(b.queue.insert(other).await.unwrap(), Insertion::Queued(_)));
}

pub async fn a_full_queue_takes_no_more(b: Bench) {
    let mut last = b.add().await;
    for _ in 1..1000 {
        last = b.add().await;
    }
    assert!(b.queue.is_full().await.unwrap());
    assert!(matches!(b.queue.insert(new_job(&b.env)).await.unwrap(), Insertion::Full));
    b.queue.cancel(last).await.unwrap();
    assert!(!b.queue.is_full().await.unwrap());
    b.add().await;
    // A retried job waits like any other.
    assert!(matches!(b.queue.retry(last).await.unwrap(), Change::Full));
    assert_eq!(b.queue.get(last).await.unwrap().unwrap().state, State::Canceled, "it may be retried later");
    // Running jobs do not wait.
    b.claim().await.unwrap();
    assert!(matches!(b.queue.retry(last).await.unwrap(), Change::Done(_)));
}

pub async fn the_list_pages_from_new_to_old(b: Bench) {
    let ids = [b.add().await, b.add().await, b.add().await];
    b.queue.cancel(ids[1]).await.unwrap();
    let list = |state, before, limit| {
        let queue = b.queue.clone();
        async move {
            let jobs = queue.list(ListFilter { state, before, limit, ..ListFilter::default() }).await.unwrap();
            jobs.into_iter().map(|job| job.id).collect::<Vec<_>>()
        }
    };
    assert_eq!(list(None, None, 2).await, [ids[2], ids[1]]);
    assert_eq!(list(None, Some(ids[1]), 2).await, [ids[0]]);
    assert_eq!(list(Some(State::Canceled), None, 10).await, [ids[1]]);
    assert!(list(Some(State::Failed), None, 10).await.is_empty());
    let middle = b.job(ids[1]).await.created_at;
    let ranged = |created_from, created_before| {
        let queue = b.queue.clone();
        async move {
            let filter = ListFilter { created_from, created_before, limit: 10, ..ListFilter::default() };
            queue.list(filter).await.unwrap().into_iter().map(|job| job.id).collect::<Vec<_>>()
        }
    };
    assert_eq!(ranged(Some(middle), None).await, [ids[2], ids[1]]);
    assert_eq!(ranged(None, Some(middle)).await, [ids[0]]);
    assert!(ranged(Some(middle), Some(middle)).await.is_empty());
    let all = ListFilter {
        state: Some(State::Canceled),
        before: Some(ids[2]),
        created_from: Some(middle),
        created_before: Some(middle.plus(Duration::from_millis(1))),
        key: None,
        limit: 10,
    };
    assert_eq!(b.queue.list(all.clone()).await.unwrap().into_iter().map(|job| job.id).collect::<Vec<_>>(), [ids[1]]);
    assert!(b.queue.list(ListFilter { key: Some(Uuid::nil()), ..all }).await.unwrap().is_empty());
}
