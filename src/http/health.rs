//! `/healthz`, `/readyz`, `/metrics`, `/openapi.yaml`: for those who run the service.

use axum::extract::State;
use axum::http::header;
use axum::response::IntoResponse;

use super::error::{ApiError, Problem};
use super::{App, metrics, openapi};

/// Is the process alive?
///
/// Answers without a look at anything else, so that a busy or ailing service is not taken for a dead one.
#[utoipa::path(get, path = "/healthz", tag = "service",
    responses((status = 200, description = "It is", body = String, content_type = "text/plain")))]
pub(super) async fn healthz() -> &'static str {
    "ok\n"
}

/// Can the service do its work?
///
/// Asks the database, and looks whether there is a body, and whether the worker is there and has a device; a load balancer sends
/// requests while this is 200.
#[utoipa::path(get, path = "/readyz", tag = "service", responses(
    (status = 200, description = "It can", body = String, content_type = "text/plain"),
    (status = 503, description = "It cannot, and why", body = Problem, content_type = "application/problem+json"),
))]
pub(super) async fn readyz(State(app): State<App>) -> Result<&'static str, ApiError> {
    app.queue.counts().await.map_err(|error| ApiError::Busy(error.to_string()))?;
    let bodies =
        app.store.body_names().map_err(|error| ApiError::Busy(format!("the bodies cannot be read: {error}")))?;
    if bodies.is_empty() {
        return Err(ApiError::Busy("there is no body: import one (effigy body import)".into()));
    }
    match app.renderer.trouble() {
        None => Ok("ready\n"),
        Some(trouble) => Err(ApiError::Busy(trouble)),
    }
}

/// Figures for Prometheus.
///
/// Counted when asked for; docs/operating.md explains each. Keys need the scope `metrics`.
#[utoipa::path(get, path = "/metrics", tag = "service",
    responses((status = 200, description = "Prometheus text format", body = String, content_type = "text/plain")))]
pub(super) async fn figures(State(app): State<App>) -> Result<impl IntoResponse, ApiError> {
    let text = metrics::scrape(app.queue.as_ref()).await?;
    Ok(([(header::CONTENT_TYPE, "text/plain; version=0.0.4")], text))
}

/// This description.
///
/// The same as the file `openapi.yaml` of the version that runs.
#[utoipa::path(get, path = "/openapi.yaml", tag = "service",
    responses((status = 200, description = "OpenAPI 3.1", body = String, content_type = "application/yaml")))]
pub(super) async fn description() -> Result<impl IntoResponse, ApiError> {
    Ok(([(header::CONTENT_TYPE, "application/yaml")], openapi::yaml().map_err(ApiError::internal)?))
}
