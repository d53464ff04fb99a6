//! How a command shows the progress of its fit.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use effigy::gpu::Gpu;
use effigy::worker::pipeline::{Observer, Progress, Stage, StopReason};
use indicatif::{ProgressBar, ProgressStyle};

fn bar() -> ProgressBar {
    let style = ProgressStyle::with_template("{prefix:9} [{bar:40}] {percent:>3} %  {msg}");
    ProgressBar::new(1000).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("#> "))
}

/// Shows progress as a bar, line by line where standard error is no terminal, or as JSON.
pub(super) struct Follower {
    bar: ProgressBar,
    json: bool,
    /// The last that a line told of.
    stage: Option<Stage>,
    stopped: Arc<AtomicBool>,
}

impl Follower {
    pub fn new(json: bool, stopped: Arc<AtomicBool>) -> Self {
        Self { bar: if json { ProgressBar::hidden() } else { bar() }, json, stage: None, stopped }
    }

    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

impl Observer for Follower {
    fn progress(&mut self, p: &Progress) {
        if self.json {
            if p.step == 0 || p.step == p.steps || !p.losses.is_empty() {
                let line = serde_json::json!({
                    "stage": p.stage.name(), "step": p.step, "steps": p.steps, "progress": p.progress,
                    "eta_secs": p.eta_secs, "losses": p.losses,
                });
                println!("{line}");
            }
            return;
        }
        if self.bar.is_hidden() {
            if self.stage.replace(p.stage) != Some(p.stage) {
                eprintln!("{:3.0} %  {}", 100.0 * p.progress, p.stage.name());
            }
            return;
        }
        self.bar.set_prefix(p.stage.name());
        self.bar.set_position((p.progress * 1000.0) as u64);
        let losses: Vec<String> = p.losses.iter().map(|(name, value)| format!("{name} {value:.4}")).collect();
        let left = p.eta_secs.map_or(String::new(), |secs| format!("{secs:.0} s left  "));
        self.bar.set_message(format!("{left}{}", losses.join("  ")));
    }

    fn begins_anew(&mut self) {
        self.bar
            .suspend(|| eprintln!("what lay there is of other files, options or another program: the fit begins anew"));
    }

    fn stop(&mut self) -> Option<StopReason> {
        self.stopped.load(Ordering::Relaxed).then_some(StopReason::Shutdown)
    }

    fn idle(&mut self, _gpu: &Arc<Gpu>) {}
}
