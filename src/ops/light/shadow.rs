//! Cast shadows: which part of the lamp each vertex of a posed mesh sees.
//!
//! A [`DepthMap`] of the mesh as the lamp sees it ([`SIDE`] pixels over the mesh), in which each vertex is looked
//! up. The lamp has an extent of [`RADIUS_DEG`], so the edge of a shadow is as wide as that makes it at its distance from what
//! casts it: the mean distance of the hiding surface is looked for first, then the share of hidden lookups in the disc of
//! that width (percentage-closer soft shadows, Fernando 2005).
//!
//! On the host: it is asked for once a phase and frame, or once a picture, and not in a step. Shadows move with the pose and
//! have no gradient.

use glam::{Vec2, Vec3};

use super::depth_map::DepthMap;
use crate::ops::face_normals::cpu::forward as face_normals;

/// Pixels of the depth image's side.
const SIDE: usize = 256;
/// Half the angle under which the lamp is seen (docs/lab/light.md).
const RADIUS_DEG: f32 = 10.0;
/// How far a vertex is lifted along its normal, and how much nearer to the lamp than it another surface must be to hide it,
/// metres: a face of the depth image is flat where the mesh is bent, and lies beside a pixel's middle.
const LIFT_M: f32 = 0.005;
const BIAS_M: f32 = 0.01;
/// What hides a vertex is looked for this far around it, metres.
const SEARCH_M: f32 = 0.06;
/// Lookups in a disc.
const LOOKUPS: usize = 16;

/// The share of the lamp that each vertex sees, `[V]`, 0 to 1. `direction`: unit vector towards the lamp; faces show
/// their outside counter-clockwise. A surface that looks away from the lamp lies in its own shadow.
///
/// # Panics
/// When a face names a vertex that there is not.
pub fn visibility(direction: [f32; 3], vertices: &[[f32; 3]], faces: &[[u32; 3]]) -> Vec<f32> {
    let Some(map) = DepthMap::of(direction.into(), SIDE, vertices, faces) else { return vec![1.0; vertices.len()] };
    let normals = super::cpu::vertex_normals(faces, face_normals(faces, vertices).as_flattened(), vertices.len());
    let disc = disc();
    let lifted = vertices.iter().zip(normals.as_chunks().0).map(|(&v, &n)| Vec3::from(v) + LIFT_M * Vec3::from(n));
    lifted.map(|point| visible(&map, point, &disc)).collect()
}

/// Points of the unit disc, evenly spread (Vogel's spiral).
fn disc() -> [Vec2; LOOKUPS] {
    let golden_angle = std::f32::consts::PI * (3.0 - 5.0f32.sqrt());
    std::array::from_fn(|i| {
        let radius = ((i as f32 + 0.5) / LOOKUPS as f32).sqrt();
        radius * Vec2::from_angle(golden_angle * i as f32)
    })
}

