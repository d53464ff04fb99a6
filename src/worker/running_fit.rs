//! What the two sides of a running fit share: the device's thread tells how it goes, the runner takes that and says when to
//! stop.

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use tokio::sync::watch;
use tracing::Span;

use super::pipeline::{Preview, Progress, StopReason};

/// What the two sides of a running fit share.
pub struct RunningFit {
    stop: Mutex<Option<StopReason>>,
    /// The fit's last sign of life.
    alive: Mutex<Instant>,
    /// The fit had a checkpoint of no use, until that is told on.
    begun_anew: AtomicBool,
    /// How far the newest checkpoint has come, until it is told on.
    saved: Mutex<Option<f32>>,
    /// The newest picture with its number, until it is passed on.
    preview: Mutex<(u32, Option<Preview>)>,
    progress: watch::Sender<Option<Progress>>,
    /// The first progress of each stage, however short the stage was.
    begun: Mutex<Vec<Progress>>,
    stage_secs: Mutex<BTreeMap<&'static str, f64>>,
    /// The attempt's, in which the stages are.
    span: Span,
}

impl Default for RunningFit {
    fn default() -> Self {
        RunningFit {
            stop: Mutex::default(),
            alive: Mutex::new(Instant::now()),
            begun_anew: AtomicBool::default(),
            saved: Mutex::default(),
            preview: Mutex::default(),
            progress: watch::Sender::default(),
            begun: Mutex::default(),
            stage_secs: Mutex::default(),
            span: Span::current(),
        }
    }
}

impl RunningFit {
    /// How long the fit has shown no step.
    pub fn silence(&self) -> Duration {
        self.alive.lock().unwrap().elapsed()
    }

    /// The fit, or whoever has its device meanwhile, shows a sign of life.
    pub fn mark_alive(&self) {
        *self.alive.lock().unwrap() = Instant::now();
    }

    /// Whether the fit has begun anew since the last call.
    pub fn take_begun_anew(&self) -> bool {
        self.begun_anew.swap(false, Ordering::Relaxed)
    }

    /// How far the checkpoint has come, where one was written since the last call.
    pub fn take_saved(&self) -> Option<f32> {
        self.saved.lock().unwrap().take()
    }

    /// The newest picture and its number, from 1 on, where one was drawn since the last call.
    pub fn take_preview(&self) -> Option<(u32, Preview)> {
        let mut preview = self.preview.lock().unwrap();
        Some((preview.0, preview.1.take()?))
    }

    /// Asks the fit to stop. The first reason stays, but a lost lease outweighs all: nothing may be written then.
    pub fn stop(&self, reason: StopReason) {
        let mut stop = self.stop.lock().unwrap();
        if stop.is_none() || reason == StopReason::LostLease {
            *stop = Some(reason);
        }
    }

    pub fn stop_reason(&self) -> Option<StopReason> {
        *self.stop.lock().unwrap()
    }

    pub fn progress(&self) -> watch::Receiver<Option<Progress>> {
        self.progress.subscribe()
    }

    /// The beginnings of stages since the last call.
    pub fn take_begun(&self) -> Vec<Progress> {
        std::mem::take(&mut *self.begun.lock().unwrap())
    }

    /// Seconds spent in stages since the last call.
    pub fn take_stage_secs(&self) -> BTreeMap<&'static str, f64> {
        std::mem::take(&mut *self.stage_secs.lock().unwrap())
    }

    /// Where the fit stands.
    pub fn set_progress(&self, progress: Progress) {
        self.progress.send_replace(Some(progress));
    }

    /// A stage begins, with this progress; the span is the stage's.
    pub fn begin_stage(&self, progress: Progress) -> Span {
        let span = tracing::info_span!(parent: &self.span, "stage", stage = progress.stage.name());
        self.begun.lock().unwrap().push(progress);
        span
    }

    pub fn add_stage_secs(&self, stage: &'static str, secs: f64) {
        *self.stage_secs.lock().unwrap().entry(stage).or_default() += secs;
    }

    pub fn set_begun_anew(&self) {
        self.begun_anew.store(true, Ordering::Relaxed);
    }

    /// How far the newest checkpoint has come.
    pub fn set_saved(&self, progress: f32) {
        *self.saved.lock().unwrap() = Some(progress);
    }

    pub fn set_preview(&self, preview: Preview) {
        let mut newest = self.preview.lock().unwrap();
        *newest = (newest.0 + 1, Some(preview));
    }
}
