//! The integration tests: one binary, one module a topic.

mod import_rule;
mod synth;
