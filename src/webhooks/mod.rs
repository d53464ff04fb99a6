//! Sends what `jobs::webhooks` has written down: signed as Standard Webhooks, to public addresses only (unless
//! `webhooks_to_private`), again and again until it is taken.

mod sender;
mod sign;

use std::collections::HashSet;
use std::sync::Arc;
use std::time::Duration;

use futures_util::StreamExt;
use futures_util::future::BoxFuture;
use futures_util::stream::FuturesUnordered;

use crate::jobs::webhooks::{Due, Webhooks};
use crate::jobs::{Env, QueueError};

pub use sender::{Lookup, Sender, install_cryptography, system_lookup};
pub use sign::signature;

/// Messages that are on their way at the same time, and those of one webhook among them: a receiver that lets each attempt
/// wait for its end holds up its own messages first.
const AT_ONCE: u32 = 32;
const OF_ONE: u32 = 4;
/// How often it is looked for what is due.
const LOOK: Duration = Duration::from_secs(1);

/// Carries messages to their receivers. One a data folder: two would send everything twice.
pub struct Courier {
    pub webhooks: Arc<dyn Webhooks>,
    pub sender: Sender,
    pub env: Env,
}

/// Attempts that have begun. Their messages are due until what came of them is written down.
#[derive(Default)]
struct OnTheWay<'a> {
    ids: HashSet<String>,
    attempts: FuturesUnordered<BoxFuture<'a, (String, Result<(), QueueError>)>>,
}

impl OnTheWay<'_> {
    /// Waits for an attempt to end; none where none is on its way.
    async fn next(&mut self) -> Option<Result<(), QueueError>> {
        let (id, written) = self.attempts.next().await?;
        self.ids.remove(&id);
        Some(written)
    }
}

impl Courier {
    /// Sends what becomes due, for ever.
    pub async fn run(self) {
        let mut on_the_way = OnTheWay::default();
        loop {
            let begun = self.begin(&mut on_the_way).await;
            let ended = tokio::select! {
                Some(ended) = on_the_way.next() => ended,
                () = tokio::time::sleep(LOOK) => Ok(()),
            };
            for error in [begun.err(), ended.err()].into_iter().flatten() {
                tracing::warn!(%error, "webhooks wait");
                tokio::time::sleep(LOOK).await;
            }
        }
    }

    /// Sends what is due, once each, to its end; how many that were.
    pub async fn round(&self) -> Result<usize, QueueError> {
        let mut on_the_way = OnTheWay::default();
        let sent = self.begin(&mut on_the_way).await?;
        while let Some(ended) = on_the_way.next().await {
            ended?;
        }
        Ok(sent)
    }

    /// Begins attempts for what is due and not on its way; how many.
    async fn begin<'a>(&'a self, on_the_way: &mut OnTheWay<'a>) -> Result<usize, QueueError> {
        let mut begun = 0;
        for due in self.webhooks.due(AT_ONCE, OF_ONE).await? {
            if on_the_way.attempts.len() < AT_ONCE as usize && on_the_way.ids.insert(due.id.clone()) {
                on_the_way.attempts.push(Box::pin(self.attempt(due)));
                begun += 1;
            }
        }
        Ok(begun)
    }

    /// A message whose attempt was not written down, because the process ended in between, is sent again with the same id.
    async fn attempt(&self, due: Due) -> (String, Result<(), QueueError>) {
        let attempt = self.sender.send(&due, self.env.now()).await;
        tracing::info!(message = due.id, url = due.url, attempt = due.attempts + 1, outcome = ?attempt, "webhook");
        let written = self.webhooks.attempted(&due.id, &attempt).await;
        (due.id, written)
    }
}
