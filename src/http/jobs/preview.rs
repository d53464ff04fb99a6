//! `GET /v1/jobs/{id}/preview`: how the avatar looks so far.

use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};

use crate::http::App;
use crate::http::error::{ApiError, Problem};
use crate::http::extract::{ApiPath, parse_id, unknown};
use crate::http::files::matches_etag;

/// See the avatar in the making.
///
/// A small picture (JPEG on white, 320 pixels along its longer side) by the camera of the first frame, drawn between the
/// steps of the fit: first when poses and shape are known, then every 20 seconds or 10 % of the way, and at the ends of
/// stages. The last one stays as long as the job's files do. A `preview` event tells of each new one.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/preview", tag = "jobs",
    params(
        ("id" = String, Path, description = "The job's id"),
        ("if-none-match" = Option<String>, Header, description = "ETags that the client has"),
    ),
    responses(
        (status = 200, description = "The newest picture", body = String, content_type = "image/jpeg",
            headers(("etag" = String, description = "Changes with the picture"))),
        (status = 304, description = "The client has it"),
        (status = 404, description = "No such job, or no picture of it yet", body = Problem,
            content_type = "application/problem+json"),
    )
)]
pub(super) async fn preview(
    State(app): State<App>,
    ApiPath(id): ApiPath<String>,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let job = parse_id("job", &id)?;
    // A newer picture may replace the named one before it is read; the second name is then fresh enough.
    for _ in 0..2 {
        let found = app.queue.get(job).await?.ok_or_else(|| unknown("job", id.clone()))?;
        let Some(name) = found.preview else { break };
        let etag = format!("\"{}\"", name.trim_end_matches(".jpg"));
        let tags = [(header::ETAG, etag.clone()), (header::CACHE_CONTROL, "no-cache".into())];
        if matches_etag(&headers, &etag) {
            return Ok((StatusCode::NOT_MODIFIED, tags).into_response());
        }
        match tokio::fs::read(app.store.previews(job).join(name)).await {
            Ok(jpeg) => return Ok((tags, [(header::CONTENT_TYPE, "image/jpeg")], jpeg).into_response()),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
            Err(error) => return Err(error.into()),
        }
    }
    Err(unknown("preview of job", id))
}
