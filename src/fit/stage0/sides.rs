//! Reads the detections again in the light of the fit: which limbs have their sides swapped, and which points are wrong.

use glam::{DVec2, DVec3};

use super::landmarks::{GROUPS, Part};
use super::problem::{Problem, Scales};
use super::rig::Posed;
use super::state::State;
use crate::body::joints::{HEAD, SPINE3};

/// A swap must explain a group this much better (log-odds) before it is believed.
const MARGIN: f64 = 3.0;

/// From all landmarks to their detections, in pixels: `[N][K]`, none where nothing was seen.
pub fn errors(problem: &Problem, state: &State) -> Vec<Vec<Option<DVec2>>> {
    let camera = problem.camera.zoomed(state.shared.log_focal);
    let of_frame = |t: usize| {
        let posed = problem.rig.pose(&state.frames[t], &state.shared);
        let places = problem.landmarks_at(&posed, state, &camera);
        let error = |k: usize| {
            let seen = &problem.observations[t][k];
            (seen.weight > 0.0).then(|| seen.at - places[k])
        };
        (0..places.len()).map(error).collect()
    };
    (0..state.frames.len()).map(of_frame).collect()
}

/// Lengths of [`errors`]: `[N][K]`, NaN where nothing was seen.
pub fn distances(problem: &Problem, state: &State) -> Vec<Vec<f64>> {
    let of_frame = |errors: Vec<Option<DVec2>>| errors.iter().map(|e| e.map_or(f64::NAN, DVec2::length)).collect();
    errors(problem, state).into_iter().map(of_frame).collect()
}

/// Swaps the detections of limbs (or of the face) that fit far better so. `swapped [N]`: the groups that differ
/// from the upload, kept up to date.
pub fn reread(problem: &mut Problem, state: &State, scales: &Scales, swapped: &mut [[bool; 3]]) {
    let camera = problem.camera.zoomed(state.shared.log_focal);
    let information = 1.0 / (scales.sigma_px * scales.sigma_px);
    let limit = scales.rho * scales.rho;
    for (t, flags) in swapped.iter_mut().enumerate() {
        let posed = problem.rig.pose(&state.frames[t], &state.shared);
        let places = problem.landmarks_at(&posed, state, &camera);
        for (g, group) in GROUPS.into_iter().enumerate() {
            let (mut kept, mut exchanged) = (0.0, 0.0);
            for (k, landmark) in problem.landmarks.iter().enumerate() {
                let seen = &problem.observations[t][k];
                if landmark.part.group() != group || landmark.side == 0.0 || seen.weight == 0.0 {
                    continue;
                }
                let cost = |at: usize| {
                    let q = seen.at.distance_squared(places[at]) * information;
                    0.5 * seen.weight * q * limit / (q + limit)
                };
                kept += cost(k);
                exchanged += cost(landmark.partner);
            }
            if exchanged + MARGIN < kept {
                swap_group(problem, t, g);
                flags[g] ^= true;
            }
        }
    }
}

/// Chest and head, which both look away where a face is hidden.
const FACING_JOINTS: [usize; 2] = [SPINE3, HEAD];
/// Cosine between where they look and where the camera is: from here on the head is in front of nose and eyes.
const HIDES_FACE: f64 = -0.3;

/// Whether a body is seen from behind, its head too.
pub fn hides_face(posed: &Posed) -> bool {
    FACING_JOINTS
        .into_iter()
        .all(|joint| (posed.rotations[joint] * DVec3::Z).dot(-posed.positions[joint].normalize_or_zero()) < HIDES_FACE)
}

/// Takes nose and eyes of heads that are seen from behind for unseen. Some detectors (MediaPipe's) guess them there, with the
/// same confidence as in front: they would nod the head. Frame, landmark and weight of each.
pub fn ignore_hidden_faces(problem: &mut Problem, state: &State) -> Vec<(usize, usize, f64)> {
    let mut hidden = Vec::new();
    for (t, frame) in state.frames.iter().enumerate() {
        if !hides_face(&problem.rig.pose(frame, &state.shared)) {
            continue;
        }
        for (k, (landmark, seen)) in problem.landmarks.iter().zip(&mut problem.observations[t]).enumerate() {
            if matches!(landmark.part, Part::Nose | Part::Eye) && seen.weight > 0.0 {
                hidden.push((t, k, std::mem::take(&mut seen.weight)));
            }
        }
    }
    hidden
}

/// Exchanges left and right detections of one group in one frame.
pub fn swap_group(problem: &mut Problem, t: usize, group: usize) {
    for (k, landmark) in problem.landmarks.iter().enumerate() {
        if landmark.part.group() == GROUPS[group] && landmark.side > 0.0 {
            problem.observations[t].swap(k, landmark.partner);
        }
    }
}
