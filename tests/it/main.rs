//! The integration tests: one binary, one module a topic.

mod bench;
mod import_rule;
mod service;
mod synth;
