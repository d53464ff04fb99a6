//! `POST /v1/jobs`

use std::time::Duration;

use axum::body::to_bytes;
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use uuid::Uuid;

use super::form::Form;
use super::upload::{JobOfUploads, Received, UploadForm, Used, receive, receive_json};
use super::view::JobView;
use crate::http::access::{BytesLeft, Caller};
use crate::http::app::{App, InspectError, Limits};
use crate::http::error::{ApiError, Problem};
use crate::http::pace::Lateness;
use crate::http::uploads::promised;
use crate::jobs::{Clip, Insertion, Job, NewJob, QueueError, Remember, Remembered};

/// How long a clip waits for others that are looked at.
const INSPECTION_WAIT: Duration = Duration::from_secs(120);
/// A JSON body names its parts only.
const JSON_LIMIT_BYTES: usize = 64 << 10;

/// Upload a clip and queue the making of its avatar.
///
/// The parts stream to the disk and are checked against each other before the answer; the order of parts is free. Parts
/// may be finished uploads of `/v1/uploads` instead.
///
/// With an `Idempotency-Key`, sending the same request again within 24 hours gives the first answer again and no second
/// job, however often and whenever it is sent.
#[utoipa::path(
    post, path = "/v1/jobs", tag = "jobs",
    params(("idempotency-key" = Option<String>, Header, description = "A name of the client's own for this request")),
    request_body(content((UploadForm = "multipart/form-data"), (JobOfUploads = "application/json"))),
    responses(
        (status = 202, description = "The job is queued", body = JobView,
            headers(
                ("location" = String, description = "Where to ask for the job"),
                ("idempotency-replayed" = String, description = "true where this is the answer to an earlier request"))),
        (status = 400, description = "A part is missing, unknown or sent twice, or the options cannot be followed",
            body = Problem, content_type = "application/problem+json"),
        (status = 413, description = "Larger than the server takes", body = Problem,
            content_type = "application/problem+json"),
        (status = 415, description = "Neither multipart/form-data nor application/json", body = Problem,
            content_type = "application/problem+json"),
        (status = 422, description = "A part cannot be used, the parts do not belong together, or the idempotency key was \
            given with another request", body = Problem,
            content_type = "application/problem+json"),
        (status = 429, description = "So many jobs wait that no more are taken, or more than the caller's key allows", body = Problem,
            content_type = "application/problem+json", headers(("retry-after" = u32, description = "Seconds"))),
        (status = 503, description = "Other clips are being looked at, or another request uses an upload; try again",
            body = Problem, content_type = "application/problem+json"),
        (status = 507, description = "The server's disk has no room but its reserve", body = Problem,
            content_type = "application/problem+json"),
    )
)]
pub(super) async fn create(State(app): State<App>, caller: Caller, request: Request) -> Result<Response, ApiError> {
    let headers = request.headers().clone();
    let key = idempotency_key(&headers, &caller)?;
    let is_known = match &key {
        Some(key) => app.queue.remembered(key).await?.is_some(),
        None => false,
    };
    // A repeated request makes no second job: it needs no place in the queue and nothing of the quota.
    let quota = if is_known { None } else { left_of_quota(&app, &caller).await? };
    let limits = match &quota {
        Some(quota) => Limits { upload_bytes: app.limits.upload_bytes.min(quota.left), ..app.limits.clone() },
        None => app.limits.clone(),
    };
    let blame = |error| blame_quota(error, quota.as_ref(), &limits);
    refuse_by_length(&headers, limits.upload_bytes).map_err(blame)?;
    refuse_without_room(&app, &headers, is_known).await?;
    let mut received = read(&app, request, &limits, key.is_some()).await.map_err(blame)?;
    let remember = key.map(|key| Remember { key, fingerprint: received.fingerprint(), answer });
    // Requests under one key go one after the other: the first makes the job, the others find its answer.
    let mut _lock = None;
    if let Some(remember) = &remember {
        _lock = Some(app.keys.lock(&remember.key).await);
        if let Some(known) = app.queue.remembered(&remember.key).await? {
            return replay(remember, known);
        }
    }
    let used = received.adopt(&app, &caller, &limits).await.map_err(blame)?;
    refuse_beyond_promises(&app, &caller, &received, &used).await?;
    let (received, clip) = inspect(&app, received).await?;
    match accept(app, caller.key_id(), received, clip, remember.clone(), used).await? {
        Insertion::Queued(job) => {
            tracing::info!(job = %job.id, "accepted");
            accepted(answer(&job))
        }
        Insertion::Known(known) => match &remember {
            Some(remember) => replay(remember, known),
            None => Err(ApiError::internal(anyhow::anyhow!("a request without a key was known"))),
        },
        Insertion::Full => Err(ApiError::QueueFull),
    }
}

