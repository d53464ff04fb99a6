//! From `tracing`'s spans to those of OpenTelemetry.

use std::sync::mpsc::SyncSender;
use std::time::SystemTime;

use serde_json::{Value, json};
use tracing::field::{Field, Visit};
use tracing::span::{Attributes, Id, Record};
use tracing::{Event, Level, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::layer::Context;
use tracing_subscriber::registry::LookupSpan;
use uuid::Uuid;

/// What goes to the exporter.
pub(super) enum Message {
    Span(Finished),
    End,
}

/// A span that has ended.
#[derive(Debug)]
pub(super) struct Finished {
    open: Open,
    name: &'static str,
    end: SystemTime,
}

#[derive(Debug)]
struct Open {
    trace: u128,
    id: u64,
    parent: Option<u64>,
    start: SystemTime,
    /// OTLP's `KeyValue`s.
    attributes: Vec<Value>,
    /// The first error that was logged within.
    error: Option<String>,
}

/// Hears of this program's spans and hands them on when they end.
pub struct SpanLayer {
    sink: SyncSender<Message>,
}

impl SpanLayer {
    pub(super) fn new(sink: SyncSender<Message>) -> Self {
        Self { sink }
    }
}

impl<S: Subscriber + for<'a> LookupSpan<'a>> Layer<S> for SpanLayer {
    fn on_new_span(&self, attributes: &Attributes<'_>, id: &Id, context: Context<'_, S>) {
        let Some(span) = context.span(id) else { return };
        if !attributes.metadata().target().starts_with("effigy") {
            return;
        }
        let mut fields = Fields::default();
        attributes.record(&mut fields);
        let parent =
            span.parent().and_then(|parent| parent.extensions().get::<Open>().map(|open| (open.trace, open.id)));
        // A caller may be part of a trace already.
        let parent = parent.or_else(|| parse_traceparent(fields.traceparent.as_deref()?));
        let open = Open {
            trace: parent.map_or_else(|| Uuid::new_v4().as_u128(), |(trace, _)| trace),
            id: Uuid::new_v4().as_u64_pair().0,
            parent: parent.map(|(_, id)| id),
            start: now(),
            attributes: fields.attributes,
            error: None,
        };
        span.extensions_mut().insert(open);
    }

    fn on_record(&self, id: &Id, values: &Record<'_>, context: Context<'_, S>) {
        let Some(span) = context.span(id) else { return };
        if let Some(open) = span.extensions_mut().get_mut::<Open>() {
            let mut fields = Fields::default();
            values.record(&mut fields);
            open.attributes.append(&mut fields.attributes);
        }
    }

    fn on_event(&self, event: &Event<'_>, context: Context<'_, S>) {
        if *event.metadata().level() != Level::ERROR {
            return;
        }
        let Some(span) = context.event_span(event) else { return };
        if let Some(open) = span.extensions_mut().get_mut::<Open>()
            && open.error.is_none()
        {
            let mut fields = Fields::default();
            event.record(&mut fields);
            open.error = Some(fields.message.unwrap_or_default());
        }
    }

    fn on_close(&self, id: Id, context: Context<'_, S>) {
        let Some(span) = context.span(&id) else { return };
        if let Some(open) = span.extensions_mut().remove::<Open>() {
            // A full channel means that the collector is too slow: the span is dropped.
            let _ = self.sink.try_send(Message::Span(Finished { open, name: span.name(), end: now() }));
        }
    }
}

#[expect(
    clippy::disallowed_methods,
    reason = "spans are made before there is an environment, and nothing follows from them"
)]
fn now() -> SystemTime {
    SystemTime::now()
}

impl Finished {
    /// OTLP's `Span`, in JSON: ids as hex, times as decimal text.
    pub(super) fn json(&self) -> Value {
        const INTERNAL: u32 = 1;
        const SERVER: u32 = 2;
        const ERROR: u32 = 2;
        let nanos = |time: SystemTime| {
            time.duration_since(SystemTime::UNIX_EPOCH).map_or(0, |since| since.as_nanos()).to_string()
        };
        let Open { trace, id, parent, start, attributes, error } = &self.open;
        let mut span = json!({
            "traceId": format!("{trace:032x}"), "spanId": format!("{id:016x}"), "name": self.name,
            "kind": if self.name == "request" { SERVER } else { INTERNAL },
            "startTimeUnixNano": nanos(*start), "endTimeUnixNano": nanos(self.end), "attributes": attributes,
        });
        if let Some(parent) = parent {
            span["parentSpanId"] = format!("{parent:016x}").into();
        }
        if let Some(error) = error {
            span["status"] = json!({ "code": ERROR, "message": error });
        }
        span
    }
}

