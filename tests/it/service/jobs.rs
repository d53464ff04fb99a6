//! `/v1/jobs` beyond the upload.

use effigy::jobs::{JobError, ProgressReport, Repeat};

use super::*;

#[tokio::test]
async fn the_figures_tell_waits_failures_and_what_is_undelivered() {
    let clock = effigy::jobs::ManualClock::new(effigy::jobs::Timestamp(1_700_000_000_000));
    let bench = Bench::with(Limits::default(), Policy::default(), 0, Env::new(clock.clone(), 1)).await;
    assert_eq!(bench.queue.figures().await.unwrap(), effigy::jobs::Figures::default());
    bench.add_job().await;
    let waiting = bench.add_job().await;
    clock.advance(std::time::Duration::from_secs(30));
    let lease = bench.claim().await;
    bench.queue.fail(&lease, JobError::new("diverged", "offsets"), effigy::jobs::Repeat::Never).await.unwrap();
    clock.advance(std::time::Duration::from_secs(12));
    let figures = bench.queue.figures().await.unwrap();
    assert_eq!((figures.failed, figures.started), (vec![("diverged".to_string(), 1)], 1));
    assert_eq!((figures.waited_secs, figures.oldest_secs, figures.deliveries), (30.0, 42.0, 0));
    // What is queued again has waited since then.
    bench.queue.cancel(waiting).await.unwrap();
    clock.advance(std::time::Duration::from_secs(100));
    bench.queue.retry(waiting).await.unwrap();
    clock.advance(std::time::Duration::from_secs(3));
    assert_eq!(bench.queue.figures().await.unwrap().oldest_secs, 3.0);
    let text = String::from_utf8(bench.get("/metrics").await.body).unwrap();
    for name in [
        "effigy_failed_jobs{type=\"diverged\"}",
        "effigy_queue_oldest_seconds",
        "effigy_queue_wait_seconds_sum",
        "effigy_device_peak_bytes",
        "effigy_webhook_deliveries_waiting",
    ] {
        assert!(text.contains(&format!("\n{name} ")), "{name}: {text}");
    }
}

#[tokio::test]
async fn methods_that_clients_make_up_share_a_figure() {
    let bench = Bench::new().await;
    for method in ["WALK", "RUN"] {
        let method = Method::from_bytes(method.as_bytes()).unwrap();
        bench.call(method, "/healthz", &[], Body::empty()).await.problem(405);
    }
    let text = String::from_utf8(bench.get("/metrics").await.body).unwrap();
    assert!(!text.contains("WALK") && !text.contains("RUN"), "{text}");
    let series = "effigy_http_requests_total{method=\"other\",route=\"/healthz\",status=\"405\"} ";
    assert_eq!(text.lines().filter(|line| line.starts_with(series)).count(), 1, "{text}");
}

/// In a process of its own: figures are a process's.
#[tokio::test(flavor = "multi_thread")]
async fn failures_are_counted_until_their_jobs_are_gone() {
    let folder = tempfile::tempdir().unwrap();
    let serve = super::process::Serve::start(folder.path(), &["--workers", "0"]);
    let bench = Bench::on(folder.path().to_path_buf()).await;
    let id = bench.add_job().await;
    let lease = bench.claim().await;
    bench.queue.fail(&lease, JobError::new("unfit", "no person"), effigy::jobs::Repeat::Never).await.unwrap();
    let client = client();
    for count in ["1", "0"] {
        let text = client.get(format!("{}/metrics", serve.url)).send().await.unwrap().text().await.unwrap();
        for kind in JobError::KINDS {
            let count = if kind == "unfit" { count } else { "0" };
            assert!(text.contains(&format!("\neffigy_failed_jobs{{type=\"{kind}\"}} {count}\n")), "{kind}: {text}");
        }
        client.delete(format!("{}/v1/jobs/{id}", serve.url)).send().await.unwrap();
    }
}

