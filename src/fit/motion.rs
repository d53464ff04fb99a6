//! What is expected of poses besides the pictures, for both stages: smooth motion, since a frame alone says little about its
//! depth, and joints near where the stage found them.

use super::config::Weights;
use super::poses::PoseGroups;
use crate::gpu::{Gpu, Recorder};
use crate::ops::anchor::{Anchor, AnchorConfig};
use crate::ops::temporal::{Temporal, TemporalConfig};

/// Changes from one frame to the next above these are no motion: radians, metres.
pub const POSE_JUMP: f32 = 0.5;
pub const PLACE_JUMP: f32 = 0.1;

/// Usual accelerations of clips of this many frames and more: radians and metres a frame². Fewer frames lie further apart,
/// and what is the same motion accelerates by the square of that more.
const FRAMES: f64 = 30.0;
const POSE_ACCELERATION: f64 = 0.03;
const PLACE_ACCELERATION: f64 = 0.005;

/// Penalties on the accelerations of pose and placement, and on the way of the joints' angles from the stage's start.
pub struct Motion {
    pose: Temporal,
    transl: Temporal,
    anchor: Anchor,
}

impl Motion {
    /// `start [N, 72]`: the poses that the joints are held near.
    pub fn new(gpu: &Gpu, start: &[f32]) -> Self {
        let apart = (FRAMES / (start.len() / 72).max(1) as f64).max(1.0).powi(2);
        let (scale, max_change) = (POSE_ACCELERATION * apart, POSE_JUMP.into());
        // The root's orientation is well seen and is left free.
        let pose = TemporalConfig { stride: 72, first: 3, scale, max_change };
        let (scale, max_change) = (PLACE_ACCELERATION * apart, PLACE_JUMP.into());
        let transl = TemporalConfig { stride: 3, first: 0, scale, max_change };
        let anchor = AnchorConfig { stride: 72, first: 3, scale: 0.1 };
        Self {
            pose: Temporal::new(gpu, pose),
            transl: Temporal::new(gpu, transl),
            anchor: Anchor::new(gpu, anchor, start),
        }
    }

    /// Adds the gradients, times `share` a frame.
    pub fn record(&self, recorder: &mut Recorder<'_>, weights: &Weights, share: f32, groups: &PoseGroups) {
        let PoseGroups { poses, transl, .. } = groups;
        if weights.motion != 0.0 {
            self.pose.backward(recorder, &poses.values, share * weights.motion, &poses.grads);
            self.transl.backward(recorder, &transl.values, share * weights.motion, &transl.grads);
        }
        if weights.anchor != 0.0 {
            self.anchor.backward(recorder, &poses.values, share * weights.anchor, &poses.grads);
        }
    }
}
