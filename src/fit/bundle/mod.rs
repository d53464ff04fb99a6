//! Bundle adjustment with the pictures themselves (Delaunoy and Pollefeys 2014, "Photometric Bundle Adjustment for Dense Multi-View
//! 3D Modeling"), after stage 2. Not in the paper.
//!
//! What is wrong with poses by then is slow: where a person faces, how the trunk is twisted, how far a leg swings, and the surface is
//! bent to go with it. To get out of that, all poses and the surface must move together, by a little each: Adam, which scales each number's
//! step by its own gradients, hardly moves along such a valley (docs/lab/bundle.md). Newton's method sees it. Here Gauss and Newton's
//! steps are taken for poses and places of all frames and the surface along its normals at once, by what the pictures have of the
//! surface's points and by outlines. How a point looks is not an unknown: it is the mean of how the frames show it.

mod kinematics;
mod looks;
mod normal;
mod prior;
#[cfg(test)]
mod tests;
mod view;

use glam::DVec3;
use rayon::prelude::*;

use self::kinematics::{N_DOF, PLACE};
use self::looks::Looks;
use self::normal::Normal;
use self::prior::Prior;
use self::view::View;
use super::stage0::rotation;
use super::{FitError, FitState, Inputs, motion};
use crate::body::{Body, N_JOINTS, N_POSE};
use crate::camera::Camera;
use crate::ops::skinning::cpu::{Posed, forward};
use crate::ops::{Topology, face_normals, light};

/// Steps of Gauss and Newton, and iterations of conjugate gradients for each.
const STEPS: usize = 5;
const ITERATIONS: usize = 150;
/// No number goes further in a step: radians, metres.
const MOST_TURN: f64 = 0.03;
const MOST_WAY_M: f64 = 0.03;
const MOST_RAISED_M: f64 = 0.005;

/// Adjusts poses, places and the surface of `state` to all frames at once, and says whether anything moved; asks `go_on` now and then.
/// Poses that are known stay as they are.
///
/// # Errors
/// [`FitError::Stopped`] where `go_on` says so; `state` is then what the last step made of it.
pub fn adjust(inputs: &Inputs<'_>, state: &mut FitState, go_on: &mut dyn FnMut() -> bool) -> Result<bool, FitError> {
    let Inputs { body, capture, camera, config } = *inputs;
    if config.held.is_some() || capture.frames.is_empty() {
        return Ok(false);
    }
    let n = capture.frames.len();
    let cameras: Vec<Camera> =
        capture.frames.iter().map(|f| camera.cropped(f.x0 as i32, f.y0 as i32, f.width, f.height)).collect();
    let depth = |t: &[f32]| camera.view([0, 1, 2].map(|axis| t[axis].into()))[2];
    let metre = camera.fx * n as f64 / state.transl.chunks_exact(3).map(depth).sum::<f64>();
    let looks: Vec<Looks> = capture.frames.par_iter().map(|frame| Looks::of(frame, metre)).collect();
    let normals = normals(body, &surface(body, state));
    let frames_a_turn = f64::from(motion::frames_in(1.0, &state.poses));
    let prior = Prior::new(n, frames_a_turn, &Topology::new(body.n_vertices(), &body.faces));
    let mut correction = vec![0.0; n * N_DOF + body.n_vertices()];
    let (mut spreads, mut best, mut moved) = (None, None::<(f64, FitState)>, false);
    for step in 0..=STEPS {
        if !go_on() {
            return Err(FitError::Stopped);
        }
        let views = views(body, state, &cameras, &looks, &normals);
        let normal = Normal::new(body, &views, &prior, &mut spreads);
        let cost = spreads.as_ref().map_or(f64::INFINITY, |spreads| normal.cost(&correction, spreads));
        tracing::debug!(step, cost, "bundle adjustment");
        if best.as_ref().is_some_and(|(least, _)| cost >= *least) || !cost.is_finite() {
            break;
        }
        moved = step > 0;
        best = Some((cost, state.clone()));
        if step < STEPS {
            let mut found = normal.solve(&correction, ITERATIONS, go_on).ok_or(FitError::Stopped)?;
            limit(&mut found, n);
            apply(state, &found, &normals);
            correction.iter_mut().zip(&found).for_each(|(sum, step)| *sum += step);
        }
    }
    if let Some((_, best)) = best {
        *state = best;
    }
    Ok(moved)
}

