//! How a stage runs: phases, epochs and batches in an order that a resumed fit repeats, with losses, checkpoints and
//! reports in between. What a step does is the stage's own ([`super::stage`]).

use std::path::Path;
use std::time::Instant;

use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;

use super::FitError;
use super::checkpointed::{Arrays, Checkpointed, Checkpointer};
use super::config::{FitConfig, FrameSampling, Phase, StageConfig};
use super::control::{Control, Flow, Pace, StepReport};
use super::losses::Losses;
use super::scene::Scene;
use super::state::{Begun, FitState, Progress, Stage};
use crate::math::{DEVIATION_OVER_MEDIAN, median_f32};

/// One step of a stage.
pub(super) struct Step<'a> {
    pub phase: &'a Phase,
    /// The frames that the step looks at.
    pub frames: &'a [usize],
    /// `[N]`: what each frame of the clip counts, see [`trust`].
    pub trust: &'a [f32],
    /// Factor on all learning rates: the phase's, and the decay over the stage.
    pub rate: f32,
    /// From 1 on, over the whole stage.
    pub number: u32,
}

/// What a stage does; [`run`] says when.
pub(super) trait Work: Checkpointed {
    /// Called before the first step of a phase, with the parameters as they are then; also before the first step after a
    /// resumption, with the parameters as they were when the phase began.
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

/// What a stage's kept arrays are called.
const NAME: &str = "stage";

/// Runs the phases of a stage from `state.step` on. Where the state has its progress, `work` stands at the start of the phase that was
/// interrupted, and goes on as it would have.
pub(super) fn run(
    scene: &Scene,
    config: &FitConfig,
    stage: &StageConfig,
    work: &mut dyn Work,
    state: &mut FitState,
    outside: &mut Outside<'_>,
) -> Result<(), FitError> {
    let n_frames = scene.frames.len();
    let steps = config.steps(&stage.phases, n_frames);
    let mut pace = Pace::new();
    let mut number = 0;
    let (mut progress, resumed) = (state.progress.take(), state.step);
    for (nth, phase) in stage.phases.iter().enumerate() {
        let (passes, each) = config.passes(phase, n_frames);
        let end = number + passes * each;
        // A phase that was interrupted after its last step has a pass to end.
        if end < resumed || (end == resumed && progress.is_none()) {
            number = end;
            continue;
        }
        let since = Instant::now();
        let begun = if let Some(Progress { begun, kept }) = progress.take() {
            work.start_phase(phase)?;
            work.checkpoint(&mut Checkpointer::Restore(&scene.gpu, &kept), NAME)?;
            begun
        } else {
            work.read_into(state)?;
            let begun = Begun::of(state);
            work.start_phase(phase)?;
            begun
        };
        let started_secs = since.elapsed().as_secs_f64();
        for epoch in 0..passes {
            let mut rng = epoch_rng(config.seed, state.stage, nth, epoch);
            let (order, trust) = match config.frame_sampling {
                FrameSampling::Uniform => ((0..n_frames).collect(), vec![1.0; n_frames]),
                FrameSampling::ByError => {
                    let errors = work.losses().frame_errors();
                    let trust = trust(errors);
                    (sampled(errors, &trust, &mut rng), trust)
                }
            };
            let order = shuffled(order, &mut rng);
            for frames in order.chunks(config.batch) {
                number += 1;
                if number <= state.step {
                    continue;
                }
                let rate = phase.rate * decay(number, steps, stage.rate_end);
                work.step(&Step { phase, frames, trust: &trust, rate, number })?;
                work.losses().count(frames);
                state.step = number;
                after_step(scene, work, state, steps, &begun, &mut pace, outside)?;
            }
            if number >= resumed {
                work.losses().end_pass(scene)?;
            }
        }
        let secs = since.elapsed().as_secs_f64();
        tracing::debug!(stage = ?state.stage, phase = nth, steps = passes * each, started_secs, secs, "a phase has ended");
    }
    work.read_into(state)
}

/// The randomness of an epoch. It depends on the epoch's place alone, so that a resumed fit sees the frames as it would
/// have.
fn epoch_rng(seed: u64, stage: Stage, phase: usize, epoch: u32) -> Pcg32 {
    let stage = if stage == Stage::Geometry { 0 } else { 1 << 63 };
    Pcg32::seed_from_u64(seed ^ (stage | (phase as u64) << 32 | epoch as u64))
}

fn shuffled(mut order: Vec<usize>, rng: &mut Pcg32) -> Vec<usize> {
    order.shuffle(rng);
    order
}

/// How many robust standard deviations an error may lie above the median before it says that the frame cannot be explained,
/// and the least deviation that counts, over the median.
const OUTLIER_SIGMAS: f32 = 3.0;
const MIN_DEVIATION: f32 = 0.15;

/// `[N]`: 1 for a frame whose error is like the others', less for one that stands out: a mask that caught somebody else, a
/// blurred picture, an arm before the face. The fit cannot explain it, and its gradient would bend what all frames share.
/// It falls with the square of the error, as the weights of Geman and McClure do in the end. Frames without an error count
/// whole.
fn trust(errors: &[Option<f32>]) -> Vec<f32> {
    let known = || errors.iter().flatten().copied();
    let median = median_f32(known()).unwrap_or(0.0);
    let deviation = DEVIATION_OVER_MEDIAN as f32 * median_f32(known().map(|e| (e - median).abs())).unwrap_or(0.0);
    let limit = median + OUTLIER_SIGMAS * deviation.max(MIN_DEVIATION * median);
    let of = |error: f32| if error > limit { (limit / error).powi(2) } else { 1.0 };
    errors.iter().map(|e| e.map_or(1.0, of)).collect()
}

/// As many frames as there are, each as often as its error is of the mean, bounded to half and twice (systematic
/// sampling). Frames that cannot be explained come as rarely as the best: looking at them again teaches nothing. Frames
/// without an error count as the mean, so the first epoch of a stage sees each once.
fn sampled(errors: &[Option<f32>], trust: &[f32], rng: &mut Pcg32) -> Vec<usize> {
    let trusted = || errors.iter().zip(trust).filter(|(_, trust)| **trust == 1.0).filter_map(|(error, _)| *error);
    let mean = (trusted().sum::<f32>() / trusted().count().max(1) as f32).max(f32::MIN_POSITIVE);
    let weight = |(error, &trust): (&Option<f32>, &f32)| {
        if trust < 1.0 { 0.5 } else { error.map_or(1.0, |e| (e / mean).clamp(0.5, 2.0)) }
    };
    let weights: Vec<f32> = errors.iter().zip(trust).map(weight).collect();
    let step = weights.iter().sum::<f32>() / weights.len() as f32;
    let mut next = step * rng.random::<f32>();
    let (mut frames, mut sum) = (Vec::with_capacity(errors.len()), 0.0);
    for (frame, weight) in weights.iter().enumerate() {
        sum += weight;
        while next < sum && frames.len() < errors.len() {
            frames.push(frame);
            next += step;
        }
    }
    // Rounding may leave the last place free.
    frames.resize(errors.len(), errors.len() - 1);
    frames
}

/// What is left of learning rates that fall to `end` over the stage.
pub(super) fn decay(step: u32, steps: u32, end: f32) -> f32 {
    end.powf(step as f32 / steps.max(1) as f32)
}

/// Reads losses when it is time, and reports; stops when told to, or writes the checkpoint when it is time.
fn after_step(
    scene: &Scene,
    work: &mut dyn Work,
    state: &mut FitState,
    steps: u32,
    begun: &Begun,
    pace: &mut Pace,
    outside: &mut Outside<'_>,
) -> Result<(), FitError> {
    let step = state.step;
    let due = pace.losses_due() || step == steps;
    let losses = if due { Some(work.losses().report(scene, step)?) } else { None };
    let report = StepReport { stage: state.stage, step, steps, losses: losses.as_ref() };
    match outside.control.after_step(&report) {
        Flow::Continue if !pace.checkpoint_due() => {}
        Flow::Continue => checkpoint(scene, work, state, begun, outside.checkpoint)?,
        Flow::Stop => {
            checkpoint(scene, work, state, begun, outside.checkpoint)?;
            return Err(FitError::Stopped);
        }
        Flow::Abandon => return Err(FitError::Stopped),
    }
    if outside.control.wants_look() {
        work.read_into(state)?;
        outside.control.look(state);
    }
    Ok(())
}

/// Writes the state with all that the rest of the stage follows from.
fn checkpoint(
    scene: &Scene,
    work: &mut dyn Work,
    state: &mut FitState,
    begun: &Begun,
    path: &Path,
) -> Result<(), FitError> {
    work.read_into(state)?;
    let mut kept = Arrays::new();
    work.checkpoint(&mut Checkpointer::Save(&scene.gpu, &mut kept), NAME)?;
    state.progress = Some(Progress { begun: begun.clone(), kept });
    let saved = state.save(path);
    state.progress = None;
    Ok(saved?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_epoch_has_an_order_of_its_own_that_is_always_the_same() {
        let order = |stage, phase, epoch| shuffled((0..20).collect(), &mut epoch_rng(7, stage, phase, epoch));
        let mut sorted = order(Stage::Geometry, 0, 0);
        assert_eq!(order(Stage::Geometry, 0, 0), sorted);
        for other in [order(Stage::Texture, 0, 0), order(Stage::Geometry, 1, 0), order(Stage::Geometry, 0, 1)] {
            assert_ne!(other, sorted);
        }
        sorted.sort();
        assert_eq!(sorted, (0..20).collect::<Vec<_>>(), "every frame once");
    }

    #[test]
    fn frames_with_large_errors_come_more_often() {
        let mut rng = epoch_rng(7, Stage::Geometry, 0, 0);
        assert_eq!(
            sampled(&[None; 9], &[1.0; 9], &mut rng),
            (0..9).collect::<Vec<_>>(),
            "every frame once while nothing is known"
        );
        let errors: Vec<Option<f32>> = (0..10).map(|k| Some(0.2 + 0.2 * k as f32)).collect();
        let trust = trust(&errors);
        assert_eq!(trust, [1.0; 10], "errors that spread are no outliers");
        let mut counts = [0u32; 10];
        for _ in 0..1000 {
            let frames = sampled(&errors, &trust, &mut rng);
            assert_eq!(frames.len(), 10);
            frames.iter().for_each(|&f| counts[f] += 1);
        }
        assert!(counts[9] > 3 * counts[0] && counts[9] < 5 * counts[0], "{counts:?}");
        assert!(counts.iter().all(|&n| n > 400), "no frame is forgotten: {counts:?}");
    }

    #[test]
    fn frames_that_cannot_be_explained_count_less_and_come_rarely() {
        let mut errors: Vec<Option<f32>> = (0..20).map(|k| Some(1.0 + 0.02 * (k % 5) as f32)).collect();
        (errors[3], errors[7], errors[11]) = (Some(3.0), Some(1.4), None);
        let trust = trust(&errors);
        assert!(trust[3] < 0.3, "{trust:?}");
        assert!(trust.iter().enumerate().all(|(k, &t)| k == 3 || t == 1.0), "{trust:?}");
        let mut rng = epoch_rng(7, Stage::Geometry, 0, 0);
        let mut counts = [0u32; 20];
        (0..1000).for_each(|_| sampled(&errors, &trust, &mut rng).into_iter().for_each(|f| counts[f] += 1));
        assert!((400..700).contains(&counts[3]) && counts[7] > 1200, "{counts:?}");
        assert_eq!(super::trust(&[None; 3]), [1.0; 3]);
        assert!(super::trust(&[Some(0.0), Some(0.0), Some(1.0)])[2] < 1.0, "whatever stands out of nothing");
    }

    #[test]
    fn rates_fall_steadily_to_their_end() {
        for end in [0.1, 0.3] {
            let rates: Vec<f32> = (1..=50).map(|step| decay(step, 50, end)).collect();
            assert!((rates[49] - end).abs() < 1e-6 && rates[0] > 0.9, "{rates:?}");
            assert!(rates.windows(2).all(|pair| (pair[1] / pair[0] - end.powf(0.02)).abs() < 1e-5), "{rates:?}");
        }
    }
}
