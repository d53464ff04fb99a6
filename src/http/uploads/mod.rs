//! `/v1/uploads`: uploads that go on after a cut, by the tus protocol 1.0.0 (<https://tus.io/protocols/resumable-upload>)
//! with its extensions creation, termination, checksum and expiration.
//!
//! An upload is in the store (`storage/resumable.rs`), so it outlives the server. A job is made of finished uploads by
//! their ids (`jobs/create.rs`), which uses them up.

mod expiry;
mod headers;
mod piece;
mod turns;

use axum::extract::{DefaultBodyLimit, Request, State};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;
use uuid::Uuid;

use super::App;
use super::access::{BytesLeft, Caller};
use super::error::{ApiError, Problem};
use super::extract::{ApiPath, parse_id, unknown};
use crate::jobs::QueueError;
use crate::storage::{AboutUpload, ResumableUpload};

use expiry::{expires, wall_clock};

pub(super) use expiry::sweep;
pub(super) use turns::{Turn, Turns};

const VERSION: HeaderValue = HeaderValue::from_static("1.0.0");

pub(super) fn router() -> OpenApiRouter<App> {
    OpenApiRouter::new()
        .routes(routes!(options, begin))
        .routes(routes!(look, append, remove, overridden))
        .layer(DefaultBodyLimit::disable())
        .layer(axum::middleware::from_fn(speak))
}

/// Every answer tells the protocol's version, and every request but the first question must.
async fn speak(request: Request, next: Next) -> Response {
    let version = request.headers().get(headers::RESUMABLE);
    let mut response = if request.method() != Method::OPTIONS && version != Some(&VERSION) {
        let detail = format!("Tus-Resumable is {version:?}");
        let mut response = ApiError::Precondition { detail, expected: "Tus-Resumable: 1.0.0".into() }.into_response();
        response.headers_mut().insert(headers::VERSION, VERSION);
        response
    } else {
        next.run(request).await
    };
    response.headers_mut().insert(headers::RESUMABLE, VERSION);
    response
}

/// Ask what the server can do with resumable uploads (tus 1.0.0).
///
/// Needs no `Tus-Resumable`. The extensions are creation, termination, checksum and expiration.
#[utoipa::path(
    options, path = "/v1/uploads", tag = "uploads",
    responses((status = 204, description = "Its abilities are in the headers", headers(
        ("tus-version" = String), ("tus-extension" = String), ("tus-max-size" = u64, description = "Bytes"),
        ("tus-checksum-algorithm" = String))))
)]
async fn options(State(app): State<App>) -> Response {
    let abilities = [
        (headers::VERSION, "1.0.0".to_string()),
        (headers::EXTENSION, "creation,termination,checksum,expiration".into()),
        (headers::MAX_SIZE, app.limits.upload_bytes.to_string()),
        (headers::CHECKSUM_ALGORITHM, "sha1,sha256".into()),
    ];
    (StatusCode::NO_CONTENT, abilities).into_response()
}

