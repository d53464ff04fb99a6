//! Sends what `jobs::webhooks` has written down: signed as Standard Webhooks, to public addresses only (unless
//! `webhooks_to_private`), again and again until it is taken.

mod sender;
mod sign;

use std::sync::Arc;
use std::time::Duration;

use futures_util::future::join_all;

use crate::jobs::webhooks::Webhooks;
use crate::jobs::{Env, QueueError};

pub use sender::{Lookup, Sender, install_cryptography, system_lookup};
pub use sign::signature;

/// Messages that are on their way at the same time.
const AT_ONCE: u32 = 16;
/// How often it is looked for what is due.
const LOOK: Duration = Duration::from_secs(1);

/// Carries messages to their receivers. One a data folder: two would send everything twice.
pub struct Courier {
    pub webhooks: Arc<dyn Webhooks>,
    pub sender: Sender,
    pub env: Env,
}

impl Courier {
    /// Rounds for ever.
    pub async fn run(self) {
        loop {
            match self.round().await {
                // There may be more than one round takes.
                Ok(sent) if sent == AT_ONCE as usize => continue,
                Ok(_) => {}
                Err(error) => tracing::warn!(%error, "webhooks wait"),
            }
            tokio::time::sleep(LOOK).await;
        }
    }

    /// Sends what is due, once each; how many that were. A message whose attempt was not written down, because the
    /// process ended in between, is sent again with the same id.
    pub async fn round(&self) -> Result<usize, QueueError> {
        let due = self.webhooks.due(AT_ONCE).await?;
        let sent = due.len();
        let attempts = join_all(due.iter().map(|due| self.sender.send(due, self.env.now()))).await;
        for (due, attempt) in due.iter().zip(attempts) {
            tracing::info!(message = due.id, url = due.url, attempt = due.attempts + 1, outcome = ?attempt, "webhook");
            self.webhooks.attempted(&due.id, &attempt).await?;
        }
        Ok(sent)
    }
}
