//! Clips that come with poses: the fit keeps to them and finds the shape.

use glam::{DMat3, DMat4, DVec3};

use super::noise;
use super::problem::{Problem, geman_mcclure_share};
use super::rotation;
use super::setup;
use super::state::{Frame, State};
use super::{Candidate, Stage0Error, Stage0Report};
use crate::body::{Body, N_JOINTS, N_POSE};
use crate::capture::{Capture, KnownPoses};

/// Steps of the search for a shift that all frames share, and its spread along the world's axes, metres: another
/// body's pelvis stands higher or lower at the origin, hardly to the side. Above all the distance is kept, since
/// it tells the person's size.
const SHIFT_STEPS: usize = 12;
const SHIFT_SIGMA: DVec3 = DVec3::new(0.002, 0.2, 0.002);
/// How much larger or smaller than the mean a person is, log.
const GROWTH_SIGMA: f64 = 0.15;
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
        let shift = common_shift(&problem, &state, &to_camera, scales.sigma_px);
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
    problem.anchor = Some(state.frames.clone());
    Ok(Candidate { problem, state, swapped: vec![[false; 3]; n], hidden: Vec::new(), scales, cost: f64::INFINITY })
}

/// From the capture's world to its camera.
pub fn camera_rotation(capture: &Capture) -> DMat3 {
    DMat3::from_cols_array(&capture.camera.rotation).transpose()
}

/// A displacement in camera space that brings all frames nearer to their keypoints: Gauss–Newton with
/// Geman–McClure weights. The shape is still to be found, and what a person of another size has further from the pelvis must not
/// pass for another pelvis: so the body may grow about it meanwhile.
fn common_shift(problem: &Problem, start: &State, to_camera: &DMat3, sigma_px: f64) -> DVec3 {
    let mut state = start.clone();
    let (mut shift, mut growth) = (DVec3::ZERO, 0.0);
    let certainty = *to_camera * DMat3::from_diagonal((SHIFT_SIGMA * SHIFT_SIGMA).recip()) * to_camera.transpose();
    for _ in 0..SHIFT_STEPS {
        let mut h = DMat4::from_mat3(certainty);
        h.w_axis.w = GROWTH_SIGMA.powi(-2);
        let mut g = (certainty * shift).extend(growth * h.w_axis.w);
        for (t, frame) in state.frames.iter().enumerate() {
            let posed = problem.rig.pose(frame, &state.shared);
            for (k, seen) in problem.observations[t].iter().enumerate().filter(|(_, o)| o.weight > 0.0) {
                let from_pelvis = posed.place(&problem.points[k], &state.shared.betas, DVec3::ZERO) - frame.pelvis;
                let grown = from_pelvis * f64::exp(growth);
                let place = frame.pelvis + grown;
                let error = problem.camera.project(place) - seen.at;
                let share = geman_mcclure_share(error.length_squared() / (sigma_px * sigma_px), 3.0);
                let weight = seen.weight * share * share / (sigma_px * sigma_px);
                for (slope, residual) in problem.camera.slopes(place).into_iter().zip(error.to_array()) {
                    let slope = slope.extend(slope.dot(grown));
                    let row = slope * weight;
                    h += DMat4::from_cols(row * slope.x, row * slope.y, row * slope.z, row * slope.w);
                    g += row * residual;
                }
            }
        }
        let step = -(h.inverse() * g);
        shift += step.truncate();
        growth += step.w;
        state.frames.iter_mut().for_each(|f| f.pelvis += step.truncate());
    }
    shift
}
