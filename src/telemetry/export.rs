//! The thread that sends spans to the collector.

use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use serde_json::{Value, json};

use super::spans::{Message, SpanLayer};

/// Spans that wait for the thread at most.
const WAITING: usize = 4096;
/// Spans in a request at most, and the longest that one waits.
const BATCH: usize = 512;
const INTERVAL: Duration = Duration::from_secs(2);
const TIMEOUT: Duration = Duration::from_secs(5);

/// Sends spans until it is dropped, then what is left.
pub struct Exporter {
    sink: SyncSender<Message>,
    thread: Option<JoinHandle<()>>,
}

/// Where a collector takes spans.
pub fn traces_url(endpoint: &str) -> Result<reqwest::Url> {
    let url = format!("{}/v1/traces", endpoint.trim_end_matches('/'));
    reqwest::Url::parse(&url).with_context(|| format!("the setting otlp_endpoint, {endpoint:?}"))
}

impl Exporter {
    /// To the collector at `endpoint` (`http://127.0.0.1:4318`), in the name of `role`.
    pub fn start(endpoint: &str, role: &'static str) -> Result<(SpanLayer, Exporter)> {
        let url = traces_url(endpoint)?;
        let (sink, source) = sync_channel(WAITING);
        let thread = std::thread::Builder::new().name("otlp".into());
        // The client keeps a runtime of its own, which must not be made within another.
        let thread = thread.spawn(move || match reqwest::blocking::Client::builder().timeout(TIMEOUT).build() {
            Ok(client) => serve(&source, &client, &url, role),
            Err(error) => tracing::error!(%error, "no spans are sent"),
        })?;
        Ok((SpanLayer::new(sink.clone()), Exporter { sink, thread: Some(thread) }))
    }
}

impl Drop for Exporter {
    fn drop(&mut self) {
        // A thread that is overwhelmed does not hear of the end, and would be waited for in vain: it goes with the process.
        let told = self.sink.try_send(Message::End).is_ok();
        if told && let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn serve(source: &Receiver<Message>, client: &reqwest::blocking::Client, url: &reqwest::Url, role: &str) {
    let mut batch: Vec<Value> = Vec::new();
    let mut due = Instant::now() + INTERVAL;
    let mut failing = false;
    loop {
        let message = source.recv_timeout(due.saturating_duration_since(Instant::now()));
        let ends = matches!(message, Ok(Message::End) | Err(RecvTimeoutError::Disconnected));
        if let Ok(Message::Span(span)) = message {
            batch.push(span.json());
        }
        if !batch.is_empty() && (ends || batch.len() >= BATCH || Instant::now() >= due) {
            let sent = send(client, url, role, std::mem::take(&mut batch));
            match &sent {
                Err(error) if !failing => tracing::warn!(%url, %error, "the collector takes no spans"),
                Ok(()) if failing => tracing::info!(%url, "the collector takes spans again"),
                _ => {}
            }
            failing = sent.is_err();
        }
        if Instant::now() >= due {
            due = Instant::now() + INTERVAL;
        }
        if ends {
            return;
        }
    }
}

/// OTLP's `ExportTraceServiceRequest`. Spans that are not taken are lost.
fn send(client: &reqwest::blocking::Client, url: &reqwest::Url, role: &str, spans: Vec<Value>) -> reqwest::Result<()> {
    let attribute = |key: &str, value: &str| json!({ "key": key, "value": { "stringValue": value } });
    let resource = json!({ "attributes": [
        attribute("service.name", "effigy"),
        attribute("service.version", env!("CARGO_PKG_VERSION")),
        attribute("effigy.role", role),
    ] });
    let scope = json!({ "scope": { "name": "effigy" }, "spans": spans });
    let body = json!({ "resourceSpans": [{ "resource": resource, "scopeSpans": [scope] }] });
    client.post(url.clone()).json(&body).send()?.error_for_status().map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_end_does_not_wait_for_a_thread_that_was_not_told() {
        let (sink, source) = sync_channel(1);
        sink.send(Message::End).unwrap();
        let (release, held) = std::sync::mpsc::channel::<()>();
        let thread = std::thread::spawn(move || {
            // Busy with a request.
            let _ = held.recv();
            drop(source);
        });
        drop(Exporter { sink, thread: Some(thread) });
        release.send(()).expect("it is still busy");
    }
}
