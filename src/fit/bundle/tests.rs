use glam::DVec2;

use super::looks::CHANNELS;
use super::*;
use crate::body::joints::{LEFT_HIP, RIGHT_HIP, SPINE1};
use crate::capture::{Capture, Frame};
use crate::fit::FitConfig;
use crate::ops::hard_rasterize::{HardRasterizeConfig, cpu};

const SIDE: u32 = 160;

/// Who turns once in so many frames, bends and twists a little, and stands at three metres with the world's y running down.
fn turning(body: &Body, frames: usize) -> FitState {
    let pose = |t: usize| {
        let phase = std::f64::consts::TAU * t as f64 / frames as f64;
        let mut pose = [0.0f32; N_POSE];
        let root = rotation::exp(DVec3::X * std::f64::consts::PI) * rotation::exp(DVec3::Y * phase);
        pose[..3].copy_from_slice(&rotation::log(root).as_vec3().to_array());
        (3..N_POSE).for_each(|k| pose[k] = 0.04 * (1.7 * k as f64 + phase).sin() as f32);
        pose
    };
    let poses: Vec<[f32; N_POSE]> = (0..frames).map(pose).collect();
    let config = FitConfig::standard(0);
    FitState::new(body, vec![0.3, -0.5, 0.2], &poses, &vec![[0.02, 0.1, 3.0]; frames], config.field, 0)
}

fn camera() -> Camera {
    let side = f64::from(SIDE);
    Camera::pinhole(SIDE, SIDE, [1.5 * side, 1.5 * side, 0.5 * side, 0.5 * side])
}

/// Vertices of all frames, one after the other.
fn vertices(body: &Body, state: &FitState) -> Vec<DVec3> {
    let of = |frame| posed(body, state, frame).0.vertices.into_iter().map(|v| DVec3::from(v.map(f64::from)));
    (0..state.n_frames()).flat_map(of).collect()
}

fn random(n: usize, seed: f64) -> Vec<f64> {
    (0..n).map(|i| (12.9898 * (i as f64 + seed)).sin() * 43758.5453).map(|x| x.fract() - 0.5).collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[test]
fn velocities_are_the_derivative_of_the_posed_surface() {
    let (body, frames) = (Body::test_body(), 3);
    let state = turning(&body, frames);
    let normals = normals(&body, &surface(&body, &state));
    let step = random(frames * N_DOF + body.n_vertices(), 1.0);
    let moved = |by: f64| {
        let mut state = state.clone();
        apply(&mut state, &step.iter().map(|s| by * s).collect::<Vec<_>>(), &normals);
        vertices(&body, &state)
    };
    let (after, before) = (moved(5e-3), moved(-5e-3));
    for t in 0..frames {
        let (posed, transl) = posed(&body, &state, t);
        let kinematics = kinematics::Kinematics::new(&body, &posed, transl, &normals);
        let velocities = kinematics.velocities(&step[t * N_DOF..][..N_DOF], &step[frames * N_DOF..]);
        for (v, found) in velocities.iter().enumerate() {
            let i = t * body.n_vertices() + v;
            let expected = (after[i] - before[i]) / 1e-2;
            assert!(found.distance(expected) < 2e-3, "frame {t}, vertex {v}: {found}, expected {expected}");
        }
        let forces: Vec<DVec3> = random(3 * body.n_vertices(), 5.0).chunks_exact(3).map(DVec3::from_slice).collect();
        let (mut into_step, mut into_raised) = (vec![0.0; N_DOF], vec![0.0; body.n_vertices()]);
        kinematics.pull_back(&forces, &mut into_step, &mut into_raised);
        let work: f64 = velocities.iter().zip(&forces).map(|(v, f)| v.dot(*f)).sum();
        let same = dot(&into_step, &step[t * N_DOF..][..N_DOF]) + dot(&into_raised, &step[frames * N_DOF..]);
        assert!((work - same).abs() < 1e-9 * work.abs().max(1.0), "{work} and {same}");
    }
}

/// Pictures of `state` in a pattern that goes with the surface.
fn filmed(body: &Body, state: &FitState) -> Capture {
    let rest = surface(body, state);
    let frame = |t: usize| {
        let (posed, _) = posed(body, state, t);
        let view: Vec<f32> = posed.vertices.as_flattened().to_vec();
        let image = cpu::forward(&HardRasterizeConfig::default(), &camera(), &view, &body.faces);
        let colour = |i: usize| {
            let face = usize::try_from(image.pix_to_face[i]).ok()?;
            let corners = body.faces[face].iter().zip(&image.bary_coords[3 * i..]);
            let p: DVec3 = corners.map(|(&v, &b)| f64::from(b) * rest[v as usize]).sum();
            let wave = |x: f64, y: f64| (128.0 + 50.0 * (60.0 * x).sin() + 50.0 * (55.0 * y).cos()) as u8;
            Some([wave(p.x + p.z, p.y), wave(p.y, p.z - p.x), wave(p.x - p.y, p.z)])
        };
        let pixels: Vec<Option<[u8; 3]>> = (0..image.zbuf.len()).map(colour).collect();
        Frame {
            index: t as u32,
            x0: 0,
            y0: 0,
            width: SIDE,
            height: SIDE,
            rgb: pixels.iter().flat_map(|p| p.unwrap_or([255; 3])).collect(),
            mask: pixels.iter().map(|p| if p.is_some() { 255 } else { 0 }).collect(),
            keypoints: Vec::new(),
        }
    };
    Capture {
        camera: camera(),
        uploaded_side_px: SIDE,
        camera_estimated: false,
        fps: 30.0,
        frames: (0..state.n_frames()).map(frame).collect(),
        keypoint_format: "coco17".into(),
        given_keypoint_format: "coco17".into(),
        poses: None,
        warnings: Vec::new(),
    }
}

fn linearised<'a>(body: &'a Body, capture: &Capture, state: &FitState) -> (Vec<View<'a>>, Vec<DVec3>) {
    let looks: Vec<Looks> = capture.frames.iter().map(|frame| Looks::of(frame, 80.0)).collect();
    let normals = normals(body, &surface(body, state));
    (views(body, state, &vec![camera(); state.n_frames()], &looks, &normals), normals)
}

