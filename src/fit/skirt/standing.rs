//! The body in the clip's mean pose: where its legs are, and its sections.

use glam::{Mat3, Vec2, Vec3};

use crate::body::joints::{LEFT_ANKLE, LEFT_HIP, LEFT_KNEE, LEFT_SHOULDER, RIGHT_ANKLE, RIGHT_HIP, RIGHT_KNEE};
use crate::body::{Body, N_JOINTS, N_POSE};
use crate::fit::state::FitState;
use crate::ops::skinning::cpu::{Posed, Transform, forward};

/// Hip, knee, ankle: left, right.
const LEGS: [[usize; 3]; 2] = [[LEFT_HIP, LEFT_KNEE, LEFT_ANKLE], [RIGHT_HIP, RIGHT_KNEE, RIGHT_ANKLE]];
/// From the upper arms on.
const ARMS: std::ops::Range<usize> = LEFT_SHOULDER..N_JOINTS;

/// The body in the clip's mean pose, upright: x to its left, y up, z ahead.
pub(super) struct Standing {
    pub(super) posed: Posed<f32>,
    pub(super) of_arm: Vec<bool>,
    /// Edges of the surface without arms
    edges: Vec<[u32; 2]>,
}

impl Standing {
    pub(super) fn new(body: &Body, state: &FitState, offsets: &[f32]) -> Self {
        let n = state.n_frames().max(1) as f32;
        let mut pose = [0.0; N_POSE];
        for frame in state.poses.chunks(N_POSE) {
            pose.iter_mut().zip(frame).for_each(|(mean, angle)| *mean += angle / n);
        }
        pose[..3].fill(0.0);
        let posed = forward(body, &state.betas, Some(offsets.as_chunks().0), &pose, [0.0; 3]);
        let is_of_arm = |v| body.weight_of(v, |joint| ARMS.contains(&(joint as usize))) > 0.5;
        let of_arm: Vec<bool> = (0..body.n_vertices()).map(is_of_arm).collect();
        let edges = body.faces.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
        let edges = edges.filter(|edge| edge.iter().all(|&v| !of_arm[v as usize])).collect();
        Self { posed, of_arm, edges }
    }

    fn joint(&self, side: usize, k: usize) -> Vec3 {
        self.posed.joints[LEGS[side][k]].into()
    }

    /// Height of hips, of knees, of ankles: the mean of both.
    pub(super) fn height(&self, k: usize) -> f32 {
        0.5 * (self.joint(0, k).y + self.joint(1, k).y)
    }

    /// x of both legs' axes; above the hips, that of the hips.
    pub(super) fn axes(&self, along: f32) -> [f32; 2] {
        let knee = (self.height(0) - self.height(1)) / (self.height(0) - self.height(2));
        let between = |side: usize, k: usize, t: f32| self.joint(side, k).lerp(self.joint(side, k + 1), t).x;
        [0, 1].map(|side| match along < knee {
            true => between(side, 0, (along / knee).max(0.0)),
            false => between(side, 1, (along - knee) / (1.0 - knee)),
        })
    }

    /// Half of the distance between the legs' axes, metres.
    pub(super) fn half_width(&self, along: f32) -> f32 {
        let [left, right] = self.axes(along);
        (0.5 * (left - right)).max(1e-3)
    }

    /// The cosine of the angle by which legs slant outwards: how wide they are across, of how wide they are in a section.
    pub(super) fn slant(&self) -> f32 {
        let outwards = self.half_width(1.0) - self.half_width(0.0);
        let down = self.height(0) - self.height(2);
        down / down.hypot(outwards)
    }

    /// x between the legs' axes (−1 the right one's, 1 the left one's), y from hip (0) to ankle (1).
    pub(super) fn place(&self, v: usize) -> Vec2 {
        let [x, y, _] = self.posed.vertices[v];
        let along = (self.height(0) - y) / (self.height(0) - self.height(2));
        Vec2::new(self.across(x, along), along)
    }

    fn across(&self, x: f32, along: f32) -> f32 {
        let [left, right] = self.axes(along);
        (x - 0.5 * (left + right)) / self.half_width(along)
    }

    /// Where the surface crosses a height: x as of [`Standing::place`], and z in metres.
    pub(super) fn section(&self, along: f32) -> Vec<Vec2> {
        let y = self.height(0) + along * (self.height(2) - self.height(0));
        let at = |v: u32| Vec3::from(self.posed.vertices[v as usize]);
        let crossing = |[a, b]: [u32; 2]| {
            let (a, b) = (at(a), at(b));
            let point = a.lerp(b, (y - a.y) / (b.y - a.y));
            ((a.y < y) != (b.y < y)).then(|| Vec2::new(self.across(point.x, along), point.z))
        };
        self.edges.iter().filter_map(|&edge| crossing(edge)).collect()
    }

    /// Width and depth of the surface at a height together, metres; 0 where there is none.
    pub(super) fn extent(&self, along: f32) -> f32 {
        let section = self.section(along);
        let least = section.iter().copied().reduce(Vec2::min);
        let most = section.iter().copied().reduce(Vec2::max);
        let size = least.zip(most).map_or(Vec2::ZERO, |(least, most)| most - least);
        size.x * self.half_width(along) + size.y
    }

    /// Sets the offsets so that the body, by its present weights, has these vertices in this pose.
    pub(super) fn lay(&self, body: &Body, state: &mut FitState, vertices: &[Vec3]) {
        for (v, (offset, &vertex)) in state.offsets.as_chunks_mut::<3>().0.iter_mut().zip(vertices).enumerate() {
            let (rotation, translation) = blend(&self.posed.transforms, &body.lbs_joints[v], &body.lbs_weights[v]);
            let rest = rotation.inverse() * (vertex - translation);
            // Blend shapes of the pose are added between offset and skinning, and are as they were.
            *offset = (Vec3::from(*offset) + rest - Vec3::from(self.posed.v_posed[v])).into();
        }
    }
}

/// Linear blend skinning's transform of one vertex.
fn blend(transforms: &[Transform<f32>], joints: &[u32], weights: &[f32]) -> (Mat3, Vec3) {
    let mut sum = (Mat3::ZERO, Vec3::ZERO);
    for (&joint, &weight) in joints.iter().zip(weights) {
        let Transform { rotation, translation } = &transforms[joint as usize];
        // Rows, as the operators keep them.
        sum.0 += weight * Mat3::from_cols_array_2d(rotation).transpose();
        sum.1 += weight * Vec3::from(*translation);
    }
    sum
}