/// `[V]`: the shaped and dressed T-pose.
fn surface(body: &Body, state: &FitState) -> Vec<DVec3> {
    let offsets = state.offsets.as_chunks::<3>().0;
    let shaped = body.shaped_vertices(&state.betas);
    shaped.iter().zip(offsets).map(|(v, d)| DVec3::from([0, 1, 2].map(|axis| f64::from(v[axis] + d[axis])))).collect()
}

/// `[V]`, of length one.
fn normals(body: &Body, vertices: &[DVec3]) -> Vec<DVec3> {
    let vertices: Vec<[f64; 3]> = vertices.iter().map(DVec3::to_array).collect();
    let of_faces = face_normals::cpu::forward(&body.faces, &vertices).concat();
    let normals = light::cpu::vertex_normals(&body.faces, &of_faces, vertices.len());
    normals.chunks_exact(3).map(DVec3::from_slice).collect()
}

fn posed(body: &Body, state: &FitState, frame: usize) -> (Posed<f32>, [f32; 3]) {
    let transl = state.transl.as_chunks::<3>().0[frame];
    let pose = &state.poses[frame * N_POSE..][..N_POSE];
    (forward(body, &state.betas, Some(state.offsets.as_chunks::<3>().0), pose, transl), transl)
}

fn views<'a>(
    body: &'a Body,
    state: &FitState,
    cameras: &[Camera],
    looks: &[Looks],
    normals: &[DVec3],
) -> Vec<View<'a>> {
    let view = |(frame, (camera, looks)): (usize, (&Camera, &Looks))| {
        let (posed, transl) = posed(body, state, frame);
        View::new(body, &posed, transl, camera, looks, normals)
    };
    cameras.par_iter().zip(looks).enumerate().map(view).collect()
}

fn limit(step: &mut [f64], n_frames: usize) {
    let (frames, raised) = step.split_at_mut(n_frames * N_DOF);
    for frame in frames.chunks_exact_mut(N_DOF) {
        frame[..PLACE].iter_mut().for_each(|turn| *turn = turn.clamp(-MOST_TURN, MOST_TURN));
        frame[PLACE..].iter_mut().for_each(|way| *way = way.clamp(-MOST_WAY_M, MOST_WAY_M));
    }
    raised.iter_mut().for_each(|raised| *raised = raised.clamp(-MOST_RAISED_M, MOST_RAISED_M));
}

fn apply(state: &mut FitState, step: &[f64], normals: &[DVec3]) {
    let n = state.n_frames();
    for (t, step) in step[..n * N_DOF].chunks_exact(N_DOF).enumerate() {
        for joint in 0..N_JOINTS {
            let numbers = &mut state.poses[t * N_POSE + 3 * joint..][..3];
            let angles = DVec3::from([0, 1, 2].map(|axis| f64::from(numbers[axis])));
            let turned = rotation::exp(angles) * rotation::exp(DVec3::from_slice(&step[3 * joint..]));
            let after = rotation::log_near(turned, angles).as_vec3().to_array();
            numbers.copy_from_slice(&after);
        }
        let place = &mut state.transl[3 * t..][..3];
        place.iter_mut().zip(&step[PLACE..]).for_each(|(place, way)| *place += *way as f32);
    }
    let raised = step[n * N_DOF..].iter().zip(normals).map(|(raised, normal)| (*raised * *normal).as_vec3());
    for (offset, raised) in state.offsets.as_chunks_mut::<3>().0.iter_mut().zip(raised) {
        offset.iter_mut().zip(raised.to_array()).for_each(|(offset, raised)| *offset += raised);
    }
}
