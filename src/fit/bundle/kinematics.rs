//! How the vertices of one frame move with its unknowns, to first order, and what forces on them do to these.

use glam::{DMat3, DVec3};

use crate::body::{Body, N_JOINTS};
use crate::ops::skinning::cpu::{Posed, Transform};

/// Unknowns of a frame: turns of the joints about the axes of their own frames, on top of what they are turned by; then the place.
pub const N_DOF: usize = 3 * N_JOINTS + 3;
pub const PLACE: usize = 3 * N_JOINTS;

/// A posed body, linearised. Pose blend shapes are taken to stand.
pub struct Kinematics<'a> {
    body: &'a Body,
    /// `[24]`: T-pose to world
    bones: Vec<(DMat3, DVec3)>,
    /// `[24]`, world
    centres: Vec<DVec3>,
    /// `[V]`, T-pose
    rest: Vec<DVec3>,
    /// `[V]`: where a vertex goes that is raised by a metre, world
    outwards: Vec<DVec3>,
}

impl<'a> Kinematics<'a> {
    /// `normals [V]` of the T-pose are where vertices are raised to.
    pub fn new(body: &'a Body, posed: &Posed<f32>, transl: [f32; 3], normals: &[DVec3]) -> Self {
        let vector = |v: [f32; 3]| DVec3::from(v.map(f64::from));
        let bone = |Transform { rotation, translation }: &Transform<f32>| {
            let rotation = DMat3::from_cols(vector(rotation[0]), vector(rotation[1]), vector(rotation[2])).transpose();
            (rotation, vector(*translation) + vector(transl))
        };
        let bones: Vec<(DMat3, DVec3)> = posed.transforms.iter().map(bone).collect();
        let outwards = normals
            .iter()
            .enumerate()
            .map(|(v, normal)| influences(body, v).map(|(k, weight)| weight * (bones[k].0 * *normal)).sum());
        Self {
            body,
            outwards: outwards.collect(),
            centres: posed.joints.iter().map(|&j| vector(j)).collect(),
            rest: posed.v_posed.iter().map(|&v| vector(v)).collect(),
            bones,
        }
    }

    /// `[V]`: how vertices move by a step of the frame's unknowns `[N_DOF]` and of what all frames share, `raised [V]`.
    pub fn velocities(&self, step: &[f64], raised: &[f64]) -> Vec<DVec3> {
        // Bone k moves by spin × x + drift.
        let (mut spins, mut drifts) = ([DVec3::ZERO; N_JOINTS], [DVec3::ZERO; N_JOINTS]);
        for j in 0..N_JOINTS {
            let turn = self.bones[j].0 * DVec3::from_slice(&step[3 * j..]);
            let [spin, drift] = match usize::try_from(self.body.parents[j]) {
                Ok(parent) => [spins[parent], drifts[parent]],
                Err(_) => [DVec3::ZERO, DVec3::from_slice(&step[PLACE..])],
            };
            (spins[j], drifts[j]) = (spin + turn, drift - turn.cross(self.centres[j]));
        }
        let moving = |v: usize| -> DVec3 {
            let by_bones: DVec3 = influences(self.body, v)
                .map(|(k, weight)| weight * (spins[k].cross(self.by_bone(k, v)) + drifts[k]))
                .sum();
            by_bones + raised[v] * self.outwards[v]
        };
        (0..self.rest.len()).map(moving).collect()
    }

    /// The transpose of [`Self::velocities`]: adds what `forces [V]` do to the frame's unknowns and to what all frames share.
    pub fn pull_back(&self, forces: &[DVec3], step: &mut [f64], raised: &mut [f64]) {
        let (mut pulls, mut torques) = ([DVec3::ZERO; N_JOINTS], [DVec3::ZERO; N_JOINTS]);
        for (v, &force) in forces.iter().enumerate().filter(|(_, force)| **force != DVec3::ZERO) {
            for (k, weight) in influences(self.body, v) {
                pulls[k] += weight * force;
                torques[k] += weight * self.by_bone(k, v).cross(force);
            }
            raised[v] += force.dot(self.outwards[v]);
        }
        for j in (0..N_JOINTS).rev() {
            let turned = self.bones[j].0.transpose() * (torques[j] - self.centres[j].cross(pulls[j]));
            (0..3).for_each(|axis| step[3 * j + axis] += turned[axis]);
            match usize::try_from(self.body.parents[j]) {
                Ok(parent) => {
                    pulls[parent] += pulls[j];
                    torques[parent] += torques[j];
                }
                Err(_) => (0..3).for_each(|axis| step[PLACE + axis] += pulls[j][axis]),
            }
        }
    }

    /// Adds, times `weight`, the squares of what [`Self::pull_back`] makes of the force `slope` on a point between three vertices.
    pub fn add_squares(
        &self,
        corners: [u32; 3],
        bary: [f64; 3],
        slope: DVec3,
        weight: f64,
        step: &mut [f64],
        raised: &mut [f64],
    ) {
        let (mut pulls, mut torques) = ([0.0; N_JOINTS], [DVec3::ZERO; N_JOINTS]);
        for (v, bary) in corners.map(|v| v as usize).into_iter().zip(bary) {
            for (k, part) in influences(self.body, v) {
                pulls[k] += bary * part;
                torques[k] += bary * part * self.by_bone(k, v);
            }
            raised[v] += weight * (bary * slope.dot(self.outwards[v])).powi(2);
        }
        for j in (0..N_JOINTS).rev() {
            if pulls[j] == 0.0 {
                continue;
            }
            let turned = self.bones[j].0.transpose() * (torques[j] - pulls[j] * self.centres[j]).cross(slope);
            (0..3).for_each(|axis| step[3 * j + axis] += weight * turned[axis].powi(2));
            if let Ok(parent) = usize::try_from(self.body.parents[j]) {
                pulls[parent] += pulls[j];
                torques[parent] += torques[j];
            }
        }
        (0..3).for_each(|axis| step[PLACE + axis] += weight * slope[axis].powi(2));
    }

    /// Where bone `k` alone would take vertex `v`.
    fn by_bone(&self, k: usize, v: usize) -> DVec3 {
        self.bones[k].0 * self.rest[v] + self.bones[k].1
    }
}

/// The bones that move a vertex, and how much.
fn influences(body: &Body, v: usize) -> impl Iterator<Item = (usize, f64)> {
    let pairs = body.lbs_joints[v].into_iter().zip(body.lbs_weights[v]);
    pairs.filter(|(_, weight)| *weight > 0.0).map(|(joint, weight)| (joint as usize, weight.into()))
}
