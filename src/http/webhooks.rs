//! `/v1/webhooks`: whom to tell when a job changes its state.

use std::collections::BTreeSet;

use axum::Json;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use serde::{Deserialize, Serialize};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;
use uuid::Uuid;

use super::App;
use super::access::Caller;
use super::error::{ApiError, Problem};
use super::extract::{ApiJson, ApiPath, parse_id, unknown};
use crate::jobs::webhooks::{Delivery, MOST_URL_BYTES, NewWebhook, TOLD, Webhook, Webhooks, check_url, event_type};

/// Deliveries that are shown.
const SHOWN: u32 = 50;
/// Of a secret; Standard Webhooks asks for 24 to 64.
const SECRET_BYTES: usize = 32;

pub(super) fn router() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(create, list)).routes(routes!(get, delete))
}

/// What is asked.
#[derive(Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct WebhookBody {
    /// Where to send: https, and an address of the public internet.
    #[schema(max_length = 2048)]
    url: String,
    /// `job.queued`, `job.running`, `job.succeeded`, `job.failed`, `job.canceled`, `job.expired`; without them, the last
    /// four.
    #[schema(min_items = 1)]
    events: Option<BTreeSet<String>>,
}

/// A receiver of messages.
#[derive(Serialize, utoipa::ToSchema)]
pub(super) struct WebhookView {
    id: Uuid,
    url: String,
    events: BTreeSet<String>,
    created_at: String,
    /// When the receiver answered 410; it gets nothing more.
    disabled_at: Option<String>,
    /// What the messages are signed with, as receivers' libraries take it. Told once, when the webhook is made.
    #[serde(skip_serializing_if = "Option::is_none")]
    secret: Option<String>,
    /// The newest messages; only where one webhook is asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    deliveries: Option<Vec<DeliveryView>>,
}

/// A message and what has come of it.
#[derive(Serialize, utoipa::ToSchema)]
pub(super) struct DeliveryView {
    /// The `webhook-id` of all its attempts.
    id: String,
    /// What was or will be sent.
    #[schema(value_type = Object)]
    payload: serde_json::Value,
    created_at: String,
    attempts: u32,
    /// When it will be tried again; null when it was taken or given up.
    next_at: Option<String>,
    delivered_at: Option<String>,
    /// The answer to the last attempt, where there was one.
    last_status: Option<u16>,
    last_error: Option<String>,
}

/// The webhooks of a caller.
#[derive(Serialize, utoipa::ToSchema)]
pub(super) struct WebhookList {
    /// Newest first.
    webhooks: Vec<WebhookView>,
}

/// Be told of jobs.
///
/// Messages are POSTed as Standard Webhooks has it (standardwebhooks.com): `webhook-id`, `webhook-timestamp` and
/// `webhook-signature` (v1, HMAC-SHA256), the body `{type, timestamp, data: {job, state, attempt, avatar, error}}`. What
/// is not answered with 2xx is sent again for about three days, with the same id; 410 ends the webhook. A webhook hears of
/// the jobs of the key that made it.
#[utoipa::path(
    post, path = "/v1/webhooks", tag = "webhooks", request_body = WebhookBody,
    responses(
        (status = 201, description = "The webhook, with its secret", body = WebhookView,
            headers(("location" = String, description = "Where to ask for it"))),
        (status = 400, description = "No JSON, or an unknown field", body = Problem,
            content_type = "application/problem+json"),
        (status = 429, description = "The key has as many webhooks as it may", body = Problem,
            content_type = "application/problem+json"),
        (status = 422, description = "Not https, not public, or an unknown event or none", body = Problem,
            content_type = "application/problem+json"),
    )
)]
pub(super) async fn create(
    State(app): State<App>,
    caller: Caller,
    ApiJson(body): ApiJson<WebhookBody>,
) -> Result<Response, ApiError> {
    let webhooks = webhooks(&app)?;
    let url = check_url(&body.url, webhooks.private).map_err(|error| ApiError::Input {
        detail: error.to_string(),
        part: "url".into(),
        frame: None,
        expected: format!("https and a public address, without user and password, of at most {MOST_URL_BYTES} bytes"),
    })?;
    let known: BTreeSet<String> = TOLD.into_iter().map(event_type).collect();
    let events =
        body.events.unwrap_or_else(|| TOLD.into_iter().filter(|state| state.is_final()).map(event_type).collect());
    if let Some(strange) = events.difference(&known).next() {
        return Err(ApiError::Input {
            detail: format!("there is no event {strange:?}"),
            part: "events".into(),
            frame: None,
            expected: known.into_iter().collect::<Vec<_>>().join(", "),
        });
    }
    if events.is_empty() {
        return Err(ApiError::Input {
            detail: "the list of events is empty".into(),
            part: "events".into(),
            frame: None,
            expected: "one event or more; without `events` those of a job's end".into(),
        });
    }
    let mut secret = vec![0; SECRET_BYTES];
    getrandom::fill(&mut secret).map_err(ApiError::internal)?;
    let text = format!("whsec_{}", BASE64_STANDARD.encode(&secret));
    let new = NewWebhook { key: caller.key_id(), url: url.into(), secret, events };
    let webhook = webhooks.queue.create_webhook(new).await?;
    let location = format!("/v1/webhooks/{}", webhook.id);
    let view = WebhookView { secret: Some(text), ..view(webhook) };
    Ok((StatusCode::CREATED, [(header::LOCATION, location)], Json(view)).into_response())
}

