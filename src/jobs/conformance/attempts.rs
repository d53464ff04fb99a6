//! How attempts end without an avatar, and which of them count.

use super::*;

pub async fn a_job_that_kills_its_worker_fails_after_its_attempts(b: Bench) {
    let id = b.add().await;
    for attempt in 1..=3 {
        let lease = b.claim().await.unwrap_or_else(|| panic!("attempt {attempt} is claimable"));
        assert_eq!((b.job(id).await.attempt, lease.epoch), (attempt, i64::from(attempt)));
        b.clock.advance(Duration::from_secs(60));
        assert_eq!(b.queue.reap().await.unwrap().reclaimed, [id]);
        b.clock.advance(Duration::from_secs(600));
    }
    assert_eq!(b.claim().await, None);
    let job = b.job(id).await;
    assert_eq!((job.state, job.attempt, job.error.unwrap().kind.as_str()), (State::Failed, 3, "lease-lost"));
    assert_eq!(b.states(id).await, ["queued", "running", "queued", "running", "queued", "running", "failed"]);
}

pub async fn a_killed_attempt_that_moved_on_is_not_counted(b: Bench) {
    let id = b.add().await;
    for attempt in 1..=5 {
        let lease = b.claim().await.unwrap();
        assert_eq!(b.queue.saved(&lease, f64::from(attempt) / 10.0).await.unwrap(), Standing::Held);
        // By a death and by silence.
        if attempt % 2 == 0 {
            assert_eq!(b.queue.release_owner("worker-1").await.unwrap(), [id]);
        } else {
            b.clock.advance(Duration::from_secs(60));
            assert_eq!(b.queue.reap().await.unwrap().reclaimed, [id]);
        }
        let job = b.job(id).await;
        assert_eq!((job.state, job.attempt, job.excused), (State::Queued, attempt, attempt));
        b.clock.advance(Duration::from_secs(600));
    }
    // The same place once more is no progress, and neither is less.
    for attempt in 6..=8 {
        let lease = b.claim().await.unwrap();
        b.queue.saved(&lease, [0.5, 0.3, f64::NAN][attempt as usize - 6]).await.unwrap();
        b.queue.release_owner("worker-1").await.unwrap();
        assert_eq!((b.job(id).await.attempt, b.job(id).await.excused), (attempt, 5));
        b.clock.advance(Duration::from_secs(600));
    }
    assert_eq!(b.job(id).await.state, State::Failed);
    assert!(matches!(b.queue.retry(id).await.unwrap(), Change::Done(job) if job.attempt == 0 && job.excused == 0));
}

pub async fn a_job_that_was_given_back_tells_no_time_left(b: Bench) {
    let id = b.add().await;
    let lease = b.claim().await.unwrap();
    b.queue.report(&lease, &report(0.5)).await.unwrap();
    assert_eq!(b.job(id).await.eta_secs, Some(60.0));
    b.queue.give_back(&lease).await.unwrap();
    assert_eq!((b.job(id).await.state, b.job(id).await.eta_secs), (State::Queued, None));
}

/// As after an upgrade: what another program had saved is no measure for what this one saves.
pub async fn a_killed_attempt_that_began_anew_and_moved_on_is_not_counted(b: Bench) {
    let id = b.add().await;
    let lease = b.claim().await.unwrap();
    b.queue.saved(&lease, 0.9).await.unwrap();
    b.queue.give_back(&lease).await.unwrap();
    for attempt in 1..=3 {
        let lease = b.claim().await.unwrap();
        if attempt == 1 {
            assert_eq!(b.queue.begun_anew(&lease).await.unwrap(), Standing::Held);
        }
        b.queue.saved(&lease, 0.2 * f64::from(attempt)).await.unwrap();
        b.queue.release_owner("worker-1").await.unwrap();
        assert_eq!((b.job(id).await.attempt, b.job(id).await.excused), (attempt, attempt));
        b.clock.advance(Duration::from_secs(600));
    }
    let stale = Lease { job: id, epoch: 1 };
    assert_eq!(b.queue.begun_anew(&stale).await.unwrap(), Standing::Lost);
}

pub async fn an_attempt_that_fails_by_itself_is_counted_wherever_it_got(b: Bench) {
    let id = b.add().await;
    for attempt in 1..=3 {
        let lease = b.claim().await.unwrap();
        b.queue.saved(&lease, f64::from(attempt) / 10.0).await.unwrap();
        b.queue.fail(&lease, JobError::new("device", "lost"), Repeat::Counted).await.unwrap();
        b.clock.advance(Duration::from_secs(600));
    }
    let job = b.job(id).await;
    assert_eq!((job.state, job.attempt, job.excused), (State::Failed, 3, 0));
}

