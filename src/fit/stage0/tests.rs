use glam::{DVec2, DVec3};

use super::normal::Normal;
use super::problem::Scales;
use super::rig::Point;
use super::setup;
use super::silhouette::{Field, Grid};
use super::state::{Frame as Pose, Layout, Shared, State, Step};
use super::synthetic::{self, Clip, Difficulty, Errors, clip, errors};
use super::tracks::Sighting;
use super::{FocalCheck, Stage0Error, Stage0Options, Stage0Result, solve};
use crate::body::Body;
use crate::body::joints::{HEAD, NECK, RIGHT_WRIST};
use crate::keypoints::{COCO17, Part, Side, index_of};

fn solved(how: &Difficulty) -> (Clip, Stage0Result, Errors) {
    let body = Body::test_body();
    let clip = clip(&body, how);
    let options = Stage0Options { use_masks: false, ..Stage0Options::default() };
    let result = solve(&body, &clip.capture, &options, &mut |_| true).unwrap();
    let errors = errors(&body, &clip, &result);
    (clip, result, errors)
}

/// Asserts a mean joint error (size and distance scaled to the truth's) and a facing.
fn recovers(how: &Difficulty, metres: f64, degrees: f64) -> Stage0Result {
    let (_, result, errors) = solved(how);
    assert!(errors.scaled < metres && errors.facing_degrees < degrees, "{errors:?} of {how:?}");
    assert!(errors.joints < 0.15, "size or distance is off: {errors:?}");
    result
}

#[test]
fn a_plain_turn() {
    recovers(&Difficulty::default(), 0.02, 5.0);
}

#[test]
fn turning_the_other_way_round() {
    let result = recovers(&Difficulty { turn_degrees: -360.0, seed: 2, ..Difficulty::default() }, 0.02, 5.0);
    assert!((result.report.turn_degrees + 360.0).abs() < 10.0);
}

#[test]
fn two_hundred_seventy_degrees() {
    recovers(&Difficulty { turn_degrees: 270.0, start_degrees: -60.0, seed: 3, ..Difficulty::default() }, 0.025, 6.0);
}

#[test]
fn one_and_a_half_turns_at_a_varying_pace() {
    let how = Difficulty { frames: 45, turn_degrees: 540.0, pace: 0.6, seed: 4, ..Difficulty::default() };
    recovers(&how, 0.025, 8.0);
}

/// 13° and 21° where the pace changes as a Gaussian walk.
#[test]
fn a_turn_that_stops_and_goes_on() {
    let once = Difficulty { stands: 0.17, pace: 0.0, dropped: 0.0, seed: 14, ..Difficulty::default() };
    recovers(&once, 0.02, 9.0);
    recovers(&Difficulty { frames: 90, turn_degrees: 1080.0, stands: 0.2, ..once }, 0.015, 10.0);
}

#[test]
fn arms_that_swing() {
    recovers(&Difficulty { swing_degrees: 30.0, seed: 5, ..Difficulty::default() }, 0.03, 6.0);
}

/// Mean distance of a joint from the truth's once sizes are made equal, metres, over the frames from `from` on.
fn joint_error(clip: &Clip, result: &Stage0Result, joint: usize, from: usize) -> f64 {
    let (scale, frames) = synthetic::joints(&Body::test_body(), clip, result);
    let errors = frames[from..].iter().map(|frame| (frame[joint].0 * scale).distance(frame[joint].1));
    errors.sum::<f64>() / (frames.len() - from) as f64
}

#[test]
fn a_hand_that_goes_to_the_hip() {
    let (clip, result, errors) = solved(&Difficulty { hand_on_hip: true, seed: 12, ..Difficulty::default() });
    let wrist = joint_error(&clip, &result, RIGHT_WRIST, 22);
    assert!(errors.scaled < 0.03 && wrist < 0.06, "{errors:?}, wrist {wrist}");
}

#[test]
fn a_head_that_looks_over_the_shoulder() {
    let how = Difficulty { looks_back_degrees: 60.0, dropped: 0.0, seed: 13, ..Difficulty::default() };
    let (clip, result, errors) = solved(&how);
    let turns = |pose: &Pose| pose.theta[HEAD].y + pose.theta[NECK].y;
    let of = |t: usize| f64::from(result.poses[t][3 * HEAD + 1] + result.poses[t][3 * NECK + 1]);
    let off: Vec<f64> = clip.poses.iter().enumerate().map(|(t, pose)| (of(t) - turns(pose)).to_degrees()).collect();
    let turned = || off.iter().zip(&clip.poses).filter(|(_, pose)| turns(pose).abs() > 0.7).map(|(off, _)| off.abs());
    let mean = turned().sum::<f64>() / turned().count() as f64;
    assert!(errors.facing_degrees < 6.0 && mean < 30.0, "{errors:?}, {mean}: {off:.0?}");
}

