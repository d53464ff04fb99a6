//! The losses of a stage on the device, read back now and then.

use std::collections::BTreeMap;

use super::FitError;
use super::scene::Scene;
use super::state::Stage;
use crate::gpu::Buffer;
use crate::ops::LossSlot;

/// One slot a name; the slots add up until they are read.
pub struct Losses {
    stage: Stage,
    names: &'static [&'static str],
    values: Buffer<f32>,
    /// Frames whose losses have been added since the last reading.
    frames: usize,
}

impl Losses {
    pub fn new(scene: &Scene, stage: Stage, names: &'static [&'static str]) -> Self {
        Self { stage, names, values: scene.gpu.zeros("fit/losses", names.len()), frames: 0 }
    }

    pub fn slot(&self, index: usize) -> LossSlot<'_> {
        LossSlot::new(&self.values, index)
    }

    pub fn values(&self) -> &Buffer<f32> {
        &self.values
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
        let losses = self.names.iter().zip(&values).map(|(&name, value)| (name, value / frames)).collect();
        if values.iter().all(|v| v.is_finite()) {
            Ok(losses)
        } else {
            Err(FitError::Diverged { stage: self.stage, step, losses })
        }
    }
}
