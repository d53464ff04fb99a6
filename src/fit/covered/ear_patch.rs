//! A head without an ear on one side: the ear's vertices go to the surface that goes on from around it.

use glam::Vec3;
use nalgebra::{Matrix6, Vector6};

use super::mean_around;
use crate::ops::Topology;

/// How far round its landmark an ear reaches, and how wide the ring is that tells how the head goes on, of the distance between
/// the ears.
const REACH: f32 = 0.33;
const RING: f32 = 0.12;
/// The ring lies on the ear's side: at least so far out, of the distance from the middle to the ear.
const OUT: f32 = 0.24;
/// Rounds until the ear's vertices lie flat, and until their faces are of like sizes: the small ones in an ear's folds would rule
/// the steps of a fit.
const ROUNDS: usize = 600;
const EVEN_ROUNDS: usize = 300;

/// Moves the vertices of the ear to which `ear` belongs; `other` is where the other one is.
pub(super) fn patch(vertices: &mut [Vec3], faces: &[[u32; 3]], topology: &Topology, ear: usize, other: Vec3) {
    let (centre, width) = (vertices[ear], vertices[ear].distance(other));
    let out = (centre - other) / width;
    let up = Vec3::Y.reject_from_normalized(out).normalize();
    let ahead = up.cross(out);
    let region = connected(vertices, topology, ear, REACH * width);
    let is_ring = |p: Vec3| {
        (REACH..REACH + RING).contains(&(p.distance(centre) / width))
            && (p - centre).dot(out) > (OUT - 1.0) * 0.5 * width
    };
    // Up, ahead and out, in parts of the ear's reach.
    let local = |p: Vec3| (Vec3::new(up.dot(p - centre), ahead.dot(p - centre), out.dot(p - centre))) / (REACH * width);
    let Some(head) = Paraboloid::through(vertices.iter().filter(|p| is_ring(**p)).map(|p| local(*p))) else { return };
    // A place on the paraboloid and the distance from it: all three spread evenly from the ring inwards.
    let mut flat: Vec<Vec3> =
        vertices.iter().map(|p| local(*p)).map(|p| Vec3 { z: p.z - head.height(p.x, p.y), ..p }).collect();
    region.iter().for_each(|&v| flat[v].z = 0.0);
    for _ in 0..ROUNDS {
        for &v in &region {
            flat[v] = mean_around(&flat, topology, v);
        }
    }
    for _ in 0..EVEN_ROUNDS {
        let even: Vec<Vec3> = region.iter().map(|&v| flat[v].midpoint(middle(&flat, faces, topology, v))).collect();
        region.iter().zip(even).for_each(|(&v, even)| flat[v] = even);
    }
    for v in region {
        let p = flat[v] * REACH * width;
        let height = head.height(flat[v].x, flat[v].y) * REACH * width;
        vertices[v] = centre + up * p.x + ahead * p.y + out * (p.z + height);
    }
}

/// Of the middles of the faces at a vertex their mean, by area.
fn middle(vertices: &[Vec3], faces: &[[u32; 3]], topology: &Topology, v: usize) -> Vec3 {
    let weighed = topology.corners.row(v).iter().map(|corner| {
        let [a, b, c] = faces[*corner as usize / 3].map(|v| vertices[v as usize]);
        let area = (b - a).cross(c - a).length();
        (area * (a + b + c) / 3.0, area)
    });
    let (sum, area) = weighed.fold((Vec3::ZERO, 0.0), |sum, one| (sum.0 + one.0, sum.1 + one.1));
    if area > 0.0 { sum / area } else { vertices[v] }
}

/// The vertices within `reach` of `start` that hang together with it.
fn connected(vertices: &[Vec3], topology: &Topology, start: usize, reach: f32) -> Vec<usize> {
    let mut found = vec![start];
    let mut known = vec![false; vertices.len()];
    known[start] = true;
    let mut next = 0;
    while let Some(&v) = found.get(next) {
        next += 1;
        for &n in topology.neighbours.row(v) {
            let n = n as usize;
            if !known[n] && vertices[n].distance(vertices[start]) < reach {
                known[n] = true;
                found.push(n);
            }
        }
    }
    found
}

/// `z = a + b x + c y + d x² + e x y + f y²`
struct Paraboloid(Vector6<f64>);

impl Paraboloid {
    /// The least squares one; `None` through too few points.
    fn through(points: impl Iterator<Item = Vec3>) -> Option<Self> {
        let (mut ata, mut atb) = (Matrix6::zeros(), Vector6::zeros());
        for p in points {
            let row = terms(p.x, p.y);
            ata += row * row.transpose();
            atb += row * f64::from(p.z);
        }
        ata.cholesky().map(|factors| Self(factors.solve(&atb)))
    }

    fn height(&self, x: f32, y: f32) -> f32 {
        terms(x, y).dot(&self.0) as f32
    }
}

fn terms(x: f32, y: f32) -> Vector6<f64> {
    let (x, y) = (f64::from(x), f64::from(y));
    Vector6::new(1.0, x, y, x * x, x * y, y * y)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sphere of radius 1 round the origin as a grid of angles, with a spike at one vertex; its faces.
    fn spiked() -> (Vec<Vec3>, Vec<[u32; 3]>, usize) {
        let (rows, columns) = (40, 80);
        let at = |r: usize, c: usize| {
            let (polar, around) = (
                std::f32::consts::PI * (r as f32 + 0.5) / rows as f32,
                std::f32::consts::TAU * c as f32 / columns as f32,
            );
            Vec3::new(polar.sin() * around.cos(), polar.cos(), polar.sin() * around.sin())
        };
        let mut vertices: Vec<Vec3> = (0..rows * columns).map(|i| at(i / columns, i % columns)).collect();
        let index = |r: usize, c: usize| (r * columns + c % columns) as u32;
        let faces = (0..rows - 1)
            .flat_map(|r| (0..columns).map(move |c| (r, c)))
            .flat_map(|(r, c)| {
                let [a, b, c, d] = [index(r, c), index(r, c + 1), index(r + 1, c), index(r + 1, c + 1)];
                [[a, b, c], [b, d, c]]
            })
            .collect();
        let ear = rows / 2 * columns;
        vertices[ear] *= 1.3;
        (vertices, faces, ear)
    }

    #[test]
    fn a_spike_is_gone_and_the_rest_stays() {
        let (mut vertices, faces, ear) = spiked();
        let before = vertices.clone();
        patch(&mut vertices, &faces, &Topology::new(before.len(), &faces), ear, Vec3::new(-1.0, 0.0, 0.0));
        assert!((before[ear].length() - 1.3).abs() < 1e-3);
        for (v, (before, after)) in before.iter().zip(&vertices).enumerate() {
            let far = before.distance(vertices[ear]) > 0.9;
            assert!(!far || before == after, "vertex {v} moved");
            assert!((after.length() - 1.0).abs() < 0.08, "vertex {v} lies {} from the middle", after.length());
        }
    }
}