/// Begin an upload that can be resumed (tus 1.0.0, creation).
///
/// `Upload-Length` is required. The bytes follow by `PATCH`; a finished upload is given to `POST /v1/jobs` by its id.
#[utoipa::path(
    post, path = "/v1/uploads", tag = "uploads",
    params(
        ("tus-resumable" = String, Header, description = "1.0.0"),
        ("upload-length" = u64, Header, description = "Bytes that will come"),
        ("upload-metadata" = Option<String>, Header, description = "Given back as it is"),
    ),
    responses(
        (status = 201, description = "The upload has begun", headers(
            ("location" = String, description = "Where its bytes go; the last part is its id"),
            ("upload-expires" = String, description = "When it is removed if nothing more comes"))),
        (status = 400, description = "No length", body = Problem, content_type = "application/problem+json"),
        (status = 412, description = "Another version of the protocol", body = Problem,
            content_type = "application/problem+json"),
        (status = 413, description = "Larger than the server takes", body = Problem,
            content_type = "application/problem+json"),
        (status = 429, description = "So many uploads are open, or so large ones, that no more are taken",
            body = Problem, content_type = "application/problem+json"),
        (status = 507, description = "The server's disk has no room for it", body = Problem,
            content_type = "application/problem+json"),
    )
)]
async fn begin(State(app): State<App>, caller: Caller, given: HeaderMap) -> Result<Response, ApiError> {
    let bytes = headers::number(&given, headers::LENGTH)?;
    let limits = &app.limits;
    if bytes > limits.upload_bytes {
        let detail = format!("the upload would have {bytes} bytes");
        return Err(ApiError::TooLarge { detail, part: None, limit_bytes: limits.upload_bytes });
    }
    let metadata = headers::metadata(&given)?;
    let id = Uuid::new_v4();
    // One at a time, so that the limits hold.
    let _turn = app.uploads.take(Uuid::nil()).await?;
    let quota = caller.bytes_left(&app).await?;
    let (store, about) = (app.store.clone(), AboutUpload { bytes, metadata, owner: caller.key_id() });
    let (most, most_bytes) = (limits.open_uploads, limits.open_upload_bytes);
    let begun = tokio::task::spawn_blocking(move || {
        let open = store.open_resumables()?;
        refuse_too_many(&open, &about, most, most_bytes)?;
        refuse_beyond_quota(&open, &about, quota)?;
        // What was promised to others has a claim on the room, too.
        let outstanding = open.iter().map(|(other, came)| other.bytes.saturating_sub(*came)).sum::<u64>();
        if !store.has_room(outstanding.saturating_add(bytes)) {
            return Err(ApiError::DiskReserve {
                free_bytes: store.free_bytes()?,
                reserve_bytes: store.reserve_bytes(),
            });
        }
        store.begin_resumable(id, &about)?;
        Ok(())
    });
    begun.await.map_err(ApiError::internal)??;
    let location = [(header::LOCATION, format!("/v1/uploads/{id}"))];
    let expires = [(headers::EXPIRES, expires(&app, wall_clock(&app)))];
    Ok((StatusCode::CREATED, location, expires).into_response())
}

/// A key may hold this part of all open uploads and of their bytes, so that others can begin some, too.
const KEYS_SHARE: usize = 4;

fn refuse_too_many(
    open: &[(AboutUpload, u64)],
    asked: &AboutUpload,
    most: usize,
    most_bytes: u64,
) -> Result<(), ApiError> {
    let bytes = asked.bytes;
    if open.len() >= most {
        return Err(ApiError::TooManyUploads { expected: format!("at most {most} uploads that no job has used yet") });
    }
    let share = most.div_ceil(KEYS_SHARE);
    let own: Vec<u64> =
        open.iter().filter(|(about, _)| about.owner == asked.owner).map(|(about, _)| about.bytes).collect();
    if asked.owner.is_some() && own.len() >= share {
        return Err(ApiError::TooManyUploads {
            expected: format!("at most {share} uploads of one key that no job has used yet"),
        });
    }
    let share_bytes = most_bytes.div_ceil(KEYS_SHARE as u64);
    // One may be as large as uploads are let be.
    if asked.owner.is_some() && !own.is_empty() && own.iter().sum::<u64>().saturating_add(bytes) > share_bytes {
        return Err(ApiError::TooManyUploads {
            expected: format!("at most {share_bytes} bytes in uploads of one key that no job has used yet"),
        });
    }
    let total = open.iter().map(|(about, _)| about.bytes).sum::<u64>();
    if total.saturating_add(bytes) > most_bytes {
        return Err(ApiError::TooManyUploads {
            expected: format!("at most {most_bytes} bytes in uploads that no job has used yet; there are {total}"),
        });
    }
    Ok(())
}

/// The bytes of a key's open uploads.
pub(super) fn promised(open: &[(AboutUpload, u64)], owner: Option<Uuid>) -> u64 {
    open.iter().filter(|(about, _)| about.owner == owner).map(|(about, _)| about.bytes).sum()
}

