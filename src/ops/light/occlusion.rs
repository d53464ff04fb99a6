//! Ambient occlusion: which share of its surroundings each vertex of a posed mesh sees past the rest of the mesh.
//!
//! The share of the directions above a vertex, by the cosine to its normal, in which nothing hides it: looked up in depth
//! images ([`DepthMap`]) along [`AXES`] lines spread evenly over the sphere. An image's nearest depths tell of one end of its
//! line and its farthest of the other, so half as many images serve as directions.
//!
//! On the host, as shadows are ([`super::shadow`]): once a phase and frame, or once a picture, and without a gradient.

use glam::Vec3;
use rayon::prelude::*;

use super::depth_map::DepthMap;
use crate::ops::face_normals::cpu::forward as face_normals;

/// Lines along which is looked.
const AXES: usize = 32;
/// Lines whose sums are made one after the other.
const AXES_A_PART: usize = 4;
/// Pixels of a depth image's side.
const SIDE: usize = 160;
/// How far a vertex is lifted along its normal, in pixels: then a plane does not hide itself, however it lies.
const LIFT_PX: f32 = 1.0;
/// How much further out another surface must be to hide it, metres.
const BIAS_M: f32 = 0.004;

/// The share of the surroundings that each vertex sees, `[V]`, 0 to 1; faces show their outside counter-clockwise. A vertex
/// without a normal sees all.
///
/// # Panics
/// When a face names a vertex that there is not.
pub fn openness(vertices: &[[f32; 3]], faces: &[[u32; 3]]) -> Vec<f32> {
    let normals = super::cpu::vertex_normals(faces, face_normals(faces, vertices).as_flattened(), vertices.len());
    let normals: Vec<Vec3> = normals.as_chunks().0.iter().map(|&n| n.into()).collect();
    let along = |axes: &[Vec3]| -> Vec<[f32; 2]> {
        let mut sums = vec![[0.0; 2]; vertices.len()];
        axes.iter().for_each(|&axis| look_along(axis, vertices, &normals, faces, &mut sums));
        sums
    };
    // Equal parts on every machine, so that the sums do not depend on its cores.
    let parts: Vec<Vec<[f32; 2]>> = axes().par_chunks(AXES_A_PART).map(along).collect();
    let sum = |v: usize, k: usize| parts.iter().map(|part| part[v][k]).sum::<f32>();
    let share = |v| if sum(v, 1) > 0.0 { sum(v, 0) / sum(v, 1) } else { 1.0 };
    (0..vertices.len()).map(share).collect()
}

/// Adds to `sums [V]` the cosine to the normal of the end of a line that lies above a vertex where the vertex sees out along it, and
/// that cosine in any case. Nothing is added for a mesh without extent.
fn look_along(axis: Vec3, vertices: &[[f32; 3]], normals: &[Vec3], faces: &[[u32; 3]], sums: &mut [[f32; 2]]) {
    let Some(map) = DepthMap::of(axis, SIDE, vertices, faces) else { return };
    let lift = LIFT_PX * map.pixel_m();
    for ((&vertex, &normal), [open, all]) in vertices.iter().zip(normals).zip(sums) {
        let cosine = normal.dot(axis);
        let (place, depth) = map.place(Vec3::from(vertex) + lift * normal);
        let pixel = map.pixel(place);
        let sees =
            if cosine > 0.0 { depth - BIAS_M <= map.nearest(pixel) } else { depth + BIAS_M >= map.farthest(pixel) };
        *all += cosine.abs();
        *open += if sees { cosine.abs() } else { 0.0 };
    }
}

