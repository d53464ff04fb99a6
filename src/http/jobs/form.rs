//! A multipart form of which but little meets in memory, whatever it says.
//!
//! multer keeps what it cannot tell yet, such as the head of a part, however long that gets; and it takes all that is there before it
//! looks at any of it. So the body goes to it in stretches, and ends where nothing has come of them for too long.

use std::future::poll_fn;
use std::pin::Pin;
use std::sync::{Arc, Mutex};
use std::task::{Context, Poll};

use axum::body::{Body, Bytes, HttpBody};
use axum::extract::multipart::{Field, MultipartError};
use axum::extract::{FromRequest, Multipart, Request};
use axum::http::header;
use http_body::Frame;

use crate::http::error::ApiError;

/// The reader is made to look at what it has each time that so much came at once.
const STRETCH_BYTES: usize = 256 << 10;
/// So much may come without a part, or more of one: what stands before the parts and at their heads is short.
const HELD_BYTES: usize = 1 << 20;

/// The parts of a request's body, one after the other.
pub(in crate::http) struct Form {
    parts: Multipart,
    supply: Supply,
}

/// A part of a form.
pub(super) struct FormPart<'a> {
    field: Field<'a>,
    supply: &'a Supply,
}

impl Form {
    pub async fn of(request: Request) -> Result<Form, ApiError> {
        let (head, body) = request.into_parts();
        let supply = Supply::of(body);
        let request = Request::from_parts(head, Body::new(supply.clone()));
        let kind = request.headers().get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or("");
        let detail =
            format!("the content type is {kind:?}, neither multipart/form-data with a boundary nor application/json");
        let parts = Multipart::from_request(request, &()).await.map_err(|_| ApiError::MediaType(detail))?;
        Ok(Form { parts, supply })
    }

    pub(super) async fn next_part(&mut self) -> Result<Option<FormPart<'_>>, ApiError> {
        let Form { parts, supply } = self;
        let field = parts.next_field().await.map_err(|error| supply.explain(&error))?;
        supply.release();
        Ok(field.map(|field| FormPart { field, supply }))
    }

    /// Reads what is left and keeps none of it.
    pub async fn discard(self) {
        let Form { parts, mut supply } = self;
        drop(parts);
        supply.release();
        while let Some(Ok(_)) = poll_fn(|context| Pin::new(&mut supply).poll_frame(context)).await {
            supply.release();
        }
    }
}

impl FormPart<'_> {
    pub fn name(&self) -> &str {
        self.field.name().unwrap_or("")
    }

    pub async fn chunk(&mut self) -> Result<Option<Bytes>, ApiError> {
        let chunk = self.field.chunk().await.map_err(|error| self.supply.explain(&error))?;
        self.supply.release();
        Ok(chunk)
    }
}

/// A body that the form's reader and the form itself have in common.
#[derive(Clone)]
struct Supply(Arc<Mutex<Flow>>);

struct Flow {
    /// None after its end.
    body: Option<Body>,
    /// Bytes since the reader last looked.
    unseen: usize,
    /// Bytes since the reader last made something of them.
    held: usize,
}

#[derive(Debug, thiserror::Error)]
#[error("no part, and no more of one, in {HELD_BYTES} bytes")]
struct Shapeless;

impl Supply {
    fn of(body: Body) -> Supply {
        Supply(Arc::new(Mutex::new(Flow { body: Some(body), unseen: 0, held: 0 })))
    }

    /// What came has become a part, or more of one.
    fn release(&self) {
        self.0.lock().unwrap().held = 0;
    }

    /// The body ended early, or is no form.
    fn explain(&self, error: &MultipartError) -> ApiError {
        let is_shapeless = self.0.lock().unwrap().held > HELD_BYTES;
        let (detail, expected) = match is_shapeless {
            true => (Shapeless.to_string(), "a multipart/form-data body whose parts have short heads"),
            false => (error.body_text(), "a complete multipart/form-data body"),
        };
        ApiError::Malformed { detail, part: None, expected: Some(expected.into()) }
    }
}