#[test]
fn a_back_view_with_swapped_sides_does_not_flip() {
    let result = recovers(&Difficulty { swapped_backs: 0.8, seed: 6, ..Difficulty::default() }, 0.025, 6.0);
    assert!(result.report.swapped.len() >= 5, "{:?}", result.report.swapped);
}

#[test]
fn a_noisy_detector() {
    recovers(&Difficulty { noise_px: 6.0, seed: 7, ..Difficulty::default() }, 0.04, 9.0);
}

#[test]
fn missing_and_wrong_points() {
    recovers(&Difficulty { dropped: 0.25, wrong: 0.08, seed: 8, ..Difficulty::default() }, 0.03, 7.0);
}

#[test]
fn faces_imagined_on_the_back_of_the_head() {
    let how = Difficulty { face_through_head: true, dropped: 0.0, seed: 9, ..Difficulty::default() };
    let (clip, result, errors) = solved(&how);
    assert!(errors.scaled < 0.02 && errors.facing_degrees < 5.0 && errors.joints < 0.15, "{errors:?}");
    // Stages that follow must not nod the head by them either.
    let (mut behind, mut before) = (0, 0);
    for ((truth, given), points) in clip.poses.iter().zip(&clip.capture.frames).zip(&result.keypoints) {
        let seen = |points: &[[f32; 3]]| (0..3).filter(|k| points[*k][2] > 0.0).count();
        assert_eq!(seen(&given.keypoints), 3);
        match truth.root.z_axis.z {
            away if away > 0.5 => behind += seen(points),
            towards if towards < -0.5 => before += seen(points),
            _ => {}
        }
    }
    assert!(behind == 0 && before >= 20, "{behind} from behind, {before} from before");
}

#[test]
fn unknown_focal_length() {
    let how = Difficulty { focal_guess: Some(1.2), seed: 10, ..Difficulty::default() };
    let (clip, result, errors) = solved(&how);
    let depth = f64::from(result.transl[0][2]);
    assert!(errors.facing_degrees < 6.0, "{errors:?}");
    assert!((2.2..3.8).contains(&depth), "{depth}");
    let ratio = result.camera.fx / (clip.capture.camera.fx / 1.2);
    assert!((0.85..1.25).contains(&ratio), "{ratio}");
}

#[test]
fn a_focal_length_that_the_clip_contradicts() {
    let (body, how) = (Body::test_body(), Difficulty { seed: 10, ..Difficulty::default() });
    for (wrong, contradicted) in [(1.0, false), (0.6, true), (1.6, true)] {
        let mut capture = clip(&body, &how).capture;
        let right = capture.camera.fx;
        (capture.camera.fx, capture.camera.fy) = (wrong * right, wrong * right);
        let check = FocalCheck::of(&body, &capture, &mut || true).unwrap();
        assert_eq!((check.given_px, check.contradicts()), (wrong * right, contradicted), "{wrong}: {check:?}");
        assert!((check.ratio * wrong - 1.0).abs() < 0.2, "{wrong}: {check:?}");
        capture.forget_focal();
        assert_eq!(FocalCheck::of(&body, &capture, &mut || true), None, "a guess contradicts nothing");
    }
    assert_eq!(FocalCheck::of(&body, &clip(&body, &how).capture, &mut || false), None, "stopped");
}

#[test]
fn body25_points() {
    recovers(&Difficulty { format: "body25", seed: 11, ..Difficulty::default() }, 0.025, 5.0);
}

