//! `POST /v1/jobs`

use axum::Json;
use axum::extract::multipart::MultipartRejection;
use axum::extract::{Multipart, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};

use uuid::Uuid;

use super::upload::{Received, UploadForm, receive};
use super::view::JobView;
use crate::http::access::Caller;
use crate::http::app::{App, InspectError, Limits};
use crate::http::error::{ApiError, Problem};
use crate::jobs::{Clip, Job, NewJob, QueueError};

/// Upload a clip and queue the making of its avatar.
///
/// The parts stream to the disk and are checked against each other before the answer; the order of parts is free.
#[utoipa::path(
    post, path = "/v1/jobs", tag = "jobs",
    request_body(content = UploadForm, content_type = "multipart/form-data"),
    responses(
        (status = 202, description = "The job is queued", body = JobView,
            headers(("location" = String, description = "Where to ask for the job"))),
        (status = 400, description = "A part is missing, unknown or sent twice, or the options cannot be followed",
            body = Problem, content_type = "application/problem+json"),
        (status = 413, description = "Larger than the server takes", body = Problem,
            content_type = "application/problem+json"),
        (status = 415, description = "Not multipart/form-data", body = Problem,
            content_type = "application/problem+json"),
        (status = 422, description = "A part cannot be used, or the parts do not belong together", body = Problem,
            content_type = "application/problem+json"),
        (status = 429, description = "More than the caller's key allows", body = Problem,
            content_type = "application/problem+json"),
        (status = 507, description = "The server's disk is full", body = Problem,
            content_type = "application/problem+json"),
    )
)]
pub(super) async fn create(
    State(app): State<App>,
    caller: Caller,
    headers: HeaderMap,
    form: Result<Multipart, MultipartRejection>,
) -> Result<Response, ApiError> {
    let limits = allowance(&app, &caller).await?;
    refuse_by_length(&headers, limits.upload_bytes)?;
    let form = form.map_err(|e| match e {
        MultipartRejection::InvalidBoundary(e) => ApiError::MediaType(e.body_text()),
        other => ApiError::MediaType(other.body_text()),
    })?;
    let received = receive(form, &app.store, &limits).await?;
    let (received, clip) = inspect(&app, received).await?;
    let job = accept(app, caller.key_id(), received, clip).await?;
    let location = format!("/v1/jobs/{}", job.id);
    tracing::info!(job = %job.id, "accepted");
    Ok((StatusCode::ACCEPTED, [(header::LOCATION, location)], Json(JobView::from(job))).into_response())
}

/// The server's limits, narrowed to what the caller's key may still keep. The transaction that puts the job in decides;
/// this spares the caller a long upload in vain.
async fn allowance(app: &App, caller: &Caller) -> Result<Limits, ApiError> {
    let mut limits = app.limits.clone();
    if let (Some(key), Some(keys)) = (caller.key(), app.access.keys())
        && let Some(limit) = key.quota.max_bytes
    {
        let left = limit.saturating_sub(keys.kept_bytes(key.id).await?);
        if left == 0 {
            return Err(QueueError::Quota { what: "bytes kept", limit }.into());
        }
        limits.upload_bytes = limits.upload_bytes.min(left);
    }
    Ok(limits)
}

/// A client that tells the size beforehand need not send it all to learn that it is too much.
fn refuse_by_length(headers: &HeaderMap, limit_bytes: u64) -> Result<(), ApiError> {
    let length = headers.get(header::CONTENT_LENGTH).and_then(|value| value.to_str().ok()?.parse::<u64>().ok());
    match length {
        // The boundaries and headers of the parts come on top.
        Some(bytes) if bytes > limit_bytes.saturating_add(64 << 10) => {
            Err(ApiError::TooLarge { detail: format!("the upload has {bytes} bytes"), part: None, limit_bytes })
        }
        _ => Ok(()),
    }
}

async fn inspect(app: &App, received: Received) -> Result<(Received, Clip), ApiError> {
    let _permit = app.inspections.acquire().await.map_err(ApiError::internal)?;
    let inspector = app.inspector.clone();
    // The files go along, so that they outlive the look even where the client has gone away.
    let (received, clip) = tokio::task::spawn_blocking(move || {
        let clip = inspector.inspect(&received.files(), &received.options);
        (received, clip)
    })
    .await
    .map_err(ApiError::internal)?;
    let clip = clip.map_err(|error| match error {
        InspectError::Bad { part, frame, message, expected } => {
            ApiError::Input { detail: message, part, frame, expected }
        }
        InspectError::Internal(error) => ApiError::Internal(error),
    })?;
    Ok((received, clip))
}

/// Files first, then the row: a row's files are always there. Runs to its end even if the client goes away.
async fn accept(app: App, key: Option<Uuid>, received: Received, clip: Clip) -> Result<Job, ApiError> {
    let task = tokio::spawn(async move {
        let id = app.env.new_id();
        let Received { upload, inputs, options } = received;
        let store = app.store.clone();
        tokio::task::spawn_blocking(move || store.commit_upload(upload, id)).await.map_err(ApiError::internal)??;
        let queued = app.queue.insert(NewJob { id, key, options, inputs, clip }).await;
        if queued.is_err() {
            let store = app.store.clone();
            tokio::task::spawn_blocking(move || store.delete_job(id)).await.map_err(ApiError::internal)??;
        }
        Ok(queued?)
    });
    task.await.map_err(ApiError::internal)?
}
