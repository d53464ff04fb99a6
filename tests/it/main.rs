//! The integration tests: one binary, one module a topic.

mod bench;
mod fit;
mod import_rule;
mod service;
mod synth;
