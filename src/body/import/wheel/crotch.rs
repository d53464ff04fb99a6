//! Weights between the legs.
//!
//! MPFB gives the strip between the thighs to the pelvis (0.83 to 0.9) and what lies one or two centimetres beside it to the thighs
//! (0.35 to 0.6). When hips bend far with the legs apart, as on a chair, the strip stays behind and hangs between the thighs as a peg. Here
//! weights are diffused over the mesh until they pass evenly from one leg to the other.

use std::collections::BTreeSet;

use glam::Vec3;

use crate::body::import::prune_weights;
use crate::body::{Body, N_INFLUENCES, N_JOINTS};

/// Where: an ellipsoid below the pelvis joint, half axes in metres, outside of which weights stay from 1.3 times as far on.
const BELOW_PELVIS_M: f32 = 0.10;
const HALF_AXES_M: Vec3 = Vec3::new(0.09, 0.10, 0.14);
const FADES_UNTIL: f32 = 1.3;
/// Rounds of diffusion, and its largest step: ten leave a trace of the peg.
const ROUNDS: usize = 30;
const STEP: f64 = 0.7;

/// Diffuses the weights between the legs of a body in the zero pose.
pub(super) fn even_out(body: &mut Body) {
    let centre = Vec3::from(body.j_template[0]) - BELOW_PELVIS_M * Vec3::Y;
    let share = |vertex: &[f32; 3]| {
        let distance = ((Vec3::from(*vertex) - centre) / HALF_AXES_M).length();
        STEP * f64::from((FADES_UNTIL - distance).clamp(0.0, 1.0))
    };
    let shares: Vec<f64> = body.v_template.iter().map(share).collect();
    let mut neighbours = vec![BTreeSet::new(); shares.len()];
    for &[a, b, c] in &body.faces {
        for (v, others) in [(a, [b, c]), (b, [c, a]), (c, [a, b])] {
            neighbours[v as usize].extend(others);
        }
    }
    let mut dense: Vec<[f64; N_JOINTS]> = body.lbs_joints.iter().zip(&body.lbs_weights).map(spread).collect();
    let inside: Vec<usize> = (0..shares.len()).filter(|&v| shares[v] > 0.0).collect();
    for _ in 0..ROUNDS {
        let step = |&v: &usize| {
            let around = &neighbours[v];
            std::array::from_fn(|j| {
                let mean = around.iter().map(|&n| dense[n as usize][j]).sum::<f64>() / around.len().max(1) as f64;
                dense[v][j] + shares[v] * (mean - dense[v][j])
            })
        };
        let next: Vec<[f64; N_JOINTS]> = inside.iter().map(step).collect();
        inside.iter().zip(next).for_each(|(&v, weights)| dense[v] = weights);
    }
    for v in inside {
        (body.lbs_joints[v], body.lbs_weights[v]) = prune_weights(&dense[v]);
    }
}

/// A row of weights on all joints.
fn spread((joints, weights): (&[u32; N_INFLUENCES], &[f32; N_INFLUENCES])) -> [f64; N_JOINTS] {
    let mut row = [0.0; N_JOINTS];
    joints.iter().zip(weights).for_each(|(&joint, &weight)| row[joint as usize] += f64::from(weight));
    row
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::joints::{LEFT_HIP, PELVIS};

    #[test]
    fn weights_between_the_legs_pass_evenly_and_others_stay() {
        let mut body = Body::test_body();
        let crotch = Vec3::from(body.j_template[0]) - BELOW_PELVIS_M * Vec3::Y;
        let distance = |body: &Body, v: usize| ((Vec3::from(body.v_template[v]) - crotch) / HALF_AXES_M).length();
        let mut inside: Vec<usize> = (0..body.n_vertices()).filter(|&v| distance(&body, v) < FADES_UNTIL).collect();
        inside.sort_by(|&a, &b| distance(&body, a).total_cmp(&distance(&body, b)));
        assert!(inside.len() > 8, "the test body has {} vertices there", inside.len());
        // As the rig has it: one vertex follows the pelvis, its neighbours a thigh.
        for &v in &inside {
            body.lbs_joints[v] = [LEFT_HIP as u32, 0, 0, 0];
            body.lbs_weights[v] = [1.0, 0.0, 0.0, 0.0];
        }
        body.lbs_joints[inside[0]][0] = PELVIS as u32;
        let before = body.clone();
        even_out(&mut body);
        let of = |body: &Body, v: usize, joint: usize| {
            let row = body.lbs_joints[v].iter().zip(&body.lbs_weights[v]);
            row.filter(|(j, _)| **j == joint as u32).map(|(_, w)| *w).sum::<f32>()
        };
        assert!(of(&body, inside[0], LEFT_HIP) > 0.3, "{:?}", body.lbs_weights[inside[0]]);
        for v in 0..body.n_vertices() {
            assert!((body.lbs_weights[v].iter().sum::<f32>() - 1.0).abs() < 1e-5);
            if distance(&body, v) > FADES_UNTIL {
                assert_eq!(body.lbs_weights[v], before.lbs_weights[v]);
            }
        }
    }
}
