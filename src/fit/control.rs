//! How the outside follows and stops a fit.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use super::state::{FitState, Stage};

/// Where the fit stands after a step.
#[derive(Debug)]
pub struct StepReport<'a> {
    pub stage: Stage,
    pub step: u32,
    pub steps: u32,
    /// Mean losses a frame since the last report, in the steps that read them back.
    pub losses: Option<&'a BTreeMap<&'static str, f32>>,
}

/// What to do next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flow {
    Continue,
    /// With a checkpoint, from which another run goes on.
    Stop,
    /// As it is: the checkpoint is somebody else's by now.
    Abandon,
}

/// Called between iterations on the thread that owns the device.
pub trait Control {
    fn after_step(&mut self, report: &StepReport<'_>) -> Flow;

    /// Asked after a step: whether [`Control::look`] shall see the parameters. Reading them back waits for the device.
    fn wants_look(&mut self) -> bool {
        false
    }

    /// The parameters as they are: after a step for which they were wanted, and at the end of each stage.
    fn look(&mut self, _state: &FitState) {}
}

/// Checkpoints and read-backs of losses in time, not in steps: a step takes milliseconds on one device and a second on
/// another.
pub(super) struct Pace {
    last_checkpoint: Instant,
    last_losses: Instant,
}

impl Pace {
    pub(super) fn new() -> Self {
        let now = Instant::now();
        Self { last_checkpoint: now, last_losses: now }
    }

    /// True every 20 seconds: with the step and the writing that come on top, a kill costs less than 30 seconds of fitting.
    pub(super) fn checkpoint_due(&mut self) -> bool {
        due(&mut self.last_checkpoint, Duration::from_secs(20))
    }

    /// True every second.
    pub(super) fn losses_due(&mut self) -> bool {
        due(&mut self.last_losses, Duration::from_secs(1))
    }
}

fn due(last: &mut Instant, every: Duration) -> bool {
    let now = Instant::now();
    let due = now.duration_since(*last) >= every;
    if due {
        *last = now;
    }
    due
}
