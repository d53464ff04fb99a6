//! The parametric body: its data, its file format, its importers.

mod check;
mod file;
pub mod import;
pub mod joints;
mod landmarks;
mod test_body;

pub use check::InvalidBody;
pub use file::BodyError;
pub use joints::{JOINT_NAMES, N_JOINTS, N_POSE, PARENTS};
pub use landmarks::Landmarks;

use serde::{Deserialize, Serialize};

/// Skinning influences of a vertex.
pub const N_INFLUENCES: usize = 4;

/// A linear parametric body in the T-pose (SMPL, Loper et al. 2015): all arrays in C order, metres.
#[derive(Clone, Debug, PartialEq)]
pub struct Body {
    /// A short name for people: `default`, `smpl-neutral`, `test`.
    pub name: String,
    /// `[V, 3]`
    pub v_template: Vec<[f32; 3]>,
    /// `[V, 3, B]`: displacement for a unit of each component; components are scaled so that betas are about N(0, 1).
    pub shapedirs: Vec<f32>,
    /// `[(24−1)·9, V·3]`, or empty where the body has no pose blend shapes.
    pub posedirs: Vec<f32>,
    /// `[24, 3]`: joints of the template.
    pub j_template: Vec<[f32; 3]>,
    /// `[24, 3, B]`: how the joints move with the shape.
    pub j_shapedirs: Vec<f32>,
    /// B
    pub n_betas: usize,
    /// `[24]`, −1 for the root; a parent stands before its children.
    pub parents: Vec<i32>,
    /// `[V, 4]`: joints that move the vertex; unused places hold joint 0 with weight 0.
    pub lbs_joints: Vec<[u32; N_INFLUENCES]>,
    /// `[V, 4]`, each row sums to 1.
    pub lbs_weights: Vec<[f32; N_INFLUENCES]>,
    /// `[F, 3]`, counter-clockwise seen from outside (in the right-handed, +Y-up rest space).
    pub faces: Vec<[u32; 3]>,
    /// `[T, 2]`, glTF's convention: v runs down. Empty where the body has no texture layout.
    pub uvs: Vec<[f32; 2]>,
    /// `[F, 3]`: texture corners of each face; empty with `uvs`.
    pub uv_faces: Vec<[u32; 3]>,
    /// The vertex on the other side of the body; its own index where there is none. `[V]`
    pub mirror: Vec<u32>,
    /// How each keypoint format is read off this body.
    pub keypoints: Vec<KeypointSet>,
}

/// The keypoints of one detector format on a body.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeypointSet {
    /// `coco17`, `coco18`, `body25`
    pub format: String,
    /// In the format's order.
    pub points: Vec<KeypointSource>,
}

/// Where a keypoint lies.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum KeypointSource {
    /// A joint.
    Joint(u32),
    /// The mean of surface vertices.
    Vertices(Vec<u32>),
    /// The mean of joints (BODY_25's mid-hip and neck on some bodies).
    Joints(Vec<u32>),
}

impl Body {
    pub fn n_vertices(&self) -> usize {
        self.v_template.len()
    }

    pub fn n_faces(&self) -> usize {
        self.faces.len()
    }

    /// Vertices of the shaped body in the T-pose, without offsets: `T + B_s β`. Missing betas count as zero.
    pub fn shaped_vertices(&self, betas: &[f32]) -> Vec<[f32; 3]> {
        shaped(&self.v_template, &self.shapedirs, self.n_betas, betas)
    }

    /// The part of vertex `v` that the joints move for which `of` holds, 0 to 1.
    pub fn weight_of(&self, v: usize, of: impl Fn(u32) -> bool) -> f32 {
        let pairs = self.lbs_joints[v].iter().zip(self.lbs_weights[v]);
        pairs.filter(|(joint, _)| of(**joint)).map(|(_, weight)| weight).sum()
    }

    /// Joints of the shaped body in the T-pose, `[24]`. Missing betas count as zero.
    pub fn shaped_joints(&self, betas: &[f32]) -> Vec<[f32; 3]> {
        shaped(&self.j_template, &self.j_shapedirs, self.n_betas, betas)
    }

    pub fn keypoint_set(&self, format: &str) -> Option<&KeypointSet> {
        self.keypoints.iter().find(|set| set.format == format)
    }
}

fn shaped(template: &[[f32; 3]], dirs: &[f32], n_betas: usize, betas: &[f32]) -> Vec<[f32; 3]> {
    let mut out = template.to_vec();
    for (i, point) in out.iter_mut().enumerate() {
        for (axis, value) in point.iter_mut().enumerate() {
            let row = &dirs[(i * 3 + axis) * n_betas..][..n_betas];
            *value += row.iter().zip(betas).map(|(d, b)| d * b).sum::<f32>();
        }
    }
    out
}