/// The truth, but for a slow error of where the person faces, of a twist of the trunk and of how both legs swing.
fn off(truth: &FitState, degrees: f64) -> FitState {
    let mut state = truth.clone();
    let n = state.n_frames();
    for t in 0..n {
        let wave = degrees.to_radians() * (std::f64::consts::TAU * t as f64 / n as f64).sin();
        let mut turn = |joint: usize, by: DVec3| {
            let numbers = &mut state.poses[t * N_POSE + 3 * joint..][..3];
            let angles = DVec3::from([0, 1, 2].map(|axis| f64::from(numbers[axis])));
            let turned = rotation::log_near(rotation::exp(angles) * rotation::exp(by), angles);
            numbers.copy_from_slice(&turned.as_vec3().to_array());
        };
        turn(0, wave * DVec3::Y);
        turn(SPINE1, -0.7 * wave * DVec3::Y);
        [LEFT_HIP, RIGHT_HIP].into_iter().for_each(|hip| turn(hip, wave * DVec3::X));
    }
    state
}

fn distance(body: &Body, a: &FitState, b: &FitState) -> f64 {
    let squares: Vec<f64> =
        vertices(body, a).iter().zip(vertices(body, b)).map(|(a, b)| a.distance_squared(b)).collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

#[test]
fn the_matrix_is_symmetric_and_its_gradient_that_of_the_rows() {
    let body = Body::test_body();
    let truth = turning(&body, 4);
    let (capture, start) = (filmed(&body, &truth), off(&truth, 1.0));
    let (views, _) = linearised(&body, &capture, &start);
    let prior = Prior::new(4, 4.0, &Topology::new(body.n_vertices(), &body.faces));
    let normal = Normal::new(&body, &views, &prior, &mut None);
    let n = 4 * N_DOF + body.n_vertices();
    let [mut a, mut b] = [random(n, 2.0), random(n, 3.0)];
    [&mut a, &mut b].into_iter().for_each(|vector| prior.hold(vector));
    let (ab, ba) = (dot(&a, &normal.times(&b)), dot(&b, &normal.times(&a)));
    assert!((ab - ba).abs() < 1e-9 * ab.abs().max(dot(&a, &normal.times(&a))), "{ab} and {ba}");
    assert!(dot(&a, &normal.times(&a)) > 0.0);
    // What is expected says its own diagonal, of turns, places and the surface.
    let mut unit = vec![0.0; n];
    let diagonal = prior.diagonal();
    for i in [0, 7, N_DOF + PLACE, 4 * N_DOF + 20] {
        unit[i] = 1.0;
        let own = prior.times(&unit)[i];
        assert!((own - diagonal[i]).abs() < 1e-9 * own, "{i}: {own} and {}", diagonal[i]);
        unit[i] = 0.0;
    }
}

#[test]
fn what_is_slowly_wrong_with_all_frames_is_found() {
    let body = Body::test_body();
    let truth = turning(&body, 24);
    let (capture, start) = (filmed(&body, &truth), off(&truth, 2.0));
    let config = FitConfig::standard(0);
    let inputs = Inputs { body: &body, capture: &capture, camera: &capture.camera, config: &config };
    let mut found = start.clone();
    assert!(adjust(&inputs, &mut found, &mut || true).unwrap());
    let (before, after) = (distance(&body, &start, &truth), distance(&body, &found, &truth));
    assert!(after < 0.55 * before, "{before} m before, {after} m after");
    let mut again = start.clone();
    adjust(&inputs, &mut again, &mut || true).unwrap();
    assert!(again == found, "two adjustments of one start differ");
    // What is right stays, to a quarter of a pixel, which is 12.5 mm.
    let mut same = truth.clone();
    adjust(&inputs, &mut same, &mut || true).unwrap();
    let moved = distance(&body, &same, &truth);
    assert!(moved < 0.25 * 3.0 / 240.0, "{moved} m away from the truth");
}

#[test]
fn known_poses_stay_and_whoever_stops_keeps_what_was() {
    let body = Body::test_body();
    let truth = turning(&body, 6);
    let (capture, start) = (filmed(&body, &truth), off(&truth, 2.0));
    let mut config = FitConfig::standard(0);
    let mut state = start.clone();
    let stopped = {
        let inputs = Inputs { body: &body, capture: &capture, camera: &capture.camera, config: &config };
        adjust(&inputs, &mut state, &mut || false)
    };
    assert!(matches!(stopped, Err(FitError::Stopped)) && state == start);
    config.held = Some(crate::fit::stage0::Trust { root: 0.01, place: 0.01, joints: 0.01 });
    let inputs = Inputs { body: &body, capture: &capture, camera: &capture.camera, config: &config };
    assert!(!adjust(&inputs, &mut state, &mut || true).unwrap() && state == start);
}

#[test]
fn looks_do_not_change_with_the_light_and_tell_their_slopes() {
    let [width, height] = [40u32, 30];
    let frame = |brightness: f64| {
        let value = |i: u32| brightness * (110.0 + 60.0 * (0.6 * f64::from(i % width)).sin());
        Frame {
            index: 0,
            x0: 0,
            y0: 0,
            width,
            height,
            rgb: (0..width * height).flat_map(|i| [value(i) as u8; 3]).collect(),
            mask: vec![255; (width * height) as usize],
            keypoints: Vec::new(),
        }
    };
    let [bright, dim] = [1.0, 0.7].map(|brightness| Looks::of(&frame(brightness), 200.0));
    for x in [12.0, 14.3, 17.8, 21.5] {
        let [bright_look, dim_look] = [&bright, &dim].map(|looks| looks.at([x, 15.2]).unwrap());
        for c in 0..CHANNELS {
            let [a, b] = [bright_look[c].value, dim_look[c].value];
            assert!((a - b).abs() < 0.05, "{a} and {b} in another light, at {x}");
        }
        let beside = |dx: f64| bright.at([x + dx, 15.2]).unwrap()[0].value;
        let expected = (beside(1.0) - beside(-1.0)) / 2.0;
        assert!((bright_look[0].slope[0] - expected).abs() < 1e-5);
        assert!(bright_look[0].slope[1].abs() < 1e-3, "{}", bright_look[0].slope[1]);
    }
    assert!(bright.at(DVec2::new(0.5, 3.0).to_array()).is_none() && bright.at([39.0, 15.0]).is_none());
}
