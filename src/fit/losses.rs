//! The losses of a stage on the device, read back now and then.

use std::cell::Cell;
use std::collections::BTreeMap;

use super::FitError;
use super::checkpointed::{Checkpointed, Checkpointer};
use super::scene::Scene;
use super::state::Stage;
use crate::gpu::Buffer;
use crate::ops::LossSlot;

/// A term of the loss; its place in the buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Term {
    Rgb,
    RgbSoft,
    Silhouette,
    Keypoints,
    NormalConsistency,
    FaceArea,
    Laplacian,
}

/// The names of the terms, in their order.
const NAMES: [&str; 7] = ["rgb", "rgb_soft", "silhouette", "keypoints", "normal_consistency", "face_area", "laplacian"];

/// One slot a term, and for the hard image one a frame. The slots add up over a pass through the clip: what is told of a
/// pass then does not depend on when somebody looked in between.
pub struct Losses {
    stage: Stage,
    /// `[terms + N]`: the colours of the hard image add to the slots of their frames.
    values: Buffer<f32>,
    /// Terms that have been recorded since the last report.
    recorded: [Cell<bool>; NAMES.len()],
    /// `[N]`: how often each frame's losses have been added in this pass.
    visits: Vec<u32>,
    /// `[N]`: the colour loss of the frame a foreground pixel in the last pass that had it; `None` before.
    errors: Vec<Option<f32>>,
    pixels: Vec<usize>,
    /// What of this pass's slots and visits has been reported.
    told: Sums,
    /// What of earlier passes has not been.
    untold: Sums,
}

/// Slots, and the visits that filled them.
#[derive(Clone)]
struct Sums {
    values: Vec<f64>,
    visits: u32,
}

impl Sums {
    fn new(n_frames: usize) -> Self {
        Self { values: vec![0.0; NAMES.len() + n_frames], visits: 0 }
    }

    /// `self + other · sign`
    fn plus(mut self, other: &Self, sign: i32) -> Self {
        self.values.iter_mut().zip(&other.values).for_each(|(a, b)| *a += f64::from(sign) * b);
        self.visits = self.visits.wrapping_add_signed(sign * other.visits as i32);
        self
    }
}

impl Losses {
    pub fn new(scene: &Scene, stage: Stage) -> Self {
        let n_frames = scene.frames.len();
        Self {
            stage,
            values: scene.gpu.zeros("fit/losses", NAMES.len() + n_frames),
            recorded: Default::default(),
            visits: vec![0; n_frames],
            errors: vec![None; n_frames],
            pixels: scene.frames.iter().map(|frame| frame.levels[0].inside.len().max(1)).collect(),
            told: Sums::new(n_frames),
            untold: Sums::new(n_frames),
        }
    }

    /// Where a term that is about to be recorded adds its value. A term that never asks is not reported.
    pub fn slot(&self, term: Term) -> LossSlot<'_> {
        self.recorded[term as usize].set(true);
        LossSlot::new(&self.values, term as usize)
    }

    /// Where the colours of a frame's hard image add theirs.
    pub fn rgb_slot(&self, frame: usize) -> LossSlot<'_> {
        self.recorded[Term::Rgb as usize].set(true);
        LossSlot::new(&self.values, NAMES.len() + frame)
    }

    /// Counts the frames of a step.
    pub fn count(&mut self, frames: &[usize]) {
        frames.iter().for_each(|&frame| self.visits[frame] += 1);
    }

    /// `[N]`: the frames' colour losses, up to a common factor; `None` where no pass that has ended had the frame.
    pub fn frame_errors(&self) -> &[Option<f32>] {
        &self.errors
    }

    fn sums(&self, scene: &Scene) -> Result<Sums, FitError> {
        let values = scene.gpu.read(&self.values)?.into_iter().map(f64::from).collect();
        Ok(Sums { values, visits: self.visits.iter().sum() })
    }

    /// Ends a pass: [`frame_errors`](Self::frame_errors) are its, and the slots start anew. Nothing changes where no
    /// frame has been counted. Waits.
    pub fn end_pass(&mut self, scene: &Scene) -> Result<(), FitError> {
        if self.visits.iter().all(|&n| n == 0) {
            return Ok(());
        }
        let sums = self.sums(scene)?;
        let mut recorder = scene.gpu.recorder("fit/losses");
        recorder.clear(&self.values);
        recorder.submit()?;
        for (frame, loss) in sums.values[NAMES.len()..].iter().enumerate().filter(|(frame, _)| self.visits[*frame] > 0)
        {
            self.errors[frame] = Some((loss / (self.visits[frame] as usize * self.pixels[frame]) as f64) as f32);
        }
        self.visits.fill(0);
        self.untold = sums.plus(&self.told, -1).plus(&self.untold, 1);
        self.told = Sums::new(self.pixels.len());
        Ok(())
    }

    /// Mean losses a frame since the last report. Waits.
    ///
    /// # Errors
    /// [`FitError::Diverged`] where one is not finite.
    pub fn report(&mut self, scene: &Scene, step: u32) -> Result<BTreeMap<&'static str, f32>, FitError> {
        let sums = self.sums(scene)?;
        let since = sums.clone().plus(&self.told, -1).plus(&self.untold, 1);
        self.told = sums;
        self.untold = Sums::new(self.pixels.len());
        let mut values = since.values;
        let of_frames = values.split_off(NAMES.len());
        values[Term::Rgb as usize] = of_frames.iter().sum();
        let frames = f64::from(since.visits.max(1));
        let recorded = self.recorded.iter().map(|r| r.replace(false));
        let rows = NAMES.iter().zip(&values).zip(recorded).filter(|(_, recorded)| *recorded);
        let losses = rows.map(|((&name, value), _)| (name, (value / frames) as f32)).collect();
        if values.iter().all(|v| v.is_finite()) {
            Ok(losses)
        } else {
            Err(FitError::Diverged { stage: self.stage, step, losses })
        }
    }
}

impl Checkpointed for Losses {
    /// What frames are sampled by. What has been reported of a pass is not known after a resumption.
    fn checkpoint(&mut self, checkpointer: &mut Checkpointer<'_>, name: &str) -> Result<(), FitError> {
        checkpointer.buffer(&format!("{name}.values"), &self.values)?;
        checkpointer.counts(&format!("{name}.visits"), &mut self.visits)?;
        let mut errors: Vec<f32> = self.errors.iter().map(|error| error.unwrap_or(UNKNOWN)).collect();
        checkpointer.numbers(&format!("{name}.errors"), &mut errors)?;
        self.errors = errors.into_iter().map(|error| (error != UNKNOWN).then_some(error)).collect();
        Ok(())
    }
}

/// No error is below zero.
const UNKNOWN: f32 = -1.0;
