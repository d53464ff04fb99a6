//! Who may: every request passes here before its handler. Keys and scopes, whose job it is, requests a minute, signed
//! links, and what a browser may be made to do to a server that asks for no key.
//!
//! A job, and the avatar that carries its id, belongs to the key that made it. Whether the caller may see it is decided
//! here from the path alone, so that no handler can forget to ask.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex};

use axum::extract::{FromRequestParts, MatchedPath, RawPathParams, Request, State};
use axum::http::request::Parts;
use axum::http::{HeaderMap, Method, header};
use axum::middleware::Next;
use axum::response::Response;
use uuid::Uuid;

use super::App;
use super::error::ApiError;
use super::extract::unknown;
use super::links;
use crate::jobs::keys::{Key, Keys, Scope, Token};
use crate::jobs::{QueueError, Timestamp};

/// Whom a server listens to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Openness {
    /// Everybody may do everything.
    Open,
    /// Whoever is on this machine may do everything, until there is a key.
    Local,
    /// Nobody without a key.
    Keys,
}

/// The rules of a server.
pub struct Access {
    openness: Openness,
    keys: Option<Arc<dyn Keys>>,
    /// Origins whose pages may call; `*` is any.
    origins: Vec<String>,
    /// What links are signed with.
    pub(super) secret: Vec<u8>,
    rates: Rates,
}

impl Access {
    pub fn new(openness: Openness, keys: Arc<dyn Keys>, origins: Vec<String>, secret: Vec<u8>) -> Access {
        Access { openness, keys: Some(keys), origins, secret, rates: Rates::default() }
    }

    /// No rules. Links live as long as the process.
    pub fn open() -> Access {
        let secret = [Uuid::new_v4().into_bytes(), Uuid::new_v4().into_bytes()].concat();
        Access { openness: Openness::Open, keys: None, origins: Vec::new(), secret, rates: Rates::default() }
    }

    pub(super) fn origins(&self) -> &[String] {
        &self.origins
    }

    pub(super) fn keys(&self) -> Option<&dyn Keys> {
        self.keys.as_deref()
    }

    async fn caller(&self, headers: &HeaderMap, now: Timestamp) -> Result<Caller, ApiError> {
        let Some(keys) = &self.keys else { return Ok(Caller::default()) };
        if let Some(token) = bearer(headers)? {
            let key = keys.key_of(&Token::from_text(token)).await?;
            let key = key.ok_or_else(|| ApiError::Unauthorized("the key is unknown, expired or revoked".into()))?;
            if let Some(per_minute) = key.quota.per_minute {
                self.rates.take(key.id, per_minute, now).map_err(|retry_after_secs| ApiError::TooMany {
                    slug: "rate-limited",
                    detail: format!("the key {:?} allows {per_minute} requests a minute", key.name),
                    retry_after_secs,
                })?;
            }
            return Ok(Caller { key: Some(Arc::new(key)) });
        }
        match self.openness {
            Openness::Open => Ok(Caller::default()),
            // A last key that expires or is revoked closes the server; it does not open it again.
            Openness::Local if !keys.any_key().await? => {
                self.check_local(headers).map_err(ApiError::Forbidden)?;
                Ok(Caller::default())
            }
            _ => Err(ApiError::Unauthorized("a key is needed: `Authorization: Bearer effigy_…`".into())),
        }
    }

    /// A server without keys trusts whoever can reach this machine's own addresses. A browser here can, for any page on
    /// the web: by its own requests, which name the page's origin, and by a name that points here (DNS rebinding), which
    /// stands in `Host`. So can a proxy for the whole world.
    fn check_local(&self, headers: &HeaderMap) -> Result<(), String> {
        let text = |name: &str| headers.get(name).map(|value| String::from_utf8_lossy(value.as_bytes()).into_owned());
        if let Some(name) =
            ["forwarded", "x-forwarded-for", "x-forwarded-host"].iter().find(|n| headers.contains_key(**n))
        {
            return Err(format!(
                "`{name}` tells of a proxy, and a server behind a proxy needs keys (`effigy keys create`)"
            ));
        }
        let host = text("host");
        if let Some(host) = host.as_deref().filter(|host| !is_local_name(host)) {
            return Err(format!("without keys this server answers to localhost only, not to {host:?}"));
        }
        if let Some(origin) = text("origin") {
            let own = origin.split_once("://").map(|(_, rest)| rest) == host.as_deref();
            if !own && !self.origins.iter().any(|allowed| allowed == "*" || *allowed == origin) {
                return Err(format!("pages of {origin} may not call this server (setting `cors_origins`)"));
            }
        }
        Ok(())
    }
}

