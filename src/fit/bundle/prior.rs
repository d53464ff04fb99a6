//! What is expected of a correction: little, alike in neighbouring frames, and of the surface smooth.

use super::kinematics::{N_DOF, PLACE};
use crate::body::joints::{
    LEFT_ANKLE, LEFT_COLLAR, LEFT_ELBOW, LEFT_FOOT, LEFT_HAND, LEFT_HIP, LEFT_KNEE, LEFT_WRIST, PELVIS, RIGHT_ANKLE,
    RIGHT_COLLAR, RIGHT_ELBOW, RIGHT_FOOT, RIGHT_HAND, RIGHT_HIP, RIGHT_KNEE, RIGHT_WRIST,
};
use crate::ops::Topology;
use crate::ops::topology::Rows;

/// Usual corrections: of the root's turn and of joints, radians; of the place, metres.
const ROOT: f64 = 0.05;
const JOINT: f64 = 0.03;
const PLACE_M: f64 = 0.05;
/// Of what hinges do not do, of the twist of legs, of collars.
const HINGE: f64 = 0.005;
const TWIST: f64 = 0.01;
const COLLAR: f64 = 0.015;
/// Of how corrections bend from frame to frame where a turn has [`FRAMES`] or more: radians and metres a frame².
const BEND: f64 = 0.003;
const PLACE_BEND_M: f64 = 0.002;
const FRAMES: f64 = 60.0;
/// Of a joint's mean correction over the clip: what poses have in common the surface has, too, and there is no telling them apart.
const MEAN: f64 = 0.0005;
/// How far the surface is usually moved along its normals, and how far from the sum of its neighbours' less its own, metres.
const RAISED_M: f64 = 0.01;
const UNEVEN_M: f64 = 0.003;

/// Precisions.
pub struct Prior {
    n_frames: usize,
    neighbours: Rows,
    /// `[N_DOF]`: zero where a number stands.
    still: Vec<f64>,
    bend: Vec<f64>,
    mean: Vec<f64>,
}

impl Prior {
    /// Of a clip that shows so many frames of a turn.
    pub fn new(n_frames: usize, frames_a_turn: f64, topology: &Topology) -> Self {
        let precision = |sigma: f64| if sigma > 0.0 { sigma.powi(-2) } else { 0.0 };
        // The same motion bends by the square of the time between frames.
        let apart = (FRAMES / frames_a_turn.clamp(1.0, FRAMES)).powi(2);
        let joints = || (0..PLACE).map(|dof| (dof / 3, spread(dof / 3, dof % 3)));
        let (mut still, mut bend, mut mean): (Vec<f64>, Vec<f64>, Vec<f64>) = (Vec::new(), Vec::new(), Vec::new());
        for (joint, sigma) in joints() {
            still.push(precision(sigma));
            bend.push(precision(BEND * apart));
            mean.push(if joint == PELVIS { 0.0 } else { precision(MEAN) });
        }
        still.extend([precision(PLACE_M); 3]);
        bend.extend([precision(PLACE_BEND_M * apart); 3]);
        mean.extend([0.0; 3]);
        Self { n_frames, neighbours: topology.neighbours.clone(), still, bend, mean }
    }

    /// Sets to zero what belongs to numbers that stand.
    pub fn hold(&self, vector: &mut [f64]) {
        for frame in vector[..self.n_frames * N_DOF].chunks_exact_mut(N_DOF) {
            frame.iter_mut().zip(&self.still).filter(|(_, still)| **still == 0.0).for_each(|(value, _)| *value = 0.0);
        }
    }

    /// The precision matrix by `step`.
    pub fn times(&self, step: &[f64]) -> Vec<f64> {
        let n = self.n_frames;
        let mut product = vec![0.0; step.len()];
        for dof in 0..N_DOF {
            let of = |t: usize| step[t * N_DOF + dof];
            let mean = (0..n).map(of).sum::<f64>() / n.max(1) as f64;
            for t in 0..n {
                product[t * N_DOF + dof] += self.still[dof] * of(t) + self.mean[dof] * mean;
            }
            for t in 1..n.saturating_sub(1) {
                let bent = self.bend[dof] * (of(t - 1) - 2.0 * of(t) + of(t + 1));
                product[(t - 1) * N_DOF + dof] += bent;
                product[t * N_DOF + dof] -= 2.0 * bent;
                product[(t + 1) * N_DOF + dof] += bent;
            }
        }
        let (raised, of_raised) = (&step[n * N_DOF..], &mut product[n * N_DOF..]);
        let uneven: Vec<f64> = (self.neighbours.iter().zip(raised))
            .map(|(around, own)| {
                around.iter().map(|&other| own - raised[other as usize]).sum::<f64>() / UNEVEN_M.powi(2)
            })
            .collect();
        for ((v, around), uneven) in self.neighbours.iter().enumerate().zip(&uneven) {
            of_raised[v] += raised[v] / RAISED_M.powi(2) + around.len() as f64 * uneven;
            around.iter().for_each(|&other| of_raised[other as usize] -= uneven);
        }
        product
    }

    /// Of the precision matrix, and 1 for numbers that stand.
    pub fn diagonal(&self) -> Vec<f64> {
        let n = self.n_frames;
        let frame = |t: usize| {
            // A frame has a part in as many bends as there are with it, with 1, −2 and 1.
            let bends = (1..n.saturating_sub(1)).filter(|&m| m.abs_diff(t) <= 1);
            let squares: f64 = bends.map(|m| if m == t { 4.0 } else { 1.0 }).sum();
            (0..N_DOF).map(move |dof| match self.still[dof] {
                0.0 => 1.0,
                still => still + squares * self.bend[dof] + self.mean[dof] / n as f64,
            })
        };
        let mut diagonal: Vec<f64> = (0..n).flat_map(frame).collect();
        let raised = |around: &[u32]| {
            let degree = around.len() as f64;
            RAISED_M.powi(-2) + (degree * degree + degree) / UNEVEN_M.powi(2)
        };
        diagonal.extend(self.neighbours.iter().map(raised));
        diagonal
    }
}

/// The usual correction of a joint about one of its axes, radians; 0 for what no picture tells of.
fn spread(joint: usize, axis: usize) -> f64 {
    match joint {
        PELVIS => ROOT,
        LEFT_FOOT | RIGHT_FOOT | LEFT_WRIST | RIGHT_WRIST | LEFT_HAND | RIGHT_HAND => 0.0,
        LEFT_KNEE | RIGHT_KNEE if axis != 0 => HINGE,
        LEFT_ELBOW | RIGHT_ELBOW if axis != 1 => HINGE,
        LEFT_HIP | RIGHT_HIP | LEFT_ANKLE | RIGHT_ANKLE if axis == 1 => TWIST,
        LEFT_COLLAR | RIGHT_COLLAR => COLLAR,
        _ => JOINT,
    }
}
