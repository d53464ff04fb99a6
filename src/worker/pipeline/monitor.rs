//! What a run tells and is told between its steps: progress, losses, previews, and whether to stop.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Instant, SystemTime};

use super::curves::{Curves, StageSecs};
use super::preview::Previews;
use super::{Observer, PipelineError, Preview, Progress, Stage, StopReason};
use crate::body::Body;
use crate::camera::Camera;
use crate::capture::Capture;
use crate::fit::{self, Control, FitConfig, FitState, Flow, StepReport};
use crate::gpu::Gpu;
use crate::jobs::Preset;

/// Parts of a job.
type Shares = [(Stage, f32); 6];

/// The part of a job that each stage takes, roughly, for the progress of the whole. `geometry` and `texture` are measured, on two
/// cores; the rest is little.
fn shares(preset: Preset) -> Shares {
    let (geometry, texture) = match preset {
        Preset::Draft => (0.20, 0.74),
        Preset::Standard => (0.43, 0.53),
        Preset::Paper => (0.32, 0.62),
        Preset::SilhouetteOnly => (0.28, 0.68),
    };
    let rest = 1.0 - geometry - texture;
    [
        (Stage::Decode, 0.1 * rest),
        (Stage::Pose, 0.4 * rest),
        (Stage::Geometry, geometry),
        (Stage::Texture, texture),
        (Stage::Bake, 0.2 * rest),
        (Stage::Export, 0.3 * rest),
    ]
}

/// Turns steps of stages into the progress of the whole, and asks whether to go on.
pub(super) struct Monitor<'a> {
    gpu: &'a Arc<Gpu>,
    observer: &'a mut dyn Observer,
    pub(super) stopped: Option<StopReason>,
    /// Of this attempt.
    secs: StageSecs,
    pub(super) curves: Curves,
    pub(super) draws_curves: bool,
    stage: Stage,
    stage_started: Instant,
    /// The step of the stage at which this run began: a resumed one does not begin at zero.
    first_step: Option<u32>,
    losses: BTreeMap<String, f64>,
    shares: Shares,
    /// Of the whole job.
    progress: f32,
    /// Steps of the texture's stage that are known of, and those before it began to go on with a tailored surface, or with
    /// larger pictures.
    texture_steps: u32,
    steps_before: u32,
    checkpoint: PathBuf,
    /// When the checkpoint was written that was last told of.
    saved: Option<SystemTime>,
    /// Whether pictures are wanted and can be had.
    takes_previews: bool,
    /// Where they are, from the end of stage 0 on.
    previews: Option<Previews>,
    /// What was last told.
    told: Option<Progress>,
}

impl<'a> Monitor<'a> {
    pub(super) fn new(
        gpu: &'a Arc<Gpu>,
        observer: &'a mut dyn Observer,
        preset: Preset,
        checkpoint: &Path,
        curves: Curves,
    ) -> Self {
        Self {
            gpu,
            takes_previews: observer.takes_previews(),
            observer,
            stopped: None,
            secs: BTreeMap::new(),
            curves,
            draws_curves: true,
            stage: Stage::Decode,
            stage_started: Instant::now(),
            first_step: None,
            losses: BTreeMap::new(),
            shares: shares(preset),
            progress: 0.0,
            texture_steps: 0,
            steps_before: 0,
            checkpoint: checkpoint.into(),
            saved: written(checkpoint),
            previews: None,
            told: None,
        }
    }

    /// Ends the current stage and starts the next; an error where somebody wants to stop.
    pub(super) fn start(&mut self, stage: Stage) -> Result<(), PipelineError> {
        self.enter(stage);
        self.check()
    }

    /// An error where somebody wants to stop.
    pub(super) fn check(&mut self) -> Result<(), PipelineError> {
        match self.go_on() {
            true => Ok(()),
            false => Err(PipelineError::Stopped(self.stopped.unwrap_or(StopReason::Shutdown))),
        }
    }

    /// What lay there to go on from was made by another program or of something else, and is gone.
    pub(super) fn begin_anew(&mut self) {
        tracing::info!("the checkpoint is of another program, clip, body or options: the fit begins anew");
        self.observer.begins_anew();
    }

    pub(super) fn end(&mut self) {
        self.secs = self.spent();
        self.stage_started = Instant::now();
    }

    /// Seconds by stage in this attempt, with what the current stage has taken so far.
    fn spent(&self) -> StageSecs {
        let mut secs = self.secs.clone();
        *secs.entry(self.stage.name().to_owned()).or_default() += self.stage_started.elapsed().as_secs_f64();
        secs
    }

    /// Seconds by stage in all attempts, as far as stages have ended.
    pub(super) fn whole_secs(&self) -> StageSecs {
        self.curves.whole(&self.secs)
    }

    fn enter(&mut self, stage: Stage) {
        self.end();
        self.stage = stage;
        self.first_step = None;
        self.tell(stage, 0, 1);
    }

    /// Draws what is fitted on this body from now on, where that is wanted.
    pub(super) fn preview_from(
        &mut self,
        body: &Body,
        capture: &Capture,
        camera: &Camera,
        config: &FitConfig,
        state: &FitState,
    ) {
        if self.takes_previews {
            self.previews = Some(Previews::new(body, capture, camera, config, state));
            self.look(state);
        }
    }

