//! The description of the API, made from the handlers.

use utoipa::OpenApi;

use super::error::Problem;

#[derive(OpenApi)]
#[openapi(
    info(
        title = "Effigy",
        description = "Rigged, textured, animatable 3D avatars from ordinary video. Upload a clip, follow its job, \
                       download the avatar or ask for renders of it.",
        license(name = "MIT", identifier = "MIT")
    ),
    components(schemas(Problem)),
    tags(
        (name = "jobs", description = "Clips on their way to avatars"),
        (name = "uploads", description = "Files in pieces, which survive a cut (tus 1.0.0)"),
        (name = "avatars", description = "Results and renders"),
        (name = "webhooks", description = "Who is told of jobs"),
        (name = "service", description = "For those who run it"),
    )
)]
pub(super) struct Description;

/// `openapi.yaml` as the handlers have it.
pub fn yaml() -> Result<String, impl std::error::Error + Send + Sync + 'static> {
    super::routes().to_openapi().to_yaml()
}
