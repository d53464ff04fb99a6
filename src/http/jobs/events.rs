//! `GET /v1/jobs/{id}/events`: the job's history as it happens (server-sent events).

use std::collections::VecDeque;
use std::convert::Infallible;
use std::time::Duration;

use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::response::sse::{self, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use futures_util::stream;
use tokio::sync::watch;
use uuid::Uuid;

use super::view::preview_url;
use crate::http::App;
use crate::http::app::Feed;
use crate::http::error::{ApiError, Problem};
use crate::http::extract::{ApiPath, parse_id, unknown};
use crate::jobs::{Event, EventKind, QueueError};

/// Events read at once.
const PAGE: u32 = 256;
/// A look without a hint from the feed, should that have missed something.
const LOOK: Duration = Duration::from_secs(2);

/// Follow a job.
///
/// `state`, `progress` and `preview` events, from the job's first one on; `preview` names the `url` of a new picture. Each has an id; a client that comes back with
/// `Last-Event-ID` (browsers do so by themselves) goes on after it without a gap. The stream ends after the job; coming
/// back then answers 204, which tells a browser to stay away.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/events", tag = "jobs",
    params(
        ("id" = String, Path, description = "The job's id"),
        ("last-event-id" = Option<String>, Header, description = "The last event that was seen"),
    ),
    responses(
        (status = 200, description = "The stream", body = String, content_type = "text/event-stream"),
        (status = 204, description = "The job has ended and the client has seen everything"),
        (status = 404, description = "No such job", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn events(
    State(app): State<App>,
    ApiPath(id): ApiPath<String>,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let job = parse_id("job", &id)?;
    let seen = headers.get("last-event-id").map(|value| value.to_str().ok().and_then(|text| text.parse::<i64>().ok()));
    let seen = match seen {
        None => 0,
        Some(Some(seen)) if seen >= 0 => seen,
        Some(_) => {
            return Err(ApiError::Malformed {
                detail: "Last-Event-ID is no id of ours".into(),
                part: Some("last-event-id".into()),
                expected: Some("the id of an event of this stream".into()),
            });
        }
    };
    let now = app.queue.get(job).await?.ok_or_else(|| unknown("job", id))?;
    if now.state.is_final() && app.queue.events(job, seen, 1).await?.is_empty() {
        return Ok(StatusCode::NO_CONTENT.into_response());
    }
    let feed = app.feed.subscribe();
    let follower = Follower { app, job, seen, waiting: VecDeque::new(), feed };
    let events = stream::unfold(follower, |mut follower| async move {
        let event = follower.next().await?;
        Some((Ok::<_, Infallible>(event), follower))
    });
    let keep_alive = KeepAlive::new().interval(Duration::from_secs(15));
    Ok(Sse::new(events).keep_alive(keep_alive).into_response())
}

/// A reader of a job's events.
struct Follower {
    app: App,
    job: Uuid,
    seen: i64,
    waiting: VecDeque<Event>,
    feed: watch::Receiver<Feed>,
}

impl Follower {
    /// The next event; None at the end of the job, of the server, or of the database. The client may come back.
    async fn next(&mut self) -> Option<sse::Event> {
        loop {
            if let Some(event) = self.waiting.pop_front() {
                self.seen = event.id;
                return Some(line(self.job, &event));
            }
            match self.look().await {
                Ok(true) => {}
                Ok(false) => return None,
                Err(error) => {
                    tracing::error!(job = %self.job, %error, "an event stream ends");
                    return None;
                }
            }
        }
    }

    /// Reads what is new, waiting for it where need be; false at the end.
    async fn look(&mut self) -> Result<bool, QueueError> {
        // In this order: what happens after the look at the job moves the feed.
        let feed = *self.feed.borrow_and_update();
        let job = self.app.queue.get(self.job).await?;
        self.waiting.extend(self.app.queue.events(self.job, self.seen, PAGE).await?);
        if !self.waiting.is_empty() {
            return Ok(true);
        }
        if feed.closing || job.is_none_or(|job| job.state.is_final()) {
            return Ok(false);
        }
        // The sender lives in the state of this very stream, and a look too many does no harm.
        let _ = tokio::time::timeout(LOOK, self.feed.changed()).await;
        Ok(true)
    }
}

fn line(job: Uuid, event: &Event) -> sse::Event {
    let mut data = event.data.clone();
    data["at"] = event.at.rfc3339().into();
    if event.kind == EventKind::Preview {
        data["url"] = preview_url(job).into();
    }
    sse::Event::default().id(event.id.to_string()).event(event.kind.name()).data(data.to_string())
}
