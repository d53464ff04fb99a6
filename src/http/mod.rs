//! The REST API: one file a resource, [`error`] alone knows the statuses of errors.
//!
//! Handlers know the queue, the store and traits for what is done elsewhere ([`app::Inspector`], the renderer). None
//! computes: a fit may use every core and a status call is still answered at once.

mod access;
mod app;
mod avatars;
mod error;
mod extract;
mod files;
pub mod fuzz_entries;
mod health;
mod inspector;
mod jobs;
mod links;
mod metrics;
pub mod openapi;
mod pace;
mod page;
mod patience;
mod renders;
mod server;
mod uploads;
mod webhooks;

use std::any::Any;
use std::time::Duration;

use axum::Router;
use axum::extract::Request;
use axum::http::{HeaderName, HeaderValue, Method, header};
use axum::response::{IntoResponse, Response};
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::cors::{AllowHeaders, AllowOrigin, CorsLayer, ExposeHeaders};
use tower_http::request_id::{MakeRequestUuid, PropagateRequestIdLayer, SetRequestIdLayer};
use tower_http::trace::TraceLayer;
use utoipa::OpenApi;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

pub use access::{Access, Openness};
pub use app::{App, InspectError, Inspector, Limits};
pub use inspector::ClipInspector;
pub use pace::Pace;
pub use server::serve;

use error::ApiError;

const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");

fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::with_openapi(openapi::Description::openapi())
        .merge(jobs::router())
        .merge(uploads::router())
        .merge(webhooks::router())
        .routes(routes!(avatars::get))
        .routes(routes!(avatars::mesh))
        .routes(routes!(files::file))
        .routes(routes!(renders::render))
        .routes(routes!(links::links))
        .routes(routes!(health::healthz))
        .routes(routes!(health::readyz))
        .routes(routes!(health::figures))
        .routes(routes!(health::description))
}

/// The whole API over its state.
pub fn router(app: App) -> Router {
    metrics::install();
    let (router, _) = routes().split_for_parts();
    let router = router
        .merge(page::router())
        .fallback(|request: Request| async move { ApiError::UnknownPath(request.uri().path().into()) })
        .method_not_allowed_fallback(|request: Request| async move {
            ApiError::MethodNotAllowed(format!("{} {}", request.method(), request.uri().path()))
        })
        // Runs inside the routes, where the pattern of the path is known.
        .route_layer(axum::middleware::from_fn_with_state(app.clone(), access::check))
        .route_layer(axum::middleware::from_fn(metrics::count))
        .layer(axum::middleware::from_fn_with_state(app.limits.pace, pace::keep_pace))
        .with_state(app.clone());
    router
        .layer(axum::middleware::map_request(unmask_options))
        .layer(cors(app.access.origins()))
        .layer(axum::middleware::map_request(mask_options))
        .layer(CatchPanicLayer::custom(panicked))
        .layer(PropagateRequestIdLayer::new(REQUEST_ID))
        .layer(TraceLayer::new_for_http().make_span_with(span).on_response(tell_status).on_failure(()))
        .layer(SetRequestIdLayer::new(REQUEST_ID, MakeRequestUuid))
}

/// An OPTIONS that is no browser's question about origins: the tus protocol has one of its own.
#[derive(Clone, Copy)]
struct AsksForOptions;

/// The layer for origins answers every OPTIONS itself; such a one passes it as a GET, and gets its headers as any other request.
async fn mask_options(mut request: Request) -> Request {
    let preflight = request.headers().contains_key(header::ACCESS_CONTROL_REQUEST_METHOD);
    if request.method() == Method::OPTIONS && !preflight {
        *request.method_mut() = Method::GET;
        request.extensions_mut().insert(AsksForOptions);
    }
    request
}

async fn unmask_options(mut request: Request) -> Request {
    if request.extensions_mut().remove::<AsksForOptions>().is_some() {
        *request.method_mut() = Method::OPTIONS;
    }
    request
}

/// What browsers let the pages of other origins do: nothing, unless it is configured. A page shows its key in a header
/// of its own, so no credentials of the browser's are ever involved.
fn cors(origins: &[String]) -> CorsLayer {
    if origins.is_empty() {
        return CorsLayer::new();
    }
    let allowed = if origins.iter().any(|origin| origin == "*") {
        AllowOrigin::any()
    } else {
        AllowOrigin::list(origins.iter().filter_map(|origin| HeaderValue::from_str(origin).ok()))
    };
    CorsLayer::new()
        .allow_origin(allowed)
        .allow_methods([Method::GET, Method::HEAD, Method::POST, Method::PATCH, Method::DELETE, Method::OPTIONS])
        .allow_headers(AllowHeaders::mirror_request())
        .expose_headers(ExposeHeaders::any())
        .max_age(Duration::from_secs(3600))
}

fn span(request: &Request) -> tracing::Span {
    let id = request.headers().get(REQUEST_ID).and_then(|value| value.to_str().ok()).unwrap_or("");
    // Of a trace that the caller is part of (W3C Trace Context).
    let traceparent = request.headers().get("traceparent").and_then(|value| value.to_str().ok());
    let (method, path) = (request.method(), request.uri().path());
    tracing::info_span!("request", %method, path, id, traceparent, status = tracing::field::Empty)
}

fn tell_status(response: &Response, _: Duration, span: &tracing::Span) {
    span.record("status", response.status().as_u16());
}

fn panicked(panic: Box<dyn Any + Send>) -> Response {
    let message = panic.downcast_ref::<String>().cloned();
    let message = message.or_else(|| panic.downcast_ref::<&str>().map(ToString::to_string));
    ApiError::Internal(anyhow::anyhow!("a handler panicked: {}", message.unwrap_or_default())).into_response()
}