/// The share of the lamp that a point sees.
fn visible(map: &DepthMap, point: Vec3, disc: &[Vec2; LOOKUPS]) -> f32 {
    let (place, depth) = map.place(point);
    let depth = depth - BIAS_M;
    let at = |shift: Vec2| map.nearest(map.pixel(place + shift));
    let spread = RADIUS_DEG.to_radians().tan();
    // What lies further aside than the lamp reaches at its distance hides nothing; 2 cm are left to the image's pixels.
    let hides = |shift: Vec2| {
        let before = depth - at(shift);
        (before > 0.0 && before * spread >= shift.length() - 0.02).then_some(before)
    };
    let (sum, n) =
        disc.iter().filter_map(|&d| hides(SEARCH_M * d)).fold((0.0, 0.0), |(sum, n), before| (sum + before, n + 1.0));
    // At least a pixel, so that the image's raster does not show.
    let radius = (sum / f32::max(n, 1.0) * spread).max(map.pixel_m());
    disc.iter().filter(|&&d| depth <= at(radius * d)).count() as f32 / LOOKUPS as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ops::light::WRAP;

    /// A square of `n`² cells and side `side` metres in the plane z, its normals towards −z.
    fn square(n: usize, side: f32, z: f32) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
        let at = |k: usize| side * (k as f32 / n as f32 - 0.5);
        let vertices = (0..=n).flat_map(|y| (0..=n).map(move |x| [at(x), at(y), z])).collect();
        let corner = |x: usize, y: usize| (y * (n + 1) + x) as u32;
        let cell = |x: usize, y: usize| {
            let [a, b, c, d] = [corner(x, y), corner(x + 1, y), corner(x, y + 1), corner(x + 1, y + 1)];
            [[a, b, c], [b, d, c]]
        };
        (vertices, (0..n).flat_map(|y| (0..n).flat_map(move |x| cell(x, y))).collect())
    }

    /// A square of 20 cm between the lamp and one of 1 m, which lies so far behind; the visibility of the large one along
    /// its middle row.
    fn shadow(gap: f32) -> Vec<f32> {
        let (mut vertices, mut faces) = square(100, 1.0, 0.0);
        let (more, others) = square(4, 0.2, -gap);
        let n = vertices.len() as u32;
        vertices.extend(more);
        faces.extend(others.into_iter().map(|face| face.map(|v| v + n)));
        let visible = visibility([0.0, 0.0, -1.0], &vertices, &faces);
        assert!(visible[n as usize..].iter().all(|&v| v == 1.0), "nothing lies before the small one");
        visible[50 * 101..51 * 101].to_vec()
    }

    #[test]
    fn what_lies_behind_is_dark_and_what_lies_beside_is_lit() {
        let row = shadow(0.1);
        for (x, &visible) in row.iter().enumerate() {
            let from_edge = (x as f32 / 100.0 - 0.5).abs() - 0.1;
            if from_edge < -0.04 {
                assert_eq!(visible, 0.0, "{from_edge} m inside");
            } else if from_edge > 0.04 {
                assert_eq!(visible, 1.0, "{from_edge} m outside");
            }
        }
    }

    #[test]
    fn a_shadow_is_softer_the_further_away_it_falls() {
        let soft = |gap: f32| shadow(gap).iter().filter(|v| (0.05..0.95).contains(*v)).count();
        let (near, far) = (soft(0.03), soft(0.3));
        assert!(near <= 6 && far >= 2 * near.max(2), "{near} and {far} vertices in the penumbra");
    }

    #[test]
    fn a_ball_is_lit_on_the_side_of_the_lamp() {
        let (n_rings, n_sides) = (40, 60);
        let vertex = |ring: usize, side: usize| {
            let (sin, cos) = (std::f32::consts::PI * ring as f32 / n_rings as f32).sin_cos();
            let (s, c) = (std::f32::consts::TAU * side as f32 / n_sides as f32).sin_cos();
            [sin * c, cos, sin * s]
        };
        let normals: Vec<[f32; 3]> = (0..=n_rings).flat_map(|r| (0..n_sides).map(move |s| vertex(r, s))).collect();
        let vertices: Vec<[f32; 3]> = normals.iter().map(|n| n.map(|x| 0.15 * x)).collect();
        let at = |r: usize, s: usize| (r * n_sides + s % n_sides) as u32;
        let faces: Vec<[u32; 3]> = (0..n_rings)
            .flat_map(|r| {
                (0..n_sides).flat_map(move |s| {
                    [[at(r, s), at(r, s + 1), at(r + 1, s)], [at(r, s + 1), at(r + 1, s + 1), at(r + 1, s)]]
                })
            })
            .collect();
        let lamp = Vec3::new(0.6, -0.64, 0.48);
        let visible = visibility(lamp.to_array(), &vertices, &faces);
        for (n, visible) in normals.iter().zip(visible) {
            let cosine = lamp.dot(Vec3::from(*n));
            assert!(cosine < 0.35 || visible == 1.0, "{visible} where the cosine is {cosine}");
            // Near the rim the disc looks past the ball, but there the lamp has little part in the shade any more.
            let lamp = visible * ((cosine + WRAP) / (1.0 + WRAP)).max(0.0);
            assert!(cosine > -0.45 || lamp < 0.04, "{visible} where the cosine is {cosine}");
        }
    }

    #[test]
    fn nothing_casts_no_shadow() {
        assert!(visibility([0.0, -1.0, 0.0], &[], &[]).is_empty());
        let broken = [[f32::NAN; 3]; 2];
        assert_eq!(visibility([0.0, -1.0, 0.0], &broken, &[]), [1.0; 2]);
    }
}
