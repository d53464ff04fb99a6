use std::f64::consts::{PI, TAU};

use super::cpu::Joints;
use super::quaternion::Quaternion;
use super::{BoneTurns, cpu};
use crate::body::joints::{N_JOINTS, N_POSE, PARENTS};
use crate::ops::linear::{Vector, add, scale, sub};
use crate::ops::testing::{assert_close, assert_gradient, f32s, gpu, points, random};

/// The root, hips, the spine's first joint, a knee, and an elbow whose parent is not in space but whose collar is.
const SOME: [usize; 7] = [0, 1, 2, 3, 5, 13, 18];

fn mask(joints: &[usize]) -> [bool; N_JOINTS] {
    std::array::from_fn(|j| joints.contains(&j))
}

fn all() -> Vec<usize> {
    (0..N_JOINTS).collect()
}

/// Frames of a body that faces the camera, whose y runs down, turned by more than half a turn: rotation vectors beyond π.
fn start(n: usize) -> Vec<f64> {
    let mut poses = random(3, N_POSE * n);
    for (frame, pose) in poses.chunks_exact_mut(N_POSE).enumerate() {
        let angle = if frame % 2 == 0 { PI - 0.1 } else { PI + 0.3 };
        pose[..3].copy_from_slice(&[angle, 0.1 * frame as f64, 0.2]);
    }
    poses
}

/// One joint has not turned at all.
fn turns(n: usize) -> Vec<f64> {
    let mut turns: Vec<f64> = random(4, N_POSE * n).iter().map(|x| 0.3 * x).collect();
    turns.chunks_exact_mut(N_POSE).for_each(|turn| turn[9..12].fill(0.0));
    turns
}

fn orientations(pose: &[Vector<f64>]) -> Vec<Quaternion<f64>> {
    cpu::orientations(Joints { parents: &PARENTS, in_space: &mask(&[]) }, pose)
}

/// How far two orientations are from each other, radians.
fn between(a: Quaternion<f64>, b: Quaternion<f64>) -> f64 {
    let turn = a.inverse().after(b).log(Quaternion::identity());
    turn.iter().map(|x| x * x).sum::<f64>().sqrt()
}

#[test]
fn where_nothing_has_turned_the_pose_is_the_start() {
    for in_space in [mask(&[]), mask(&SOME), mask(&all())] {
        let (start, joints) = (start(2), Joints { parents: &PARENTS, in_space: &in_space });
        for pose in start.chunks_exact(N_POSE) {
            let pose: Vec<Vector<f64>> = points(pose);
            let same = cpu::forward(joints, &pose, &[[0.0; 3]; N_JOINTS]);
            assert_close("pose", same.as_flattened(), pose.as_flattened(), 1e-12);
        }
    }
}

#[test]
fn a_bone_turns_about_its_own_axes_and_those_that_hang_on_it_keep_their_orientation() {
    let start: Vec<Vector<f64>> = points(&start(1));
    let in_space = mask(&all());
    let turned = |joint: usize, turn: Vector<f64>| {
        let mut turns = [[0.0; 3]; N_JOINTS];
        turns[joint] = turn;
        orientations(&cpu::forward(Joints { parents: &PARENTS, in_space: &in_space }, &start, &turns))
    };
    let (began, turn) = (orientations(&start), [0.1, -0.2, 0.3]);
    for joint in 0..N_JOINTS {
        for (j, (&before, &after)) in began.iter().zip(&turned(joint, turn)).enumerate() {
            let want = if j == joint { before.after(Quaternion::exp(turn)) } else { before };
            assert!(between(after, want) < 1e-9, "{j} as {joint} turns: off by {}", between(after, want));
        }
    }
}

#[test]
fn what_is_not_in_space_goes_along_up_to_the_next_joint_that_is() {
    let start: Vec<Vector<f64>> = points(&start(1));
    let in_space = mask(&SOME);
    let mut turns = [[0.0; 3]; N_JOINTS];
    // The left collar is in space, the shoulder is not, the elbow is, the wrist is not.
    turns[13] = [0.2, 0.0, 0.1];
    let pose = cpu::forward(Joints { parents: &PARENTS, in_space: &in_space }, &start, &turns);
    let (before, after) = (orientations(&start), orientations(&pose));
    let moved: Vec<usize> = (0..N_JOINTS).filter(|&j| between(before[j], after[j]) > 1e-9).collect();
    assert_eq!(moved, [13, 16]);
    assert_eq!(pose[16], start[16]);
}

