//! `/v1/jobs/{id}` and the wishes about it.

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};

use super::view::JobView;
use crate::http::App;
use crate::http::error::{ApiError, Problem};
use crate::http::extract::{ApiPath, parse_id, unknown};
use crate::http::files::matches_etag;
use crate::jobs::{self, Change, Deletion, Job, QueueError};

/// Ask how a job stands.
///
/// Send the `ETag` of the last answer as `If-None-Match` to learn cheaply that nothing changed.
#[utoipa::path(
    get, path = "/v1/jobs/{id}", tag = "jobs",
    params(
        ("id" = String, Path, description = "The job's id"),
        ("if-none-match" = Option<String>, Header, description = "The `ETag` of the last answer"),
    ),
    responses(
        (status = 200, description = "The job", body = JobView, headers(
            ("etag" = String, description = "Changes with the job"),
            ("retry-after" = u32, description = "Seconds after which to ask again; absent once the job has ended"))),
        (status = 304, description = "The job is as it was"),
        (status = 404, description = "No such job", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get(
    State(app): State<App>,
    ApiPath(id): ApiPath<String>,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let job = app.queue.get(parse_id("job", &id)?).await?.ok_or_else(|| unknown("job", id))?;
    // The place in the queue changes without the job.
    let etag = format!("\"{}.{}\"", job.version, job.queue_position.unwrap_or(0));
    let hint = retry_after(&job).map(|secs| [(header::RETRY_AFTER, secs.to_string())]);
    let tags = [(header::ETAG, etag.clone()), (header::CACHE_CONTROL, "no-cache".into())];
    if matches_etag(&headers, &etag) {
        return Ok((StatusCode::NOT_MODIFIED, tags, hint, ()).into_response());
    }
    Ok((tags, hint, Json(JobView::from(job))).into_response())
}

/// Seconds after which asking again may tell something new.
fn retry_after(job: &Job) -> Option<u32> {
    match job.state {
        jobs::State::Running | jobs::State::Canceling => Some(1),
        jobs::State::Queued => Some(job.queue_position.unwrap_or(1).min(30) as u32),
        _ => None,
    }
}

/// Stop a job.
///
/// A queued job is canceled at once; a running one stops between two steps of its fit and keeps its checkpoint.
#[utoipa::path(
    post, path = "/v1/jobs/{id}/cancel", tag = "jobs", params(("id" = String, Path, description = "The job's id")),
    responses(
        (status = 200, description = "The job is canceled", body = JobView),
        (status = 202, description = "The job's worker will stop soon", body = JobView),
        (status = 404, description = "No such job", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "The job has ended otherwise", body = Problem,
            content_type = "application/problem+json"),
    )
)]
pub(super) async fn cancel(State(app): State<App>, ApiPath(id): ApiPath<String>) -> Result<Response, ApiError> {
    let job = done(app.queue.cancel(parse_id("job", &id)?).await?, "canceled", id)?;
    let status = if job.state.is_final() { StatusCode::OK } else { StatusCode::ACCEPTED };
    Ok((status, Json(JobView::from(job))).into_response())
}

/// Queue a failed or canceled job again, with all its attempts; it goes on from its checkpoint.
///
/// Its deadline, where it has one, counts from now on again.
#[utoipa::path(
    post, path = "/v1/jobs/{id}/retry", tag = "jobs", params(("id" = String, Path, description = "The job's id")),
    responses(
        (status = 202, description = "The job is queued again", body = JobView),
        (status = 404, description = "No such job", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "The job did not fail and was not canceled", body = Problem,
            content_type = "application/problem+json"),
        (status = 429, description = "The queue, or the key's share of it, is full, or there are too many requests a minute", body = Problem,
            content_type = "application/problem+json"),
    )
)]
pub(super) async fn retry(State(app): State<App>, ApiPath(id): ApiPath<String>) -> Result<Response, ApiError> {
    let job = done(app.queue.retry(parse_id("job", &id)?).await?, "retried", id)?;
    Ok((StatusCode::ACCEPTED, Json(JobView::from(job))).into_response())
}

/// Delete a job with its avatar and all its files.
///
/// A running job is canceled first and vanishes when its worker has let go of it.
#[utoipa::path(
    delete, path = "/v1/jobs/{id}", tag = "jobs", params(("id" = String, Path, description = "The job's id")),
    responses(
        (status = 202, description = "The job is stopping and will vanish"),
        (status = 204, description = "The job is gone"),
        (status = 404, description = "No such job", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn delete(State(app): State<App>, ApiPath(id): ApiPath<String>) -> Result<StatusCode, ApiError> {
    let job = parse_id("job", &id)?;
    // To its end, even if the client goes away: no row means no files. What a crash leaves behind, the next start removes.
    let deletion = tokio::spawn(async move {
        let deletion = app.store.despite_full_disk(QueueError::is_disk_full, || app.queue.delete(job)).await?;
        if deletion == Deletion::Gone {
            let store = app.store.clone();
            let removed = tokio::task::spawn_blocking(move || {
                store.delete_job(job)?;
                // At once: the next deletion may not wait for the reaper.
                store.reload_ballast();
                std::io::Result::Ok(())
            });
            removed.await.map_err(ApiError::internal)??;
        }
        Ok::<_, ApiError>(deletion)
    });
    match deletion.await.map_err(ApiError::internal)?? {
        Deletion::Unknown => Err(unknown("job", id)),
        Deletion::Pending => Ok(StatusCode::ACCEPTED),
        Deletion::Gone => Ok(StatusCode::NO_CONTENT),
    }
}

fn done(change: Change, wish: &'static str, id: String) -> Result<Job, ApiError> {
    match change {
        Change::Done(job) => Ok(job),
        Change::Refused(job) => Err(ApiError::Conflict { state: job.state, wish }),
        Change::Full => Err(ApiError::QueueFull),
        Change::Unknown => Err(unknown("job", id)),
    }
}
