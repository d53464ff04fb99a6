//! Smooth motion of the person over time, for both stages: a frame alone says little about its depth.

use super::groups::PoseGroups;
use crate::gpu::{Gpu, Recorder};
use crate::ops::temporal::{Temporal, TemporalConfig};

/// Penalties on the accelerations of pose and placement.
pub struct Motion {
    pose: Temporal,
    transl: Temporal,
}

impl Motion {
    pub fn new(gpu: &Gpu) -> Self {
        // Radians and metres a frame²; the root's orientation is well seen and is left free.
        let pose = TemporalConfig { stride: 72, first: 3, scale: 0.03, max_change: 0.5 };
        let transl = TemporalConfig { stride: 3, first: 0, scale: 0.005, max_change: 0.1 };
        Self { pose: Temporal::new(gpu, pose), transl: Temporal::new(gpu, transl) }
    }

    /// Adds the gradients, times `weight` a frame.
    pub fn record(&self, recorder: &mut Recorder<'_>, weight: f32, groups: &PoseGroups) {
        let PoseGroups { poses, transl } = groups;
        self.pose.backward(recorder, &poses.values, weight, &poses.grads);
        self.transl.backward(recorder, &transl.values, weight, &transl.grads);
    }
}