/// The bearer token, if one was sent.
fn bearer(headers: &HeaderMap) -> Result<Option<&str>, ApiError> {
    let Some(value) = headers.get(header::AUTHORIZATION) else { return Ok(None) };
    let token = value.to_str().ok().and_then(|text| text.split_once(' '));
    match token.filter(|(scheme, _)| scheme.eq_ignore_ascii_case("bearer")) {
        Some((_, token)) => Ok(Some(token.trim())),
        None => Err(ApiError::Unauthorized("`Authorization` is not `Bearer` and a key".into())),
    }
}

/// Whether a `Host` header names this machine to itself.
fn is_local_name(host: &str) -> bool {
    let name = match host.strip_prefix('[') {
        Some(rest) => rest.split(']').next().unwrap_or(""),
        None => host.split(':').next().unwrap_or(""),
    };
    name.eq_ignore_ascii_case("localhost") || name.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}

/// A quota of bytes, and what is left of it.
#[derive(Clone, Copy, Debug)]
pub(super) struct BytesLeft {
    pub limit: u64,
    pub left: u64,
}

/// Who asks.
#[derive(Clone, Debug, Default)]
pub(super) struct Caller {
    key: Option<Arc<Key>>,
}

impl Caller {
    pub fn key(&self) -> Option<&Key> {
        self.key.as_deref()
    }

    pub fn key_id(&self) -> Option<Uuid> {
        self.key.as_ref().map(|key| key.id)
    }

    /// What the key's quota of bytes leaves beside the jobs that it keeps; None without a quota.
    pub async fn bytes_left(&self, app: &App) -> Result<Option<BytesLeft>, ApiError> {
        let (Some(key), Some(keys)) = (self.key(), app.access.keys()) else { return Ok(None) };
        let Some(limit) = key.quota.max_bytes else { return Ok(None) };
        Ok(Some(BytesLeft { limit, left: limit.saturating_sub(keys.kept_bytes(key.id).await?) }))
    }

    /// Refuses a caller whose key has as many jobs waiting as it may.
    pub async fn refuse_beyond_queue(&self, app: &App) -> Result<(), ApiError> {
        let (Some(key), Some(keys)) = (self.key(), app.access.keys()) else { return Ok(()) };
        match key.quota.max_queued.map(u64::from) {
            Some(limit) if keys.queued_jobs(key.id).await? >= limit => {
                Err(QueueError::Quota { what: "queued jobs", limit }.into())
            }
            _ => Ok(()),
        }
    }

    /// Whose jobs are to be seen; None for everybody's.
    pub fn sees_only(&self) -> Option<Uuid> {
        self.key.as_ref().filter(|key| !key.is_admin()).map(|key| key.id)
    }
}

impl<S: Send + Sync> FromRequestParts<S> for Caller {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, _state: &S) -> Result<Self, ApiError> {
        let caller = parts.extensions.get::<Caller>().cloned();
        caller.ok_or_else(|| ApiError::internal(anyhow::anyhow!("{} is not guarded", parts.uri.path())))
    }
}

/// What a route asks of a key, any of them; None for what is everybody's.
fn needed(method: &Method, route: &str) -> Option<&'static [Scope]> {
    let looks = matches!(*method, Method::GET | Method::HEAD | Method::OPTIONS);
    match route {
        "/metrics" => Some(&[Scope::Metrics]),
        // They make pictures and addresses of what may be read, and change nothing.
        "/v1/avatars/{id}/renders" | "/v1/avatars/{id}/links" => Some(&[Scope::Read]),
        _ if !route.starts_with("/v1/") => None,
        // Who uploads asks how much has come before going on.
        _ if looks && route.starts_with("/v1/uploads") => Some(&[Scope::Read, Scope::Write]),
        _ if looks => Some(&[Scope::Read]),
        _ => Some(&[Scope::Write]),
    }
}

