//! What can go wrong with a request. The only place that knows the statuses of errors: everything else names the mistake.

use axum::Json;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;

use crate::jobs::render::RenderError;
use crate::jobs::{QueueError, State};
use crate::json::JsonError;

/// A problem document (RFC 9457).
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(example = json!({
    "type": "urn:effigy:problem:invalid-input", "title": "The upload cannot be used", "status": 422,
    "detail": "masks, frame 12: the mask is empty", "part": "masks", "frame": 12, "expected": "a person in most masks",
}))]
pub struct Problem {
    /// Stable name of the kind of problem, for programs.
    #[serde(rename = "type")]
    pub kind: String,
    /// The kind of problem, for people.
    pub title: String,
    pub status: u16,
    /// This occurrence.
    pub detail: String,
    /// The part or field of the request that is at fault.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub part: Option<String>,
    /// The frame of the uploaded video that is at fault, from 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame: Option<u32>,
    /// What would have been right.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub expected: Option<String>,
}

/// A request that cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum ApiError {
    #[error("there is nothing at {0}")]
    UnknownPath(String),
    #[error("{0} is not possible here")]
    MethodNotAllowed(String),
    #[error("there is no {what} {id:?}")]
    Unknown { what: &'static str, id: String },
    /// The request's form is wrong: not multipart, not JSON, a part missing, unknown or sent twice.
    #[error("{detail}")]
    Malformed { detail: String, part: Option<String>, expected: Option<String> },
    #[error("{0}")]
    MediaType(String),
    #[error("options: {0}")]
    Options(JsonError),
    /// The form is right, the content cannot be used.
    #[error("{detail}")]
    Input { detail: String, part: String, frame: Option<u32>, expected: String },
    #[error("{detail}")]
    TooLarge { detail: String, part: Option<String>, limit_bytes: u64 },
    #[error("the job is {}: it cannot be {wish}", state.name())]
    Conflict { state: State, wish: &'static str },
    #[error("the file has {size} bytes")]
    Range { size: u64 },
    /// Nobody has said who asks.
    #[error("{0}")]
    Unauthorized(String),
    #[error("{0}")]
    Forbidden(String),
    /// Beyond what the key allows.
    #[error("{detail}")]
    TooMany { slug: &'static str, detail: String, retry_after_secs: u32 },
    #[error("{0}")]
    Busy(String),
    #[error("so many jobs wait that no more are taken")]
    QueueFull,
    #[error("{detail}")]
    Precondition { detail: String, expected: String },
    #[error("the offset is {given}, {actual} bytes have come")]
    Offset { given: u64, actual: u64 },
    #[error("the bytes do not have the checksum")]
    Checksum,
    #[error("more than is taken: {expected}")]
    TooManyUploads { expected: String },
    /// A newer request for the same upload came meanwhile; the client of this one is gone or has given it up.
    #[error("a newer request works on this upload")]
    Superseded,
    #[error("the body came too slowly")]
    TooSlow,
    #[error("this idempotency key was given with another request")]
    KeyReused,
    #[error("the disk is full")]
    DiskFull,
    /// Room for what is at work already, none for more.
    #[error("the server's disk has {free_bytes} bytes left, of which {reserve_bytes} are kept free")]
    DiskReserve { free_bytes: u64, reserve_bytes: u64 },
    /// Ours; the cause is logged and not told.
    #[error("something went wrong inside the server")]
    Internal(#[source] anyhow::Error),
}

/// Seconds after which a client may ask again when the server was busy.
const RETRY_AFTER_SECS: u32 = 5;
/// A place in the queue comes free when a fit ends, which takes minutes.
const QUEUE_RETRY_AFTER_SECS: u32 = 60;

/// The same for a quota, which frees up when a job ends or is deleted.
const QUOTA_RETRY_SECS: u32 = 60;

/// Where a mistake in JSON is that is the part `within`, or the whole body where that is empty.
fn part_of(error: &JsonError, within: &str) -> Option<String> {
    let at: Vec<&str> =
        [Some(within), error.field.as_deref()].into_iter().flatten().filter(|at| !at.is_empty()).collect();
    (!at.is_empty()).then(|| at.join("."))
}

impl ApiError {
    pub fn malformed(detail: impl Into<String>) -> Self {
        ApiError::Malformed { detail: detail.into(), part: None, expected: None }
    }

    pub fn internal(error: impl Into<anyhow::Error>) -> Self {
        ApiError::Internal(error.into())
    }

    /// A mistake in an object of JSON that is the part `within`, or the whole body where that is empty.
    pub fn json(error: JsonError, within: &str) -> Self {
        let part = part_of(&error, within);
        ApiError::Malformed { detail: error.message, part, expected: error.expected }
    }

    /// A key's quota of bytes, where some are left but too few.
    pub fn quota_left(limit: u64, left: u64) -> Self {
        let quota = QueueError::Quota { what: "bytes kept", limit };
        let detail = format!("{quota}, of which {left} are left");
        ApiError::TooMany { slug: "quota-exceeded", detail, retry_after_secs: QUOTA_RETRY_SECS }
    }

    fn kind(&self) -> (StatusCode, &'static str, &'static str) {
        match self {
            ApiError::UnknownPath(_) => (StatusCode::NOT_FOUND, "unknown-path", "There is nothing here"),
            ApiError::MethodNotAllowed(_) => {
                (StatusCode::METHOD_NOT_ALLOWED, "method-not-allowed", "This method is not possible here")
            }
            ApiError::Unknown { .. } => (StatusCode::NOT_FOUND, "not-found", "There is no such thing"),
            ApiError::Malformed { .. } => (StatusCode::BAD_REQUEST, "malformed-request", "The request is malformed"),
            ApiError::MediaType(_) => {
                (StatusCode::UNSUPPORTED_MEDIA_TYPE, "unsupported-media-type", "The content type is not the right one")
            }
            ApiError::Options(_) => (StatusCode::BAD_REQUEST, "invalid-options", "The options cannot be followed"),
            ApiError::Input { .. } => (StatusCode::UNPROCESSABLE_ENTITY, "invalid-input", "The input cannot be used"),
            ApiError::TooLarge { .. } => (StatusCode::PAYLOAD_TOO_LARGE, "too-large", "The request is too large"),
            ApiError::Conflict { .. } => (StatusCode::CONFLICT, "conflict", "The job's state does not allow this"),
            ApiError::Range { .. } => {
                (StatusCode::RANGE_NOT_SATISFIABLE, "range-not-satisfiable", "The range is outside the file")
            }
            ApiError::Unauthorized(_) => (StatusCode::UNAUTHORIZED, "unauthorized", "A key is needed"),
            ApiError::Forbidden(_) => (StatusCode::FORBIDDEN, "forbidden", "This is not allowed"),
            ApiError::TooMany { slug, .. } => {
                (StatusCode::TOO_MANY_REQUESTS, *slug, "This is more than the key allows")
            }
            ApiError::Busy(_) => (StatusCode::SERVICE_UNAVAILABLE, "busy", "The server cannot do this now"),
            ApiError::QueueFull => (StatusCode::TOO_MANY_REQUESTS, "queue-full", "The queue is full"),
            ApiError::Precondition { .. } => {
                (StatusCode::PRECONDITION_FAILED, "precondition-failed", "A header asks for something else")
            }
            ApiError::Offset { .. } => (StatusCode::CONFLICT, "offset-mismatch", "The offset is another"),
            ApiError::Checksum => {
                // The tus protocol's own number.
                let mismatch = StatusCode::from_u16(460).unwrap_or(StatusCode::BAD_REQUEST);
                (mismatch, "checksum-mismatch", "The checksum is another")
            }
            ApiError::TooManyUploads { .. } => {
                (StatusCode::TOO_MANY_REQUESTS, "too-many-uploads", "Too many uploads are open")
            }
            ApiError::Superseded => (StatusCode::LOCKED, "superseded", "A newer request works on this upload"),
            ApiError::TooSlow => (StatusCode::REQUEST_TIMEOUT, "too-slow", "The body came too slowly"),
            ApiError::KeyReused => {
                (StatusCode::UNPROCESSABLE_ENTITY, "idempotency-key-reused", "The key belongs to another request")
            }
            ApiError::DiskFull | ApiError::DiskReserve { .. } => {
                (StatusCode::INSUFFICIENT_STORAGE, "disk-full", "The server's disk is full")
            }
            ApiError::Internal(_) => (StatusCode::INTERNAL_SERVER_ERROR, "internal", "The server failed"),
        }
    }

    fn problem(&self) -> (StatusCode, Problem) {
        let (status, slug, title) = self.kind();
        let mut problem = Problem {
            kind: format!("urn:effigy:problem:{slug}"),
            title: title.into(),
            status: status.as_u16(),
            detail: self.to_string(),
            part: None,
            frame: None,
            expected: None,
        };
        match self {
            ApiError::Malformed { part, expected, .. } => {
                problem.part = part.clone();
                problem.expected = expected.clone();
            }
            ApiError::Options(error) => {
                problem.part = part_of(error, "options");
                problem.expected = error.expected.clone();
            }
            ApiError::Input { part, frame, expected, .. } => {
                problem.part = Some(part.clone());
                problem.frame = *frame;
                problem.expected = Some(expected.clone());
            }
            ApiError::TooLarge { part, limit_bytes, .. } => {
                problem.part = part.clone();
                problem.expected = Some(format!("at most {limit_bytes} bytes"));
            }
            ApiError::Precondition { expected, .. } | ApiError::TooManyUploads { expected } => {
                problem.expected = Some(expected.clone());
            }
            ApiError::Offset { actual, .. } => {
                problem.part = Some("upload-offset".into());
                problem.expected = Some(actual.to_string());
            }
            ApiError::KeyReused => {
                problem.part = Some("idempotency-key".into());
                problem.expected = Some("a new key for a new request, the same parts for the same key".into());
            }
            _ => {}
        }
        (status, problem)
    }
}

/// The document of a typical error of this status, for the description of the API.
pub(super) fn example(status: u16) -> Option<serde_json::Value> {
    let words = |text: &str| text.to_string();
    let error = match status {
        400 => ApiError::Malformed {
            detail: words("unknown field `presett`"),
            part: Some(words("options.presett")),
            expected: Some(words(
                "preset, max_frames, max_side_px, body, seed, height_m, trust_camera, texture_px, priority, deadline_secs",
            )),
        },
        401 => ApiError::Unauthorized(words("the key is unknown, expired or revoked")),
        403 => ApiError::Forbidden(words("the key \"viewer\" lacks the scope \"write\"")),
        404 => ApiError::Unknown { what: "job", id: words("0190a1b2-c3d4-7e5f-8a9b-0c1d2e3f4a5b") },
        405 => ApiError::MethodNotAllowed(words("PUT /v1/jobs")),
        408 => ApiError::TooSlow,
        409 => ApiError::Conflict { state: State::Succeeded, wish: "canceled" },
        412 => {
            ApiError::Precondition { detail: words("Tus-Resumable is None"), expected: words("Tus-Resumable: 1.0.0") }
        }
        413 => ApiError::TooLarge {
            detail: words("the part \"video\" is too large"),
            part: Some(words("video")),
            limit_bytes: 4 << 30,
        },
        415 => ApiError::MediaType(words("the content type is \"text/plain\", not application/json")),
        416 => ApiError::Range { size: 4096 },
        422 => ApiError::Input {
            detail: words("the mask is empty"),
            part: words("masks"),
            frame: Some(12),
            expected: words("a person in most masks"),
        },
        423 => ApiError::Superseded,
        429 => ApiError::TooMany {
            slug: "rate-limited",
            detail: words("the key \"phone\" allows 120 requests a minute"),
            retry_after_secs: 1,
        },
        460 => ApiError::Checksum,
        500 => ApiError::Internal(anyhow::anyhow!("not told")),
        503 => ApiError::Busy(words("the worker does not answer")),
        507 => ApiError::DiskReserve { free_bytes: 900 << 20, reserve_bytes: 1 << 30 },
        _ => return None,
    };
    serde_json::to_value(error.problem().1).ok()
}

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        if let ApiError::Internal(error) = &self {
            tracing::error!("{error:#}");
        }
        let (status, problem) = self.problem();
        let mut response = (status, Json(problem)).into_response();
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("application/problem+json"));
        match self {
            ApiError::Busy(_) => {
                headers.insert(header::RETRY_AFTER, RETRY_AFTER_SECS.into());
            }
            ApiError::TooMany { retry_after_secs, .. } => {
                headers.insert(header::RETRY_AFTER, retry_after_secs.into());
            }
            ApiError::Unauthorized(_) => {
                headers.insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
            }
            ApiError::QueueFull | ApiError::TooManyUploads { .. } => {
                headers.insert(header::RETRY_AFTER, QUEUE_RETRY_AFTER_SECS.into());
            }
            ApiError::Range { size } => {
                if let Ok(value) = HeaderValue::try_from(format!("bytes */{size}")) {
                    headers.insert(header::CONTENT_RANGE, value);
                }
            }
            _ => {}
        }
        response
    }
}

impl From<QueueError> for ApiError {
    fn from(error: QueueError) -> Self {
        match &error {
            full if full.is_disk_full() => ApiError::DiskFull,
            QueueError::Quota { .. } => ApiError::TooMany {
                slug: "quota-exceeded",
                detail: error.to_string(),
                retry_after_secs: QUOTA_RETRY_SECS,
            },
            _ => ApiError::internal(error),
        }
    }
}

impl From<std::io::Error> for ApiError {
    fn from(error: std::io::Error) -> Self {
        match error.kind() {
            std::io::ErrorKind::StorageFull | std::io::ErrorKind::QuotaExceeded => ApiError::DiskFull,
            _ => ApiError::internal(error),
        }
    }
}

impl From<RenderError> for ApiError {
    fn from(error: RenderError) -> Self {
        match error {
            RenderError::Busy | RenderError::Unavailable(_) => ApiError::Busy(error.to_string()),
            RenderError::Refused(detail) => ApiError::Input {
                detail,
                part: "render".into(),
                frame: None,
                expected: "a render of this avatar".into(),
            },
            RenderError::Failed(_) => ApiError::internal(error),
        }
    }
}
