//! From the solver's unknowns to the result.

use glam::DVec3;

use super::known::camera_rotation;
use super::landmarks::Landmark;
use super::{Candidate, Stage0Report, Stage0Result, rotation, sides};
use crate::body::{Body, N_POSE};
use crate::capture::Capture;

pub fn result(best: &Candidate, body: &Body, capture: &Capture, mut report: Stage0Report) -> Stage0Result {
    let state = &best.state;
    let to_world = camera_rotation(capture).transpose();
    let camera_shift = DVec3::from_array(capture.camera.translation);
    let rest_pelvis = best.problem.rig.rest_joints(&state.shared.betas)[0];
    let mut poses = Vec::with_capacity(state.frames.len());
    let mut transl = Vec::with_capacity(state.frames.len());
    let mut root = DVec3::ZERO;
    for frame in &state.frames {
        root = rotation::log_near(to_world * frame.root, root);
        let mut pose = [0.0; N_POSE];
        for (j, slot) in pose.chunks_exact_mut(3).enumerate() {
            let angles = if j == 0 { root } else { frame.theta[j] };
            slot.copy_from_slice(&angles.as_vec3().to_array());
        }
        poses.push(pose);
        transl.push((to_world * (frame.pelvis - camera_shift) - rest_pelvis).as_vec3().to_array());
    }
    let mut camera = capture.camera.clone();
    let zoomed = best.problem.camera.zoomed(state.shared.log_focal);
    if capture.camera_estimated {
        (camera.fx, camera.fy) = (zoomed.fx, zoomed.fy);
        report.notes.push(format!("the camera's focal length was estimated: {:.0} px", zoomed.fx));
    }
    describe(best, &mut report);
    let keypoints = understood(best, capture);
    let mut betas = vec![0.0; body.n_betas];
    betas.iter_mut().zip(&state.shared.betas).for_each(|(b, found)| *b = *found as f32);
    Stage0Result { betas, poses, transl, camera, keypoints, report }
}

/// See [`Stage0Result::keypoints`].
fn understood(best: &Candidate, capture: &Capture) -> Vec<Vec<[f32; 3]>> {
    let Candidate { problem, state, .. } = best;
    let camera = problem.camera.zoomed(state.shared.log_focal);
    let mut bare = state.clone();
    bare.shared.offsets.fill(DVec3::ZERO);
    let limit = best.scales.rho * best.scales.sigma_px;
    let of_frame = |(t, frame): (usize, &crate::capture::Frame)| {
        let posed = problem.rig.pose(&state.frames[t], &state.shared);
        let found = problem.landmarks_at(&posed, state, &camera);
        let own = problem.landmarks_at(&posed, &bare, &camera);
        let read = |(k, landmark): (usize, &Landmark)| {
            let seen = &problem.observations[t][k];
            let as_given = if best.swapped[t][landmark.part.group() as usize] { landmark.partner } else { k };
            let believed = seen.weight > 0.0 && seen.at.distance(found[k]) <= limit;
            let [x, y] = (seen.at + own[k] - found[k]).as_vec2().to_array();
            [x, y, if believed { frame.keypoints[as_given][2] } else { 0.0 }]
        };
        problem.landmarks.iter().enumerate().map(read).collect()
    };
    capture.frames.iter().enumerate().map(of_frame).collect()
}

fn describe(best: &Candidate, report: &mut Stage0Report) {
    let limit = best.scales.rho * best.scales.sigma_px;
    report.sigma_px = best.scales.sigma_px as f32;
    for (t, distances) in sides::distances(&best.problem, &best.state).iter().enumerate() {
        let (mut sum, mut count) = (0.0, 0);
        for (k, distance) in distances.iter().enumerate().filter(|(_, d)| d.is_finite()) {
            if *distance > limit {
                let landmark = &best.problem.landmarks[k];
                let group = landmark.part.group() as usize;
                let as_given = if best.swapped[t][group] { landmark.partner } else { k };
                report.dropped.push((t, as_given));
            } else {
                sum += distance * distance;
                count += 1;
            }
        }
        report.residual_px.push((sum / f64::from(count)).sqrt() as f32);
    }
    report.swapped = (0..best.swapped.len()).filter(|t| best.swapped[*t].contains(&true)).collect();
    let turn = |pair: &[super::state::Frame]| rotation::log(pair[0].root.transpose() * pair[1].root).y;
    report.turn_degrees = best.state.frames.windows(2).map(turn).sum::<f64>().to_degrees() as f32;
    let stature = &best.problem.stature;
    let guessed = best.problem.given.is_none() && !stature.is_measured();
    report.guessed_height_m = guessed.then(|| stature.of(&best.state.shared.betas));
    if !report.swapped.is_empty() {
        report.notes.push(format!("left and right were swapped in {} frames", report.swapped.len()));
    }
    if best.problem.given.is_none() && report.turn_degrees.abs() < 180.0 {
        report.notes.push(format!("the person turns by {:.0}° only: unseen sides are guessed", report.turn_degrees));
    }
}