/// `00-<trace>-<parent>-<flags>` (W3C Trace Context).
fn parse_traceparent(text: &str) -> Option<(u128, u64)> {
    let mut words = text.split('-');
    let (version, trace, parent) = (words.next()?, words.next()?, words.next()?);
    let is_hex = |text: &str| text.bytes().all(|b| b.is_ascii_digit() || (b'a'..=b'f').contains(&b));
    if version.len() != 2 || trace.len() != 32 || parent.len() != 16 || !is_hex(trace) || !is_hex(parent) {
        return None;
    }
    let (trace, parent) = (u128::from_str_radix(trace, 16).ok()?, u64::from_str_radix(parent, 16).ok()?);
    (trace != 0 && parent != 0).then_some((trace, parent))
}

#[derive(Default)]
struct Fields {
    attributes: Vec<Value>,
    traceparent: Option<String>,
    message: Option<String>,
}

impl Fields {
    fn add(&mut self, field: &Field, value: Value) {
        // By the names of OpenTelemetry's conventions where there are any.
        let key = match field.name() {
            "method" => "http.request.method".into(),
            "path" => "url.path".into(),
            "status" => "http.response.status_code".into(),
            name => format!("effigy.{name}"),
        };
        self.attributes.push(json!({ "key": key, "value": value }));
    }
}

impl Visit for Fields {
    fn record_str(&mut self, field: &Field, value: &str) {
        match field.name() {
            "traceparent" => self.traceparent = Some(value.into()),
            "message" => self.message = Some(value.into()),
            _ if value.is_empty() => {}
            _ => self.add(field, json!({ "stringValue": value })),
        }
    }

    fn record_debug(&mut self, field: &Field, value: &dyn std::fmt::Debug) {
        self.record_str(field, &format!("{value:?}"));
    }

    fn record_u64(&mut self, field: &Field, value: u64) {
        self.add(field, json!({ "intValue": value.to_string() }));
    }

    fn record_i64(&mut self, field: &Field, value: i64) {
        self.add(field, json!({ "intValue": value.to_string() }));
    }

    fn record_f64(&mut self, field: &Field, value: f64) {
        self.add(field, json!({ "doubleValue": value }));
    }

    fn record_bool(&mut self, field: &Field, value: bool) {
        self.add(field, json!({ "boolValue": value }));
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::sync_channel;

    use tracing_subscriber::layer::SubscriberExt;

    use super::*;

    fn spans(act: impl FnOnce()) -> Vec<Value> {
        let (sink, source) = sync_channel(16);
        tracing::subscriber::with_default(tracing_subscriber::registry().with(SpanLayer::new(sink)), act);
        let message = |message| match message {
            Message::Span(span) => span.json(),
            Message::End => panic!("nobody said so"),
        };
        source.into_iter().map(message).collect()
    }

    #[test]
    fn a_span_within_another_is_of_its_trace() {
        let spans = spans(|| {
            let fit = tracing::info_span!("fit", job = "j", attempt = 2, outcome = tracing::field::Empty);
            let stage = tracing::info_span!(parent: &fit, "stage", stage = "pose");
            stage.in_scope(|| tracing::error!("it broke"));
            drop(stage);
            fit.record("outcome", "failed");
        });
        let (stage, fit) = (&spans[0], &spans[1]);
        assert_eq!((&stage["name"], &fit["name"], &fit["kind"]), (&json!("stage"), &json!("fit"), &json!(1)));
        assert_eq!((&stage["traceId"], &stage["parentSpanId"]), (&fit["traceId"], &fit["spanId"]));
        assert_eq!(fit.get("parentSpanId"), None);
        assert_eq!(stage["status"], json!({ "code": 2, "message": "it broke" }));
        let attributes = |key: &str, value: Value| json!({ "key": key, "value": value });
        assert_eq!(
            fit["attributes"],
            json!([
                attributes("effigy.job", json!({ "stringValue": "j" })),
                attributes("effigy.attempt", json!({ "intValue": "2" })),
                attributes("effigy.outcome", json!({ "stringValue": "failed" })),
            ])
        );
        let nanos = |key: &str| fit[key].as_str().unwrap().parse::<u128>().unwrap();
        assert!(nanos("startTimeUnixNano") <= nanos("endTimeUnixNano"));
    }

    #[test]
    fn a_request_goes_on_with_the_trace_of_its_caller() {
        let caller = "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01";
        let spans = spans(|| drop(tracing::info_span!("request", traceparent = caller)));
        assert_eq!(spans[0]["traceId"], "0af7651916cd43dd8448eb211c80319c");
        assert_eq!((&spans[0]["parentSpanId"], &spans[0]["kind"]), (&json!("b7ad6b7169203331"), &json!(2)));
        for wrong in
            ["", "00-0-0-0", &caller.replace('a', "A"), &caller.replace("b7ad6b7169203331", "0000000000000000")]
        {
            assert_eq!(parse_traceparent(wrong), None, "{wrong}");
        }
    }
}