    /// The texture's stage will have so many steps more, as far as is known.
    pub(super) fn expect_texture_steps(&mut self, more: u32) {
        self.texture_steps += more;
    }

    /// The texture's stage goes on with another checkpoint; its steps are counted on.
    pub(super) fn go_on_with(&mut self, checkpoint: &Path, steps_before: u32) {
        self.curves.save(&self.spent());
        self.steps_before = steps_before;
        (self.checkpoint, self.saved) = (checkpoint.into(), written(checkpoint));
    }

    pub(super) fn go_on(&mut self) -> bool {
        self.observer.idle(self.gpu);
        self.stopped = self.stopped.or_else(|| self.observer.stop());
        // Then what lies there may be another's.
        if self.stopped == Some(StopReason::LostLease) {
            return false;
        }
        let saved = written(&self.checkpoint);
        if saved != self.saved {
            self.saved = saved;
            self.curves.save(&self.spent());
            self.observer.saved(self.progress);
        }
        if self.stopped.is_some() {
            self.curves.save(&self.spent());
        }
        self.stopped.is_none()
    }

    pub(super) fn tell(&mut self, stage: Stage, step: u32, steps: u32) {
        let before: f32 = self.shares.iter().take_while(|(s, _)| *s != stage).map(|(_, share)| share).sum();
        let share = self.shares.iter().find(|(s, _)| *s == stage).map_or(0.0, |(_, share)| *share);
        let done = step as f32 / steps.max(1) as f32;
        // More steps may come than were known of.
        let progress = (before + share * done).clamp(self.progress, 1.0);
        self.progress = progress;
        let first = self.first_step.unwrap_or(0);
        let elapsed = self.stage_started.elapsed().as_secs_f64();
        // The rest of this stage at its pace so far, and the later stages by their shares. What comes before the geometry is
        // the host's: on a graphics processor it says nothing of the rest.
        let eta_secs = (stage >= Stage::Geometry && step > first && elapsed > 1.0).then(|| {
            let whole = elapsed / ((step - first) as f64 / steps.max(1) as f64);
            whole * (1.0 - done as f64) + whole / share as f64 * (1.0 - before - share).max(0.0) as f64
        });
        let losses = self.losses.clone();
        let told = Progress { stage, step, steps, progress, eta_secs, losses };
        self.observer.progress(&told);
        self.told = Some(told);
    }
}

/// When a file was written, if it is there.
fn written(path: &Path) -> Option<SystemTime> {
    path.metadata().and_then(|meta| meta.modified()).ok()
}

impl Control for Monitor<'_> {
    fn after_step(&mut self, report: &StepReport<'_>) -> Flow {
        let stage = match report.stage {
            fit::Stage::Geometry => Stage::Geometry,
            _ => Stage::Texture,
        };
        if stage != self.stage {
            self.enter(stage);
        }
        let (step, mut steps) = (self.steps_before + report.step, self.steps_before + report.steps);
        if stage == Stage::Texture {
            steps = steps.max(self.texture_steps);
        }
        self.first_step.get_or_insert(step - 1);
        if let Some(losses) = report.losses {
            self.losses = losses.iter().map(|(name, value)| ((*name).to_owned(), *value as f64)).collect();
            if self.draws_curves {
                self.curves.push(stage, step, &self.losses);
            }
        }
        self.tell(stage, step, steps);
        match (self.go_on(), self.stopped) {
            (true, _) => Flow::Continue,
            (false, Some(StopReason::LostLease)) => Flow::Abandon,
            (false, _) => Flow::Stop,
        }
    }

    fn wants_look(&mut self) -> bool {
        self.previews.as_ref().is_some_and(|previews| previews.is_due(self.progress))
    }

    /// A picture is worth showing, not failing for: without memory for one, or whatever else is wrong with it, this attempt goes on
    /// without pictures. What is wrong with the device itself the next step finds out.
    fn look(&mut self, state: &FitState) {
        let (Some(previews), Some(at)) = (&mut self.previews, &self.told) else { return };
        let draw = || self.gpu.apart(|| previews.draw(self.gpu, state, self.progress));
        let drawn = catch_unwind(AssertUnwindSafe(draw)).unwrap_or_else(|_| Ok(Err(anyhow::anyhow!("panicked"))));
        match drawn.map_err(Into::into).flatten() {
            Ok(jpeg) => self.observer.preview(Preview { jpeg, at: at.clone() }),
            Err(error) => {
                tracing::warn!(%error, "no preview, and none from here on");
                (self.previews, self.takes_previews) = (None, false);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_share_the_whole_job() {
        for preset in [Preset::Draft, Preset::Standard, Preset::Paper, Preset::SilhouetteOnly] {
            let shares = shares(preset);
            assert!(shares.iter().all(|(_, share)| *share > 0.0), "{shares:?}");
            assert!((shares.iter().map(|(_, share)| share).sum::<f32>() - 1.0).abs() < 1e-6, "{shares:?}");
            assert!(shares.is_sorted_by_key(|(stage, _)| *stage), "{shares:?}");
        }
    }
}
