//! What is expected of poses besides the pictures, for both stages: smooth motion, since a frame alone says little about its
//! depth, and joints near where the stage found them, the more so the less pictures tell of them.

use super::config::Weights;
use super::poses::PoseGroups;
use crate::body::{JOINT_NAMES, N_JOINTS};
use crate::gpu::{Gpu, Recorder};
use crate::ops::anchor::{Anchor, AnchorConfig};
use crate::ops::angular_acceleration::{AngularAcceleration, AngularAccelerationConfig};
use crate::ops::temporal::{Temporal, TemporalConfig};

/// Changes from one frame to the next above these are no motion: radians, metres.
pub const POSE_JUMP: f32 = 0.5;
pub const PLACE_JUMP: f32 = 0.1;

/// Usual accelerations in a clip of 30 frames or more: radians and metres a frame².
const POSE_ACCELERATION: f64 = 0.03;
const PLACE_ACCELERATION: f64 = 0.005;

/// A person does not turn faster from one frame to the next, radians: more is a gap in the clip.
const TURN_JUMP: f64 = 1.0;

/// Usual accelerations in a clip of `n` frames over those: fewer frames lie further apart, and the same motion accelerates by
/// the square of that more.
fn acceleration(n: usize) -> f64 {
    (30.0 / n.clamp(1, 30) as f64).powi(2)
}

/// How far each number of a pose usually ends from where a stage began, radians.
///
/// What is hardly seen is held the more firmly: knees and elbows are hinges, a standing leg is not twisted, and of toes and
/// fingers pictures tell little. Left to the pictures alone, such numbers take up what is wrong with the shape and the
/// raster's noise.
fn anchor_scales() -> [[f64; 3]; N_JOINTS] {
    const USUAL: f64 = 0.1;
    const HINGE: f64 = 0.01;
    const TWIST: f64 = 0.02;
    const END: f64 = 0.03;
    let of = |joint: &str| match joint {
        // The root's orientation is well seen.
        "pelvis" => [f64::INFINITY; 3],
        "left_hip" | "right_hip" | "left_ankle" | "right_ankle" => [USUAL, TWIST, USUAL],
        "left_knee" | "right_knee" => [USUAL, HINGE, HINGE],
        "left_elbow" | "right_elbow" => [HINGE, USUAL, HINGE],
        "left_foot" | "right_foot" | "left_hand" | "right_hand" => [END; 3],
        _ => [USUAL; 3],
    };
    JOINT_NAMES.map(of)
}

/// Penalties on the accelerations of pose and placement, and on the way of the joints' angles from the stage's start.
pub struct Motion {
    root: AngularAcceleration,
    joints: Temporal,
    transl: Temporal,
    anchor: Anchor,
}

impl Motion {
    /// `start [N, 72]`: the poses that the joints are held near.
    pub fn new(gpu: &Gpu, start: &[f32]) -> Self {
        let usual = acceleration(start.len() / (3 * N_JOINTS));
        let stride = 3 * N_JOINTS;
        let (scale, max_change) = (POSE_ACCELERATION * usual, POSE_JUMP.into());
        let root = AngularAccelerationConfig { stride, scale, max_turn: TURN_JUMP };
        let joints = TemporalConfig { stride, first: 3, scale, max_change };
        let (scale, max_change) = (PLACE_ACCELERATION * usual, PLACE_JUMP.into());
        let transl = TemporalConfig { stride: 3, first: 0, scale, max_change };
        let anchor = AnchorConfig { scales: anchor_scales().as_flattened().to_vec() };
        Self {
            root: AngularAcceleration::new(gpu, root),
            joints: Temporal::new(gpu, joints),
            transl: Temporal::new(gpu, transl),
            anchor: Anchor::new(gpu, &anchor, start),
        }
    }

    /// Adds the gradients, times `share` a frame.
    pub fn record(&self, recorder: &mut Recorder<'_>, weights: &Weights, share: f32, groups: &PoseGroups) {
        let PoseGroups { poses, transl, .. } = groups;
        if weights.motion != 0.0 {
            self.root.backward(recorder, &poses.values, share * weights.motion, &poses.grads);
            self.joints.backward(recorder, &poses.values, share * weights.motion, &poses.grads);
            self.transl.backward(recorder, &transl.values, share * weights.motion, &transl.grads);
        }
        if weights.anchor != 0.0 {
            self.anchor.backward(recorder, &poses.values, share * weights.anchor, &poses.grads);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hinges_are_held_where_they_do_not_bend() {
        let scales = anchor_scales();
        let held = |joint: &str| {
            let scales = scales[JOINT_NAMES.iter().position(|name| *name == joint).unwrap()];
            scales.map(|scale| scale < 0.05)
        };
        for side in ["left", "right"] {
            // A knee bends about the axis that points to the left, an elbow in the T-pose about the vertical one.
            assert_eq!(held(&format!("{side}_knee")), [false, true, true]);
            assert_eq!(held(&format!("{side}_elbow")), [true, false, true]);
            assert_eq!(held(&format!("{side}_hip")), [false, true, false]);
            assert_eq!(held(&format!("{side}_shoulder")), [false; 3]);
        }
        assert_eq!(held("pelvis"), [false; 3]);
    }

    #[test]
    fn the_same_motion_costs_the_same_in_few_frames_and_in_fewer() {
        // Of a parabola over the clip, the second difference.
        let second = |n: usize| 2.0 / (n as f64).powi(2);
        for n in [3, 8, 15, 30] {
            let cost = second(n) / acceleration(n);
            assert!((cost / second(30) - 1.0).abs() < 1e-9, "{n} frames: {cost}");
        }
        assert_eq!(acceleration(120), 1.0);
    }
}
