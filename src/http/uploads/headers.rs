//! The protocol's headers.

use axum::http::{HeaderMap, HeaderName, HeaderValue};
use base64::Engine;
use base64::prelude::BASE64_STANDARD;

use crate::http::error::ApiError;

pub const RESUMABLE: HeaderName = HeaderName::from_static("tus-resumable");
pub const VERSION: HeaderName = HeaderName::from_static("tus-version");
pub const EXTENSION: HeaderName = HeaderName::from_static("tus-extension");
pub const MAX_SIZE: HeaderName = HeaderName::from_static("tus-max-size");
pub const CHECKSUM_ALGORITHM: HeaderName = HeaderName::from_static("tus-checksum-algorithm");
pub const OFFSET: HeaderName = HeaderName::from_static("upload-offset");
pub const LENGTH: HeaderName = HeaderName::from_static("upload-length");
pub const METADATA: HeaderName = HeaderName::from_static("upload-metadata");
pub const EXPIRES: HeaderName = HeaderName::from_static("upload-expires");
pub const CHECKSUM: HeaderName = HeaderName::from_static("upload-checksum");

const METADATA_LIMIT_BYTES: usize = 8 << 10;

/// A header that must be a number.
pub fn number(headers: &HeaderMap, name: HeaderName) -> Result<u64, ApiError> {
    let value = headers.get(&name).and_then(|value| value.to_str().ok());
    let digits = value.filter(|text| !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit()));
    digits.and_then(|text| text.parse().ok()).ok_or_else(|| wrong(&name, "a number of bytes"))
}

/// `Upload-Metadata`: keys and base64 values, kept as they are.
pub fn metadata(headers: &HeaderMap) -> Result<Option<String>, ApiError> {
    let Some(value) = headers.get(METADATA) else { return Ok(None) };
    let text = value.to_str().ok().filter(|text| text.len() <= METADATA_LIMIT_BYTES);
    let is_pair = |pair: &str| {
        let mut words = pair.trim().splitn(2, ' ');
        let key = words.next().is_some_and(|key| !key.is_empty());
        key && words.next().is_none_or(|value| BASE64_STANDARD.decode(value).is_ok())
    };
    match text {
        Some("") => Ok(None),
        Some(text) if text.split(',').all(is_pair) => Ok(Some(text.into())),
        _ => Err(wrong(&METADATA, &format!("keys and base64 values, at most {METADATA_LIMIT_BYTES} bytes"))),
    }
}

pub fn wrong(name: &HeaderName, expected: &str) -> ApiError {
    ApiError::Malformed {
        detail: format!("the header {name} cannot be used"),
        part: Some(name.to_string()),
        expected: Some(expected.into()),
    }
}

/// A value of ours, or one that came as a header.
pub fn text(value: &str) -> HeaderValue {
    HeaderValue::from_str(value).unwrap_or_else(|_| HeaderValue::from_static(""))
}
