//! One frame's share of a step.

use super::config::{Phase, Weights};
use super::frames::FrameLevel;
use crate::ops::Target;

/// Masked pictures lie on black (paper §3.5).
pub const BACKGROUND: [f32; 3] = [0.0; 3];

/// The frame that a step looks at, and how.
pub struct FrameStep<'a> {
    pub frame: usize,
    /// The frame at the phase's resolution.
    pub level: &'a FrameLevel,
    pub phase: &'a Phase,
    pub weights: &'a Weights,
    /// One over the frames of the step, times what the frame counts.
    pub part: f32,
    /// Of the step, over the whole stage.
    pub number: u32,
}

impl FrameStep<'_> {
    pub fn target(&self) -> Target<'_> {
        self.level.masked(BACKGROUND)
    }

    /// A weight on a sum over pixels, as one on their mean over the foreground.
    pub fn per_pixel(&self, weight: f32) -> f32 {
        self.part * weight / self.level.inside.len().max(1) as f32
    }
}
