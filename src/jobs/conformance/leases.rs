//! What the worker that has a job may tell of it.

use super::*;

pub async fn a_job_goes_through_its_life(b: Bench) {
    let id = b.add().await;
    assert_eq!((b.job(id).await.state, b.job(id).await.queue_position), (State::Queued, Some(1)));
    let (lease, job) = b.queue.claim("w").await.unwrap().unwrap();
    assert_eq!((job.id, job.state, job.attempt, job.epoch), (id, State::Running, 1, 1));
    assert_eq!(b.queue.report(&lease, &report(0.4)).await.unwrap(), Standing::Held);
    let job = b.job(id).await;
    assert_eq!((job.stage.as_deref(), job.step, job.steps, job.progress), (Some("geometry"), 3, 9, 0.4));
    assert_eq!((job.eta_secs, job.losses["rgb"]), (Some(60.0), 0.5));
    assert!(b.queue.avatar(id).await.unwrap().is_none());
    assert_eq!(b.queue.succeed(&lease, avatar()).await.unwrap(), Standing::Held);
    let job = b.job(id).await;
    assert_eq!((job.state, job.progress, job.owner), (State::Succeeded, 1.0, None));
    assert!(job.finished_at.is_some() && job.expires_at.is_some());
    let avatar = b.queue.avatar(id).await.unwrap().unwrap();
    assert_eq!((avatar.epoch, avatar.frames, avatar.files[0].name.as_str()), (1, 5, "avatar.glb"));
    assert_eq!(b.states(id).await, ["queued", "running", "succeeded"]);
    assert_eq!(b.queue.counts().await.unwrap()[&State::Succeeded], 1);
}

pub async fn a_picture_is_told_of_and_stays_until_the_files_go(b: Bench) {
    let id = b.add().await;
    let lease = b.claim().await.unwrap();
    assert_eq!(b.job(id).await.preview, None);
    let before = b.job(id).await.version;
    assert_eq!(b.queue.show(&lease, "1-1.jpg", &report(0.2)).await.unwrap(), Standing::Held);
    assert_eq!(b.queue.show(&lease, "1-2.jpg", &report(0.4)).await.unwrap(), Standing::Held);
    let job = b.job(id).await;
    assert_eq!((job.preview.as_deref(), job.version), (Some("1-2.jpg"), before + 2));
    let events = b.queue.events(id, 0, 1000).await.unwrap();
    let told: Vec<_> = events.iter().filter(|event| event.kind == EventKind::Preview).collect();
    assert_eq!((told.len(), &told[1].data["progress"], &told[1].data["stage"]), (2, &json!(0.4), &json!("geometry")));
    b.queue.succeed(&lease, avatar()).await.unwrap();
    assert_eq!(b.queue.show(&lease, "1-3.jpg", &report(0.9)).await.unwrap(), Standing::Lost);
    assert_eq!(b.job(id).await.preview.as_deref(), Some("1-2.jpg"), "a thumbnail of the avatar");
    b.clock.advance(Duration::from_secs(2 * 3600));
    b.queue.reap().await.unwrap();
    assert_eq!((b.job(id).await.state, b.job(id).await.preview), (State::Expired, None));
}

