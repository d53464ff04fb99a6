//! Sends what `jobs::webhooks` has written down: signed as Standard Webhooks, to public addresses only (unless
//! `webhooks_to_private`), again and again until it is taken.

mod sender;
mod sign;

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use futures_util::StreamExt;
use futures_util::future::BoxFuture;
use futures_util::stream::FuturesUnordered;
use uuid::Uuid;

use crate::jobs::webhooks::{Due, Places, Webhooks};
use crate::jobs::{Env, QueueError};

pub use sender::{Lookup, Sender, install_cryptography, system_lookup};
pub use sign::signature;

/// A receiver that lets each attempt wait for its end holds up its own messages, several such receivers of one key that key's.
const PLACES: Places = Places { all: 64, of_key: 16, of_webhook: 4 };
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
    /// Each with the key whose webhook it is for.
    messages: HashMap<String, Option<Uuid>>,
    attempts: FuturesUnordered<BoxFuture<'a, (String, Result<(), QueueError>)>>,
}

impl OnTheWay<'_> {
    /// Whether a message may go: it is not under way, and there is a place. A key's turns change with what becomes due, so
    /// what is on its way is counted and not taken for what is due first.
    fn has_place_for(&self, due: &Due) -> bool {
        !self.messages.contains_key(&due.id)
            && self.messages.len() < PLACES.all as usize
            && self.messages.values().filter(|key| **key == due.key).count() < PLACES.of_key as usize
    }

    /// Waits for an attempt to end; none where none is on its way.
    async fn next(&mut self) -> Option<Result<(), QueueError>> {
        let (id, written) = self.attempts.next().await?;
        self.messages.remove(&id);
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
        for due in self.webhooks.due(PLACES).await? {
            if on_the_way.has_place_for(&due) {
                on_the_way.messages.insert(due.id.clone(), due.key);
                on_the_way.attempts.push(Box::pin(self.attempt(due)));
                begun += 1;
            }
        }
        Ok(begun)
    }

    /// A message whose attempt was not written down, because the process ended in between, is sent again with the same id.
    async fn attempt(&self, due: Due) -> (String, Result<(), QueueError>) {
        let attempt = self.sender.send(&due, self.env.now()).await;
        // The rest of an address is often its receiver's secret.
        let url = url::Url::parse(&due.url).ok();
        let host = url.as_ref().and_then(url::Url::host_str);
        tracing::info!(message = due.id, host, attempt = due.attempts + 1, outcome = ?attempt, "webhook");
        let written = self.webhooks.attempted(&due.id, &attempt).await;
        (due.id, written)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use tokio::net::TcpListener;

    use super::*;
    use crate::jobs::conformance::new_job;
    use crate::jobs::keys::{Keys, NewKey, Quota, Scope, Token};
    use crate::jobs::sqlite::SqliteQueue;
    use crate::jobs::webhooks::{NewWebhook, event_type};
    use crate::jobs::{Policy, Queue, State};

    struct Bench {
        queue: Arc<SqliteQueue>,
        env: Env,
        _folder: tempfile::TempDir,
    }

    impl Bench {
        async fn new() -> Bench {
            let folder = tempfile::tempdir().unwrap();
            let env = Env::system();
            let queue = SqliteQueue::open(&folder.path().join("effigy.db"), env.clone(), Policy::default()).await;
            Bench { queue: Arc::new(queue.unwrap()), env, _folder: folder }
        }

        async fn key(&self, name: &str) -> Uuid {
            let scopes = BTreeSet::from([Scope::Write]);
            let new = NewKey { name: name.into(), scopes, quota: Quota::default(), expires_at: None };
            self.queue.create_key(&new, &Token::from_text(name)).await.unwrap().unwrap().id
        }

        async fn subscribe(&self, key: Uuid, to: &TcpListener) {
            let url = format!("http://{}/", to.local_addr().unwrap());
            let events = BTreeSet::from([event_type(State::Queued)]);
            let new = NewWebhook { key: Some(key), url, secret: vec![7; 32], events };
            self.queue.create_webhook(new).await.unwrap();
        }

        /// A message for each webhook of the key.
        async fn tell(&self, key: Uuid) {
            self.queue.insert(crate::jobs::NewJob { key: Some(key), ..new_job(&self.env) }).await.unwrap();
        }

        fn courier(&self) -> Courier {
            let sender = Sender::new(system_lookup(), true).unwrap();
            Courier { webhooks: self.queue.clone(), sender, env: self.env.clone() }
        }
    }

    #[tokio::test]
    async fn a_keys_mute_receivers_leave_places_for_another_keys() {
        let b = Bench::new().await;
        // Take connections, and say nothing.
        let (mute, other) =
            (TcpListener::bind("127.0.0.1:0").await.unwrap(), TcpListener::bind("127.0.0.1:0").await.unwrap());
        let (one, two) = (b.key("one").await, b.key("other").await);
        for _ in 0..4 {
            b.subscribe(one, &mute).await;
        }
        for _ in 0..4 {
            b.tell(one).await;
        }
        let courier = b.courier();
        let mut on_the_way = OnTheWay::default();
        assert_eq!(courier.begin(&mut on_the_way).await.unwrap(), PLACES.of_key as usize);
        // Nor do webhooks get more whose first turn comes before the second ones that are on their way.
        for _ in 0..5 {
            b.subscribe(one, &mute).await;
            b.tell(one).await;
            assert_eq!(courier.begin(&mut on_the_way).await.unwrap(), 0);
        }
        b.subscribe(two, &other).await;
        b.tell(two).await;
        assert_eq!(courier.begin(&mut on_the_way).await.unwrap(), 1);
        assert!(on_the_way.messages.values().any(|key| *key == Some(two)));
    }

    #[tokio::test]
    async fn keys_take_turns() {
        let b = Bench::new().await;
        let receiver = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let (one, two) = (b.key("one").await, b.key("other").await);
        for _ in 0..10 {
            b.subscribe(one, &receiver).await;
        }
        b.subscribe(two, &receiver).await;
        for _ in 0..3 {
            b.tell(one).await;
        }
        for _ in 0..6 {
            b.tell(two).await;
        }
        let due = b.queue.due(PLACES).await.unwrap();
        let of = |key| due.iter().filter(|due| due.key == Some(key)).count();
        assert_eq!((of(one), of(two)), (PLACES.of_key as usize, PLACES.of_webhook as usize));
        let first: Vec<_> = due[..8].iter().map(|due| due.key).collect();
        assert_eq!(first, [Some(one), Some(two)].repeat(4), "whoever has many waits no less than the other");
    }
}