#[test]
fn slopes_agree_with_central_differences() {
    let body = Body::test_body();
    let clip = clip(&body, &Difficulty { frames: 4, turn_degrees: 40.0, ..Difficulty::default() });
    let mut problem = setup::problem(&body, &clip.capture).unwrap();
    problem.focal_sigma = 0.2;
    let mut state = State { frames: clip.poses.clone(), shared: setup::mean_shape(body.n_betas) };
    state.shared.betas = vec![0.4, -0.3, 0.2];
    state.shared.offsets[4] = DVec3::new(0.02, -0.01, 0.015);
    problem.tracks.points = vec![Point::vertex(&body, 3), Point::vertex(&body, 40)];
    problem.tracks.expected = vec![DVec3::ZERO, DVec3::new(0.01, 0.0, 0.02)];
    let sighting = |point, x, y| Sighting { point, at: DVec2::new(x, y) };
    problem.tracks.sightings = vec![
        vec![],
        vec![sighting(0, 262.0, 240.0)],
        vec![sighting(0, 266.0, 240.0), sighting(1, 280.0, 300.0)],
        vec![],
    ];
    problem.layout.track(2);
    state.shared.tracked = vec![DVec3::new(0.01, 0.02, -0.01), DVec3::ZERO];
    state.frames[1].theta[4].x = -0.3;
    state.frames[2].theta[18] = DVec3::new(0.1, 0.4, -0.05);
    problem.steps.lifted = vec![[false; 2], [true, false], [true, true], [false; 2]];
    problem.steps.twist = vec![[0.0; 2], [0.3, 0.0], [-0.15, 0.15], [0.0; 2]];
    state.frames[1].step = [[-0.3, 0.5], [0.0; 2]];
    state.frames[2].step = [[-0.2, 0.45], [-0.1, 0.3]];
    problem.stance = Some(problem.stance_of(&state));
    let scales = Scales { track_px: 30.0, ..setup::rough_scales(&problem, &state) };
    let layout: &Layout = &problem.layout;
    let mut normal = Normal::new(4, layout.n_frame, layout.n_shared);
    problem.evaluate(&state, &scales, Some(&mut normal));
    let zero = || Step { frames: vec![0.0; 4 * layout.n_frame], shared: vec![0.0; layout.n_shared] };
    let h = 1e-5;
    for column in 0..4 * layout.n_frame + layout.n_shared {
        let along = |size: f64| {
            let mut step = zero();
            let frames = step.frames.len();
            if column < frames {
                step.frames[column] = size
            } else {
                step.shared[column - frames] = size
            }
            step
        };
        let cost = |size: f64| problem.evaluate(&state.stepped(layout, &along(size)), &scales, None);
        let difference = (cost(h) - cost(-h)) / (2.0 * h);
        let slope = normal.slope_along(&along(1.0));
        let tolerance = 1e-4 * slope.abs().max(1.0);
        assert!((difference - slope).abs() < tolerance, "column {column}: {difference} and {slope}");
    }
}

#[test]
fn what_is_expected_of_followed_points_is_the_same_at_every_size() {
    let body = Body::test_body();
    let clip = clip(&body, &Difficulty { frames: 2, ..Difficulty::default() });
    let mut problem = setup::problem(&body, &clip.capture).unwrap();
    let mut small = setup::mean_shape(body.n_betas);
    small.betas = vec![0.4, -0.3, 0.2];
    let mut large = small.clone();
    large.betas[0] += 1.5;
    let times = problem.stature.of(&large.betas) / problem.stature.of(&small.betas);
    assert!((times - 1.0).abs() > 0.01, "{times}");
    problem.tracks.points = vec![Point::vertex(&body, 3)];
    problem.tracks.expected = vec![DVec3::new(0.01, 0.0, 0.02)];
    problem.layout.track(1);
    small.tracked = vec![DVec3::new(0.03, 0.02, -0.01)];
    let cost = |shared: &Shared| problem.tracked_prior(shared, None);
    large.tracked = small.tracked.clone();
    assert!((cost(&large) / cost(&small) - 1.0).abs() > 0.01);
    large.tracked = vec![small.tracked[0] * times];
    assert!((cost(&large) / cost(&small) - 1.0).abs() < 1e-9);
}

