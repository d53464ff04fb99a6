//! How a stage runs: phases, epochs and batches in an order that a resumed fit repeats, with losses, checkpoints and
//! reports in between. What a step does is the stage's own ([`super::stage`]).

use std::path::Path;

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_pcg::Pcg32;

use super::FitError;
use super::config::{FitConfig, Phase};
use super::control::{Control, Flow, Pace, StepReport};
use super::losses::Losses;
use super::scene::Scene;
use super::state::{FitState, Stage};

/// One step of a stage.
pub(super) struct Step<'a> {
    pub phase: &'a Phase,
    /// The frames that the step looks at.
    pub frames: &'a [usize],
    /// Factor on all learning rates: the phase's, and the decay over the stage.
    pub rate: f32,
    /// From 1 on, over the whole stage.
    pub number: u32,
}

/// What a stage does; [`run`] says when.
pub(super) trait Work {
    /// Called before the first step of a phase, and before the first one after a resumption.
    fn start_phase(&mut self, phase: &Phase) -> Result<(), FitError>;

    /// Records and submits one step.
    fn step(&mut self, step: &Step<'_>) -> Result<(), FitError>;

    fn losses(&mut self) -> &mut Losses;

    /// Reads the parameters of the stage back. Waits.
    fn read_into(&self, state: &mut FitState) -> Result<(), FitError>;
}

/// Who follows the fit, and where its state goes.
pub(super) struct Outside<'a> {
    pub checkpoint: &'a Path,
    pub control: &'a mut dyn Control,
}

/// Runs the phases of a stage from `state.step` on.
pub(super) fn run(
    scene: &Scene,
    config: &FitConfig,
    phases: &[Phase],
    work: &mut dyn Work,
    state: &mut FitState,
    outside: &mut Outside<'_>,
) -> Result<(), FitError> {
    let n_frames = scene.frames.len();
    let batches = n_frames.div_ceil(config.batch) as u32;
    let steps: u32 = phases.iter().map(|p| p.epochs * batches).sum();
    let mut pace = Pace::new();
    let mut number = 0;
    for (nth, phase) in phases.iter().enumerate() {
        if number + phase.epochs * batches <= state.step {
            number += phase.epochs * batches;
            continue;
        }
        work.start_phase(phase)?;
        for epoch in 0..phase.epochs {
            let order = epoch_order(config.seed, state.stage, nth, epoch, n_frames);
            for frames in order.chunks(config.batch) {
                number += 1;
                if number <= state.step {
                    continue;
                }
                let rate = phase.rate * decay(number, steps);
                work.step(&Step { phase, frames, rate, number })?;
                work.losses().count(frames.len());
                state.step = number;
                after_step(scene, work, state, steps, &mut pace, outside)?;
            }
        }
    }
    work.read_into(state)
}

/// The order of the frames in an epoch. It depends on the epoch's place alone, so that a resumed fit sees the frames as it
/// would have.
fn epoch_order(seed: u64, stage: Stage, phase: usize, epoch: u32, n_frames: usize) -> Vec<usize> {
    let stage = if stage == Stage::Geometry { 0 } else { 1 << 63 };
    let mut order: Vec<usize> = (0..n_frames).collect();
    order.shuffle(&mut Pcg32::seed_from_u64(seed ^ (stage | (phase as u64) << 32 | epoch as u64)));
    order
}

/// Learning rates fall to a tenth over the stage.
fn decay(step: u32, steps: u32) -> f32 {
    0.1f32.powf(step as f32 / steps.max(1) as f32)
}

/// Reads losses and writes the checkpoint when it is time; reports, and stops when told to.
fn after_step(
    scene: &Scene,
    work: &mut dyn Work,
    state: &mut FitState,
    steps: u32,
    pace: &mut Pace,
    outside: &mut Outside<'_>,
) -> Result<(), FitError> {
    let step = state.step;
    let due = pace.losses_due() || step == steps;
    let losses = if due { Some(work.losses().read(scene, step)?) } else { None };
    if pace.checkpoint_due() {
        work.read_into(state)?;
        state.save(outside.checkpoint)?;
    }
    let report = StepReport { stage: state.stage, step, steps, losses: losses.as_ref() };
    if outside.control.after_step(&report) == Flow::Stop {
        work.read_into(state)?;
        state.save(outside.checkpoint)?;
        return Err(FitError::Stopped);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_epoch_has_an_order_of_its_own_that_is_always_the_same() {
        let order = |stage, phase, epoch| epoch_order(7, stage, phase, epoch, 20);
        let mut sorted = order(Stage::Geometry, 0, 0);
        assert_eq!(order(Stage::Geometry, 0, 0), sorted);
        for other in [order(Stage::Texture, 0, 0), order(Stage::Geometry, 1, 0), order(Stage::Geometry, 0, 1)] {
            assert_ne!(other, sorted);
        }
        sorted.sort();
        assert_eq!(sorted, (0..20).collect::<Vec<_>>(), "every frame once");
    }

    #[test]
    fn rates_end_at_a_tenth() {
        assert!((decay(50, 50) - 0.1).abs() < 1e-6 && decay(1, 50) > 0.9);
    }
}