/// Middleware inside the routes, where the pattern of the path is known.
pub(super) async fn check(State(app): State<App>, request: Request, next: Next) -> Result<Response, ApiError> {
    let route = request.extensions().get::<MatchedPath>().map_or(String::new(), |path| path.as_str().into());
    let Some(scopes) = needed(request.method(), &route) else {
        return Ok(run_as(Caller::default(), request, next).await);
    };
    if links::is_link(&route, &request) {
        let request = links::follow(&app, request).await?;
        return Ok(run_as(Caller::default(), request, next).await);
    }
    let caller = app.access.caller(request.headers(), app.env.now()).await?;
    if let Some(key) = caller.key().filter(|key| !scopes.iter().any(|scope| key.may(*scope))) {
        let lacks = scopes[0].name();
        return Err(ApiError::Forbidden(format!("the key {:?} lacks the scope {lacks:?}", key.name)));
    }
    let (mut parts, body) = request.into_parts();
    check_owner(&app, &caller, &route, &mut parts).await?;
    Ok(run_as(caller, Request::from_parts(parts, body), next).await)
}

async fn run_as(caller: Caller, mut request: Request, next: Next) -> Response {
    request.extensions_mut().insert(caller);
    next.run(request).await
}

/// What is another's is as unknown as what does not exist.
async fn check_owner(app: &App, caller: &Caller, route: &str, parts: &mut Parts) -> Result<(), ApiError> {
    let what = match route {
        _ if route.starts_with("/v1/jobs/{id}") => "job",
        _ if route.starts_with("/v1/avatars/{id}") => "avatar",
        _ => return Ok(()),
    };
    let (Some(only), Some(keys)) = (caller.sees_only(), app.access.keys()) else { return Ok(()) };
    let parameters = RawPathParams::from_request_parts(parts, app).await;
    let parameters = parameters.map_err(|_| ApiError::UnknownPath(parts.uri.path().into()))?;
    let id = parameters.iter().find(|(name, _)| *name == "id").map_or("", |(_, value)| value);
    let Ok(job) = id.parse::<Uuid>() else { return Err(unknown(what, id)) };
    match keys.owner_of(job).await? {
        Some(Some(owner)) if owner == only => Ok(()),
        _ => Err(unknown(what, id)),
    }
}

/// Requests a minute, a key each: at most a minute's worth at once, then one in each minute's share (GCRA).
#[derive(Default)]
struct Rates(Mutex<HashMap<Uuid, i64>>);

const MINUTE_US: i64 = 60_000_000;

impl Rates {
    /// Counts a request; where it is too much, seconds until there is room for one.
    fn take(&self, key: Uuid, per_minute: u32, now: Timestamp) -> Result<(), u32> {
        let now_us = now.0.saturating_mul(1000);
        let mut taken_until = self.0.lock().unwrap();
        let until = taken_until.entry(key).or_insert(now_us);
        // What was taken reaches at most a minute ahead, unless the clock was set back.
        let next = (*until).clamp(now_us, now_us + MINUTE_US) + MINUTE_US / i64::from(per_minute.max(1));
        let over_us = next - now_us - MINUTE_US;
        if over_us > 0 {
            return Err((over_us as u64).div_ceil(1_000_000) as u32);
        }
        *until = next;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_minute_has_so_many_requests_and_no_more() {
        let rates = Rates::default();
        let key = Uuid::nil();
        let start = Timestamp(1_700_000_000_000);
        for n in 0..6 {
            assert_eq!(rates.take(key, 6, start), Ok(()), "{n}");
        }
        assert_eq!(rates.take(key, 6, start), Err(10));
        assert_eq!(rates.take(Uuid::max(), 6, start), Ok(()), "another key has its own");
        assert_eq!(rates.take(key, 6, start.plus(Duration::from_secs(9))), Err(1));
        let later = start.plus(Duration::from_secs(10));
        assert_eq!((rates.take(key, 6, later), rates.take(key, 6, later)), (Ok(()), Err(10)));
        let much_later = start.plus(Duration::from_secs(600));
        let taken = (0..10).filter(|_| rates.take(key, 6, much_later).is_ok()).count();
        assert_eq!(taken, 6, "unused minutes do not add up");
        assert_eq!(rates.take(key, 6, start), Err(10), "a clock that was set back costs a minute at most");
    }

    #[test]
    fn local_names_are_loopbacks() {
        for host in ["localhost", "localhost:8080", "LOCALHOST", "127.0.0.1:1", "127.9.9.9", "[::1]:8080", "[::1]"] {
            assert!(is_local_name(host), "{host}");
        }
        for host in ["example.org", "localhost.evil.example:8080", "10.0.0.1:8080", "[::2]:1", "0.0.0.0", ""] {
            assert!(!is_local_name(host), "{host}");
        }
    }
}