/// Open uploads count towards the bytes that a key may keep.
fn refuse_beyond_quota(
    open: &[(AboutUpload, u64)],
    asked: &AboutUpload,
    quota: Option<BytesLeft>,
) -> Result<(), ApiError> {
    let Some(BytesLeft { limit, left }) = quota else { return Ok(()) };
    if promised(open, asked.owner).saturating_add(asked.bytes) > left {
        return Err(QueueError::Quota { what: "bytes kept", limit }.into());
    }
    Ok(())
}

/// Ask how much of an upload has come (tus 1.0.0).
///
/// A request that still sends bytes to this upload is cut first, so that the answer stays true.
#[utoipa::path(
    head, path = "/v1/uploads/{id}", tag = "uploads",
    params(("id" = String, Path, description = "The upload's id"), ("tus-resumable" = String, Header, description = "1.0.0")),
    responses(
        (status = 200, description = "The upload", headers(
            ("upload-offset" = u64, description = "Bytes that have come"), ("upload-length" = u64),
            ("upload-expires" = String), ("upload-metadata" = String))),
        (status = 404, description = "No such upload"),
    )
)]
async fn look(State(app): State<App>, caller: Caller, ApiPath(id): ApiPath<String>) -> Result<Response, ApiError> {
    let (upload, _turn) = take(&app, &caller, &id).await?;
    let mut response = StatusCode::OK.into_response();
    let answer = response.headers_mut();
    answer.insert(headers::OFFSET, upload.offset.into());
    answer.insert(headers::LENGTH, upload.about.bytes.into());
    answer.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    answer.insert(headers::EXPIRES, headers::text(&expires(&app, upload.touched)));
    if let Some(metadata) = &upload.about.metadata {
        answer.insert(headers::METADATA, headers::text(metadata));
    }
    Ok(response)
}

/// Send the next bytes of an upload (tus 1.0.0).
///
/// What has come before a cut is kept. With `Upload-Checksum` a piece is kept whole or not at all.
#[utoipa::path(
    patch, path = "/v1/uploads/{id}", tag = "uploads",
    params(
        ("id" = String, Path, description = "The upload's id"),
        ("tus-resumable" = String, Header, description = "1.0.0"),
        ("upload-offset" = u64, Header, description = "Where the bytes belong: what the last answer told"),
        ("upload-checksum" = Option<String>, Header, description = "`sha1` or `sha256`, a space, the hash in base64"),
    ),
    request_body(content = Vec<u8>, content_type = "application/offset+octet-stream"),
    responses(
        (status = 204, description = "The bytes are on the disk", headers(
            ("upload-offset" = u64, description = "Bytes that have come"), ("upload-expires" = String))),
        (status = 400, description = "A header is missing or wrong, or the body ended early", body = Problem,
            content_type = "application/problem+json"),
        (status = 404, description = "No such upload", body = Problem, content_type = "application/problem+json"),
        (status = 408, description = "The bytes came too slowly", body = Problem,
            content_type = "application/problem+json"),
        (status = 409, description = "The offset is not that of the upload", body = Problem,
            content_type = "application/problem+json"),
        (status = 413, description = "More bytes than the upload's length", body = Problem,
            content_type = "application/problem+json"),
        (status = 415, description = "Not application/offset+octet-stream", body = Problem,
            content_type = "application/problem+json"),
        (status = 460, description = "The checksum is another", body = Problem,
            content_type = "application/problem+json"),
    )
)]
async fn append(
    State(app): State<App>,
    caller: Caller,
    ApiPath(id): ApiPath<String>,
    request: Request,
) -> Result<Response, ApiError> {
    let (upload, turn) = take(&app, &caller, &id).await?;
    let offset = piece::append(&app.store, &upload, turn, request).await?;
    let told = [(headers::OFFSET, offset.to_string()), (headers::EXPIRES, expires(&app, wall_clock(&app)))];
    Ok((StatusCode::NO_CONTENT, told).into_response())
}