/// Whether a request names finished uploads, instead of bringing the files.
fn is_json(headers: &HeaderMap) -> bool {
    let kind = headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or("");
    kind.split(';').next().is_some_and(|kind| kind.trim().eq_ignore_ascii_case("application/json"))
}

/// The body, on the disk.
async fn read(app: &App, request: Request, limits: &Limits, hash: bool) -> Result<Received, ApiError> {
    let lateness = request.extensions().get::<Lateness>().cloned().unwrap_or_default();
    if is_json(request.headers()) {
        let too_much = |_| match lateness.is_late() {
            true => ApiError::TooSlow,
            false => ApiError::TooLarge {
                detail: "the body is too large, or ended early".into(),
                part: None,
                limit_bytes: JSON_LIMIT_BYTES as u64,
            },
        };
        let json = to_bytes(request.into_body(), JSON_LIMIT_BYTES).await.map_err(too_much)?;
        return receive_json(&json, &app.store).await;
    }
    receive(Form::of(request).await?, &app.store, limits, hash, &lateness).await
}

/// The body of the answer: a repeated request gets the very same.
fn answer(job: &Job) -> String {
    serde_json::to_string(&JobView::from(job.clone())).expect("a job is JSON")
}

fn accepted(answer: String) -> Result<Response, ApiError> {
    let job: Accepted = serde_json::from_str(&answer).map_err(ApiError::internal)?;
    let headers =
        [(header::LOCATION, format!("/v1/jobs/{}", job.id)), (header::CONTENT_TYPE, "application/json".into())];
    Ok((StatusCode::ACCEPTED, headers, answer).into_response())
}

#[derive(serde::Deserialize)]
struct Accepted {
    id: Uuid,
}

fn replay(remember: &Remember, known: Remembered) -> Result<Response, ApiError> {
    if known.fingerprint != remember.fingerprint {
        return Err(ApiError::KeyReused);
    }
    let mut response = accepted(known.answer)?;
    response.headers_mut().insert("idempotency-replayed", HeaderValue::from_static("true"));
    Ok(response)
}

/// The client's key as it is kept: each of the service's keys has names of its own.
fn idempotency_key(headers: &HeaderMap, caller: &Caller) -> Result<Option<String>, ApiError> {
    let Some(value) = headers.get("idempotency-key") else { return Ok(None) };
    match value.to_str() {
        Ok(key) if (1..=255).contains(&key.len()) => Ok(Some(match caller.key_id() {
            Some(owner) => format!("{owner}/{key}"),
            None => format!("/{key}"),
        })),
        _ => Err(ApiError::Malformed {
            detail: "the idempotency key cannot be used".into(),
            part: Some("idempotency-key".into()),
            expected: Some("1 to 255 visible characters".into()),
        }),
    }
}

/// Before the body is read: is there room on the disk and in the queue?
async fn refuse_without_room(app: &App, headers: &HeaderMap, is_known: bool) -> Result<(), ApiError> {
    let (store, expected) = (&app.store, content_length(headers).unwrap_or(0));
    if !store.has_room(expected) {
        return Err(ApiError::DiskReserve { free_bytes: store.free_bytes()?, reserve_bytes: store.reserve_bytes() });
    }
    if !is_known && app.queue.is_full().await? {
        return Err(ApiError::QueueFull);
    }
    Ok(())
}

