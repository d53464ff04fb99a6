//! Clips that come with poses: the fit keeps to them and finds the shape.

use glam::{DMat3, DVec3};

use super::noise;
use super::problem::{Problem, Scales};
use super::rotation;
use super::setup;
use super::state::{Frame, Layout, State, Step};
use super::trust::Given;
use super::{Candidate, GivenPoses, Stage0Error, Stage0Report};
use crate::body::{Body, N_JOINTS, N_POSE};
use crate::capture::{Capture, KnownPoses};

/// Steps of the search for a shift that all frames share, and its spread along the world's axes, metres: another
/// body's pelvis stands higher or lower at the origin, hardly to the side. Above all the distance is kept, since
/// it tells the person's size.
const SHIFT_STEPS: usize = 12;
const SHIFT_SIGMA: DVec3 = DVec3::new(0.002, 0.2, 0.002);
/// Geman–McClure's ρ there, in multiples of σ.
const SHIFT_RHO: f64 = 3.0;
/// Shifts below this are the fit's own business, metres.
const SHIFT_OF_NOTE: f64 = 0.03;

/// The clip with its poses as start and anchor.
pub fn candidate(
    body: &Body,
    capture: &Capture,
    known: &KnownPoses,
    report: &mut Stage0Report,
) -> Result<Candidate, Stage0Error> {
    let mut problem = setup::problem(body, capture)?;
    let n = capture.frames.len();
    if known.poses.len() != n || known.trans.len() != n {
        return Err(Stage0Error::PoseCount { found: known.poses.len().min(known.trans.len()), expected: n });
    }
    let mut shared = setup::mean_shape(problem.rig.n_betas());
    match &known.betas {
        Some(betas) if betas.len() == body.n_betas => {
            shared.betas.iter_mut().zip(betas).for_each(|(b, given)| *b = f64::from(*given));
        }
        Some(betas) => report.notes.push(format!(
            "poses: `betas` has {} numbers and this body {}: they are of another body and left out, the shape is found",
            betas.len(),
            body.n_betas
        )),
        None => {}
    }
    let rest_pelvis = if known.is_pelvis { DVec3::ZERO } else { problem.rig.rest_joints(&shared.betas)[0] };
    let to_camera = camera_rotation(capture);
    let camera_shift = DVec3::from_array(capture.camera.translation);
    let mut frames = Vec::with_capacity(n);
    for (t, (pose, trans)) in known.poses.iter().zip(&known.trans).enumerate() {
        if pose.len() != N_POSE {
            return Err(Stage0Error::PoseLength { frame: t, found: pose.len() });
        }
        let theta: [DVec3; N_JOINTS] =
            std::array::from_fn(|j| DVec3::from_array([0, 1, 2].map(|a| f64::from(pose[3 * j + a]))));
        let pelvis = DVec3::from_array(trans.map(f64::from)) + rest_pelvis;
        frames.push(Frame {
            root: to_camera * rotation::exp(theta[0]),
            pelvis: to_camera * pelvis + camera_shift,
            turn_rate: 0.0,
            step: [[0.0; 2]; 2],
            theta,
        });
    }
    let mut state = State { frames, shared };
    let mut scales = setup::rough_scales(&problem, &state);
    if !known.is_pelvis {
        let shift = common_shift(&problem, &state, &to_camera, &scales);
        if shift.length() > SHIFT_OF_NOTE {
            state.frames.iter_mut().for_each(|f| f.pelvis += shift);
            report.notes.push(format!(
                "poses: `trans` moved by {:.2} {:.2} {:.2} m (camera axes) to meet the keypoints: it seems to belong \
                 to a body with another pelvis",
                shift.x, shift.y, shift.z
            ));
        }
    }
    scales.sigma_px = noise::of_each_frame(&problem, &state, &scales);
    problem.given = Some(Given::new(state.frames.clone()));
    Ok(Candidate { problem, state, swapped: vec![[false; 3]; n], hidden: Vec::new(), scales, cost: f64::INFINITY })
}

/// Given poses whose joints are off by more than this in single frames, radians, are worse than those that are found without them
/// (docs/lab/poses.md, "Poses that are given").
pub const COARSE_POSES: f64 = 0.009;
/// Places that are off by more, metres, do not tell how far away the person is, and so how tall.
const LOOSE_PLACE: f64 = 0.05;
/// Unless these leave errors of so many times the keypoints' noise: who does not stand and turn is not found.
const NOT_FOUND: f64 = 1.5;