#[test]
fn steps_of_the_block_solver_solve_the_whole_system() {
    let (n, d, s) = (4, 5, 7);
    let mut normal = Normal::new(n, d, s);
    let size = n * d + s;
    let mut dense = nalgebra::DMatrix::<f64>::zeros(size, size);
    let mut gradient = nalgebra::DVector::<f64>::zeros(size);
    let mut value = 0.3f64;
    let mut next = || {
        value = (value * 91.7 + 0.37).fract();
        value - 0.5
    };
    let mut record = |row: Vec<(usize, f64)>, residual: f64, weight: f64| {
        for (i, a) in &row {
            gradient[*i] += weight * a * residual;
            for (j, b) in &row {
                dense[(*i, *j)] += weight * a * b;
            }
        }
    };
    for round in 0..60 {
        let t = round % n;
        let frame: Vec<(usize, f64)> = (0..d).map(|c| (c, next())).collect();
        // The first frames do not see the last unknowns.
        let shared: Vec<(usize, f64)> = (0..s - 3 + t).map(|c| (c, next())).collect();
        let residual = next();
        normal.add(t, &frame, &shared, residual, 0.7);
        let whole = frame.iter().map(|(c, v)| (t * d + c, *v)).chain(shared.iter().map(|(c, v)| (n * d + c, *v)));
        record(whole.collect(), residual, 0.7);
        if t + 1 < n {
            let other: Vec<(usize, f64)> = (0..d).map(|c| (c, next())).collect();
            normal.add_pair(t, &frame, &other, residual, 1.3);
            let pair =
                frame.iter().map(|(c, v)| (t * d + c, *v)).chain(other.iter().map(|(c, v)| ((t + 1) * d + c, *v)));
            record(pair.collect(), residual, 1.3);
        }
    }
    // All frames' second and third unknowns move alike.
    let (h, g) = normal.where_all_frames_move(1..3);
    let mut alike = nalgebra::DMatrix::<f64>::zeros(size, 2 + s);
    (0..n).for_each(|t| (0..2).for_each(|c| alike[(t * d + 1 + c, c)] = 1.0));
    (0..s).for_each(|c| alike[(n * d + c, 2 + c)] = 1.0);
    assert!((alike.transpose() * &dense * &alike - h).amax() < 1e-9);
    assert!((alike.transpose() * &gradient - g).amax() < 1e-9);
    let expected = -dense.lu().solve(&gradient).unwrap();
    let step = normal.solve(0.0).unwrap();
    for (i, found) in step.frames.iter().chain(&step.shared).enumerate() {
        assert!((found - expected[i]).abs() < 1e-6, "{i}: {found} and {}", expected[i]);
    }
}

#[test]
fn masks_tell_the_girth() {
    let body = Body::test_body();
    let how = Difficulty { frames: 12, masks: true, betas: vec![0.2, 1.0, 0.3], seed: 12, ..Difficulty::default() };
    let clip = clip(&body, &how);
    let result = solve(&body, &clip.capture, &Stage0Options::default(), &mut |_| true).unwrap();
    let errors = errors(&body, &clip, &result);
    // Masks may be of clothes, so the fit stays on the slim side.
    assert!((0.4..1.1).contains(&result.betas[1]), "{:?}", result.betas);
    assert!(result.report.mask_iou > 0.9, "{}", result.report.mask_iou);
    assert!(errors.scaled < 0.02, "{errors:?}");
}

#[test]
fn feet_that_step_are_found_and_standing_ones_stand() {
    let body = Body::test_body();
    for step_degrees in [0.0, 22.0] {
        let how = Difficulty { frames: 36, masks: true, step_degrees, seed: 21, ..Difficulty::default() };
        let clip = clip(&body, &how);
        let result = solve(&body, &clip.capture, &Stage0Options::default(), &mut |_| true).unwrap();
        let knees: Vec<(f64, f64)> = clip
            .poses
            .iter()
            .zip(&result.poses)
            .flat_map(|(truth, found)| [4, 5].map(|knee| (truth.theta[knee].x, f64::from(found[3 * knee]))))
            .collect();
        let off = |bent: bool| {
            let those: Vec<f64> =
                knees.iter().filter(|(truth, _)| (*truth > 0.4) == bent).map(|(a, b)| (a - b).abs()).collect();
            those.iter().sum::<f64>() / those.len().max(1) as f64
        };
        let errors = errors(&body, &clip, &result);
        eprintln!("{step_degrees} {errors:?} {} {}", off(true), off(false));
        assert!(off(false) < 0.06, "{step_degrees}°: knees that stand are off by {}", off(false));
        assert!(off(true) < 0.25, "{step_degrees}°: knees that step are off by {}", off(true));
        assert!(errors.scaled < 0.02, "{step_degrees}°: {errors:?}");
    }
}

