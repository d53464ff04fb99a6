//! Distances between two surfaces and their alignment. docs/metrics.md states the definitions for users.

use glam::{DMat3, DVec3};
use rand::{RngExt, SeedableRng};

use super::nearest::Surface;
use crate::avatar::ply::Mesh;

/// Points sampled on each surface.
const SAMPLES: usize = 20_000;

/// Points on each surface and rounds of the alignment.
const ALIGN_SAMPLES: usize = 4_000;
const ALIGN_ROUNDS: usize = 100;

/// Metres below which a pair's distance weighs like its square.
const ALIGN_EPSILON: f64 = 2e-3;

/// A similarity: `x ↦ scale · rotation · x + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    pub scale: f64,
    pub rotation: DMat3,
    pub translation: DVec3,
}

impl Similarity {
    pub const IDENTITY: Self = Self { scale: 1.0, rotation: DMat3::IDENTITY, translation: DVec3::ZERO };

    pub fn apply(&self, p: DVec3) -> DVec3 {
        self.scale * (self.rotation * p) + self.translation
    }
}

/// How far two surfaces lie apart, in centimetres.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Distances {
    /// Mean of the two directed mean distances (ours to truth, truth to ours).
    pub chamfer_cm: f64,
    /// Their sum, which other works print as Chamfer.
    pub chamfer_sum_cm: f64,
    /// Mean distance of the truth's points to our surface.
    pub point_to_surface_cm: f64,
}

fn positions(mesh: &Mesh) -> Vec<DVec3> {
    mesh.vertices.iter().map(|v| DVec3::from(v.map(f64::from))).collect()
}

/// `n` points, uniform over the area, the same for the same seed. Empty for a mesh without area.
pub fn sample(vertices: &[DVec3], faces: &[[u32; 3]], n: usize, seed: u64) -> Vec<DVec3> {
    let corners = |f: &[u32; 3]| f.map(|i| vertices[i as usize]);
    let mut sums = Vec::with_capacity(faces.len());
    let mut total = 0.0;
    for face in faces {
        let [a, b, c] = corners(face);
        total += (b - a).cross(c - a).length();
        sums.push(total);
    }
    if total == 0.0 || !total.is_finite() {
        return Vec::new();
    }
    let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
    (0..n)
        .map(|_| {
            let at = rng.random::<f64>() * total;
            let [a, b, c] = corners(&faces[sums.partition_point(|&s| s <= at).min(faces.len() - 1)]);
            let (root, v) = (rng.random::<f64>().sqrt(), rng.random::<f64>());
            a * (1.0 - root) + b * (root * (1.0 - v)) + c * (root * v)
        })
        .collect()
}

fn mean_distance(points: &[DVec3], to: &Surface) -> f64 {
    let sum: f64 = points.iter().filter_map(|&p| to.nearest(p)).map(|(_, d)| d.sqrt()).sum();
    sum / points.len() as f64
}

/// Distances between our mesh and the truth, both in metres, after `ours` has been moved by `alignment`.
pub fn distances(ours: &Mesh, truth: &Mesh, alignment: &Similarity) -> Distances {
    let moved: Vec<DVec3> = positions(ours).into_iter().map(|p| alignment.apply(p)).collect();
    let truth_points = positions(truth);
    let to_truth = mean_distance(&sample(&moved, &ours.faces, SAMPLES, 1), &Surface::new(&truth_points, &truth.faces));
    let to_ours = mean_distance(&sample(&truth_points, &truth.faces, SAMPLES, 2), &Surface::new(&moved, &ours.faces));
    Distances {
        chamfer_cm: 50.0 * (to_truth + to_ours),
        chamfer_sum_cm: 100.0 * (to_truth + to_ours),
        point_to_surface_cm: 100.0 * to_ours,
    }
}

