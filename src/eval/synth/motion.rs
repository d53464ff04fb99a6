//! The made motion: one turn in an A-pose, and poses that the clip does not show.

use std::f32::consts::{PI, TAU};

use glam::{Quat, Vec3};
use rand::RngExt;
use rand_pcg::Pcg64;

use super::filming::Filming;
use crate::avatar::Pose;

/// Shoulders of an A-pose, radians below the T-pose.
const ARMS_DOWN: f32 = 0.85;

/// Rotations of some joints.
type Bends<'a> = &'a [(usize, [f32; 3])];

fn set(pose: &mut Pose, joint: usize, rotation: [f32; 3]) {
    pose[3 * joint..3 * joint + 3].copy_from_slice(&rotation);
}

/// Upright before a camera whose y runs down, turned by `angle` about the body's own axis: at 0 facing the camera.
fn root(filming: &Filming, angle: f32) -> [f32; 3] {
    (filming.tilt().as_quat() * Quat::from_rotation_x(PI) * Quat::from_rotation_y(angle)).to_scaled_axis().to_array()
}

/// The turn in `n` frames: `[n]` poses and the pelvis' small sway (metres). Arms, head and trunk move a little, as living
/// people do.
pub(super) fn turn(n: usize, filming: &Filming, rng: &mut Pcg64) -> (Vec<Pose>, Vec<[f32; 3]>) {
    let phases: [f32; 8] = std::array::from_fn(|_| TAU * rng.random::<f32>());
    let frame = |i: usize| {
        let at = i as f32 / n as f32;
        let wave = |k: usize, turns: f32| (TAU * turns * at + phases[k]).sin();
        let mut pose = [0.0; 72];
        let swing = (filming.arm_swing_degrees as f32).to_radians() * (2.0 * TAU * at).sin();
        set(&mut pose, 0, root(filming, filming.facing(f64::from(at)) as f32));
        set(&mut pose, 16, [0.03 * wave(0, 2.0), 0.04 * wave(1, 1.0), -ARMS_DOWN + swing + 0.05 * wave(2, 1.0)]);
        set(&mut pose, 17, [0.03 * wave(3, 2.0), 0.04 * wave(4, 1.0), ARMS_DOWN - swing + 0.05 * wave(5, 1.0)]);
        set(&mut pose, 18, [0.0, -0.15 - 0.05 * wave(0, 1.0), 0.0]);
        set(&mut pose, 19, [0.0, 0.15 + 0.05 * wave(4, 1.0), 0.0]);
        set(&mut pose, 1, [0.0, 0.0, 0.10]);
        set(&mut pose, 2, [0.0, 0.0, -0.10]);
        set(&mut pose, 7, [0.0, 0.0, -0.08]);
        set(&mut pose, 8, [0.0, 0.0, 0.08]);
        set(&mut pose, 6, [0.03 * wave(6, 1.0), 0.03 * wave(7, 1.0), 0.0]);
        set(&mut pose, 12, [0.04 * wave(2, 1.0), 0.06 * wave(5, 1.0), 0.0]);
        let sway = Vec3::new(0.015 * wave(3, 1.0), 0.004 * wave(6, 2.0), 0.015 * wave(7, 1.0));
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
