//! Spans to an OpenTelemetry collector, where the setting `otlp_endpoint` names one: the server's requests, the attempts
//! of jobs and the stages of their fits. OTLP over HTTP in its JSON encoding, which every collector takes, from a thread of
//! its own. What a collector does not take in time is dropped: the service never waits for it.

mod export;
mod spans;

pub use export::{Exporter, traces_url};
pub use spans::SpanLayer;