/// Unit vectors spread evenly over half of the sphere (Vogel's spiral, by equal heights).
fn axes() -> [Vec3; AXES] {
    let golden_angle = std::f32::consts::PI * (3.0 - 5.0f32.sqrt());
    std::array::from_fn(|i| {
        let height = (i as f32 + 0.5) / AXES as f32;
        let (sin, cos) = (golden_angle * i as f32).sin_cos();
        let radius = (1.0 - height * height).sqrt();
        Vec3::new(radius * cos, height, radius * sin)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square of `n`² cells and one metre's side, its corner at the origin, spanned by `u` and `v`; it shows its outside to u × v.
    fn square(n: usize, u: Vec3, v: Vec3) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
        let at = |k: usize| k as f32 / n as f32;
        let vertices = (0..=n).flat_map(|y| (0..=n).map(move |x| (at(x) * u + at(y) * v).to_array())).collect();
        let corner = |x: usize, y: usize| (y * (n + 1) + x) as u32;
        let cell = |x: usize, y: usize| {
            let [a, b, c, d] = [corner(x, y), corner(x + 1, y), corner(x, y + 1), corner(x + 1, y + 1)];
            [[a, b, c], [b, d, c]]
        };
        (vertices, (0..n).flat_map(|y| (0..n).flat_map(move |x| cell(x, y))).collect())
    }

    #[test]
    fn a_plane_and_a_ball_are_open() {
        for (u, v) in [(Vec3::X, Vec3::Y), (Vec3::new(0.6, 0.0, 0.8), Vec3::new(0.48, 0.8, -0.36))] {
            let (vertices, faces) = square(40, u, v);
            let open = openness(&vertices, &faces);
            assert!(open.iter().all(|&o| o > 0.97), "{:?}", open.iter().copied().fold(1.0, f32::min));
        }
    }

    #[test]
    fn what_a_wall_hides_is_what_rays_meet() {
        // Both one metre by one.
        let (mut vertices, mut faces) = square(50, Vec3::Z, Vec3::X);
        let (more, others) = square(50, Vec3::Y, Vec3::Z);
        let n = vertices.len() as u32;
        vertices.extend(more);
        faces.extend(others.into_iter().map(|face| face.map(|v| v + n)));
        let open = openness(&vertices, &faces);
        // Rays from the floor's middle line, spread by the cosine: those that meet the wall in the plane x = 0.
        let n_rays = 5000;
        let left = |d: f32| {
            let hidden = (0..n_rays).filter(|&i| {
                let radius = ((i as f32 + 0.5) / n_rays as f32).sqrt();
                let (sin, cos) = (2.399_963 * i as f32).sin_cos();
                let ray = Vec3::new(radius * cos, (1.0 - radius * radius).sqrt(), radius * sin);
                let at = ray * (-d / ray.x);
                ray.x < 0.0 && at.y < 1.0 && at.z.abs() < 0.5
            });
            1.0 - hidden.count() as f32 / n_rays as f32
        };
        for x in [2usize, 5, 10, 20, 30, 45] {
            let d = x as f32 / 50.0;
            let (got, want) = (open[x * 51 + 25], left(d));
            assert!((got - want).abs() < 0.05, "{d} m from the wall: {got} instead of {want}");
        }
    }

    #[test]
    fn what_is_shut_in_sees_nothing() {
        // A small square under a large one, face to face, 5 cm apart.
        let (mut vertices, mut faces) = square(10, 0.1 * Vec3::X, 0.1 * Vec3::Y);
        let n = vertices.len() as u32;
        let (more, others) = square(40, Vec3::Y, Vec3::X);
        vertices.extend(more.into_iter().map(|[x, y, z]| [x - 0.45, y - 0.45, z + 0.05]));
        faces.extend(others.into_iter().map(|face| face.map(|v| v + n)));
        let open = openness(&vertices, &faces);
        let middle = open[5 * 11 + 5];
        assert!(middle < 0.05, "{middle} under the lid");
    }

    #[test]
    fn nothing_hides_nothing() {
        assert!(openness(&[], &[]).is_empty());
        assert_eq!(openness(&[[f32::NAN; 3]; 2], &[]), [1.0; 2]);
        let axes = axes();
        assert!(axes.iter().all(|a| (a.length() - 1.0).abs() < 1e-5));
        let mean = axes.iter().map(|a| a.y.abs()).sum::<f32>() / AXES as f32;
        assert!((mean - 0.5).abs() < 0.01, "evenly spread, {mean} is the mean of |cos|");
    }
}
