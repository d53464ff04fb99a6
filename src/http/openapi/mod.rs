//! The description of the API, made from the handlers. What follows from a route's kind is added here: names, general
//! errors, examples.

mod bodies;
mod errors;
mod examples;

use utoipa::openapi::path::Operation;
use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityRequirement, SecurityScheme};
use utoipa::openapi::{Components, OpenApi};

use super::error::Problem;

#[derive(utoipa::OpenApi)]
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

/// The description of the whole API.
pub(super) fn describe() -> OpenApi {
    let mut api = super::routes().to_openapi();
    api.components.get_or_insert_with(Components::new).add_security_scheme(KEY, key());
    for (path, item) in &mut api.paths.paths {
        let operations =
            [&mut item.get, &mut item.head, &mut item.post, &mut item.patch, &mut item.delete, &mut item.options];
        for operation in operations.into_iter().flatten() {
            name(operation);
            if is_guarded(path) {
                // In this order: with a key, or without where the server asks for none.
                operation.security = Some(vec![SecurityRequirement::new(KEY, [""; 0]), SecurityRequirement::default()]);
            }
            errors::complete(path, operation);
            bodies::complete(operation);
            examples::complete(operation);
        }
    }
    api
}

/// What the scheme of keys is called.
const KEY: &str = "bearer";

fn key() -> SecurityScheme {
    let text = "A key of `effigy keys create`. None is needed by a server that is open to all or has no keys yet, nor \
                where a signed link leads.";
    SecurityScheme::Http(HttpBuilder::new().scheme(HttpAuthScheme::Bearer).description(Some(text)).build())
}

/// Whether a key may be asked for; `access.rs` decides what it must allow.
fn is_guarded(path: &str) -> bool {
    path.starts_with("/v1/") || path == "/metrics"
}

/// Handlers are named within their resource; clients that are generated need one name for each of all: `jobs_list`.
fn name(operation: &mut Operation) {
    let resource = operation.tags.as_deref().and_then(<[String]>::first);
    if let (Some(id), Some(resource)) = (&mut operation.operation_id, resource) {
        *id = format!("{resource}_{id}");
    }
}

/// `openapi.yaml` as the handlers have it.
pub fn yaml() -> Result<String, impl std::error::Error + Send + Sync + 'static> {
    yaml_serde::to_value(describe()).and_then(|mut api| {
        bodies::put_forms_first(&mut api);
        yaml_serde::to_string(&api)
    })
}