/// The similarity that brings `ours` onto `truth` with the least mean distance, which is what [`distances`] reports: iterated
/// closest points in both directions, from the identity. Least squares would let what only one of the surfaces has draw all the
/// rest towards it, such as the underside of a skirt's hem. Each pair is weighed by the inverse of its last distance, by which
/// least squares sum distances (iteratively reweighted least squares).
pub fn align(ours: &Mesh, truth: &Mesh) -> Similarity {
    let (our_vertices, truth_vertices) = (positions(ours), positions(truth));
    let our_points = sample(&our_vertices, &ours.faces, ALIGN_SAMPLES, 3);
    let truth_points = sample(&truth_vertices, &truth.faces, ALIGN_SAMPLES, 4);
    // The trees stand still; points are carried to the other's space instead.
    let our_surface = Surface::new(&our_vertices, &ours.faces);
    let truth_surface = Surface::new(&truth_vertices, &truth.faces);
    let mut now = Similarity::IDENTITY;
    for _ in 0..ALIGN_ROUNDS {
        let mut pairs = Vec::with_capacity(2 * ALIGN_SAMPLES);
        pairs.extend(our_points.iter().filter_map(|&p| Some((p, truth_surface.nearest(now.apply(p))?.0))));
        pairs.extend(truth_points.iter().filter_map(|&q| {
            let back = now.rotation.transpose() * (q - now.translation) / now.scale;
            Some((our_surface.nearest(back)?.0, q))
        }));
        let weights: Vec<f64> =
            pairs.iter().map(|(x, y)| 1.0 / ((now.apply(*x) - *y).length() + ALIGN_EPSILON)).collect();
        let Some(next) = umeyama(&pairs, &weights) else { break };
        let step = (next.translation - now.translation).length() + (next.scale - now.scale).abs();
        now = next;
        if step < 1e-7 {
            break;
        }
    }
    now
}

/// Rounds of [`scale_about`]: closest points follow a shift slowly.
const SCALE_ROUNDS: usize = 100;

/// The scale about `centre` that brings `ours` nearest to `truth`: iterated closest points in both directions. About the camera's
/// centre it is what one camera cannot tell, since no picture of it changes.
pub fn scale_about(centre: DVec3, ours: &Mesh, truth: &Mesh) -> f64 {
    let about = |mesh: &Mesh| -> Vec<DVec3> { positions(mesh).into_iter().map(|p| p - centre).collect() };
    let (our_vertices, truth_vertices) = (about(ours), about(truth));
    let our_points = sample(&our_vertices, &ours.faces, ALIGN_SAMPLES, 3);
    let truth_points = sample(&truth_vertices, &truth.faces, ALIGN_SAMPLES, 4);
    let our_surface = Surface::new(&our_vertices, &ours.faces);
    let truth_surface = Surface::new(&truth_vertices, &truth.faces);
    let mut scale = 1.0;
    for _ in 0..SCALE_ROUNDS {
        let (mut top, mut bottom) = (0.0, 0.0);
        let mut pair = |x: DVec3, y: DVec3| {
            top += x.dot(y);
            bottom += x.length_squared();
        };
        our_points.iter().for_each(|&p| truth_surface.nearest(scale * p).into_iter().for_each(|(q, _)| pair(p, q)));
        truth_points.iter().for_each(|&q| our_surface.nearest(q / scale).into_iter().for_each(|(p, _)| pair(p, q)));
        if bottom <= 0.0 {
            break;
        }
        let step = top / bottom - scale;
        scale += step;
        if step.abs() < 1e-6 {
            break;
        }
    }
    scale
}

