//! Webhooks: who is told of jobs, and what is still to be told. `migrations/0011_webhooks.sql` explains each field.

mod address;

use std::collections::BTreeSet;
use std::time::Duration;

use uuid::Uuid;

use super::queue::QueueFuture;
use super::{State, Timestamp};

pub use address::{AddressError, MOST_URL_BYTES, check_url, is_public};

/// Waits after the first, second, … attempt that failed: the schedule that Standard Webhooks recommends, about three
/// days in all.
pub const SCHEDULE: [Duration; 9] = [
    Duration::from_secs(5),
    Duration::from_secs(5 * 60),
    Duration::from_secs(30 * 60),
    Duration::from_secs(2 * 3600),
    Duration::from_secs(5 * 3600),
    Duration::from_secs(10 * 3600),
    Duration::from_secs(14 * 3600),
    Duration::from_secs(20 * 3600),
    Duration::from_secs(24 * 3600),
];

/// Deliveries that are over are kept so long, for those who look what came of them.
pub const KEPT: Duration = Duration::from_secs(30 * 86_400);

/// Each change of a job writes a message for every webhook of its key: one key has no more of them.
pub const MOST_OF_A_KEY: u64 = 100;

/// `job.<state>`: what a webhook can hear of.
pub fn event_type(state: State) -> String {
    format!("job.{}", state.name())
}

/// States whose changes are told: a wish to cancel is not.
pub const TOLD: [State; 6] =
    [State::Queued, State::Running, State::Succeeded, State::Failed, State::Canceled, State::Expired];

/// A webhook to be made, of a key or of a service without keys; its messages are signed with `secret`.
#[derive(Clone, Debug)]
pub struct NewWebhook {
    pub key: Option<Uuid>,
    pub url: String,
    pub secret: Vec<u8>,
    pub events: BTreeSet<String>,
}

/// A webhook as it is kept, without its secret.
#[derive(Clone, Debug)]
pub struct Webhook {
    pub id: Uuid,
    pub key: Option<Uuid>,
    pub url: String,
    pub events: BTreeSet<String>,
    pub created_at: Timestamp,
    pub disabled_at: Option<Timestamp>,
}

/// A message and what has come of it.
#[derive(Clone, Debug)]
pub struct Delivery {
    pub id: String,
    pub payload: String,
    pub created_at: Timestamp,
    pub attempts: u32,
    pub next_at: Option<Timestamp>,
    pub delivered_at: Option<Timestamp>,
    pub last_status: Option<u16>,
    pub last_error: Option<String>,
}

/// A message that is to be sent now.
#[derive(Clone, Debug)]
pub struct Due {
    pub id: String,
    /// Whose webhook it is for.
    pub key: Option<Uuid>,
    pub url: String,
    pub secret: Vec<u8>,
    pub payload: String,
    pub attempts: u32,
}

/// How many messages may be on their way at the same time: in all, those of one key among them, those of one webhook.
#[derive(Clone, Copy, Debug)]
pub struct Places {
    pub all: u32,
    pub of_key: u32,
    pub of_webhook: u32,
}

/// What came of an attempt.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Attempt {
    /// Answered with this status.
    Answered(u16),
    /// Not even that.
    Failed(String),
}

/// The webhooks of a service. `only` limits a call to those of a key.
pub trait Webhooks: Send + Sync + 'static {
    /// Refused beyond [`MOST_OF_A_KEY`].
    fn create_webhook(&self, new: NewWebhook) -> QueueFuture<'_, Webhook>;
    /// The newest first.
    fn webhooks(&self, only: Option<Uuid>) -> QueueFuture<'_, Vec<Webhook>>;
    fn webhook(&self, id: Uuid, only: Option<Uuid>) -> QueueFuture<'_, Option<Webhook>>;
    /// With all its deliveries; false where there is none.
    fn delete_webhook(&self, id: Uuid, only: Option<Uuid>) -> QueueFuture<'_, bool>;
    /// The newest first.
    fn deliveries(&self, webhook: Uuid, limit: u32) -> QueueFuture<'_, Vec<Delivery>>;
    /// What is to be sent now, no more than there are places. Keys take turns, and so do the webhooks of each, which send
    /// what is longest due first. Webhooks that belong to no key count as those of one.
    fn due(&self, places: Places) -> QueueFuture<'_, Vec<Due>>;
    /// Writes what came of an attempt: over, or due again by [`SCHEDULE`]. 410 disables the webhook, and nothing more of it
    /// waits.
    fn attempted<'a>(&'a self, delivery: &'a str, attempt: &'a Attempt) -> QueueFuture<'a, ()>;
}
