//! `/v1/jobs`

mod create;
mod events;
mod form;
mod list;
mod one;
mod preview;
mod upload;
mod view;

use axum::extract::DefaultBodyLimit;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::App;
pub(super) use form::Form;
pub(super) use upload::receive;

pub(super) fn router() -> OpenApiRouter<App> {
    // An upload never meets in memory; it has limits of its own.
    let uploads = OpenApiRouter::new().routes(routes!(create::create, list::list)).layer(DefaultBodyLimit::disable());
    uploads
        .routes(routes!(one::get, one::delete))
        .routes(routes!(one::cancel))
        .routes(routes!(one::retry))
        .routes(routes!(events::events))
        .routes(routes!(preview::preview))
}