/// The given poses, or what `own` finds without them where that is better, and why. `own` is told the person's height, metres, where
/// the given places tell it.
pub(super) fn kept_or_replaced(
    given: Candidate,
    own: &mut dyn FnMut(Option<f64>) -> Result<Candidate, Stage0Error>,
) -> Result<(Candidate, Option<GivenPoses>), Stage0Error> {
    let Some(off) = given.problem.given.as_ref().map(|given| given.trust) else { return Ok((given, None)) };
    if off.joints <= COARSE_POSES {
        return Ok((given, Some(GivenPoses { off, replaced: false })));
    }
    let height = (off.place < LOOSE_PLACE).then(|| given.problem.stature.of(&given.state.shared.betas));
    match own(height) {
        Ok(found) if found.scales.sigma_px < NOT_FOUND * given.scales.sigma_px => {
            Ok((found, Some(GivenPoses { off, replaced: true })))
        }
        Ok(_) | Err(Stage0Error::NobodyFound) => Ok((given, Some(GivenPoses { off, replaced: false }))),
        Err(error) => Err(error),
    }
}

/// From the capture's world to its camera.
pub fn camera_rotation(capture: &Capture) -> DMat3 {
    DMat3::from_cols_array(&capture.camera.rotation).transpose()
}

/// A displacement in camera space that brings all frames nearer to their keypoints, found together with the shape: what a person of
/// other proportions has further from the pelvis must not pass for another pelvis.
fn common_shift(problem: &Problem, start: &State, to_camera: &DMat3, scales: &Scales) -> DVec3 {
    let scales = Scales { rho: SHIFT_RHO, ..*scales };
    let (layout, mut state) = (&problem.layout, start.clone());
    let certainty = *to_camera * DMat3::from_diagonal((SHIFT_SIGMA * SHIFT_SIGMA).recip()) * to_camera.transpose();
    let mut shift = DVec3::ZERO;
    for _ in 0..SHIFT_STEPS {
        let mut normal = problem.seen_alone(&state, &scales);
        problem.shared_prior(&state.shared, &scales, Some(&mut normal));
        let (mut h, mut g) = normal.where_all_frames_move(Layout::PELVIS..Layout::PELVIS + 3);
        let pulled = certainty * shift;
        for i in 0..3 {
            g[i] += pulled[i];
            (0..3).for_each(|j| h[(i, j)] += certainty.col(j)[i]);
        }
        let Some(factors) = h.cholesky() else { break };
        let step = -factors.solve(&g);
        let moved = DVec3::new(step[0], step[1], step[2]);
        shift += moved;
        let mut frames = vec![0.0; state.frames.len() * layout.n_frame];
        for frame in frames.chunks_exact_mut(layout.n_frame) {
            frame[Layout::PELVIS..Layout::PELVIS + 3].copy_from_slice(&moved.to_array());
        }
        state = state.stepped(layout, &Step { frames, shared: step.as_slice()[3..].to_vec() });
    }
    shift
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_pcg::Pcg32;

    use super::*;
    use crate::fit::stage0::synthetic::{Clip, Difficulty, clip, errors};
    use crate::fit::stage0::{Stage0Options, solve};
    use crate::math;

    /// A clip's true poses.
    fn known(clip: &Clip) -> KnownPoses {
        let numbers = |pose: &Frame| {
            let mut theta = pose.theta;
            theta[0] = rotation::log(pose.root);
            theta.iter().flat_map(|v| v.as_vec3().to_array()).collect::<Vec<f32>>()
        };
        KnownPoses {
            poses: clip.poses.iter().map(numbers).collect(),
            trans: clip.poses.iter().map(|p| p.pelvis.as_vec3().to_array()).collect(),
            is_pelvis: true,
            betas: None,
        }
    }

    #[test]
    fn given_poses_are_kept_and_give_the_shape() {
        let body = Body::test_body();
        let how = Difficulty { frames: 10, masks: true, betas: vec![0.1, 0.8, 0.9], seed: 13, ..Difficulty::default() };
        let mut clip = clip(&body, &how);
        clip.capture.poses = Some(known(&clip));
        let result = solve(&body, &clip.capture, &Stage0Options::default(), &mut |_| true).unwrap();
        let off = errors(&body, &clip, &result);
        assert!(off.joints < 0.015, "{off:?} {:?}", result.betas);
        assert!((0.4..0.9).contains(&result.betas[1]), "{:?}", result.betas);

        // `trans` of another body, whose pelvis stands 20 cm lower.
        let known = clip.capture.poses.as_mut().unwrap();
        known.is_pelvis = false;
        known.trans.iter_mut().for_each(|p| p[1] += 0.2);
        let result = solve(&body, &clip.capture, &Stage0Options::default(), &mut |_| true).unwrap();
        let off = errors(&body, &clip, &result);
        assert!(off.joints < 0.02, "{off:?} {:?}", result.report.notes);
        assert_eq!(result.report.notes.len(), 1, "{:?}", result.report.notes);

        // The shape of another body is told and not taken.
        let known = clip.capture.poses.as_mut().unwrap();
        known.trans.iter_mut().for_each(|p| p[1] -= 0.2);
        (known.is_pelvis, known.betas) = (true, Some(vec![9.0; 10]));
        let other = solve(&body, &clip.capture, &Stage0Options::default(), &mut |_| true).unwrap();
        assert!(other.report.notes[0].contains("`betas` has 10 numbers and this body 3"), "{:?}", other.report.notes);
        assert!((0.4..0.9).contains(&other.betas[1]), "{:?}", other.betas);

        clip.capture.poses.as_mut().unwrap().poses[4].pop();
        let error = solve(&body, &clip.capture, &Stage0Options::default(), &mut |_| true).unwrap_err();
        assert!(matches!(error, Stage0Error::PoseLength { frame: 4, found: 71 }), "{error}");
    }

    /// The true poses, each number of a joint off by its own error in each frame, and all frames' by a constant besides: 1σ, radians.
    fn known_but_for(clip: &Clip, each_frame: f32, all_frames: f32) -> KnownPoses {
        let mut rng = Pcg32::seed_from_u64(5);
        let mut normal = |sigma: f32| sigma * math::normal(&mut rng) as f32;
        let constants: Vec<f32> = (0..N_POSE).map(|_| normal(all_frames)).collect();
        let mut known = known(clip);
        for pose in &mut known.poses {
            for (angle, constant) in pose.iter_mut().zip(&constants).skip(3) {
                *angle += constant + normal(each_frame);
            }
        }
        known
    }

    #[test]
    fn given_poses_are_trusted_as_far_as_keypoints_bear_them_out() {
        let body = Body::test_body();
        let mut clip = clip(&body, &Difficulty { masks: true, seed: 13, ..Difficulty::default() });
        let own = solve(&body, &clip.capture, &Stage0Options::default(), &mut |_| true).unwrap();
        let own_errors = errors(&body, &clip, &own);
        assert_eq!(own.report.given_poses, None);
        let mut given = |each_frame, all_frames| {
            clip.capture.poses = Some(known_but_for(&clip, each_frame, all_frames));
            let result = solve(&body, &clip.capture, &Stage0Options::default(), &mut |_| true).unwrap();
            (result.report.given_poses.unwrap(), errors(&body, &clip, &result))
        };
        let (exact, exact_errors) = given(0.0, 0.0);
        let (another_body, _) = given(0.0, 0.05);
        let (rough, rough_errors) = given(0.06, 0.0);
        assert!(exact.off.joints < 0.006 && !exact.replaced, "{exact:?}");
        assert!(exact_errors.joints < 0.5 * own_errors.scaled, "{exact_errors:?}, {own_errors:?}");
        assert!(another_body.off.joints < COARSE_POSES && !another_body.replaced, "{another_body:?}");
        assert!((0.03..0.08).contains(&rough.off.joints) && rough.replaced, "{rough:?}");
        // Places tell the size.
        assert!(rough_errors.joints < 1.2 * own_errors.scaled, "{rough_errors:?}, {own_errors:?}");
    }

    #[test]
    fn rough_poses_are_kept_where_nothing_better_is_found() {
        let body = Body::test_body();
        let clip = clip(&body, &Difficulty { frames: 10, seed: 13, ..Difficulty::default() });
        let known = known_but_for(&clip, 0.06, 0.0);
        let start = || candidate(&body, &clip.capture, &known, &mut Stage0Report::default()).unwrap();
        for (noise, replaced) in [(1.0, true), (3.0, false)] {
            let mut own = |_| {
                let mut own = start();
                own.problem.given = None;
                own.scales.sigma_px *= noise;
                Ok(own)
            };
            let (best, found) = kept_or_replaced(start(), &mut own).unwrap();
            assert_eq!((found.unwrap().replaced, best.problem.given.is_none()), (replaced, replaced));
        }
        let (_, found) = kept_or_replaced(start(), &mut |_| Err(Stage0Error::NobodyFound)).unwrap();
        assert!(!found.unwrap().replaced);
    }

    #[test]
    fn somebody_tall_has_no_other_pelvis() {
        let body = Body::test_body();
        let mut clip =
            clip(&body, &Difficulty { frames: 10, masks: true, betas: vec![4.0], seed: 13, ..Difficulty::default() });
        clip.capture.poses = Some(KnownPoses { is_pelvis: false, ..known(&clip) });
        let result = solve(&body, &clip.capture, &Stage0Options::default(), &mut |_| true).unwrap();
        let errors = errors(&body, &clip, &result);
        assert!(errors.joints < 0.015, "{errors:?}");
        assert!(result.report.notes.is_empty(), "{:?}", result.report.notes);
    }
}
