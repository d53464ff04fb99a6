//! `GET /v1/avatars/{id}/{file}`: published files with ranges and strong ETags (RFC 9110).

use std::io;
use std::path::Path as FilePath;

use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use tokio_util::io::ReaderStream;

use super::App;
use super::avatars::find;
use super::error::{ApiError, Problem};
use super::extract::{ApiPath, unknown};
use crate::jobs::AvatarFile;
use crate::storage::{ByteRange, open_range, parse_range};

const CHUNK_BYTES: usize = 256 << 10;

/// A report shows itself: no script runs in it, it fetches nothing, and it is of no origin.
const PAGE_POLICY: &str = "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:";

/// Download a file of an avatar: `avatar.glb`, `avatar.vrm`, `texture.png`, `motion.npz`, `report.json`, `report.html`, …
///
/// One range of bytes can be asked for; the ETag is strong and holds as long as the avatar does.
#[utoipa::path(
    get, path = "/v1/avatars/{id}/{file}", tag = "avatars",
    params(
        ("id" = String, Path, description = "The avatar's id"),
        ("file" = String, Path, description = "One of the avatar's `files`"),
        ("range" = Option<String>, Header, description = "One range of bytes"),
        ("if-none-match" = Option<String>, Header, description = "ETags that the client has"),
        ("if-range" = Option<String>, Header, description = "Send the range only if the file still has this ETag"),
    ),
    responses(
        // Bytes first: that is what generated clients then take every file for.
        (status = 200, description = "The file", content(
            (String = "application/octet-stream"), (String = "model/gltf-binary"), (String = "image/png"),
            (serde_json::Value = "application/json", example = json!({ "mask_iou": 0.95 })),
            (String = "text/html", example = json!("<!doctype html><title>The fit</title>"))),
            headers(("etag" = String, description = "SHA-256 of the file"))),
        (status = 206, description = "The range", content(
            (String = "application/octet-stream"), (String = "model/gltf-binary"), (String = "image/png"),
            (String = "application/json"), (String = "text/html")),
            headers(("content-range" = String))),
        (status = 304, description = "The client has the file"),
        (status = 404, description = "No such avatar or file", body = Problem,
            content_type = "application/problem+json"),
        (status = 416, description = "The range begins after the end of the file", body = Problem,
            content_type = "application/problem+json"),
    )
)]
pub(super) async fn file(
    State(app): State<App>,
    ApiPath((id, name)): ApiPath<(String, String)>,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    published(&app, &id, &name, &headers).await
}

/// Sends a published file. Only names that the database knows reach the file system.
pub(super) async fn published(app: &App, id: &str, name: &str, headers: &HeaderMap) -> Result<Response, ApiError> {
    let mut avatar = find(app, id).await?;
    loop {
        let file = avatar.files.iter().find(|file| file.name == name).ok_or_else(|| unknown("file", name))?;
        let path = app.store.results(avatar.id, avatar.epoch).join(&file.name);
        match send(&path, file, headers).await {
            // Since the database was asked, the avatar was deleted, or has expired, or was made anew.
            Err(error) if is_missing(&error) => {
                let now = find(app, id).await?;
                if now.epoch == avatar.epoch {
                    return Err(error);
                }
                avatar = now;
            }
            answer => return answer,
        }
    }
}

fn is_missing(error: &ApiError) -> bool {
    let ApiError::Internal(cause) = error else { return false };
    cause.downcast_ref::<io::Error>().is_some_and(|cause| cause.kind() == io::ErrorKind::NotFound)
}

async fn send(path: &FilePath, file: &AvatarFile, headers: &HeaderMap) -> Result<Response, ApiError> {
    let etag = format!("\"{}\"", file.sha256);
    let fixed = [
        (header::ETAG, etag.clone()),
        (header::ACCEPT_RANGES, "bytes".into()),
        // The same name can come to hold something else only by a retry: ask, and be told 304.
        (header::CACHE_CONTROL, "no-cache".into()),
    ];
    if matches_etag(headers, &etag) {
        return Ok((StatusCode::NOT_MODIFIED, fixed).into_response());
    }
    let (status, range) = match wanted_range(headers, &etag, file.bytes) {
        None => (StatusCode::OK, ByteRange { start: 0, end: file.bytes }),
        Some(Ok(range)) => (StatusCode::PARTIAL_CONTENT, range),
        Some(Err(())) => return Err(ApiError::Range { size: file.bytes }),
    };
    let content_range = (status == StatusCode::PARTIAL_CONTENT)
        .then(|| [(header::CONTENT_RANGE, format!("bytes {}-{}/{}", range.start, range.end - 1, file.bytes))]);
    let described = [
        (header::CONTENT_TYPE, content_type(&file.name).to_string()),
        (header::CONTENT_LENGTH, range.len().to_string()),
        (header::CONTENT_DISPOSITION, format!("{}; filename=\"{}\"", disposition(&file.name), file.name)),
        (header::CONTENT_SECURITY_POLICY, PAGE_POLICY.to_string()),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff".to_string()),
    ];
    let reader = open_range(path, range).await?;
    let body = Body::from_stream(ReaderStream::with_capacity(reader, CHUNK_BYTES));
    Ok((status, fixed, described, content_range, body).into_response())
}

fn wanted_range(headers: &HeaderMap, etag: &str, size: u64) -> Option<Result<ByteRange, ()>> {
    let range = headers.get(header::RANGE)?.to_str().ok()?;
    // A date or another tag: the client's beginning may be of another file, so it gets the whole of this one.
    if headers.get(header::IF_RANGE).is_some_and(|tag| tag.as_bytes() != etag.as_bytes()) {
        return None;
    }
    parse_range(range, size)
}

/// Whether `If-None-Match` holds the tag. Weak comparison, as the header asks for.
pub(super) fn matches_etag(headers: &HeaderMap, etag: &str) -> bool {
    let values = headers.get_all(header::IF_NONE_MATCH).iter().filter_map(|value| value.to_str().ok());
    let mut tags = values.flat_map(|value| value.split(',')).map(str::trim);
    tags.any(|tag| tag == "*" || tag.strip_prefix("W/").unwrap_or(tag) == etag)
}

/// Reports are to be read, all else is to be kept.
fn disposition(name: &str) -> &'static str {
    if name.ends_with(".html") { "inline" } else { "attachment" }
}

fn content_type(name: &str) -> &'static str {
    match name.rsplit_once('.').map(|(_, extension)| extension) {
        Some("glb" | "vrm") => "model/gltf-binary",
        Some("png") => "image/png",
        Some("json") => "application/json",
        Some("html") => "text/html; charset=utf-8",
        _ => "application/octet-stream",
    }
}
