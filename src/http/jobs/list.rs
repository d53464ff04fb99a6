//! `GET /v1/jobs`

use axum::Json;
use axum::extract::State;
use serde::{Deserialize, Serialize};
use uuid::Uuid;

use super::view::JobView;
use crate::http::App;
use crate::http::access::Caller;
use crate::http::error::{ApiError, Problem};
use crate::http::extract::ApiQuery;
use crate::jobs::{self, ListFilter, Timestamp};

#[derive(Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct ListQuery {
    /// Only jobs in this state.
    state: Option<jobs::State>,
    /// Only jobs created at this time or later (RFC 3339, as in `created_at`).
    created_from: Option<String>,
    /// Only jobs created before this time.
    created_before: Option<String>,
    /// Jobs in a page.
    #[serde(default = "default_limit")]
    #[param(minimum = 1, maximum = 200, default = 50)]
    limit: u32,
    /// `next` of the page before.
    cursor: Option<Uuid>,
}

fn default_limit() -> u32 {
    50
}

/// A page of the list.
#[derive(Serialize, utoipa::ToSchema)]
pub(super) struct JobList {
    /// Newest first.
    jobs: Vec<JobView>,
    /// The cursor of the next page; null at the end.
    next: Option<Uuid>,
}

/// List jobs, newest first: those of the caller's key, or all where no key is needed or the key is an admin's.
///
/// A page holds `limit` jobs at most; `next` is the cursor of the page after it. Jobs that come meanwhile do not shift the
/// pages.
#[utoipa::path(
    get, path = "/v1/jobs", tag = "jobs", params(ListQuery),
    responses(
        (status = 200, description = "A page of jobs", body = JobList),
        (status = 400, description = "An unknown state, limit or cursor", body = Problem,
            content_type = "application/problem+json"),
    )
)]
pub(super) async fn list(
    State(app): State<App>,
    caller: Caller,
    ApiQuery(query): ApiQuery<ListQuery>,
) -> Result<Json<JobList>, ApiError> {
    if !(1..=200).contains(&query.limit) {
        return Err(ApiError::Malformed {
            detail: format!("limit is {}", query.limit),
            part: Some("limit".into()),
            expected: Some("1 to 200".into()),
        });
    }
    let time = |part: &str, text: &Option<String>| text.as_deref().map(|text| parse_time(part, text)).transpose();
    // One more than asked for tells whether there is a next page.
    let filter = ListFilter {
        state: query.state,
        key: caller.sees_only(),
        created_from: time("created_from", &query.created_from)?,
        created_before: time("created_before", &query.created_before)?,
        before: query.cursor,
        limit: query.limit + 1,
    };
    let mut jobs = app.queue.list(filter).await?;
    let more = jobs.len() > query.limit as usize;
    jobs.truncate(query.limit as usize);
    let next = jobs.last().filter(|_| more).map(|job| job.id);
    Ok(Json(JobList { jobs: jobs.into_iter().map(JobView::from).collect(), next }))
}

fn parse_time(part: &str, text: &str) -> Result<Timestamp, ApiError> {
    Timestamp::parse_rfc3339(text).ok_or_else(|| ApiError::Malformed {
        detail: format!("{part} is {text:?}"),
        part: Some(part.into()),
        expected: Some("a time as in RFC 3339: 2026-01-31T12:00:00Z".into()),
    })
}
