//! Figures for Prometheus. Requests are counted as they pass; jobs are counted in the database when asked for, so that
//! they are right whichever process worked on them.

use std::collections::BTreeMap;
use std::sync::OnceLock;
use std::time::{Duration, Instant};

use axum::extract::{MatchedPath, Request};
use axum::http::Method;
use axum::middleware::Next;
use axum::response::Response;
use metrics::{counter, describe_counter, describe_gauge, describe_histogram, gauge, histogram};
use metrics_exporter_prometheus::{PrometheusBuilder, PrometheusHandle};

use crate::jobs::{JobError, Queue, QueueError, State};

const UPKEEP: Duration = Duration::from_secs(5);
/// Seconds.
const BUCKETS: [f64; 9] = [0.001, 0.005, 0.02, 0.05, 0.1, 0.5, 2.0, 10.0, 60.0];

/// The recorder is the process's, so it is made once.
fn recorder() -> Option<&'static PrometheusHandle> {
    static HANDLE: OnceLock<Option<PrometheusHandle>> = OnceLock::new();
    let handle = HANDLE.get_or_init(|| {
        let built = PrometheusBuilder::new().set_buckets(&BUCKETS).and_then(PrometheusBuilder::install_recorder);
        match built {
            Ok(handle) => {
                describe();
                Some(handle)
            }
            Err(error) => {
                tracing::error!(%error, "there will be no figures");
                None
            }
        }
    });
    handle.as_ref()
}

fn describe() {
    describe_gauge!("effigy_jobs", "Jobs in each state");
    describe_gauge!("effigy_queue_depth", "Jobs that wait for a worker");
    describe_gauge!("effigy_stage_jobs_total", "Jobs that went through a stage");
    describe_gauge!("effigy_stage_seconds_total", "Seconds that jobs spent in a stage");
    describe_gauge!("effigy_failed_jobs", "Failed jobs that are kept, by the type of their error");
    describe_gauge!(
        "effigy_queue_oldest_seconds",
        "How long the oldest waiting job has waited, since it was queued or queued again"
    );
    describe_gauge!("effigy_queue_wait_seconds_sum", "Seconds from creation to first claim, of all jobs that are kept");
    describe_gauge!("effigy_queue_wait_seconds_count", "Jobs that are kept and were ever claimed");
    describe_gauge!("effigy_device_peak_bytes", "The most device memory that a fit of the last day took");
    describe_gauge!("effigy_webhook_deliveries_waiting", "Webhook messages that wait for an attempt");
    describe_counter!("effigy_http_requests_total", "Answered requests");
    describe_histogram!("effigy_http_request_seconds", "Time from a request to the head of its answer");
}

pub(super) fn install() {
    recorder();
}

/// Sums up, for ever, what was counted: until then each request takes a little memory, and nobody may ever ask for the figures.
pub(super) async fn upkeep() {
    loop {
        tokio::time::sleep(UPKEEP).await;
        if let Some(recorder) = recorder() {
            recorder.run_upkeep();
        }
    }
}

/// Middleware: counts an answer under the route's pattern, never under the client's path.
pub(super) async fn count(request: Request, next: Next) -> Response {
    let route = request.extensions().get::<MatchedPath>().map_or("none", MatchedPath::as_str).to_string();
    let method = method_label(request.method());
    let start = Instant::now();
    let response = next.run(request).await;
    histogram!("effigy_http_request_seconds", "method" => method, "route" => route.clone())
        .record(start.elapsed().as_secs_f64());
    let status = response.status().as_u16().to_string();
    counter!("effigy_http_requests_total", "method" => method, "route" => route, "status" => status).increment(1);
    response
}

/// HTTP lets clients make up methods, and each would make series that are never forgotten.
fn method_label(method: &Method) -> &'static str {
    const KNOWN: [&str; 7] = ["GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"];
    KNOWN.into_iter().find(|known| *known == method.as_str()).unwrap_or("other")
}

/// The text of all figures, those of the jobs freshly counted.
pub(super) async fn scrape(queue: &dyn Queue) -> Result<String, QueueError> {
    for (state, jobs) in queue.counts().await? {
        gauge!("effigy_jobs", "state" => state.name()).set(jobs as f64);
        if state == State::Queued {
            gauge!("effigy_queue_depth").set(jobs as f64);
        }
    }
    for time in queue.stage_times().await? {
        // Of the jobs that are there, as the times are: deletions lower both, which a counter cannot follow.
        gauge!("effigy_stage_jobs_total", "stage" => time.stage.clone()).set(time.jobs as f64);
        gauge!("effigy_stage_seconds_total", "stage" => time.stage).set(time.secs);
    }
    let figures = queue.figures().await?;
    // All types each time: where the last failed job of a type is deleted or retried, its gauge would else stay.
    let mut failed: BTreeMap<_, _> = JobError::KINDS.iter().map(|kind| (kind.to_string(), 0)).collect();
    failed.extend(figures.failed);
    for (kind, jobs) in failed {
        gauge!("effigy_failed_jobs", "type" => kind).set(jobs as f64);
    }
    gauge!("effigy_queue_oldest_seconds").set(figures.oldest_secs);
    gauge!("effigy_queue_wait_seconds_sum").set(figures.waited_secs);
    gauge!("effigy_queue_wait_seconds_count").set(figures.started as f64);
    gauge!("effigy_device_peak_bytes").set(figures.device_peak_bytes.unwrap_or(0) as f64);
    gauge!("effigy_webhook_deliveries_waiting").set(figures.deliveries as f64);
    Ok(recorder().map(PrometheusHandle::render).unwrap_or_default())
}
