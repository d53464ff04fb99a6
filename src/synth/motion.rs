//! The made motion: one turn in an A-pose, and poses that the clip does not show.

use std::f32::consts::{PI, TAU};
use std::f64::consts as double;

use glam::{Quat, Vec3};
use rand::RngExt;
use rand_pcg::Pcg64;

use super::filming::Filming;
use crate::avatar::Pose;

/// Rotations of some joints.
type Bends<'a> = &'a [(usize, [f32; 3])];

fn set(pose: &mut Pose, joint: usize, rotation: [f32; 3]) {
    pose[3 * joint..3 * joint + 3].copy_from_slice(&rotation);
}

/// Upright before a camera whose y runs down, turned by `angle` about the body's own axis: at 0 facing the camera.
fn root(filming: &Filming, angle: f32) -> [f32; 3] {
    (filming.tilt().as_quat() * Quat::from_rotation_x(PI) * Quat::from_rotation_y(angle)).to_scaled_axis().to_array()
}

/// Where the legs are while somebody steps round: each foot in turn stays on the floor, with the heading it came down with, and
/// is lifted to its next place.
struct Steps {
    /// Left and right: radians by which the thigh is raised.
    raised: [f32; 2],
    /// And by which the foot's heading is ahead of the pelvis'.
    ahead: [f32; 2],
}

impl Steps {
    /// Of both feet in a whole turn.
    const A_TURN: f64 = 12.0;
    /// Part of its cycle in which a foot is off the floor.
    const LIFTED: f64 = 1.0 / 3.0;
    /// The pelvis' way towards the foot that stands, metres for a radian of the other thigh's.
    const LEAN: f32 = 0.08;

    fn of(filming: &Filming, facing: f64) -> Self {
        let most = filming.step_degrees.to_radians();
        let foot = |offset: f64| {
            let cycles = facing / double::TAU * (0.5 * Self::A_TURN) + offset;
            let (at, cycle) = (cycles.rem_euclid(1.0), 2.0 * double::TAU / Self::A_TURN);
            let lifted = (at / Self::LIFTED).min(1.0);
            // On the floor the pelvis goes on and the foot falls behind; in the air it overtakes.
            let stood = ((at - Self::LIFTED) / (1.0 - Self::LIFTED)).max(0.0);
            let swung = lifted * lifted * (3.0 - 2.0 * lifted);
            let ahead =
                if most > 0.0 { 0.5 * cycle * (1.0 - Self::LIFTED) * (2.0 * (swung - stood) - 1.0) } else { 0.0 };
            ((most * (double::PI * lifted).sin().powi(2)) as f32, ahead as f32)
        };
        let [left, right] = [0.0, 0.5].map(foot);
        Self { raised: [left.0, right.0], ahead: [left.1, right.1] }
    }

    fn set_legs(&self, pose: &mut Pose) {
        for (side, out) in [1.0, -1.0].into_iter().enumerate() {
            let raised = self.raised[side];
            let thigh = Quat::from_rotation_x(-raised)
                * Quat::from_rotation_z(0.10 * out)
                * Quat::from_rotation_y(self.ahead[side]);
            set(pose, 1 + side, thigh.to_scaled_axis().to_array());
            set(pose, 4 + side, [2.0 * raised, 0.0, 0.0]);
            set(pose, 7 + side, [-raised, 0.0, -0.08 * out]);
        }
    }

    /// To the left, metres.
    fn lean(&self) -> f32 {
        Self::LEAN * (self.raised[1] - self.raised[0])
    }
}

/// The turn in `n` frames: `[n]` poses and the pelvis' small sway (metres). Arms, head and trunk move a little, as living
/// people do.
pub(super) fn turn(n: usize, filming: &Filming, rng: &mut Pcg64) -> (Vec<Pose>, Vec<[f32; 3]>) {
    let phases: [f32; 8] = std::array::from_fn(|_| TAU * rng.random::<f32>());
    let frame = |i: usize| {
        let at = i as f32 / n as f32;
        let wave = |k: usize, turns: f32| (TAU * turns * at + phases[k]).sin();
        let mut pose = [0.0; 72];
        let facing = filming.facing(f64::from(at));
        let down = filming.arms_down_degrees.to_radians() as f32;
        let swing = (filming.arm_swing_degrees as f32).to_radians() * (2.0 * TAU * at).sin();
        set(&mut pose, 0, root(filming, facing as f32));
        set(&mut pose, 16, [0.03 * wave(0, 2.0), 0.04 * wave(1, 1.0), -down + swing + 0.05 * wave(2, 1.0)]);
        set(&mut pose, 17, [0.03 * wave(3, 2.0), 0.04 * wave(4, 1.0), down - swing + 0.05 * wave(5, 1.0)]);
        set(&mut pose, 18, [0.0, -0.15 - 0.05 * wave(0, 1.0), 0.0]);
        set(&mut pose, 19, [0.0, 0.15 + 0.05 * wave(4, 1.0), 0.0]);
        let steps = Steps::of(filming, facing);
        steps.set_legs(&mut pose);
        set(&mut pose, 6, [0.03 * wave(6, 1.0), 0.03 * wave(7, 1.0), 0.0]);
        set(&mut pose, 12, [0.04 * wave(2, 1.0), 0.06 * wave(5, 1.0), 0.0]);
        let sway = Vec3::new(0.015 * wave(3, 1.0), 0.004 * wave(6, 2.0), 0.015 * wave(7, 1.0));
        let sway = sway + Quat::from_rotation_y(-facing as f32) * (steps.lean() * Vec3::X);
        (pose, (filming.tilt().as_quat() * sway).to_array())
    };
    (0..n).map(frame).unzip()
}