#[test]
fn detections_whose_errors_last_are_trusted_less() {
    let body = Body::test_body();
    let white = Difficulty { noise_px: 3.0, masks: true, painted: true, seed: 31, ..Difficulty::default() };
    let lasting = Difficulty { noise_px: 0.5, lasting_px: 4.0, ..white.clone() };
    let [white, lasting] = [white, lasting].map(|how| {
        let clip = clip(&body, &how);
        let result = solve(&body, &clip.capture, &Stage0Options::default(), &mut |_| true).unwrap();
        (result.report.sigma_px, errors(&body, &clip, &result))
    });
    eprintln!("white {white:?} lasting {lasting:?}");
    assert!((2.0..4.0).contains(&white.0), "{white:?}");
    assert!(lasting.0 > 5.0, "{lasting:?}");
    // 15 mm and 3.5° where they are taken for new in each frame.
    assert!(lasting.1.scaled < 0.0125 && lasting.1.facing_degrees < 2.7, "{lasting:?}");
}

/// People sway about a stance where detections tell little; arms that swing are no sway.
#[test]
fn arms_that_swing_before_a_detector_whose_errors_last() {
    let body = Body::test_body();
    let how = Difficulty {
        noise_px: 0.5,
        lasting_px: 4.0,
        swing_degrees: 30.0,
        masks: true,
        painted: true,
        seed: 32,
        ..Difficulty::default()
    };
    let clip = clip(&body, &how);
    let result = solve(&body, &clip.capture, &Stage0Options::default(), &mut |_| true).unwrap();
    let errors = errors(&body, &clip, &result);
    assert!(result.report.sigma_px > 5.0, "no lasting errors were found: {}", result.report.sigma_px);
    assert!(errors.scaled < 0.02 && errors.facing_degrees < 3.0, "{errors:?}");
}

#[test]
fn a_measured_height_sets_the_size() {
    let body = Body::test_body();
    let how = Difficulty { frames: 12, betas: vec![1.8, 0.0, 0.2], seed: 14, ..Difficulty::default() };
    let clip = clip(&body, &how);
    let shaped = body.shaped_vertices(&[1.8, 0.0, 0.2]);
    let ys = || shaped.iter().map(|v| f64::from(v[1]));
    let height_m = Some(ys().fold(f64::MIN, f64::max) - ys().fold(f64::MAX, f64::min));
    let options = Stage0Options { use_masks: false, height_m, ..Stage0Options::default() };
    let result = solve(&body, &clip.capture, &options, &mut |_| true).unwrap();
    let errors = errors(&body, &clip, &result);
    assert!(errors.joints < 0.035, "{errors:?} {:?}", result.betas);
}

#[test]
fn distances_to_a_disc() {
    let grid = Grid { origin: DVec2::new(-3.0, 5.0), step: 2.0, width: 60, height: 50 };
    let middle = DVec2::new(55.0, 52.0);
    let cells = (0..50 * 60).map(|i| grid.centre(i % 60, i / 60).distance(middle) < 20.0);
    let field = Field::new(grid, &cells.collect::<Vec<_>>()).unwrap();
    for place in [DVec2::new(55.0, 52.0), DVec2::new(80.0, 60.0), DVec2::new(40.0, 41.0), DVec2::new(30.0, 80.0)] {
        let (expected, found) = (place.distance(middle) - 20.0, field.at(place).unwrap());
        assert!((found - expected).abs() < 1.5, "{place}: {found} and {expected}");
    }
    let (_, normal) = field.slope(DVec2::new(80.0, 52.0)).unwrap();
    assert!(normal.dot(DVec2::X) > 0.99, "{normal}");
    assert!(Field::new(grid, &[true; 50 * 60]).is_none());
}

#[test]
fn frames_without_points_are_bridged() {
    let body = Body::test_body();
    let mut clip = clip(&body, &Difficulty { seed: 15, ..Difficulty::default() });
    for frame in &mut clip.capture.frames[11..14] {
        frame.keypoints.iter_mut().for_each(|k| *k = [0.0; 3]);
    }
    let options = Stage0Options { use_masks: false, ..Stage0Options::default() };
    let result = solve(&body, &clip.capture, &options, &mut |_| true).unwrap();
    let errors = errors(&body, &clip, &result);
    assert!(errors.scaled < 0.025 && errors.facing_degrees < 12.0, "{errors:?}");
    assert!(result.report.residual_px[12].is_nan());
}

#[test]
fn a_single_frame() {
    let how = Difficulty { frames: 1, start_degrees: 20.0, dropped: 0.0, seed: 16, ..Difficulty::default() };
    let (_, _, errors) = solved(&how);
    assert!(errors.scaled < 0.06 && errors.facing_degrees < 25.0, "{errors:?}");
}

#[test]
fn a_camera_that_looks_down() {
    recovers(&Difficulty { pitch_degrees: 15.0, seed: 17, ..Difficulty::default() }, 0.02, 6.0);
}

