//! `POST /v1/avatars/{id}/renders`

mod body;
#[cfg(test)]
mod tests;

use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};

use super::App;
use super::avatars::{find, model};
use super::error::{ApiError, Problem};
use super::extract::{ApiJson, ApiPath};
use crate::jobs::Avatar;
use crate::jobs::render::{RenderError, RenderRequest, What};
use body::RenderBody;

/// Draw an avatar.
///
/// In a pose of one's own or as in a frame of the clip, seen by a camera of one's own or by the clip's.
#[utoipa::path(
    post, path = "/v1/avatars/{id}/renders", tag = "avatars", params(("id" = String, Path, description = "The avatar's id")),
    request_body = RenderBody,
    responses(
        (status = 200, description = "The picture, at the camera's size", body = String, content_type = "image/png"),
        (status = 400, description = "No JSON, or an unknown field", body = Problem,
            content_type = "application/problem+json"),
        (status = 404, description = "No such avatar", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "A value that cannot be drawn", body = Problem,
            content_type = "application/problem+json"),
        (status = 503, description = "No worker is free; try again", body = Problem,
            content_type = "application/problem+json"),
    )
)]
pub(super) async fn render(
    State(app): State<App>,
    ApiPath(id): ApiPath<String>,
    ApiJson(body): ApiJson<RenderBody>,
) -> Result<Response, ApiError> {
    let avatar = find(&app, &id).await?;
    let image = body.check(&avatar)?;
    let png = answer(&app, avatar, What::Image(Box::new(image))).await?;
    Ok(([(header::CONTENT_TYPE, "image/png")], png).into_response())
}

/// Has something of an avatar made by a worker and takes the file that it left.
pub(super) async fn answer(app: &App, mut avatar: Avatar, what: What) -> Result<Vec<u8>, ApiError> {
    let file = loop {
        let request = RenderRequest { model: model(app, &avatar), what: what.clone() };
        match app.renderer.render(request).await {
            // While the request waited, the avatar may have been deleted, or have expired, or been made anew.
            Err(error @ RenderError::Failed(_)) => {
                let now = find(app, &avatar.id.to_string()).await?;
                if now.epoch == avatar.epoch {
                    return Err(error.into());
                }
                avatar = now;
            }
            answer => break answer?,
        }
    };
    let content = tokio::fs::read(&file).await;
    if let Err(error) = file.close() {
        tracing::warn!(%error, "a render stays until the next start");
    }
    Ok(content?)
}
