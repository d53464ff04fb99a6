//! Extractors whose refusals are problem documents.

use axum::body::Bytes;
use axum::extract::rejection::BytesRejection;
use axum::extract::{FromRequest, FromRequestParts, Path, Query, Request};
use axum::http::header;
use axum::http::request::Parts;
use axum::response::IntoResponse;
use serde::de::DeserializeOwned;
use uuid::Uuid;

use super::error::ApiError;
use super::pace::Lateness;
use crate::json;

/// A JSON body; a mistake in it is told with its field.
pub struct ApiJson<T>(pub T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequest<S> for ApiJson<T> {
    type Rejection = ApiError;

    async fn from_request(request: Request, state: &S) -> Result<Self, ApiError> {
        let kind = request.headers().get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or("");
        let essence = kind.split(';').next().unwrap_or("").trim().to_ascii_lowercase();
        if essence != "application/json" && !essence.ends_with("+json") {
            return Err(ApiError::MediaType(format!("the content type is {kind:?}, not application/json")));
        }
        let lateness = request.extensions().get::<Lateness>().cloned().unwrap_or_default();
        let body = Bytes::from_request(request, state).await.map_err(|rejection| match lateness.is_late() {
            true => ApiError::TooSlow,
            false => body_error(rejection),
        })?;
        json::object(&body).map(ApiJson).map_err(|error| ApiError::json(error, ""))
    }
}

fn body_error(rejection: BytesRejection) -> ApiError {
    let detail = rejection.body_text();
    if rejection.into_response().status() == axum::http::StatusCode::PAYLOAD_TOO_LARGE {
        // axum's default for bodies that are held in memory.
        return ApiError::TooLarge { detail, part: None, limit_bytes: 2 << 20 };
    }
    ApiError::malformed(detail)
}

/// A query string.
pub struct ApiQuery<T>(pub T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequestParts<S> for ApiQuery<T> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ApiError> {
        let query = Query::from_request_parts(parts, state).await;
        query.map(|Query(value)| ApiQuery(value)).map_err(|e| ApiError::malformed(e.body_text()))
    }
}

/// Parameters of a path. What they cannot be read from, as bytes that are no UTF-8, is the path of nothing.
pub struct ApiPath<T>(pub T);

impl<T: DeserializeOwned + Send, S: Send + Sync> FromRequestParts<S> for ApiPath<T> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ApiError> {
        let path = Path::from_request_parts(parts, state).await;
        path.map(|Path(value)| ApiPath(value)).map_err(|_| ApiError::UnknownPath(parts.uri.path().into()))
    }
}

/// An id from a path. What is no id is an unknown one.
pub fn parse_id(what: &'static str, id: &str) -> Result<Uuid, ApiError> {
    id.parse().map_err(|_| unknown(what, id))
}

pub fn unknown(what: &'static str, id: impl ToString) -> ApiError {
    ApiError::Unknown { what, id: id.to_string() }
}
