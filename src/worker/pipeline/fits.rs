//! The fits of a job, one after the other: of the person, of the texture on a surface that was adjusted or tailored, of the texture's
//! detail. Each has a checkpoint of its own and goes on from there.

use std::path::Path;
use std::sync::Arc;

use super::monitor::Monitor;
use super::{PipelineError, Stage, StopReason};
use crate::fit::detail::{Detail, ROUNDS, rounds};
use crate::fit::{self, FitError, FitState, Inputs};
use crate::gpu::Gpu;

/// Checkpoints in a job's folder.
pub(super) const PERSON: &str = "checkpoint.npz";
const TAILORED: &str = "tailored.npz";
const DETAILED: [&str; ROUNDS.len()] = ["detailed-1.npz", "detailed-2.npz", "detailed-3.npz"];

pub(super) struct Fits<'a, 'm> {
    gpu: &'a Arc<Gpu>,
    work_dir: &'a Path,
    pub monitor: &'a mut Monitor<'m>,
    /// Of the fits so far.
    texture_steps: u32,
}

impl<'a, 'm> Fits<'a, 'm> {
    pub fn new(gpu: &'a Arc<Gpu>, work_dir: &'a Path, monitor: &'a mut Monitor<'m>) -> Self {
        Self { gpu, work_dir, monitor, texture_steps: 0 }
    }

    /// Stages 1 and 2.
    pub fn person(&mut self, inputs: &Inputs<'_>, fresh: FitState) -> Result<FitState, PipelineError> {
        let checkpoint = self.work_dir.join(PERSON);
        let state = self.resumed(inputs, fresh, &checkpoint);
        self.monitor.curves.load();
        match state.stage {
            fit::Stage::Geometry => self.monitor.curves.cut(Stage::Geometry, state.step),
            fit::Stage::Texture => self.monitor.curves.cut(Stage::Texture, state.step),
            fit::Stage::Done => {}
        }
        if state.stage != fit::Stage::Done {
            // What lies there is of an earlier fit.
            std::iter::once(TAILORED).chain(DETAILED).for_each(|later| self.forget(later));
        }
        let steps = self.count_texture_steps(inputs);
        self.monitor.expect_texture_steps(steps);
        self.monitor.start(Stage::Geometry)?;
        self.run(inputs, state, &checkpoint)
    }

    /// The texture anew, on a surface that was adjusted or tailored after `fitted` had ended. Whoever knows that it will come expects its
    /// steps.
    pub fn tailored(&mut self, inputs: &Inputs<'_>, fitted: FitState) -> Result<FitState, PipelineError> {
        let checkpoint = self.work_dir.join(TAILORED);
        let fresh = FitState { stage: fit::Stage::Texture, step: 0, ..fitted };
        let state = self.resumed(inputs, fresh, &checkpoint);
        let before = self.texture_steps;
        self.count_texture_steps(inputs);
        self.monitor.go_on_with(&checkpoint, before);
        if state.stage != fit::Stage::Done {
            self.monitor.curves.cut(Stage::Texture, before + state.step);
        }
        self.run(inputs, state, &checkpoint)
    }

    /// The texture of `fitted` on, whose fit had the inputs `before`. Its steps are expected since before the pictures were read.
    pub fn detailed(
        &mut self,
        before: &Inputs<'_>,
        detail: &Detail,
        fitted: FitState,
    ) -> Result<FitState, PipelineError> {
        // Sums over other pictures are no part of the same curves.
        self.monitor.draws_curves = false;
        let fresh = detail.start(&fitted, before.config);
        let (ended, mut state) = self.ended_rounds(&fresh).unwrap_or((0, fresh));
        let mut steps_before = self.texture_steps;
        for (round, config) in rounds(&detail.config).iter().enumerate() {
            if round >= ended {
                let fresh = FitState { stage: fit::Stage::Texture, step: 0, ..state };
                let whole = Inputs { config, ..*before };
                state = self.round(&whole, detail, fresh, &self.work_dir.join(DETAILED[round]), steps_before)?;
                // What the round began from is of no use any more, and a disk may be full.
                DETAILED[..round].iter().for_each(|earlier| self.forget(earlier));
            }
            steps_before += config.steps(&config.texture.phases, state.n_frames());
        }
        Ok(Detail::end(fitted, state))
    }

    /// How many rounds of the detail that begins as `fresh` have ended, and how the last one did.
    fn ended_rounds(&self, fresh: &FitState) -> Option<(usize, FitState)> {
        let ended = |round: usize| {
            let state = saved(fresh, &self.work_dir.join(DETAILED[round]))?;
            (state.stage == fit::Stage::Done).then_some((round + 1, state))
        };
        (0..DETAILED.len()).rev().find_map(ended)
    }

    fn forget(&self, checkpoint: &str) {
        drop(std::fs::remove_file(self.work_dir.join(checkpoint)));
    }

    /// One round of the detail; `whole` has its configuration, and the clip of the fit.
    fn round(
        &mut self,
        whole: &Inputs<'_>,
        detail: &Detail,
        mut fresh: FitState,
        checkpoint: &Path,
        steps_before: u32,
    ) -> Result<FitState, PipelineError> {
        // Where a checkpoint is gone on from, too: it has no pictures.
        let placed = detail.place(self.gpu, whole.body, &mut fresh, &mut || self.monitor.go_on());
        let placed = placed.map_err(|error| from_fit(error, self.monitor.stopped))?;
        // Drawn is the whole person still: the first of the detail's pictures may be of a head.
        let state = self.resumed(whole, fresh, checkpoint);
        self.monitor.go_on_with(checkpoint, steps_before);
        self.run(&Inputs { capture: &placed, camera: &detail.camera, ..*whole }, state, checkpoint)
    }

    /// Where the fit goes on from, and a picture of it.
    fn resumed(&mut self, inputs: &Inputs<'_>, fresh: FitState, checkpoint: &Path) -> FitState {
        let state = saved(&fresh, checkpoint).unwrap_or(fresh);
        self.preview_from(inputs, &state);
        state
    }

    fn preview_from(&mut self, inputs: &Inputs<'_>, state: &FitState) {
        let Inputs { body, capture, camera, config } = *inputs;
        self.monitor.preview_from(body, capture, camera, config, state);
    }

    fn count_texture_steps(&mut self, inputs: &Inputs<'_>) -> u32 {
        let steps = inputs.config.steps(&inputs.config.texture.phases, inputs.capture.frames.len());
        self.texture_steps += steps;
        steps
    }

    fn run(&mut self, inputs: &Inputs<'_>, state: FitState, checkpoint: &Path) -> Result<FitState, PipelineError> {
        let ended = fit::run(self.gpu, inputs, state, checkpoint, self.monitor);
        ended.map_err(|error| from_fit(error, self.monitor.stopped))
    }
}

/// What a checkpoint holds of a fit that began as `fresh`. One that is not there or cannot be read is worth no more than none.
fn saved(fresh: &FitState, checkpoint: &Path) -> Option<FitState> {
    fresh.resume(checkpoint).ok().flatten()
}

pub(super) fn from_fit(error: FitError, stopped: Option<StopReason>) -> PipelineError {
    let detail = error.to_string();
    match error {
        FitError::Stopped => PipelineError::Stopped(stopped.unwrap_or(StopReason::Shutdown)),
        FitError::Diverged { losses, .. } => {
            let losses = losses.into_iter().map(|(name, value)| (name.to_owned(), value as f64)).collect();
            PipelineError::Diverged { detail, losses }
        }
        FitError::Device(error) => PipelineError::Device(error),
        other => PipelineError::Internal(other.into()),
    }
}