#[tokio::test]
async fn a_job_tells_its_progress() {
    let bench = Bench::new().await;
    let id = bench.add_job().await;
    let lease = bench.claim().await;
    let report = ProgressReport {
        stage: "texture".into(),
        step: 20,
        steps: 100,
        progress: 0.7,
        eta_secs: Some(33.5),
        losses: BTreeMap::from([("rgb".to_string(), 0.02)]),
    };
    bench.queue.report(&lease, &report).await.unwrap();
    let reply = bench.get(&format!("/v1/jobs/{id}")).await;
    assert_eq!(reply.header("retry-after"), "1");
    let job = reply.json();
    assert_eq!((&job["state"], &job["stage"], &job["step"]), (&json!("running"), &json!("texture"), &json!(20)));
    assert_eq!((&job["steps"], &job["progress"], &job["eta_secs"]), (&json!(100), &json!(0.7), &json!(33.5)));
    assert_eq!((&job["losses"], &job["queue_position"]), (&json!({ "rgb": 0.02 }), &Value::Null));
    assert!(job["started_at"].as_str().unwrap().ends_with('Z'));
}

#[tokio::test]
async fn an_unchanged_job_is_304() {
    let bench = Bench::new().await;
    let id = bench.add_job().await;
    let path = format!("/v1/jobs/{id}");
    let etag = bench.get(&path).await.header("etag").to_string();
    let ask = [("if-none-match", etag.as_str())];
    let reply = bench.call(Method::GET, &path, &ask, Body::empty()).await;
    assert_eq!((reply.status.as_u16(), reply.body.len()), (304, 0));
    bench.claim().await;
    let reply = bench.call(Method::GET, &path, &ask, Body::empty()).await;
    assert_eq!(reply.status, 200);
    assert_ne!(reply.header("etag"), etag);
}

#[tokio::test]
async fn the_list_filters_and_pages() {
    let bench = Bench::new().await;
    let mut ids = Vec::new();
    for _ in 0..3 {
        ids.push(bench.add_job().await);
        tokio::time::sleep(std::time::Duration::from_millis(2)).await;
    }
    bench.post(&format!("/v1/jobs/{}/cancel", ids[0])).await;
    let page = bench.get("/v1/jobs?limit=2").await.json();
    let listed = |page: &Value| -> Vec<String> {
        page["jobs"].as_array().unwrap().iter().map(|job| job["id"].as_str().unwrap().to_string()).collect()
    };
    assert_eq!(listed(&page), [ids[2].to_string(), ids[1].to_string()]);
    let next = bench.get(&format!("/v1/jobs?limit=2&cursor={}", page["next"].as_str().unwrap())).await.json();
    assert_eq!((listed(&next), &next["next"]), (vec![ids[0].to_string()], &Value::Null));
    assert_eq!(listed(&bench.get("/v1/jobs?state=canceled").await.json()), [ids[0].to_string()]);
    let middle = bench.get(&format!("/v1/jobs/{}", ids[1])).await.json()["created_at"].as_str().unwrap().to_string();
    let both = [ids[2].to_string(), ids[1].to_string()];
    assert_eq!(listed(&bench.get(&format!("/v1/jobs?created_from={middle}")).await.json()), both);
    assert_eq!(listed(&bench.get(&format!("/v1/jobs?created_before={middle}")).await.json()), [ids[0].to_string()]);
    let paged = format!("/v1/jobs?created_from={middle}&limit=1&cursor={}", ids[2]);
    assert_eq!(listed(&bench.get(&paged).await.json()), both[1..]);
    for query in ["state=lost", "limit=0", "limit=1000", "cursor=x", "color=red", "created_from=yesterday"] {
        bench.get(&format!("/v1/jobs?{query}")).await.problem(400);
    }
}