fn content_length(headers: &HeaderMap) -> Option<u64> {
    headers.get(header::CONTENT_LENGTH)?.to_str().ok()?.parse().ok()
}

/// What the caller's key may still keep, where that is less than the server takes. The transaction that puts the job in decides;
/// this spares the caller a long upload in vain.
async fn left_of_quota(app: &App, caller: &Caller) -> Result<Option<BytesLeft>, ApiError> {
    caller.refuse_beyond_queue(app).await?;
    match caller.bytes_left(app).await? {
        Some(BytesLeft { limit, left: 0 }) => Err(QueueError::Quota { what: "bytes kept", limit }.into()),
        quota => Ok(quota.filter(|quota| quota.left < app.limits.upload_bytes)),
    }
}

/// Refuses a job that would take what the caller's open uploads were promised, but for those that it uses.
async fn refuse_beyond_promises(app: &App, caller: &Caller, received: &Received, used: &Used) -> Result<(), ApiError> {
    let Some(BytesLeft { limit, left }) = caller.bytes_left(app).await? else { return Ok(()) };
    let (store, owner) = (app.store.clone(), caller.key_id());
    let open = tokio::task::spawn_blocking(move || store.open_resumables()).await.map_err(ApiError::internal)??;
    let left = left.saturating_sub(promised(&open, owner).saturating_sub(used.bytes_of(owner)));
    if received.bytes() > left {
        return Err(ApiError::quota_left(limit, left));
    }
    Ok(())
}

/// What is larger than the key's quota leaves is not too large: it has room when jobs are deleted.
fn blame_quota(error: ApiError, quota: Option<&BytesLeft>, limits: &Limits) -> ApiError {
    match (error, quota) {
        (ApiError::TooLarge { limit_bytes, .. }, Some(quota)) if limit_bytes == limits.upload_bytes => {
            ApiError::quota_left(quota.limit, quota.left)
        }
        (error, _) => error,
    }
}

/// A client that tells the size beforehand need not send it all to learn that it is too much.
fn refuse_by_length(headers: &HeaderMap, limit_bytes: u64) -> Result<(), ApiError> {
    match content_length(headers) {
        // The boundaries and headers of the parts come on top.
        Some(bytes) if bytes > limit_bytes.saturating_add(64 << 10) => {
            Err(ApiError::TooLarge { detail: format!("the upload has {bytes} bytes"), part: None, limit_bytes })
        }
        _ => Ok(()),
    }
}

async fn inspect(app: &App, received: Received) -> Result<(Received, Clip), ApiError> {
    let permit = tokio::time::timeout(INSPECTION_WAIT, app.inspections.clone().acquire_owned());
    let permit = permit
        .await
        .map_err(|_| ApiError::Busy("other clips are being looked at".into()))?
        .map_err(ApiError::internal)?;
    let inspector = app.inspector.clone();
    // The files go along, so that they outlive the look even where the client has gone away, and so does the permit.
    let (received, clip) = tokio::task::spawn_blocking(move || {
        let clip = inspector.inspect(&received.files(), &received.options);
        drop(permit);
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
async fn accept(
    app: App,
    key: Option<Uuid>,
    received: Received,
    clip: Clip,
    remember: Option<Remember>,
    used: Used,
) -> Result<Insertion, ApiError> {
    let task = tokio::spawn(async move {
        let id = app.env.new_id();
        let Received { upload, inputs, options, .. } = received;
        let store = app.store.clone();
        tokio::task::spawn_blocking(move || store.commit_upload(upload, id)).await.map_err(ApiError::internal)??;
        let queued = app.queue.insert(NewJob { id, key, options, inputs, clip, remember }).await;
        if matches!(queued, Ok(Insertion::Queued(_))) {
            used.remove(&app.store).await;
        } else {
            let store = app.store.clone();
            tokio::task::spawn_blocking(move || store.delete_job(id)).await.map_err(ApiError::internal)??;
        }
        Ok(queued?)
    });
    task.await.map_err(ApiError::internal)?
}