#[test]
fn a_pose_goes_on_beyond_half_a_turn() {
    let mut start = vec![[0.0; 3]; N_JOINTS];
    start[0] = [PI - 0.05, 0.0, 0.0];
    let in_space = mask(&[0]);
    let mut turns = vec![[0.0; 3]; N_JOINTS];
    turns[0] = [0.1, 0.0, 0.0];
    let pose = cpu::forward(Joints { parents: &PARENTS, in_space: &in_space }, &start, &turns);
    assert_close("root", &pose[0], &[PI + 0.05, 0.0, 0.0], 1e-12);
    // And not to the equivalent vector of the other branch.
    let other = scale((pose[0][0] - TAU) / pose[0][0], pose[0]);
    assert!(sub(pose[0], start[0])[0].abs() < 0.2 && sub(other, start[0])[0].abs() > 6.0);
}

#[test]
fn the_gradient_is_that_of_the_poses() {
    let (start, turns, upstream): (Vec<Vector<f64>>, _, Vec<Vector<f64>>) =
        (points(&start(2)), turns(2), points(&random(5, N_POSE * 2)));
    for in_space in [mask(&[]), mask(&SOME), mask(&all())] {
        let joints = Joints { parents: &PARENTS, in_space: &in_space };
        for frame in 0..2 {
            let own = frame * N_JOINTS..(frame + 1) * N_JOINTS;
            let (start, upstream) = (&start[own.clone()], &upstream[own.clone()]);
            let turns = &turns[N_POSE * frame..][..N_POSE];
            let mut grads = vec![[0.0; 3]; N_JOINTS];
            cpu::backward(joints, start, &points(turns), upstream, &mut grads);
            assert_gradient("turns", turns, grads.as_flattened(), |turns| {
                let pose = cpu::forward(joints, start, &points(turns));
                let products = pose.as_flattened().iter().zip(upstream.as_flattened());
                products.map(|(x, g)| x * g).sum()
            });
        }
    }
}

/// The derivatives' series go over into their formulas.
#[test]
fn small_and_large_turns_have_the_same_derivatives() {
    use super::quaternion::{by_turn, by_vector};
    let (x, axis) = ([0.3, -0.5, 0.7], [0.6, 0.0, 0.8]);
    for t in [0.0, 1e-9, 0.009_999, 0.010_001, 0.099_99, 0.100_01, 1.0, PI, 4.0] {
        let w = scale(t, axis);
        let back = by_turn(w, by_vector(w, x));
        assert_close("there and back", &back, &x, 1e-9);
        // exp(w + h e) = exp(w) exp(J h e): the torque of x is x · J.
        let h = 1e-6;
        for k in 0..3 {
            let mut e = [0.0; 3];
            e[k] = h;
            let turn = |e: Vector<f64>| {
                Quaternion::exp(w).inverse().after(Quaternion::exp(add(w, e))).log(Quaternion::identity())
            };
            let column = scale(0.5 / h, sub(turn(e), turn(scale(-1.0, e))));
            let want: f64 = column.iter().zip(x).map(|(a, b)| a * b).sum();
            assert!((by_vector(w, x)[k] - want).abs() < 1e-8, "{t}, {k}: {} and {want}", by_vector(w, x)[k]);
        }
    }
}

#[test]
fn gpu_matches_the_twin() {
    let Some(gpu) = gpu("bone_turns::gpu_matches_the_twin") else { return };
    let n = 11;
    let (start, turns, upstream) = (f32s(&start(n)), f32s(&turns(n)), f32s(&random(6, N_POSE * n)));
    for in_space in [mask(&[]), mask(&SOME), mask(&all())] {
        let joints = Joints { parents: &PARENTS, in_space: &in_space };
        let (mut want, mut want_grads) = (Vec::new(), Vec::new());
        for frame in 0..n {
            let of = |x: &[f32]| -> Vec<Vector<f32>> { points(&x[N_POSE * frame..][..N_POSE]) };
            want.extend(cpu::forward(joints, &of(&start), &of(&turns)));
            let mut grads = vec![[1.0; 3]; N_JOINTS];
            cpu::backward(joints, &of(&start), &of(&turns), &of(&upstream), &mut grads);
            want_grads.extend(grads);
        }
        let op = BoneTurns::new(&gpu, joints, &start);
        let [turns, grad_poses] = [&turns, &upstream].map(|x| gpu.upload("x", x));
        let (poses, grads) = (gpu.zeros("poses", N_POSE * n), gpu.upload("grads", &vec![1.0f32; N_POSE * n]));
        let mut recorder = gpu.recorder("bone_turns/test");
        op.forward(&mut recorder, &turns, &poses);
        op.backward(&mut recorder, &turns, &poses, &grad_poses, &grads);
        recorder.submit().unwrap();
        assert_close("poses", &gpu.read(&poses).unwrap(), want.as_flattened(), 1e-5);
        assert_close("grads", &gpu.read(&grads).unwrap(), want_grads.as_flattened(), 1e-5);
    }
}