#[tokio::test]
async fn cancel_retry_and_delete_follow_the_states() {
    let bench = Bench::new().await;
    let id = bench.add_job().await;
    let path = format!("/v1/jobs/{id}");
    bench.post(&format!("{path}/retry")).await.problem(409);
    let reply = bench.post(&format!("{path}/cancel")).await;
    assert_eq!((reply.status.as_u16(), &reply.json()["state"]), (200, &json!("canceled")));
    let reply = bench.post(&format!("{path}/retry")).await;
    assert_eq!((reply.status.as_u16(), &reply.json()["state"]), (202, &json!("queued")));
    let lease = bench.claim().await;
    let reply = bench.post(&format!("{path}/cancel")).await;
    assert_eq!((reply.status.as_u16(), &reply.json()["state"]), (202, &json!("canceling")));
    bench.queue.confirm_cancel(&lease).await.unwrap();
    assert_eq!(bench.call(Method::DELETE, &path, &[], Body::empty()).await.status, 204);
    bench.get(&path).await.problem(404);
    bench.assert_empty();
}

#[tokio::test]
async fn deleting_a_running_job_is_accepted() {
    let bench = Bench::new().await;
    let id = bench.add_job().await;
    bench.claim().await;
    let path = format!("/v1/jobs/{id}");
    assert_eq!(bench.call(Method::DELETE, &path, &[], Body::empty()).await.status, 202);
    assert_eq!(bench.get(&path).await.json()["state"], "canceling");
}

#[tokio::test]
async fn a_failed_job_tells_why() {
    let bench = Bench::new().await;
    let id = bench.add_job().await;
    let lease = bench.claim().await;
    let mut error = JobError::new("diverged", "the offsets are not finite");
    error.losses.insert("rgb".into(), 12.0);
    bench.queue.fail(&lease, error, Repeat::Never).await.unwrap();
    let job = bench.get(&format!("/v1/jobs/{id}")).await.json();
    assert_eq!((&job["state"], &job["avatar"]), (&json!("failed"), &Value::Null));
    let error = json!({ "type": "diverged", "detail": "the offsets are not finite", "losses": { "rgb": 12.0 } });
    assert_eq!(job["error"], error);
    bench.get(&format!("/v1/avatars/{id}")).await.problem(404);
    bench.post(&format!("/v1/jobs/{id}/cancel")).await.problem(409);
}

#[tokio::test]
async fn unknown_ids_and_paths_are_problems() {
    let bench = Bench::new().await;
    let id = Uuid::nil();
    for path in [format!("/v1/jobs/{id}"), "/v1/jobs/abc".into(), format!("/v1/jobs/{id}/events"), "/v1/nothing".into()]
    {
        bench.get(&path).await.problem(404);
    }
    for path in [format!("/v1/jobs/{id}/cancel"), "/v1/jobs/x/retry".into()] {
        bench.post(&path).await.problem(404);
    }
    bench.call(Method::DELETE, &format!("/v1/jobs/{id}"), &[], Body::empty()).await.problem(404);
    bench.call(Method::PUT, "/v1/jobs", &[], Body::empty()).await.problem(405);
}

#[tokio::test]
async fn the_services_own_state_is_told() {
    let bench = Bench::new().await;
    bench.add_job().await;
    assert_eq!(bench.get("/healthz").await.body, b"ok\n");
    let ready = bench.get("/readyz").await;
    assert_eq!(ready.status, 200);
    assert!(!ready.header("x-request-id").is_empty());
    for body in std::fs::read_dir(bench.store.bodies()).unwrap() {
        std::fs::remove_file(body.unwrap().path()).unwrap();
    }
    let without_body = bench.get("/readyz").await;
    assert!(String::from_utf8_lossy(&without_body.body).contains("there is no body"));
    without_body.problem(503);
    let figures = String::from_utf8(bench.get("/metrics").await.body).unwrap();
    for line in ["effigy_jobs{state=\"queued\"}", "effigy_queue_depth", "effigy_http_requests_total{"] {
        assert!(figures.contains(line), "{line} is not in\n{figures}");
    }
}
