//! What users and the policy wish: cancellation, deletion, retention.

use super::*;

pub async fn cancel_of_a_queued_job_is_immediate(b: Bench) {
    let id = b.add().await;
    let Change::Done(job) = b.queue.cancel(id).await.unwrap() else { panic!() };
    assert_eq!(job.state, State::Canceled);
    assert!(job.finished_at.is_some());
    assert!(matches!(b.queue.cancel(id).await.unwrap(), Change::Done(_)), "twice is once");
    assert_eq!(b.states(id).await, ["queued", "canceled"]);
    assert_eq!(b.claim().await, None);
}

pub async fn cancel_of_a_running_job_reaches_its_worker(b: Bench) {
    let id = b.add().await;
    let lease = b.claim().await.unwrap();
    let Change::Done(job) = b.queue.cancel(id).await.unwrap() else { panic!() };
    assert_eq!(job.state, State::Canceling);
    assert_eq!(b.queue.standing(&lease).await.unwrap(), Standing::Canceling);
    assert_eq!(b.queue.heartbeat(&lease).await.unwrap(), Standing::Canceling);
    assert_eq!(b.queue.report(&lease, &report(0.5)).await.unwrap(), Standing::Canceling);
    b.queue.confirm_cancel(&lease).await.unwrap();
    assert_eq!(b.job(id).await.state, State::Canceled);
    assert_eq!(b.states(id).await, ["queued", "running", "canceling", "canceled"]);
}

pub async fn a_canceling_job_whose_worker_dies_is_canceled(b: Bench) {
    let id = b.add().await;
    b.claim().await.unwrap();
    b.queue.cancel(id).await.unwrap();
    b.clock.advance(Duration::from_secs(61));
    b.queue.reap().await.unwrap();
    assert_eq!(b.job(id).await.state, State::Canceled);
}

pub async fn cancel_that_comes_too_late_is_refused(b: Bench) {
    let id = b.add().await;
    let lease = b.claim().await.unwrap();
    b.queue.cancel(id).await.unwrap();
    assert_eq!(b.queue.succeed(&lease, avatar()).await.unwrap(), Standing::Held, "the work was done");
    assert!(matches!(b.queue.cancel(id).await.unwrap(), Change::Refused(job) if job.state == State::Succeeded));
    assert!(matches!(b.queue.cancel(Uuid::nil()).await.unwrap(), Change::Unknown));
}

pub async fn deletion_waits_for_the_worker(b: Bench) {
    let idle = b.add().await;
    assert_eq!(b.queue.delete(idle).await.unwrap(), Deletion::Gone);
    assert_eq!(b.queue.delete(idle).await.unwrap(), Deletion::Unknown);
    assert!(b.queue.get(idle).await.unwrap().is_none());
    assert!(b.queue.events(idle, 0, 10).await.unwrap().is_empty());

    let busy = b.add().await;
    let lease = b.claim().await.unwrap();
    assert_eq!(b.queue.delete(busy).await.unwrap(), Deletion::Pending);
    assert_eq!(b.queue.standing(&lease).await.unwrap(), Standing::Canceling);
    assert!(b.queue.reap().await.unwrap().deleted.is_empty());
    b.queue.confirm_cancel(&lease).await.unwrap();
    assert!(matches!(b.queue.retry(busy).await.unwrap(), Change::Refused(_)), "it is on its way out");
    assert_eq!(b.queue.reap().await.unwrap().deleted, [busy]);
    assert!(b.queue.get(busy).await.unwrap().is_none());
}

pub async fn retention_removes_the_avatar_and_keeps_the_job(b: Bench) {
    let id = b.add().await;
    let lease = b.claim().await.unwrap();
    b.queue.report(&lease, &report(0.5)).await.unwrap();
    b.queue.succeed(&lease, avatar()).await.unwrap();
    b.clock.advance(Duration::from_secs(3599));
    assert_eq!(b.queue.reap().await.unwrap(), Reaped::default());
    assert!(b.queue.events(id, 0, 100).await.unwrap().iter().any(|event| event.kind != EventKind::State));
    b.clock.advance(Duration::from_secs(1));
    assert_eq!(b.queue.reap().await.unwrap().expired, [id]);
    assert_eq!(b.job(id).await.state, State::Expired);
    assert!(b.queue.avatar(id).await.unwrap().is_none());
    assert!(b.queue.events(id, 0, 100).await.unwrap().iter().all(|event| event.kind == EventKind::State));
    assert_eq!(b.states(id).await, ["queued", "running", "succeeded", "expired"]);
    assert_eq!(b.queue.reap().await.unwrap(), Reaped::default());
    assert!(matches!(b.queue.retry(id).await.unwrap(), Change::Refused(_)), "its inputs are gone");
}
