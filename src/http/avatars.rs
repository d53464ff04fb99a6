//! `/v1/avatars/{id}` and its posed mesh.

use std::collections::BTreeMap;

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use uuid::Uuid;

use super::App;
use super::error::{ApiError, Problem};
use super::extract::{ApiPath, ApiQuery, parse_id, unknown};
use super::files::published;
use super::renders::answer;
use crate::camera::Camera;
use crate::jobs::render::What;
use crate::jobs::{Avatar, Clip};

/// The result of a job.
#[derive(Serialize, utoipa::ToSchema)]
pub(super) struct AvatarView {
    pub id: Uuid,
    /// The job that made it.
    pub job: Uuid,
    /// Name of the body model.
    pub body: String,
    /// The video that was uploaded.
    pub clip: Clip,
    /// How many of the video's frames were fitted; `motion.npz` tells which.
    pub frames: u32,
    /// The capture's, of the images as they were fitted.
    #[schema(value_type = Object)]
    pub camera: Camera,
    /// Figures of the fit, as in `report.json`.
    #[schema(value_type = Object)]
    pub metrics: serde_json::Value,
    pub created_at: String,
    /// When the files will be removed.
    pub expires_at: Option<String>,
    /// File names and where to get them.
    pub files: BTreeMap<String, String>,
}

/// Describe an avatar.
///
/// It carries the id of the job that made it. `files` tells where each file is; renders and posed meshes are made when they
/// are asked for.
#[utoipa::path(
    get, path = "/v1/avatars/{id}", tag = "avatars", params(("id" = String, Path, description = "The avatar's id")),
    responses(
        (status = 200, description = "The avatar", body = AvatarView),
        (status = 404, description = "No such avatar", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get(State(app): State<App>, ApiPath(id): ApiPath<String>) -> Result<Json<AvatarView>, ApiError> {
    let avatar = find(&app, &id).await?;
    let url = |name: &str| format!("/v1/avatars/{}/{name}", avatar.id);
    Ok(Json(AvatarView {
        id: avatar.id,
        job: avatar.id,
        clip: avatar.clip,
        body: avatar.body,
        frames: avatar.frames,
        camera: avatar.camera,
        metrics: avatar.metrics,
        created_at: avatar.created_at.rfc3339(),
        expires_at: avatar.expires_at.map(|time| time.rfc3339()),
        files: avatar.files.iter().map(|file| (file.name.clone(), url(&file.name))).collect(),
    }))
}

#[derive(Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct MeshQuery {
    /// A frame of the video, from 0, or the nearest that was fitted; without it the T-pose.
    frame: Option<u32>,
}

/// Download the mesh: in the T-pose, or as it was posed in a frame.
///
/// PLY in world space, metres, with vertex colours.
#[utoipa::path(
    get, path = "/v1/avatars/{id}/mesh.ply", tag = "avatars",
    params(("id" = String, Path, description = "The avatar's id"), MeshQuery),
    responses(
        (status = 200, description = "The mesh", body = String, content_type = "application/octet-stream"),
        (status = 206, description = "A range of the T-pose mesh", body = String,
            content_type = "application/octet-stream"),
        (status = 304, description = "The T-pose mesh that the client has"),
        (status = 416, description = "No byte of the T-pose mesh lies in the range", body = Problem,
            content_type = "application/problem+json"),
        (status = 404, description = "No such avatar", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "The video has no such frame", body = Problem,
            content_type = "application/problem+json"),
        (status = 503, description = "No worker is free; try again", body = Problem,
            content_type = "application/problem+json"),
    )
)]
pub(super) async fn mesh(
    State(app): State<App>,
    ApiPath(id): ApiPath<String>,
    ApiQuery(query): ApiQuery<MeshQuery>,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let Some(frame) = query.frame else {
        return published(&app, &id, "mesh.ply", &headers).await;
    };
    let avatar = find(&app, &id).await?;
    check_frame(&avatar, frame)?;
    let ply = answer(&app, avatar, What::Mesh { frame }).await?;
    let described = [
        (header::CONTENT_TYPE, "application/octet-stream".to_string()),
        (header::CONTENT_DISPOSITION, format!("attachment; filename=\"mesh_{frame:04}.ply\"")),
    ];
    Ok((described, ply).into_response())
}

pub(super) async fn find(app: &App, id: &str) -> Result<Avatar, ApiError> {
    app.queue.avatar(parse_id("avatar", id)?).await?.ok_or_else(|| unknown("avatar", id))
}

pub(super) fn check_frame(avatar: &Avatar, frame: u32) -> Result<(), ApiError> {
    if frame < avatar.clip.frames {
        return Ok(());
    }
    Err(ApiError::Input {
        detail: format!("the video has no frame {frame}"),
        part: "frame".into(),
        frame: Some(frame),
        expected: format!("0 to {}", avatar.clip.frames.saturating_sub(1)),
    })
}

pub(super) fn model(app: &App, avatar: &Avatar) -> std::path::PathBuf {
    app.store.results(avatar.id, avatar.epoch).join("model.npz")
}
