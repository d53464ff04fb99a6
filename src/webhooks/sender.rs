//! One attempt to send a message. The address that is connected to is the one that was checked: names are resolved here,
//! and whatever the name service says a moment later does not matter.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use futures_util::future::BoxFuture;
use reqwest::dns::{Addrs, Name, Resolve, Resolving};
use reqwest::redirect;

use super::sign::signature;
use crate::jobs::Timestamp;
use crate::jobs::webhooks::{Attempt, Due, check_url, is_public};

/// From the connection to the head of the answer.
const TIMEOUT: Duration = Duration::from_secs(15);

/// Asks the name service for the addresses of a host.
pub type Lookup = Arc<dyn Fn(String) -> BoxFuture<'static, io::Result<Vec<SocketAddr>>> + Send + Sync>;

/// The machine's own name service.
pub fn system_lookup() -> Lookup {
    Arc::new(|host| {
        // The port is replaced by the connection's own.
        Box::pin(async move { Ok(tokio::net::lookup_host((host, 0)).await?.collect()) })
    })
}

/// Gives TLS its cryptography; without, no `reqwest` client can be made.
pub fn install_cryptography() {
    // Whoever was first has installed the same one.
    let _ = rustls::crypto::ring::default_provider().install_default();
}

/// Sends signed messages, to public addresses only unless `private`.
pub struct Sender {
    client: reqwest::Client,
    private: bool,
}

impl Sender {
    /// `private` allows plain HTTP and addresses of one's own network.
    pub fn new(lookup: Lookup, private: bool) -> anyhow::Result<Sender> {
        install_cryptography();
        let client = reqwest::Client::builder()
            .dns_resolver(Arc::new(Checked { lookup, private }))
            // A redirection leads elsewhere unchecked, and a proxy resolves by itself.
            .redirect(redirect::Policy::none())
            .no_proxy()
            .timeout(TIMEOUT)
            .user_agent(concat!("effigy/", env!("CARGO_PKG_VERSION")))
            .build()?;
        Ok(Sender { client, private })
    }

    pub async fn send(&self, due: &Due, now: Timestamp) -> Attempt {
        // Numbers in place of a name are never resolved, and the rule may have changed since the webhook was made.
        let url = match check_url(&due.url, self.private) {
            Ok(url) => url,
            Err(error) => return Attempt::Failed(error.to_string()),
        };
        let timestamp = now.0.div_euclid(1000);
        let request = self
            .client
            .post(url)
            .header("content-type", "application/json")
            .header("webhook-id", &due.id)
            .header("webhook-timestamp", timestamp)
            .header("webhook-signature", signature(&due.secret, &due.id, timestamp, &due.payload))
            .body(due.payload.clone());
        match request.send().await {
            Ok(response) => Attempt::Answered(response.status().as_u16()),
            Err(error) => Attempt::Failed(innermost(&error)),
        }
    }
}

/// The cause says more than what it caused.
fn innermost(error: &dyn std::error::Error) -> String {
    let mut cause = error;
    while let Some(source) = cause.source() {
        cause = source;
    }
    cause.to_string()
}

/// Resolves to public addresses only.
struct Checked {
    lookup: Lookup,
    private: bool,
}

impl Resolve for Checked {
    fn resolve(&self, name: Name) -> Resolving {
        let host = name.as_str().to_string();
        let (found, private) = ((self.lookup)(host.clone()), self.private);
        Box::pin(async move {
            let found = found.await?;
            // One private address among public ones is as bad: the connection could fall back to it.
            match found.iter().find(|address| !private && !is_public(address.ip())) {
                // Which one is for the log: the names of one's own network are not for whoever makes webhooks.
                Some(address) => {
                    tracing::warn!(host, address = %address.ip(), "a webhook's host has an address that is not public");
                    Err(format!("{host} has an address that is not a public address").into())
                }
                None => Ok(Box::new(found.into_iter()) as Addrs),
            }
        })
    }
}
