//! The integration tests: one binary, one module a topic.

mod bench;
mod config;
mod deploy;
mod doctor;
mod fit;
mod fuzz;
mod import_rule;
mod local;
mod program;
mod robustness;
mod service;
mod study;
mod synth;