/// The similarity that minimises `Σ w ‖s R x + t − y‖²` over pairs (x, y), a positive weight each (Umeyama 1991); `None` where the
/// points have no extent.
pub fn umeyama(pairs: &[(DVec3, DVec3)], weights: &[f64]) -> Option<Similarity> {
    let total: f64 = weights.iter().sum();
    let weighed = || pairs.iter().zip(weights).map(|((x, y), w)| (*x, *y, w / total));
    let (mx, my) = weighed().fold((DVec3::ZERO, DVec3::ZERO), |(a, b), (x, y, w)| (a + w * x, b + w * y));
    let mut covariance = nalgebra::Matrix3::<f64>::zeros();
    let mut variance = 0.0;
    for (x, y, w) in weighed() {
        let (dx, dy) = (x - mx, y - my);
        variance += w * dx.length_squared();
        covariance += w * nalgebra::Vector3::from(dy.to_array()) * nalgebra::RowVector3::from(dx.to_array());
    }
    if variance <= 1e-18 || !variance.is_finite() {
        return None;
    }
    let svd = covariance.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let sign = if (u.determinant() * v_t.determinant()) < 0.0 { -1.0 } else { 1.0 };
    let mut signs = nalgebra::Vector3::new(1.0, 1.0, 1.0);
    signs[svd.singular_values.imin()] = sign;
    let rotation = u * nalgebra::Matrix3::from_diagonal(&signs) * v_t;
    let scale = svd.singular_values.dot(&signs) / variance;
    let rotation = DMat3::from_cols_array(&rotation.as_slice().try_into().ok()?);
    Some(Similarity { scale, rotation, translation: my - scale * (rotation * mx) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::Body;

    fn mesh() -> Mesh {
        let body = Body::test_body();
        Mesh { vertices: body.v_template, faces: body.faces, colours: Vec::new() }
    }

    fn moved(mesh: &Mesh, by: &Similarity) -> Mesh {
        let vertices = mesh.vertices.iter().map(|v| by.apply(DVec3::from(v.map(f64::from))).as_vec3().to_array());
        Mesh { vertices: vertices.collect(), ..mesh.clone() }
    }

    #[test]
    fn the_scale_about_the_camera_is_found_whatever_the_size_of_the_body() {
        let away = |v: &[f32; 3]| [v[0] + 0.1, v[1] - 0.2, v[2] + 3.0];
        let ours = Mesh { vertices: mesh().vertices.iter().map(away).collect(), ..mesh() };
        let camera = DVec3::new(0.05, 0.0, -0.1);
        let larger = |v: &[f32; 3]| (camera + 1.03 * (DVec3::from(v.map(f64::from)) - camera)).as_vec3().to_array();
        let truth = Mesh { vertices: ours.vertices.iter().map(larger).collect(), ..mesh() };
        let scale = scale_about(camera, &ours, &truth);
        assert!((scale - 1.03).abs() < 5e-4, "{scale}");
        // A body that is thinner and stands at the same place is not nearer.
        let thin = |v: &[f32; 3]| [0.1 + 0.95 * (v[0] - 0.1), v[1], 3.0 + 0.95 * (v[2] - 3.0)];
        let thinner = Mesh { vertices: truth.vertices.iter().map(thin).collect(), ..mesh() };
        let same = Mesh { vertices: thinner.vertices.iter().map(thin).collect(), ..mesh() };
        assert!((scale_about(camera, &thinner, &same) - 1.0).abs() < 5e-3);
    }

    #[test]
    fn samples_lie_on_the_surface_evenly() {
        let vertices = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::X * 3.0 + DVec3::Y * 3.0];
        let faces = [[0, 1, 2], [1, 3, 2]];
        let points = sample(&vertices, &faces, 20_000, 7);
        // The first triangle has an area of 1/2, the second of 5/2.
        let first = points.iter().filter(|p| p.x + p.y < 1.0).count() as f64 / points.len() as f64;
        assert!((first - 1.0 / 6.0).abs() < 0.01, "{first}");
        assert!(points.iter().all(|p| p.z == 0.0));
    }

    #[test]
    fn parallel_squares_lie_their_distance_apart() {
        let square = |z: f32| Mesh {
            vertices: vec![[0.0, 0.0, z], [1.0, 0.0, z], [1.0, 1.0, z], [0.0, 1.0, z]],
            faces: vec![[0, 1, 2], [0, 2, 3]],
            colours: Vec::new(),
        };
        let d = distances(&square(0.0), &square(0.02), &Similarity::IDENTITY);
        assert!((d.chamfer_cm - 2.0).abs() < 1e-5 && (d.point_to_surface_cm - 2.0).abs() < 1e-5, "{d:?}");
        assert!((d.chamfer_sum_cm - 4.0).abs() < 1e-5);
    }

    #[test]
    fn umeyama_finds_the_similarity_and_no_reflection() {
        let truth = Similarity {
            scale: 1.3,
            rotation: DMat3::from_rotation_y(0.8) * DMat3::from_rotation_x(-2.0),
            translation: DVec3::new(0.1, -4.0, 2.0),
        };
        let points: Vec<DVec3> =
            (0..20).map(|i| DVec3::new((i * 7 % 5) as f64, (i * 3 % 7) as f64, i as f64)).collect();
        let pairs: Vec<_> = points.iter().map(|&p| (p, truth.apply(p))).collect();
        let found = umeyama(&pairs, &[1.0; 20]).unwrap();
        assert!((found.scale - truth.scale).abs() < 1e-9 && found.rotation.abs_diff_eq(truth.rotation, 1e-9));
        let mirrored: Vec<_> = points.iter().map(|&p| (p, DVec3::new(-p.x, p.y, p.z))).collect();
        assert!((umeyama(&mirrored, &[1.0; 20]).unwrap().rotation.determinant() - 1.0).abs() < 1e-9);
        assert!(umeyama(&[(DVec3::ONE, DVec3::X)], &[1.0]).is_none());
    }

    #[test]
    fn umeyama_counts_a_pair_as_often_as_it_weighs() {
        let pair = |i: usize| {
            (
                DVec3::new((i * 7 % 5) as f64, (i * 3 % 7) as f64, i as f64),
                DVec3::new((i * i % 5) as f64, i as f64, (i * 5 % 7) as f64),
            )
        };
        let pairs: Vec<_> = (0..6).map(pair).collect();
        let twice: Vec<_> = pairs.iter().copied().chain([pairs[2]]).collect();
        let weighed = umeyama(&pairs, &[0.5, 0.5, 1.0, 0.5, 0.5, 0.5]).unwrap();
        let counted = umeyama(&twice, &[1.0; 7]).unwrap();
        assert!(
            (weighed.scale - counted.scale).abs() < 1e-12
                && weighed.translation.abs_diff_eq(counted.translation, 1e-12)
        );
        assert!(weighed.rotation.abs_diff_eq(counted.rotation, 1e-12));
    }

    #[test]
    fn alignment_takes_out_a_small_similarity() {
        let truth = mesh();
        let shift = Similarity {
            scale: 1.04,
            rotation: DMat3::from_rotation_y(0.05),
            translation: DVec3::new(0.02, -0.03, 0.05),
        };
        let ours = moved(&truth, &shift);
        let before = distances(&ours, &truth, &Similarity::IDENTITY);
        let after = distances(&ours, &truth, &align(&ours, &truth));
        assert!(before.chamfer_cm > 1.5, "{before:?}");
        assert!(after.chamfer_cm < 0.02, "{after:?}");
    }
    /// A skirt's hem that ours closes from below and the truth leaves open.
    #[test]
    fn what_only_one_surface_has_does_not_draw_the_rest() {
        let truth = mesh();
        let shift = Similarity {
            scale: 1.02,
            rotation: DMat3::from_rotation_y(0.03),
            translation: DVec3::new(0.01, -0.02, 0.02),
        };
        let ours = moved(&truth, &shift);
        let mut closed = ours.clone();
        let first = closed.vertices.len() as u32;
        let low = ours.vertices.iter().map(|v| v[1]).fold(f32::MAX, f32::min) - 0.1;
        closed.vertices.extend([[-0.2, low, -0.2], [0.2, low, -0.2], [0.2, low, 0.2], [-0.2, low, 0.2]]);
        closed.faces.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        let off = distances(&ours, &truth, &align(&closed, &truth));
        assert!(off.chamfer_cm < 0.1, "{off:?}");
    }
}