/// Names and poses that the turn does not hold.
pub(super) fn novel_poses(filming: &Filming) -> Vec<(&'static str, Pose)> {
    let arms_down = [(16, [0.0, 0.0, -1.2]), (17, [0.0, 0.0, 1.2])];
    let poses: [(&str, f32, Bends<'_>); 8] = [
        ("walk", 0.3, &[(1, [-0.5, 0.0, 0.0]), (2, [0.4, 0.0, 0.0]), (5, [0.5, 0.0, 0.0]), (18, [0.0, -0.5, 0.0])]),
        ("stride", -0.8, &[(2, [-0.7, 0.0, 0.0]), (1, [0.5, 0.0, 0.0]), (4, [0.6, 0.0, 0.0]), (19, [0.0, 0.6, 0.0])]),
        ("reach_up", 0.0, &[(16, [0.0, 0.0, 0.55]), (17, [0.0, 0.0, -0.55])]),
        (
            "squat",
            0.5,
            &[
                (1, [-1.2, 0.2, 0.0]),
                (2, [-1.2, -0.2, 0.0]),
                (4, [1.4, 0.0, 0.0]),
                (5, [1.4, 0.0, 0.0]),
                (7, [-0.3, 0.0, 0.0]),
                (8, [-0.3, 0.0, 0.0]),
                (3, [0.3, 0.0, 0.0]),
            ],
        ),
        ("arms_front", 0.0, &[(16, [0.0, -1.4, 0.0]), (17, [0.0, 1.4, 0.0])]),
        ("twist", 0.4, &[(3, [0.0, 0.3, 0.0]), (6, [0.0, 0.3, 0.0]), (9, [0.0, 0.3, 0.0])]),
        ("kick", -0.6, &[(2, [-1.1, 0.0, 0.0]), (5, [0.3, 0.0, 0.0]), (6, [-0.1, 0.0, 0.0])]),
        ("bow", 0.9, &[(3, [0.3, 0.0, 0.0]), (6, [0.3, 0.0, 0.0]), (12, [0.2, 0.0, 0.0]), (15, [0.2, 0.0, 0.0])]),
    ];
    let pose = |(name, angle, joints): (&'static str, f32, Bends<'_>)| {
        let mut pose = [0.0; 72];
        set(&mut pose, 0, root(filming, angle));
        arms_down.iter().chain(joints).for_each(|&(joint, rotation)| set(&mut pose, joint, rotation));
        (name, pose)
    };
    poses.map(pose).to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn feet_are_lifted_in_turn_and_stand_still_between() {
        let filming = Filming { step_degrees: 20.0, ..Filming::default() };
        let at = |i: usize| {
            (std::f64::consts::TAU * i as f64 / 720.0, Steps::of(&filming, std::f64::consts::TAU * i as f64 / 720.0))
        };
        let mut lifts = 0;
        for i in 0..720 {
            let ((facing, steps), (next_facing, next)) = (at(i), at(i + 1));
            assert!(steps.raised[0].min(steps.raised[1]) < 1e-6, "both feet are off the floor");
            let is_off = |steps: &Steps, side: usize| steps.raised[side] > 1e-6;
            for side in 0..2 {
                let heading = |facing: f64, steps: &Steps| facing + f64::from(steps.ahead[side]);
                if !is_off(&steps, side) && !is_off(&next, side) {
                    let turned = heading(next_facing, &next) - heading(facing, &steps);
                    assert!(turned.abs() < 1e-4, "a foot on the floor turns by {turned}");
                }
                lifts += usize::from(!is_off(&steps, side) && is_off(&next, side));
            }
        }
        assert_eq!(lifts, 12);
        let still = Steps::of(&Filming::default(), 1.0);
        assert_eq!((still.raised, still.ahead), ([0.0; 2], [0.0; 2]));
    }
}