pub async fn a_job_that_passes_its_deadline_fails(b: Bench) {
    let mut ids = Vec::new();
    for _ in 0..3 {
        let mut new = new_job(&b.env);
        new.options.deadline_secs = Some(30);
        ids.push(b.queue.insert(new).await.unwrap().queued().unwrap().id);
    }
    let endless = b.add().await;
    let running = b.claim().await.unwrap();
    b.claim().await.unwrap();
    b.queue.cancel(ids[1]).await.unwrap();
    b.clock.advance(Duration::from_millis(29_000));
    assert!(b.queue.reap().await.unwrap().late.is_empty());
    b.clock.advance(Duration::from_millis(1_000));
    assert_eq!(b.claim().await.unwrap().job, endless, "what has passed its deadline is not begun");
    assert_eq!(b.queue.reap().await.unwrap().late, [ids[0], ids[2]]);
    for id in [ids[0], ids[2]] {
        let job = b.job(id).await;
        assert_eq!((job.state, job.error.unwrap().kind.as_str()), (State::Failed, "deadline"));
    }
    assert_eq!(b.job(ids[1]).await.state, State::Canceling, "the user's wish comes first");
    assert_eq!(b.queue.standing(&running).await.unwrap(), Standing::Lost);
    assert_eq!(b.queue.succeed(&running, avatar()).await.unwrap(), Standing::Lost);
    // A retry has the whole time again.
    let Change::Done(job) = b.queue.retry(ids[2]).await.unwrap() else { panic!() };
    assert_eq!(job.deadline_at, Some(b.env.now().plus(Duration::from_secs(30))));
    assert_eq!(b.job(endless).await.deadline_at, None);
}

pub async fn repeats_wait_longer_each_time(b: Bench) {
    let id = b.add().await;
    let mut waits = Vec::new();
    for _ in 0..2 {
        let lease = b.claim().await.unwrap();
        b.queue.fail(&lease, JobError::new("device", "lost"), Repeat::Counted).await.unwrap();
        assert_eq!(b.claim().await, None, "a repeated job waits");
        let job = b.job(id).await;
        assert_eq!((job.state, job.error.unwrap().kind.as_str()), (State::Queued, "device"));
        waits.push(job.run_at.0 - b.env.now().0);
        b.clock.advance(Duration::from_millis(*waits.last().unwrap() as u64));
    }
    assert!((2000..=2500).contains(&waits[0]), "{waits:?}");
    assert!((4000..=5000).contains(&waits[1]), "{waits:?}");
    let lease = b.claim().await.unwrap();
    b.queue.fail(&lease, JobError::new("device", "lost"), Repeat::Counted).await.unwrap();
    assert_eq!(b.job(id).await.state, State::Failed);
}

pub async fn a_final_error_is_not_repeated(b: Bench) {
    let id = b.add().await;
    let lease = b.claim().await.unwrap();
    let mut error = JobError::new("diverged", "the loss is no number");
    error.losses.insert("rgb".into(), 1e9);
    b.queue.fail(&lease, error.clone(), Repeat::Never).await.unwrap();
    let job = b.job(id).await;
    assert_eq!((job.state, job.error), (State::Failed, Some(error)));
    assert!(job.finished_at.is_some());
}

pub async fn retry_gives_all_attempts_again(b: Bench) {
    let id = b.add().await;
    assert!(matches!(b.queue.retry(id).await.unwrap(), Change::Refused(_)), "a queued job needs none");
    let lease = b.claim().await.unwrap();
    b.queue.fail(&lease, JobError::new("bad-input", "no person"), Repeat::Never).await.unwrap();
    let Change::Done(job) = b.queue.retry(id).await.unwrap() else { panic!() };
    assert_eq!((job.state, job.attempt, job.error, job.finished_at), (State::Queued, 0, None, None));
    let again = b.claim().await.unwrap();
    assert_eq!(again.epoch, 2, "epochs never fall");
    assert!(matches!(b.queue.retry(Uuid::nil()).await.unwrap(), Change::Unknown));
}

pub async fn a_shutdown_gives_the_attempt_back(b: Bench) {
    let id = b.add().await;
    for epoch in 1..=5 {
        let lease = b.claim().await.unwrap();
        assert_eq!((lease.epoch, b.job(id).await.attempt), (epoch, 1));
        assert_eq!(b.queue.give_back(&lease).await.unwrap(), Standing::Held);
        assert_eq!(b.job(id).await.state, State::Queued);
    }
}

pub async fn a_dead_workers_jobs_are_released_at_once(b: Bench) {
    let (one, two) = (b.add().await, b.add().await);
    b.queue.claim("dead").await.unwrap().unwrap();
    b.queue.claim("alive").await.unwrap().unwrap();
    let mut owners = b.queue.owners().await.unwrap();
    owners.sort();
    assert_eq!(owners, ["alive", "dead"]);
    assert_eq!(b.queue.release_owner("dead").await.unwrap(), [one]);
    assert_eq!(b.job(one).await.state, State::Queued);
    assert_eq!(b.job(two).await.state, State::Running);
}
