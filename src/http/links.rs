//! `POST /v1/avatars/{id}/links`: addresses of an avatar's files that work without a key, for a while.
//!
//! An address carries its end, the key that it was made with, and HMAC-SHA256 over path, end and key under a secret of
//! the service. It opens one file for GET and HEAD, and dies with its end, its key or its file.

use std::collections::BTreeMap;
use std::time::Duration;

use axum::Json;
use axum::extract::{Query, Request, State};
use axum::http::{Method, Uri};
use base64::Engine;
use base64::prelude::BASE64_URL_SAFE_NO_PAD;
use hmac::{Hmac, KeyInit, Mac};
use serde::{Deserialize, Serialize};
use sha2::Sha256;
use uuid::Uuid;

use super::App;
use super::access::Caller;
use super::avatars::find;
use super::error::{ApiError, Problem};
use super::extract::{ApiJson, ApiPath, unknown};
use crate::jobs::Timestamp;

/// Seconds for which a link may be asked.
const LONGEST_SECS: u64 = 7 * 86_400;

/// What is asked.
#[derive(Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct LinksBody {
    /// Names of files; without them, all of the avatar's.
    files: Option<Vec<String>>,
    /// How long the links shall work.
    #[serde(default = "an_hour")]
    #[schema(minimum = 1, maximum = 604800, default = 3600)]
    expires_in_secs: u64,
}

fn an_hour() -> u64 {
    3600
}

/// Links to an avatar's files.
#[derive(Serialize, utoipa::ToSchema)]
pub(super) struct LinksView {
    expires_at: String,
    /// File names and where to get them without a key.
    links: BTreeMap<String, String>,
}

/// Make links that need no key.
///
/// For those who shall download, and nothing else: each opens one file until it expires. Revoking the key that made
/// them, or deleting the avatar, ends them sooner.
#[utoipa::path(
    post, path = "/v1/avatars/{id}/links", tag = "avatars", params(("id" = String, Path, description = "The avatar's id")),
    request_body = LinksBody,
    responses(
        (status = 200, description = "The links", body = LinksView),
        (status = 400, description = "No JSON, an unknown field, or too long a time", body = Problem,
            content_type = "application/problem+json"),
        (status = 404, description = "No such avatar or file", body = Problem,
            content_type = "application/problem+json"),
    )
)]
pub(super) async fn links(
    State(app): State<App>,
    caller: Caller,
    ApiPath(id): ApiPath<String>,
    ApiJson(body): ApiJson<LinksBody>,
) -> Result<Json<LinksView>, ApiError> {
    let avatar = find(&app, &id).await?;
    if !(1..=LONGEST_SECS).contains(&body.expires_in_secs) {
        return Err(ApiError::Malformed {
            detail: format!("expires_in_secs is {}", body.expires_in_secs),
            part: Some("expires_in_secs".into()),
            expected: Some(format!("1 to {LONGEST_SECS}")),
        });
    }
    let names = body.files.unwrap_or_else(|| avatar.files.iter().map(|file| file.name.clone()).collect());
    if let Some(name) = names.iter().find(|name| avatar.files.iter().all(|file| file.name != **name)) {
        return Err(unknown("file", name));
    }
    let end = app.env.now().plus(Duration::from_secs(body.expires_in_secs));
    let expires = end.0.div_euclid(1000);
    let link = |name: &String| {
        let path = format!("/v1/avatars/{}/{name}", avatar.id);
        let claim = Claim { expires, key: caller.key_id(), signature: String::new() };
        let signature = BASE64_URL_SAFE_NO_PAD.encode(mac(&app, &path, &claim).finalize().into_bytes());
        let key = claim.key.map(|key| format!("&key={key}")).unwrap_or_default();
        (name.clone(), format!("{path}?expires={expires}{key}&signature={signature}"))
    };
    Ok(Json(LinksView { expires_at: Timestamp(expires * 1000).rfc3339(), links: names.iter().map(link).collect() }))
}

/// The query of a link.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Claim {
    /// Seconds since 1970.
    expires: i64,
    key: Option<Uuid>,
    signature: String,
}

/// No path and no number holds a line feed, so that no two claims have the same text.
fn mac(app: &App, path: &str, claim: &Claim) -> Hmac<Sha256> {
    let mut mac = Hmac::<Sha256>::new_from_slice(&app.access.secret).expect("HMAC takes keys of any length");
    let key = claim.key.map(|key| key.to_string()).unwrap_or_default();
    mac.update(format!("{path}\n{}\n{key}", claim.expires).as_bytes());
    mac
}

/// Whether a request comes by a link; only files have some.
pub(super) fn is_link(route: &str, request: &Request) -> bool {
    let file = ["/v1/avatars/{id}/{file}", "/v1/avatars/{id}/mesh.ply"].contains(&route);
    let query = request.uri().query().unwrap_or("");
    file && matches!(*request.method(), Method::GET | Method::HEAD)
        && query.split('&').any(|p| p.starts_with("signature="))
}

/// Checks the link and gives the request on without its query.
pub(super) async fn follow(app: &App, mut request: Request) -> Result<Request, ApiError> {
    let refused = || ApiError::Forbidden("the link is not one of ours, or is not whole".into());
    let Query(claim) = Query::<Claim>::try_from_uri(request.uri()).map_err(|_| refused())?;
    let path = request.uri().path().to_string();
    let signature = BASE64_URL_SAFE_NO_PAD.decode(&claim.signature).map_err(|_| refused())?;
    mac(app, &path, &claim).verify_slice(&signature).map_err(|_| refused())?;
    if app.env.now() >= Timestamp(claim.expires.saturating_mul(1000)) {
        return Err(ApiError::Forbidden("the link has expired".into()));
    }
    if let (Some(id), Some(keys)) = (claim.key, app.access.keys())
        && keys.living_key(id).await?.is_none()
    {
        return Err(ApiError::Forbidden("the key that made this link has expired or is revoked".into()));
    }
    *request.uri_mut() = path.parse::<Uri>().map_err(ApiError::internal)?;
    Ok(request)
}