/// List webhooks.
///
/// Those of the caller's key, or all where no key is needed or the key is an admin's; without their secrets.
#[utoipa::path(
    get, path = "/v1/webhooks", tag = "webhooks",
    responses((status = 200, description = "Those of the caller's key", body = WebhookList))
)]
pub(super) async fn list(State(app): State<App>, caller: Caller) -> Result<Json<WebhookList>, ApiError> {
    let found = webhooks(&app)?.queue.webhooks(caller.sees_only()).await?;
    Ok(Json(WebhookList { webhooks: found.into_iter().map(view).collect() }))
}

/// Ask for a webhook and its newest messages.
///
/// Each message tells its attempts, the last answer, and when it will be tried again.
#[utoipa::path(
    get, path = "/v1/webhooks/{id}", tag = "webhooks", params(("id" = String, Path, description = "The webhook's id")),
    responses(
        (status = 200, description = "The webhook", body = WebhookView),
        (status = 404, description = "No such webhook", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get(
    State(app): State<App>,
    caller: Caller,
    ApiPath(id): ApiPath<String>,
) -> Result<Json<WebhookView>, ApiError> {
    let queue = webhooks(&app)?.queue;
    let webhook = queue.webhook(parse_id("webhook", &id)?, caller.sees_only()).await?;
    let webhook = webhook.ok_or_else(|| unknown("webhook", id))?;
    let deliveries = queue.deliveries(webhook.id, SHOWN).await?.into_iter().map(delivery_view);
    Ok(Json(WebhookView { deliveries: Some(deliveries.collect::<Result<_, _>>()?), ..view(webhook) }))
}

/// Delete a webhook.
///
/// What was not yet delivered never will be.
#[utoipa::path(
    delete, path = "/v1/webhooks/{id}", tag = "webhooks", params(("id" = String, Path, description = "The webhook's id")),
    responses(
        (status = 204, description = "It is gone"),
        (status = 404, description = "No such webhook", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn delete(
    State(app): State<App>,
    caller: Caller,
    ApiPath(id): ApiPath<String>,
) -> Result<StatusCode, ApiError> {
    let gone = webhooks(&app)?.queue.delete_webhook(parse_id("webhook", &id)?, caller.sees_only()).await?;
    if gone { Ok(StatusCode::NO_CONTENT) } else { Err(unknown("webhook", id)) }
}

struct Desk<'a> {
    queue: &'a dyn Webhooks,
    private: bool,
}

fn webhooks(app: &App) -> Result<Desk<'_>, ApiError> {
    let (queue, private) = app.webhooks.as_ref().ok_or_else(|| ApiError::Busy("this server has no webhooks".into()))?;
    Ok(Desk { queue: queue.as_ref(), private: *private })
}

fn view(webhook: Webhook) -> WebhookView {
    WebhookView {
        id: webhook.id,
        url: webhook.url,
        events: webhook.events,
        created_at: webhook.created_at.rfc3339(),
        disabled_at: webhook.disabled_at.map(|time| time.rfc3339()),
        secret: None,
        deliveries: None,
    }
}

fn delivery_view(delivery: Delivery) -> Result<DeliveryView, ApiError> {
    Ok(DeliveryView {
        id: delivery.id,
        payload: serde_json::from_str(&delivery.payload).map_err(ApiError::internal)?,
        created_at: delivery.created_at.rfc3339(),
        attempts: delivery.attempts,
        next_at: delivery.next_at.map(|time| time.rfc3339()),
        delivered_at: delivery.delivered_at.map(|time| time.rfc3339()),
        last_status: delivery.last_status,
        last_error: delivery.last_error,
    })
}
