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

/// One slot a term; the slots add up until they are read.
pub struct Losses {
    stage: Stage,
    values: Buffer<f32>,
    /// Terms that have been recorded since the last reading.
    recorded: [Cell<bool>; NAMES.len()],
    /// Frames whose losses have been added since the last reading.
    frames: usize,
}

impl Losses {
    pub fn new(scene: &Scene, stage: Stage) -> Self {
        Self { stage, values: scene.gpu.zeros("fit/losses", NAMES.len()), recorded: Default::default(), frames: 0 }
    }

    /// Where a term that is about to be recorded adds its value. A term that never asks is not reported.
    pub fn slot(&self, term: Term) -> LossSlot<'_> {
        self.recorded[term as usize].set(true);
        LossSlot::new(&self.values, term as usize)
    }

    /// Counts the frames of a step.
    pub fn count(&mut self, frames: usize) {
        self.frames += frames;
    }

    /// Mean losses a frame since the last reading; the slots start anew. Waits.
    ///
    /// # Errors
    /// [`FitError::Diverged`] where one is not finite.
    pub fn read(&mut self, scene: &Scene, step: u32) -> Result<BTreeMap<&'static str, f32>, FitError> {
        let values = scene.gpu.read(&self.values)?;
        let mut recorder = scene.gpu.recorder("fit/losses");
        recorder.clear(&self.values);
        recorder.submit()?;
        let frames = std::mem::take(&mut self.frames).max(1) as f32;
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
