//! `PATCH`: a piece of an upload on its way to the disk. Memory holds one chunk, whatever the size.

use axum::extract::Request;
use axum::http::{HeaderMap, header};
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use futures_util::StreamExt;
use sha1::Sha1;
use sha2::{Digest, Sha256};

use super::headers;
use super::turns::Turn;
use crate::http::error::ApiError;
use crate::http::pace::Lateness;
use crate::storage::{Appender, ResumableUpload, Store};

enum Hasher {
    Sha1(Sha1),
    Sha256(Sha256),
}

/// What a piece must hash to.
struct Checksum {
    hasher: Hasher,
    expected: Vec<u8>,
}

impl Checksum {
    fn of(headers: &HeaderMap) -> Result<Option<Checksum>, ApiError> {
        let Some(value) = headers.get(headers::CHECKSUM) else { return Ok(None) };
        let wrong = || headers::wrong(&headers::CHECKSUM, "sha1 or sha256, a space, the hash in base64");
        let (name, hash) = value.to_str().ok().and_then(|text| text.split_once(' ')).ok_or_else(wrong)?;
        let hasher = match name {
            "sha1" => Hasher::Sha1(Sha1::new()),
            "sha256" => Hasher::Sha256(Sha256::new()),
            _ => return Err(wrong()),
        };
        let expected = BASE64_STANDARD.decode(hash.trim()).map_err(|_| wrong())?;
        Ok(Some(Checksum { hasher, expected }))
    }

    fn update(&mut self, chunk: &[u8]) {
        match &mut self.hasher {
            Hasher::Sha1(hasher) => hasher.update(chunk),
            Hasher::Sha256(hasher) => hasher.update(chunk),
        }
    }

    fn matches(self) -> bool {
        match self.hasher {
            Hasher::Sha1(hasher) => hasher.finalize()[..] == self.expected[..],
            Hasher::Sha256(hasher) => hasher.finalize()[..] == self.expected[..],
        }
    }
}

/// Whether the headers name a checksum that can be checked.
pub(super) fn names_checksum(headers: &HeaderMap) -> Result<bool, ApiError> {
    Checksum::of(headers).map(|checksum| checksum.is_some())
}

/// Appends the request's body; returns the new offset.
pub(super) async fn append(
    store: &Store,
    upload: &ResumableUpload,
    mut turn: Turn,
    request: Request,
) -> Result<u64, ApiError> {
    let given = request.headers();
    if given.get(header::CONTENT_TYPE).is_none_or(|kind| kind != "application/offset+octet-stream") {
        return Err(ApiError::MediaType("the content type is not application/offset+octet-stream".into()));
    }
    let offset = headers::number(given, headers::OFFSET)?;
    if offset != upload.offset {
        return Err(ApiError::Offset { given: offset, actual: upload.offset });
    }
    let left = upload.about.bytes - upload.offset;
    if given.get(header::CONTENT_LENGTH).and_then(|v| v.to_str().ok()?.parse::<u64>().ok()).is_some_and(|n| n > left) {
        return Err(too_long(upload));
    }
    let mut checksum = Checksum::of(given)?;
    let mut appender = store.append_resumable(upload, checksum.is_some()).await?;
    let received = receive(request, upload, &mut turn, &mut appender, checksum.as_mut()).await;
    match (checksum, received) {
        (None, received) => {
            // What came is kept, also of a body that was cut.
            let offset = appender.keep().await?;
            received.map(|()| offset)
        }
        (Some(checksum), received) => {
            if received.is_ok() && checksum.matches() {
                return Ok(appender.verify().await?);
            }
            appender.take_back().await?;
            Err(received.err().unwrap_or(ApiError::Checksum))
        }
    }
}

async fn receive(
    request: Request,
    upload: &ResumableUpload,
    turn: &mut Turn,
    appender: &mut Appender,
    mut checksum: Option<&mut Checksum>,
) -> Result<(), ApiError> {
    let mut left = upload.about.bytes - upload.offset;
    let lateness = request.extensions().get::<Lateness>().cloned().unwrap_or_default();
    let mut body = request.into_body().into_data_stream();
    loop {
        let chunk = tokio::select! {
            chunk = body.next() => chunk,
            () = turn.wanted() => return Err(ApiError::Superseded),
        };
        let Some(chunk) = chunk else { return Ok(()) };
        let chunk = chunk.map_err(|_| match lateness.is_late() {
            true => ApiError::TooSlow,
            false => ApiError::malformed("the body ended early"),
        })?;
        left = left.checked_sub(chunk.len() as u64).ok_or_else(|| too_long(upload))?;
        if let Some(checksum) = &mut checksum {
            checksum.update(&chunk);
        }
        appender.write(&chunk).await?;
    }
}

fn too_long(upload: &ResumableUpload) -> ApiError {
    let detail = "there are more bytes than the upload's length".into();
    ApiError::TooLarge { detail, part: None, limit_bytes: upload.about.bytes - upload.offset }
}