pub async fn a_stale_epoch_writes_nothing(b: Bench) {
    let id = b.add().await;
    let stale = b.claim().await.unwrap();
    b.clock.advance(Duration::from_secs(61));
    assert_eq!(b.queue.reap().await.unwrap().reclaimed, [id]);
    b.clock.advance(Duration::from_secs(10));
    let fresh = b.claim().await.unwrap();
    assert_eq!((fresh.job, fresh.epoch), (id, 2));
    let before = b.job(id).await.version;
    assert_eq!(b.queue.standing(&stale).await.unwrap(), Standing::Lost);
    assert_eq!(b.queue.heartbeat(&stale).await.unwrap(), Standing::Lost);
    assert_eq!(b.queue.report(&stale, &report(0.9)).await.unwrap(), Standing::Lost);
    assert_eq!(b.queue.saved(&stale, 0.9).await.unwrap(), Standing::Lost);
    assert_eq!(b.queue.add_stage_time(&stale, "bake", 1.0).await.unwrap(), Standing::Lost);
    assert_eq!(b.queue.succeed(&stale, avatar()).await.unwrap(), Standing::Lost);
    assert_eq!(b.queue.fail(&stale, JobError::new("internal", "x"), Repeat::Counted).await.unwrap(), Standing::Lost);
    assert_eq!(b.queue.give_back(&stale).await.unwrap(), Standing::Lost);
    assert_eq!(b.queue.confirm_cancel(&stale).await.unwrap(), Standing::Lost);
    assert_eq!(b.job(id).await.version, before);
    assert!(b.queue.avatar(id).await.unwrap().is_none() && b.queue.stage_times().await.unwrap().is_empty());
    assert_eq!(b.queue.succeed(&fresh, avatar()).await.unwrap(), Standing::Held);
    assert_eq!(b.queue.avatar(id).await.unwrap().unwrap().epoch, 2);
}

pub async fn a_finished_lease_writes_nothing(b: Bench) {
    b.add().await;
    let lease = b.claim().await.unwrap();
    b.queue.succeed(&lease, avatar()).await.unwrap();
    assert_eq!(b.queue.heartbeat(&lease).await.unwrap(), Standing::Lost);
    assert_eq!(b.queue.succeed(&lease, avatar()).await.unwrap(), Standing::Lost);
    assert_eq!(b.queue.fail(&lease, JobError::new("internal", "x"), Repeat::Counted).await.unwrap(), Standing::Lost);
}

pub async fn heartbeats_and_progress_keep_the_lease(b: Bench) {
    let id = b.add().await;
    let lease = b.claim().await.unwrap();
    for _ in 0..3 {
        b.clock.advance(Duration::from_secs(50));
        assert_eq!(b.queue.heartbeat(&lease).await.unwrap(), Standing::Held);
        b.clock.advance(Duration::from_secs(50));
        assert_eq!(b.queue.report(&lease, &report(0.1)).await.unwrap(), Standing::Held);
        assert_eq!(b.queue.reap().await.unwrap(), Reaped::default());
    }
    assert_eq!(b.job(id).await.attempt, 1);
}

pub async fn events_go_on_after_the_last_one_seen(b: Bench) {
    let id = b.add().await;
    let other = b.add().await;
    let lease = b.claim().await.unwrap();
    for i in 1..=4 {
        b.queue.report(&lease, &report(f64::from(i) / 10.0)).await.unwrap();
    }
    let all = b.queue.events(id, 0, 100).await.unwrap();
    assert_eq!(all.len(), 6);
    assert!(all.windows(2).all(|pair| pair[0].id < pair[1].id));
    let rest = b.queue.events(id, all[2].id, 100).await.unwrap();
    assert_eq!(rest, all[3..]);
    assert_eq!(b.queue.last_event().await.unwrap(), all[5].id);
    assert_eq!(b.queue.events(other, 0, 100).await.unwrap().len(), 1);
}

pub async fn losses_that_are_no_numbers_are_left_out(b: Bench) {
    let id = b.add().await;
    let lease = b.claim().await.unwrap();
    let mut bad = report(f64::NAN);
    bad.losses.insert("mask".into(), f64::INFINITY);
    bad.eta_secs = Some(f64::NAN);
    assert_eq!(b.queue.report(&lease, &bad).await.unwrap(), Standing::Held);
    let job = b.job(id).await;
    assert_eq!((job.progress, job.eta_secs, job.losses.len()), (0.0, None, 1));
}

pub async fn stage_times_add_up(b: Bench) {
    b.add().await;
    let lease = b.claim().await.unwrap();
    for secs in [1.5, 2.0] {
        b.queue.add_stage_time(&lease, "texture", secs).await.unwrap();
    }
    let times = b.queue.stage_times().await.unwrap();
    assert_eq!(times, [StageTime { stage: "texture".into(), jobs: 1, secs: 3.5 }]);
}
