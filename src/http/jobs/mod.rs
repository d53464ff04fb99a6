//! `/v1/jobs`

mod create;
mod events;
mod list;
mod one;
mod upload;
mod view;

use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::App;

pub(super) fn router() -> OpenApiRouter<App> {
    OpenApiRouter::new()
        .routes(routes!(create::create, list::list))
        .routes(routes!(one::get, one::delete))
        .routes(routes!(one::cancel))
        .routes(routes!(one::retry))
        .routes(routes!(events::events))
}