impl HttpBody for Supply {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let mut flow = self.0.lock().unwrap();
        let flow = &mut *flow;
        let Some(body) = &mut flow.body else { return Poll::Ready(None) };
        if flow.unseen >= STRETCH_BYTES {
            flow.unseen = 0;
            context.waker().wake_by_ref();
            return Poll::Pending;
        }
        if flow.held > HELD_BYTES {
            return Poll::Ready(Some(Err(axum::Error::new(Shapeless))));
        }
        match Pin::new(body).poll_frame(context) {
            Poll::Ready(Some(Ok(frame))) => {
                let bytes = frame.data_ref().map_or(0, Bytes::len);
                flow.unseen += bytes;
                flow.held += bytes;
                Poll::Ready(Some(Ok(frame)))
            }
            Poll::Ready(end) => {
                flow.body = None;
                Poll::Ready(end)
            }
            Poll::Pending => {
                flow.unseen = 0;
                Poll::Pending
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use axum::extract::DefaultBodyLimit;
    use futures_util::{StreamExt, stream};
    use tower::{Layer, ServiceExt, service_fn};

    use super::*;

    const CHUNK_BYTES: usize = 64 << 10;
    const HEAD: &str = "--b\r\ncontent-disposition: form-data; name=\"video\"\r\n\r\n";

    async fn form(body: Body) -> Form {
        let request = Request::builder().header(header::CONTENT_TYPE, "multipart/form-data; boundary=b");
        // As in the service, where forms have limits of their own.
        let made = service_fn(|request| async { Ok::<_, std::convert::Infallible>(Form::of(request).await.unwrap()) });
        DefaultBodyLimit::disable().layer(made).oneshot(request.body(body).unwrap()).await.unwrap()
    }

    /// `start`, then so many chunks that are all there at once; counts those that were taken.
    fn body(start: &str, chunks: usize, taken: &Arc<AtomicUsize>) -> Body {
        let (start, taken) = (Bytes::copy_from_slice(start.as_bytes()), taken.clone());
        // Each end of a line could be the beginning of a boundary.
        let chunk = Bytes::from(b"0123456789abcd\r\n".repeat(CHUNK_BYTES / 16));
        let chunks = stream::iter(0..chunks).map(move |_| {
            taken.fetch_add(1, Ordering::Relaxed);
            chunk.clone()
        });
        let end = stream::once(async { Bytes::from_static(b"\r\n--b--\r\n") });
        Body::from_stream(stream::once(async { start }).chain(chunks).chain(end).map(Ok::<_, std::io::Error>))
    }

    #[tokio::test]
    async fn what_makes_no_part_is_refused_before_it_fills_the_memory() {
        let whole_part = format!("{HEAD}all of it\r\n--b\r\nx-long: ");
        for start in ["", "--b\r\nx-long: ", &whole_part] {
            let taken = Arc::new(AtomicUsize::new(0));
            let mut form = form(body(start, 1024, &taken)).await;
            let refused = loop {
                match form.next_part().await {
                    Ok(Some(mut part)) => while part.chunk().await.unwrap().is_some() {},
                    Ok(None) => panic!("{start:?}: a form without an end was read to its end"),
                    Err(error) => break error,
                }
            };
            let ApiError::Malformed { detail, .. } = &refused else { panic!("{refused:?}") };
            assert!(detail.contains("1048576 bytes"), "{detail}");
            let held = taken.load(Ordering::Relaxed) * CHUNK_BYTES;
            // The reader takes up to two stretches at a look.
            assert!(held <= HELD_BYTES + 2 * STRETCH_BYTES + CHUNK_BYTES, "{start:?}: {held} bytes");
            form.discard().await;
            assert_eq!(taken.load(Ordering::Relaxed), 1024, "the client is heard to its end");
        }
    }

    #[tokio::test]
    async fn a_large_part_passes_in_small_chunks_however_it_comes() {
        let taken = Arc::new(AtomicUsize::new(0));
        let at_once = axum::body::to_bytes(body(HEAD, 256, &taken), usize::MAX).await.unwrap();
        for (body, chunk_bytes) in
            [(body(HEAD, 256, &taken), 2 * STRETCH_BYTES + CHUNK_BYTES), (Body::from(at_once), usize::MAX)]
        {
            let mut form = form(body).await;
            let mut part = form.next_part().await.unwrap().unwrap();
            assert_eq!(part.name(), "video");
            let mut bytes = 0;
            while let Some(chunk) = part.chunk().await.unwrap() {
                assert!(chunk.len() <= chunk_bytes, "{} bytes in one chunk", chunk.len());
                bytes += chunk.len();
            }
            assert_eq!(bytes, 256 * CHUNK_BYTES);
            drop(part);
            assert!(form.next_part().await.unwrap().is_none());
        }
    }
}
