//! Poses on the host, for files, pictures and evaluation.

use glam::{Quat, Vec3};

use crate::body::N_POSE;

/// A body's pose: axis-angle of the 24 joints, joint 0 the global orientation.
pub type Pose = [f32; N_POSE];

/// The rotation of joint `j`, relative to its parent.
pub(super) fn joint_rotation(pose: &Pose, j: usize) -> Quat {
    Quat::from_scaled_axis(Vec3::new(pose[3 * j], pose[3 * j + 1], pose[3 * j + 2])).normalize()
}

/// Unit vertex normals, each face weighted by its area; +Y where a vertex has no face. Vertices in one place, as those of a seam,
/// have one normal.
pub fn vertex_normals(vertices: &[[f32; 3]], faces: &[[u32; 3]]) -> Vec<[f32; 3]> {
    let first = first_in_place(vertices);
    let mut sums = vec![Vec3::ZERO; vertices.len()];
    for face in faces {
        let [a, b, c] = face.map(|i| Vec3::from(vertices[i as usize]));
        let normal = (b - a).cross(c - a);
        face.iter().for_each(|&i| sums[first[i as usize] as usize] += normal);
    }
    first.into_iter().map(|v| sums[v as usize].try_normalize().unwrap_or(Vec3::Y).into()).collect()
}

/// What is nearer lies in one place, metres: arithmetic, and no distance that a surface has.
const ONE_PLACE: f32 = 1e-5;

/// `[V]`: the first of the vertices in each one's place.
fn first_in_place(vertices: &[[f32; 3]]) -> Vec<u32> {
    let mut by_x: Vec<u32> = (0..vertices.len() as u32).collect();
    let place = |v: u32| Vec3::from(vertices[v as usize]);
    by_x.sort_unstable_by(|&a, &b| place(a).x.total_cmp(&place(b).x).then(a.cmp(&b)));
    let mut first: Vec<u32> = (0..vertices.len() as u32).collect();
    for (k, &v) in by_x.iter().enumerate() {
        for &other in by_x[k + 1..].iter().take_while(|&&other| place(other).x - place(v).x <= ONE_PLACE) {
            if place(other).distance_squared(place(v)) <= ONE_PLACE * ONE_PLACE {
                let [a, b] = [v, other].map(|v| first[v as usize]);
                (first[v as usize], first[other as usize]) = (a.min(b), a.min(b));
            }
        }
    }
    first
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_halves_of_a_seam_have_one_normal() {
        // A roof whose two sides have a ridge each, in one place but for rounding.
        let ridge = [[0.0, 1.0, 0.0], [0.0, 1.0, 1.0]];
        let again = ridge.map(|[x, y, z]| [x + 3e-7, y, z]);
        let eaves = [[-1.0, 0.0, 0.0], [-1.0, 0.0, 1.0], [1.0, 0.0, 0.0], [1.0, 0.0, 1.0]];
        let vertices = [&ridge[..], &again, &eaves].concat();
        let faces = [[0, 4, 5], [0, 5, 1], [2, 7, 6], [2, 3, 7]];
        let normals = vertex_normals(&vertices, &faces);
        assert_eq!((normals[0], normals[1]), (normals[2], normals[3]));
        assert!(normals[1][1].abs() > 0.7, "{normals:?}");
        assert_ne!(normals[4], normals[6], "the sides keep their own");
    }
}
