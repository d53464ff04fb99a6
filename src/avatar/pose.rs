//! Poses on the host, for files, pictures and evaluation.

use glam::{Quat, Vec3};

use crate::body::N_POSE;

/// A body's pose: axis-angle of the 24 joints, joint 0 the global orientation.
pub type Pose = [f32; N_POSE];

/// The rotation of joint `j`, relative to its parent.
pub(super) fn joint_rotation(pose: &Pose, j: usize) -> Quat {
    Quat::from_scaled_axis(Vec3::new(pose[3 * j], pose[3 * j + 1], pose[3 * j + 2])).normalize()
}

/// Unit vertex normals, each face weighted by its area; +Y where a vertex has no face.
pub fn vertex_normals(vertices: &[[f32; 3]], faces: &[[u32; 3]]) -> Vec<[f32; 3]> {
    let mut sums = vec![Vec3::ZERO; vertices.len()];
    for face in faces {
        let [a, b, c] = face.map(|i| Vec3::from(vertices[i as usize]));
        let normal = (b - a).cross(c - a);
        face.iter().for_each(|&i| sums[i as usize] += normal);
    }
    sums.into_iter().map(|n| n.try_normalize().unwrap_or(Vec3::Y).into()).collect()
}
