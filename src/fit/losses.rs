//! The losses of a stage on the device, read back now and then.

use std::cell::Cell;
use std::collections::BTreeMap;

use super::FitError;
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

/// One slot a term, and for the hard image one a frame; the slots add up until they are read.
pub struct Losses {
    stage: Stage,
    /// `[terms + N]`: the colours of the hard image add to the slots of their frames.
    values: Buffer<f32>,
    /// Terms that have been recorded since the last reading.
    recorded: [Cell<bool>; NAMES.len()],
    /// `[N]`: how often each frame's losses have been added since the last reading.
    visits: Vec<u32>,
    /// `[N]`: the colour loss of the frame a foreground pixel when it was last read; `None` before.
    errors: Vec<Option<f32>>,
    pixels: Vec<usize>,
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

    /// `[N]`: the frames' colour losses, up to a common factor; `None` where a frame has not been read yet.
    pub fn frame_errors(&self) -> &[Option<f32>] {
        &self.errors
    }

    /// Mean losses a frame since the last reading; the slots start anew. Waits.
    ///
    /// # Errors
    /// [`FitError::Diverged`] where one is not finite.
    pub fn read(&mut self, scene: &Scene, step: u32) -> Result<BTreeMap<&'static str, f32>, FitError> {
        let mut values = scene.gpu.read(&self.values)?;
        let mut recorder = scene.gpu.recorder("fit/losses");
        recorder.clear(&self.values);
        recorder.submit()?;
        let of_frames = values.split_off(NAMES.len());
        values[Term::Rgb as usize] = of_frames.iter().sum();
        for (frame, loss) in of_frames.iter().enumerate().filter(|(frame, _)| self.visits[*frame] > 0) {
            self.errors[frame] = Some(loss / (self.visits[frame] as usize * self.pixels[frame]) as f32);
        }
        let frames = self.visits.iter().sum::<u32>().max(1) as f32;
        self.visits.fill(0);
        let recorded = self.recorded.iter().map(|r| r.replace(false));
        let rows = NAMES.iter().zip(&values).zip(recorded).filter(|(_, recorded)| *recorded);
        let losses = rows.map(|((&name, value), _)| (name, value / frames)).collect();
        if values.iter().all(|v| v.is_finite()) {
            Ok(losses)
        } else {
            Err(FitError::Diverged { stage: self.stage, step, losses })
        }
    }
}