/// Give an upload up (tus 1.0.0, termination).
///
/// What has come is removed at once, and a request that still sends is cut.
#[utoipa::path(
    delete, path = "/v1/uploads/{id}", tag = "uploads",
    params(("id" = String, Path, description = "The upload's id"), ("tus-resumable" = String, Header, description = "1.0.0")),
    responses(
        (status = 204, description = "The upload is gone"),
        (status = 404, description = "No such upload", body = Problem, content_type = "application/problem+json"),
    )
)]
async fn remove(State(app): State<App>, caller: Caller, ApiPath(id): ApiPath<String>) -> Result<Response, ApiError> {
    let (upload, _turn) = take(&app, &caller, &id).await?;
    let store = app.store.clone();
    tokio::task::spawn_blocking(move || store.remove_resumable(upload.id)).await.map_err(ApiError::internal)??;
    Ok(StatusCode::NO_CONTENT.into_response())
}

/// `PATCH`, `DELETE` or `HEAD` for clients that can only `POST`: `X-HTTP-Method-Override` names the method.
///
/// Headers, body and answers are those of the method.
#[utoipa::path(
    post, path = "/v1/uploads/{id}", tag = "uploads",
    params(
        ("id" = String, Path, description = "The upload's id"),
        ("x-http-method-override" = String, Header, description = "PATCH, DELETE or HEAD"),
        ("tus-resumable" = String, Header, description = "1.0.0"),
    ),
    responses(
        (status = 200, description = "As HEAD answers"),
        (status = 204, description = "As PATCH and DELETE answer"),
        (status = 405, description = "Another method, or none", body = Problem,
            content_type = "application/problem+json"),
    )
)]
async fn overridden(
    app: State<App>,
    caller: Caller,
    id: ApiPath<String>,
    request: Request,
) -> Result<Response, ApiError> {
    match request.headers().get("x-http-method-override").map(HeaderValue::as_bytes) {
        Some(b"PATCH") => append(app, caller, id, request).await,
        Some(b"DELETE") => remove(app, caller, id).await,
        Some(b"HEAD") => look(app, caller, id).await,
        _ => Err(ApiError::MethodNotAllowed(format!("POST {}", request.uri().path()))),
    }
}

/// An upload, for this request alone. Another's is as unknown as one that does not exist.
pub(super) async fn take(app: &App, caller: &Caller, id: &str) -> Result<(ResumableUpload, Turn), ApiError> {
    let known = parse_id("upload", id)?;
    let about = app.store.about_resumable(known)?.ok_or_else(|| unknown("upload", id))?;
    if caller.sees_only().is_some_and(|only| about.owner != Some(only)) {
        return Err(unknown("upload", id));
    }
    let turn = app.uploads.take(known).await?;
    let store = app.store.clone();
    let found = tokio::task::spawn_blocking(move || store.resumable(known)).await.map_err(ApiError::internal)??;
    Ok((found.ok_or_else(|| unknown("upload", id))?, turn))
}

/// Reads each header that these routes read. For [`super::fuzz_entries`].
pub(super) fn read_headers(given: &HeaderMap) {
    for name in [headers::LENGTH, headers::OFFSET] {
        let _ = headers::number(given, name);
    }
    if let Ok(Some(metadata)) = headers::metadata(given) {
        assert_eq!(headers::text(&metadata), metadata.as_str(), "it is given back as it came");
    }
    let _ = piece::names_checksum(given);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_key_promises_all_the_bytes_of_others() {
        let [one, two] = [Uuid::from_u128(1), Uuid::from_u128(2)].map(Some);
        let about = |owner: Option<Uuid>, bytes: u64| AboutUpload { bytes, metadata: None, owner };
        let begins = |open: &[(Option<Uuid>, u64)], owner, bytes| {
            let open: Vec<_> = open.iter().map(|&(owner, bytes)| (about(owner, bytes), 0)).collect();
            refuse_too_many(&open, &about(owner, bytes), 100, 1000).is_ok()
        };
        assert!(begins(&[(one, 200)], one, 50) && !begins(&[(one, 200)], one, 51));
        assert!(begins(&[(one, 250)], two, 200), "the others' share is theirs");
        assert!(begins(&[], one, 800), "one is let be as large as any");
        assert!(
            begins(&[(None, 900)], None, 100) && !begins(&[(None, 900)], None, 101),
            "without keys there are no shares"
        );
    }
}
