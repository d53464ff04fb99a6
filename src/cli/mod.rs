pub mod backup;
pub mod bench;
pub mod body;
pub mod config;
pub mod doctor;
pub mod eval;
pub mod fit;
pub mod keys;
pub mod openapi;
pub mod render;
pub mod robustness;
pub mod serve;
mod service;
mod settings;
pub mod study;
pub mod synth;
pub mod worker;

use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

/// A bar for people on standard error; hidden where that is no terminal.
pub fn progress(len: u64, unit: &str) -> ProgressBar {
    let template = format!("{{bar:40}} {{pos}}/{{len}} {unit}, {{eta}} left");
    ProgressBar::new(len).with_style(ProgressStyle::with_template(&template).expect("the template is well formed"))
}

/// A spinner with a message, for work of unknown length.
pub fn spinner() -> ProgressBar {
    let spinner = ProgressBar::new_spinner();
    spinner.enable_steady_tick(Duration::from_millis(120));
    spinner
}
