//! What is expected of poses besides the pictures, for both stages: smooth motion, since a frame alone says little about its
//! depth, and joints near where the stage found them, the more so the less pictures tell of them.

use super::config::Weights;
use super::poses::PoseGroups;
use super::stage0::Trust;
use crate::body::joints::{
    LEFT_ANKLE, LEFT_ELBOW, LEFT_FOOT, LEFT_HAND, LEFT_HIP, LEFT_KNEE, PELVIS, RIGHT_ANKLE, RIGHT_ELBOW, RIGHT_FOOT,
    RIGHT_HAND, RIGHT_HIP, RIGHT_KNEE,
};
use crate::body::{N_JOINTS, N_POSE};
use crate::gpu::{Gpu, Recorder};
use crate::ops::anchor::{Anchor, AnchorConfig};
use crate::ops::angular_acceleration::{self, AngularAcceleration, AngularAccelerationConfig, Given};
use crate::ops::temporal::{Temporal, TemporalConfig, spacing};

/// Changes from one frame to the next above these are no motion: radians, metres.
pub const POSE_JUMP: f32 = 0.5;
pub const PLACE_JUMP: f32 = 0.1;

/// Usual accelerations in a clip of 30 frames or more a turn: radians and metres a frame².
const POSE_ACCELERATION: f64 = 0.03;
const PLACE_ACCELERATION: f64 = 0.005;

/// Accelerations above so many usual ones are no noise: a leg steps, a turn stops, weight goes to the other foot.
const STEP: f64 = 3.0;

/// A person does not turn faster from one frame to the next, radians: more is a gap in the clip.
const TURN_JUMP: f64 = 1.0;

/// Usual accelerations in a clip of `n` frames a turn over those: fewer frames lie further apart, and the same motion accelerates
/// by the square of that more.
fn acceleration(n: f64) -> f64 {
    (30.0 / n.clamp(1.0, 30.0)).powi(2)
}

/// [`acceleration`] in a clip that starts with `poses [N, 72]`.
fn usual(poses: &[f32]) -> f64 {
    acceleration((poses.len() / N_POSE) as f64 / turns(poses))
}

/// The frames of `poses [N, 72]` in this part of a turn.
pub fn frames_in(part: f32, poses: &[f32]) -> f32 {
    part * (poses.len() / N_POSE) as f32 / turns(poses) as f32
}

/// How often the person turns round, once at least, in `poses [N, 72]`: who turns three times in a clip moves three times as far
/// from frame to frame.
fn turns(poses: &[f32]) -> f64 {
    let root = |pose: &[f32]| glam::Quat::from_scaled_axis(glam::Vec3::new(pose[0], pose[1], pose[2]));
    let roots: Vec<glam::Quat> = poses.chunks_exact(N_POSE).map(root).collect();
    let angles = roots.windows(2).map(|pair| f64::from(pair[0].angle_between(pair[1])));
    (angles.filter(|angle| *angle <= TURN_JUMP).sum::<f64>() / std::f64::consts::TAU).max(1.0)
}

/// How far each number of a pose usually ends from where a stage began, radians.
///
/// What is hardly seen is held the more firmly: knees and elbows are hinges, a standing leg is not twisted, and of toes and
/// fingers pictures tell little. Left to the pictures alone, such numbers take up what is wrong with the shape and the
/// raster's noise. But a leg that the start `[N, 72]` twists to and fro, since the person steps round, goes on as it likes.
///
/// Poses that are known are `held` as firmly as they are known: to go away from them is nearly always to follow something else that is wrong.
fn anchor_scales(start: &[f32], held: Option<Trust>) -> [[f64; 3]; N_JOINTS] {
    const USUAL: f64 = 0.1;
    const HINGE: f64 = 0.01;
    const TWIST: f64 = 0.02;
    const END: f64 = 0.03;
    let twist = |joint: usize| TWIST.max(spread(start.chunks_exact(N_POSE).map(|pose| pose[3 * joint + 1].into())));
    let usual = |joint: usize| match joint {
        // The root's orientation is well seen.
        PELVIS => [f64::INFINITY; 3],
        LEFT_HIP | RIGHT_HIP => [USUAL, twist(joint), USUAL],
        LEFT_ANKLE | RIGHT_ANKLE => [USUAL, TWIST, USUAL],
        LEFT_KNEE | RIGHT_KNEE => [USUAL, HINGE, HINGE],
        LEFT_ELBOW | RIGHT_ELBOW => [HINGE, USUAL, HINGE],
        LEFT_FOOT | RIGHT_FOOT | LEFT_HAND | RIGHT_HAND => [END; 3],
        _ => [USUAL; 3],
    };
    let most = |joint: usize| match held {
        Some(held) if joint == PELVIS => held.root,
        Some(held) => held.joints,
        None => f64::INFINITY,
    };
    std::array::from_fn(|joint| usual(joint).map(|scale| scale.min(most(joint))))
}