#[test]
fn hips_and_shoulders_that_are_not_where_the_joints_are() {
    recovers(&Difficulty { bias: 0.03, seed: 18, ..Difficulty::default() }, 0.025, 7.0);
}

#[test]
fn a_detector_whose_habits_are_known() {
    let body = Body::test_body();
    let how =
        Difficulty { format: "body25", given: Some("mediapipe33"), noise_px: 1.0, seed: 19, ..Difficulty::default() };
    let mut clip = clip(&body, &how);
    let of = |clip: &Clip| {
        let result = solve(&body, &clip.capture, &Stage0Options::default(), &mut |_| true).unwrap();
        errors(&body, clip, &result)
    };
    let known = of(&clip);
    clip.capture.given_keypoint_format = "body25".to_owned();
    let unknown = of(&clip);
    assert!(known.scaled < 0.009 && known.scaled < 0.5 * unknown.scaled, "{known:?}, unknown {unknown:?}");
}

/// How far hips and shoulders were moved onto the body's own, mean, pixels.
fn moved_px(clip: &Clip, result: &Stage0Result) -> [f32; 2] {
    let of = |part: Part| {
        let points = [Side::Left, Side::Right].map(|side| index_of(&COCO17, (part, side)).unwrap());
        let mut moved = Vec::new();
        for (frame, understood) in clip.capture.frames.iter().zip(&result.keypoints) {
            for k in points.into_iter().filter(|&k| understood[k][2] > 0.0) {
                let ([x, y, _], [u, v, _]) = (frame.keypoints[k], understood[k]);
                moved.push((x - u).hypot(y - v));
            }
        }
        moved.iter().sum::<f32>() / moved.len() as f32
    };
    [of(Part::Hip), of(Part::Shoulder)]
}

#[test]
fn hips_and_shoulders_are_believed_where_they_are_the_joints() {
    for seed in 30..33 {
        let (clip, result, errors) = solved(&Difficulty { seed, ..Difficulty::default() });
        let moved = moved_px(&clip, &result);
        assert!(moved.iter().all(|px| *px < 0.6), "{moved:?} px of seed {seed}: {errors:?}");
        // 42 mm in the body are 11 px.
        let (clip, result, errors) = solved(&Difficulty { bias: 0.03, seed, ..Difficulty::default() });
        let moved = moved_px(&clip, &result);
        assert!(moved.iter().all(|px| *px > 4.0), "{moved:?} px of seed {seed}: {errors:?}");
    }
}

#[test]
fn a_detector_that_takes_backs_for_fronts() {
    let how =
        Difficulty { flat_confidence: true, swapped_backs: 1.0, face_through_head: true, ..Difficulty::default() };
    recovers(&Difficulty { seed: 19, ..how }, 0.025, 7.0);
}

#[test]
fn an_empty_clip_says_that_nobody_is_there() {
    let body = Body::test_body();
    let mut clip = clip(&body, &Difficulty { frames: 5, dropped: 1.0, ..Difficulty::default() });
    let options = Stage0Options::default();
    let error = solve(&body, &clip.capture, &options, &mut |_| true).unwrap_err();
    assert!(matches!(error, Stage0Error::NobodyFound), "{error}");
    clip.capture.frames[3].keypoints.pop();
    let error = solve(&body, &clip.capture, &options, &mut |_| true).unwrap_err();
    assert!(matches!(error, Stage0Error::KeypointCount { frame: 3, found: 16, expected: 17 }), "{error}");
}

#[test]
fn progress_grows_towards_the_end() {
    let body = Body::test_body();
    let clip = clip(&body, &Difficulty { frames: 6, masks: true, ..Difficulty::default() });
    let mut last = 0.0;
    let mut progress = |p: f32| {
        assert!(last < p && p <= 1.0, "{last} {p}");
        last = p;
        true
    };
    solve(&body, &clip.capture, &Stage0Options::default(), &mut progress).unwrap();
    assert!(last > 0.85, "{last}");
}

#[test]
fn a_stop_is_heard() {
    let body = Body::test_body();
    let clip = clip(&body, &Difficulty { frames: 6, ..Difficulty::default() });
    let mut calls = 0;
    let mut progress = |_| {
        calls += 1;
        calls < 3
    };
    let error = solve(&body, &clip.capture, &Stage0Options::default(), &mut progress).unwrap_err();
    assert!(matches!(error, Stage0Error::Stopped));
    assert_eq!(calls, 3);
}
