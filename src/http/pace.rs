//! Bodies that trickle are cut: whoever sends a byte a second would otherwise hold a connection and a file for days.

use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll};
use std::time::Duration;

use axum::body::{Body, Bytes, HttpBody};
use axum::extract::{Request, State};
use axum::middleware::Next;
use axum::response::Response;
use http_body::{Frame, SizeHint};
use tokio::time::{Instant, Sleep, sleep};

/// The slowest pace at which a request's body may come.
#[derive(Clone, Copy, Debug)]
pub struct Pace {
    /// In each such stretch of waiting …
    pub window: Duration,
    /// … so many bytes must come.
    pub bytes: u64,
}

impl Default for Pace {
    fn default() -> Self {
        Pace { window: Duration::from_secs(20), bytes: 20 << 10 }
    }
}

/// The body came more slowly than the pace.
#[derive(Debug, thiserror::Error)]
#[error("the body came too slowly: {bytes} bytes in {secs} s")]
pub struct TooSlow {
    bytes: u64,
    secs: f64,
}

/// Turns true when a body is cut. Multipart readers do not tell why a body ended.
#[derive(Clone, Debug, Default)]
pub struct Lateness(Arc<AtomicBool>);

impl Lateness {
    pub fn is_late(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// A body that ends with [`TooSlow`] where it falls behind.
pub struct Paced {
    body: Body,
    pace: Pace,
    lateness: Lateness,
    /// Began with the first wait for the body, so that a handler that works in between costs the client nothing.
    timer: Option<Pin<Box<Sleep>>>,
    came: u64,
}

impl Paced {
    pub fn wrap(body: Body, pace: Pace, lateness: Lateness) -> Body {
        Body::new(Paced { body, pace, lateness, timer: None, came: 0 })
    }
}

impl HttpBody for Paced {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let this = &mut *self;
        if let Poll::Ready(frame) = Pin::new(&mut this.body).poll_frame(context) {
            if let Some(Ok(frame)) = &frame {
                this.came += frame.data_ref().map_or(0, |data| data.len() as u64);
            }
            if this.came >= this.pace.bytes {
                (this.came, this.timer) = (0, None);
            }
            return Poll::Ready(frame);
        }
        let window = this.pace.window;
        let timer = this.timer.get_or_insert_with(|| Box::pin(sleep(window)));
        if timer.as_mut().poll(context).is_pending() {
            return Poll::Pending;
        }
        if this.came < this.pace.bytes {
            this.lateness.0.store(true, Ordering::Relaxed);
            let slow = TooSlow { bytes: this.came, secs: window.as_secs_f64() };
            return Poll::Ready(Some(Err(axum::Error::new(slow))));
        }
        this.came = 0;
        timer.as_mut().reset(Instant::now() + window);
        // The reset timer must be polled once to wake this task.
        context.waker().wake_by_ref();
        Poll::Pending
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

/// Middleware: every body is paced, and its handler learns from the request's extensions whether it was too slow.
pub async fn keep_pace(State(pace): State<Pace>, request: Request, next: Next) -> Response {
    let lateness = Lateness::default();
    let (mut parts, body) = request.into_parts();
    parts.extensions.insert(lateness.clone());
    next.run(Request::from_parts(parts, Paced::wrap(body, pace, lateness))).await
}

#[cfg(test)]
mod tests {
    use axum::body::to_bytes;
    use futures_util::stream;

    use super::*;

    /// A body of chunks that come one after each wait.
    fn body(chunks: u32, bytes: usize, wait: Duration) -> Body {
        Body::from_stream(stream::unfold(0, move |sent| async move {
            tokio::time::sleep(wait).await;
            (sent < chunks).then(|| (Ok::<_, std::io::Error>(vec![0; bytes]), sent + 1))
        }))
    }

    fn pace(window_ms: u64, bytes: u64) -> Pace {
        Pace { window: Duration::from_millis(window_ms), bytes }
    }

    #[tokio::test]
    async fn a_steady_body_passes_however_long_it_takes() {
        let steady = body(60, 300, Duration::from_millis(10));
        let paced = Paced::wrap(steady, pace(300, 300), Lateness::default());
        assert_eq!(to_bytes(paced, usize::MAX).await.unwrap().len(), 18_000);
    }

    #[tokio::test]
    async fn a_trickle_and_a_silence_are_cut_after_one_window() {
        for (bytes, wait) in [(1, 10), (5000, 3_600_000)] {
            let slow = body(10_000, bytes, Duration::from_millis(wait));
            let begun = Instant::now();
            let lateness = Lateness::default();
            let error = to_bytes(Paced::wrap(slow, pace(100, 1000), lateness.clone()), usize::MAX).await.unwrap_err();
            assert!(lateness.is_late(), "{error}");
            assert!(begun.elapsed() < Duration::from_secs(10));
        }
    }
}