/// The accelerations of `values [N, stride]`, those up to `least` left out.
fn steps(values: &[f32], stride: usize, spacing: &[[f64; 2]], least: f64) -> Vec<f32> {
    let mut accelerations = vec![0.0; values.len()];
    for i in stride..values.len().saturating_sub(stride) {
        let [beta, alpha] = spacing[i / stride];
        let change = |from: usize, to: usize| f64::from(values[to]) - f64::from(values[from]);
        let acceleration = alpha * change(i, i + stride) - beta * change(i - stride, i);
        if acceleration.abs() > least {
            accelerations[i] = acceleration as f32;
        }
    }
    accelerations
}

/// Standard deviation.
fn spread(values: impl ExactSizeIterator<Item = f64> + Clone) -> f64 {
    let n = values.len().max(1) as f64;
    let mean = values.clone().sum::<f64>() / n;
    (values.map(|value| (value - mean).powi(2)).sum::<f64>() / n).sqrt()
}

/// Penalties on the accelerations of pose and placement, and on the way of the joints' angles from the stage's start.
pub struct Motion {
    root: AngularAcceleration,
    joints: Temporal,
    transl: Temporal,
    anchor: Anchor,
    /// Of places that were given.
    place_anchor: Option<Anchor>,
}

impl Motion {
    /// `start [N, 72]`: the poses that the joints are held near, `places [N, 3]`: where the person stands in them; what moves
    /// quickly there is expected to. `times [N]`: when the frames were taken, in any unit. `held`: where poses were given.
    pub fn new(gpu: &Gpu, start: &[f32], places: &[f32], times: &[f64], held: Option<Trust>) -> Self {
        let spacing = &spacing(times);
        let usual = usual(start);
        let stride = N_POSE;
        let (scale, max_change) = (POSE_ACCELERATION * usual, POSE_JUMP.into());
        let root = AngularAccelerationConfig { stride, scale, max_turn: TURN_JUMP };
        let joints = TemporalConfig { stride, first: 3, scale, max_change };
        let (scale, max_change) = (PLACE_ACCELERATION * usual, PLACE_JUMP.into());
        let transl = TemporalConfig { stride: 3, first: 0, scale, max_change };
        let turns = angular_acceleration::cpu::large(&root, start, spacing, STEP * root.scale);
        let bends = steps(start, stride, spacing, STEP * joints.scale);
        let moves = steps(places, 3, spacing, STEP * transl.scale);
        let anchor = AnchorConfig { scales: anchor_scales(start, held).as_flattened().to_vec() };
        Self {
            root: AngularAcceleration::new(gpu, root, Given { expected: &turns, spacing }),
            joints: Temporal::new(gpu, joints, Given { expected: &bends, spacing }),
            transl: Temporal::new(gpu, transl, Given { expected: &moves, spacing }),
            anchor: Anchor::new(gpu, &anchor, start),
            place_anchor: held.map(|held| {
                let anchor = AnchorConfig { scales: vec![held.place; 3] };
                Anchor::new(gpu, &anchor, places)
            }),
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
            if let Some(anchor) = &self.place_anchor {
                anchor.backward(recorder, &transl.values, share * weights.anchor, &transl.grads);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::joints::{LEFT_SHOULDER, RIGHT_SHOULDER};

    /// Poses of somebody who stands before a camera whose y points down, and faces `degrees [N]`.
    fn facing(degrees: &[f32]) -> Vec<f32> {
        let pose = |degrees: &f32| {
            let upright = glam::Quat::from_rotation_x(std::f32::consts::PI);
            let root = (upright * glam::Quat::from_rotation_y(degrees.to_radians())).to_scaled_axis();
            let mut pose = [0.1; N_POSE];
            pose[..3].copy_from_slice(&root.to_array());
            pose
        };
        degrees.iter().flat_map(pose).collect()
    }

    /// `n + 1` facings from 0 to `turn` degrees.
    fn steady(n: i32, turn: f32) -> Vec<f32> {
        (0..=n).map(|i| turn * i as f32 / n as f32).collect()
    }

    #[test]
    fn turns_are_counted_to_and_fro_and_at_least_one() {
        let counted = |degrees: &[f32]| turns(&facing(degrees));
        let to_and_fro = [steady(20, 540.0), steady(20, 540.0).into_iter().rev().collect()].concat();
        // Where the clip was cut, one steps from any facing to any other.
        let cut = [steady(20, 360.0), steady(20, 360.0).iter().map(|d| d + 120.0).collect()].concat();
        for (degrees, want) in
            [(steady(40, 1080.0), 3.0), (to_and_fro, 3.0), (cut, 2.0), (steady(40, 180.0), 1.0), (vec![], 1.0)]
        {
            assert!((counted(&degrees) - want).abs() < 0.01, "{} turns, not {want}", counted(&degrees));
        }
    }

    #[test]
    fn hinges_are_held_where_they_do_not_bend() {
        let scales = anchor_scales(&[0.0; 2 * N_POSE], None);
        let held = |joint: usize| scales[joint].map(|scale| scale < 0.05);
        // A knee bends about the axis that points to the left, an elbow in the T-pose about the vertical one.
        assert_eq!([LEFT_KNEE, RIGHT_KNEE].map(held), [[false, true, true]; 2]);
        assert_eq!([LEFT_ELBOW, RIGHT_ELBOW].map(held), [[true, false, true]; 2]);
        assert_eq!([LEFT_HIP, RIGHT_HIP].map(held), [[false, true, false]; 2]);
        assert_eq!([LEFT_SHOULDER, RIGHT_SHOULDER].map(held), [[false; 3]; 2]);
        assert_eq!(held(PELVIS), [false; 3]);
    }

    #[test]
    fn given_poses_are_held_as_they_are_known() {
        let held = Trust { root: 0.005, joints: 0.015, place: 0.01 };
        let scales = anchor_scales(&[0.0; 2 * N_POSE], Some(held));
        assert_eq!((scales[PELVIS], scales[LEFT_SHOULDER]), ([0.005; 3], [0.015; 3]));
        assert_eq!(scales[LEFT_KNEE], [0.015, 0.01, 0.01], "hinges stay hinges");
    }

    #[test]
    fn a_leg_that_steps_may_twist() {
        let hip = |joint: usize| 3 * joint + 1;
        let mut start = vec![0.0; 8 * N_POSE];
        for (frame, pose) in start.chunks_exact_mut(N_POSE).enumerate() {
            pose[hip(LEFT_HIP)] = if frame % 2 == 0 { 0.3 } else { -0.3 };
        }
        let scales = anchor_scales(&start, None);
        let twist = |joint: usize| scales.as_flattened()[hip(joint)];
        assert!((twist(LEFT_HIP) - 0.3).abs() < 1e-6 && twist(RIGHT_HIP) < 0.05);
    }

    #[test]
    fn steps_of_the_start_are_expected_and_its_sway_is_not() {
        // Two numbers a frame: one sways, one steps in the fourth frame.
        let values: Vec<f32> = (0..8).flat_map(|i| [0.01 * (i % 2) as f32, if i == 3 { 0.3 } else { 0.0 }]).collect();
        let steps = steps(&values, 2, &spacing(&[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]), 0.09);
        assert!(steps.iter().step_by(2).all(|&sway| sway == 0.0));
        let stepped: Vec<f32> = steps.into_iter().skip(1).step_by(2).collect();
        assert_eq!(stepped, [0.0, 0.0, 0.3, -0.6, 0.3, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn the_same_motion_costs_the_same_in_few_frames_and_in_fewer() {
        // Of a parabola over the clip, the second difference.
        let second = |n: f64| 2.0 / n.powi(2);
        for n in [3.0, 8.0, 13.3, 30.0] {
            let cost = second(n) / acceleration(n);
            assert!((cost / second(30.0) - 1.0).abs() < 1e-9, "{n} frames: {cost}");
        }
        assert_eq!(acceleration(120.0), 1.0);
    }

    #[test]
    fn what_is_usual_goes_by_the_turn() {
        let [once, thrice] = [360.0, 1080.0].map(|turn| facing(&steady(38, turn)));
        assert!((usual(&thrice) / acceleration(13.0) - 1.0).abs() < 0.01 && usual(&once) == 1.0);
        for (poses, want) in [(once, 3.9), (thrice, 1.3)] {
            assert!((frames_in(0.1, &poses) - want).abs() < 0.01, "{}", frames_in(0.1, &poses));
        }
    }
}
