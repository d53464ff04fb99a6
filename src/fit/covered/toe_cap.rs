//! A foot that ends like a shoe: the toes' vertices go to the convex hull of the front of the foot.

use std::f32::consts::PI;

use glam::Vec3;

use super::mean_around;
use crate::body::Body;
use crate::math::smoothstep;
use crate::ops::Topology;

/// Part of a vertex' weight from which on it goes all the way.
const WHOLLY: f32 = 0.5;
/// How far behind the toes' beginning lies what all directions start from, and by how much the cap is larger than the hull, of the
/// way from ankle to foot: as its corners are cut, it is as long as the toes then.
const BEHIND: f32 = 0.22;
const LARGER: f32 = 0.045;
/// Planes round the hull, and rounds until the toes' sides no longer lie across each other (200 leave dents on the default body).
const PLANES: usize = 500;
const ROUNDS: usize = 400;
/// Rounds of smoothing in the end, which take the corners off.
const LAST_ROUNDS: usize = 2;

/// Moves the toes of one foot. `joints` are its ankle and foot, `places` where these lie.
pub(super) fn cap(vertices: &mut [Vec3], body: &Body, topology: &Topology, joints: [usize; 2], places: [Vec3; 2]) {
    let toes = |v: usize| body.weight_of(v, |joint| joint as usize == joints[1]);
    let region: Vec<(usize, f32)> = (0..vertices.len())
        .map(|v| (v, toes(v)))
        .filter(|(_, weight)| *weight > 0.0)
        .map(|(v, weight)| (v, smoothstep(weight / WHOLLY)))
        .collect();
    let ahead = Vec3 { y: 0.0, ..places[1] - places[0] };
    let begin: Vec<Vec3> = region.iter().filter(|r| (0.2..0.95).contains(&toes(r.0))).map(|r| vertices[r.0]).collect();
    if begin.is_empty() || ahead.length() <= 0.0 {
        return;
    }
    let centre = begin.iter().sum::<Vec3>() / begin.len() as f32 - BEHIND * ahead;
    let of_foot = |v: usize| body.weight_of(v, |joint| joints.contains(&(joint as usize))) > 0.5;
    let front = (0..vertices.len()).filter(|&v| of_foot(v)).map(|v| vertices[v] - centre);
    let hull = Hull::of(front.filter(|p| p.dot(ahead) > 0.0), LARGER * ahead.length());
    let before = vertices.to_vec();
    for round in 0..ROUNDS + LAST_ROUNDS {
        let moved: Vec<Vec3> = region
            .iter()
            .map(|&(v, part)| {
                let between = vertices[v].midpoint(mean_around(vertices, topology, v));
                match round < ROUNDS {
                    true => before[v].lerp(centre + hull.reached(between - centre), part),
                    false => vertices[v].lerp(between, part),
                }
            })
            .collect();
        region.iter().zip(moved).for_each(|(&(v, _), moved)| vertices[v] = moved);
    }
}

/// A convex hull round the origin, by planes that touch it.
struct Hull {
    /// Unit normals, and how far away each plane is.
    planes: Vec<(Vec3, f32)>,
}

impl Hull {
    fn of(points: impl Iterator<Item = Vec3>, larger: f32) -> Self {
        let points: Vec<Vec3> = points.collect();
        let away = |n: Vec3| points.iter().map(|p| p.dot(n)).fold(0.0, f32::max) + larger;
        Self { planes: directions(PLANES).map(|n| (n, away(n))).collect() }
    }

    /// Where the ray through `point` leaves.
    fn reached(&self, point: Vec3) -> Vec3 {
        let to = point.normalize_or(Vec3::Z);
        let distance = |(n, away): &(Vec3, f32)| away / n.dot(to).max(1e-3);
        to * self.planes.iter().map(distance).fold(f32::INFINITY, f32::min)
    }
}

/// Directions that lie evenly all round (Fibonacci's spiral).
fn directions(n: usize) -> impl Iterator<Item = Vec3> {
    let golden = PI * (1.0 + 5.0f32.sqrt());
    (0..n).map(move |i| {
        let (y, angle) = (1.0 - (2 * i + 1) as f32 / n as f32, golden * (i as f32 + 0.5));
        let across = (1.0 - y * y).sqrt();
        Vec3::new(across * angle.cos(), y, across * angle.sin())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ray_leaves_a_box_on_its_sides() {
        let corners = [-1.0, 1.0].into_iter().flat_map(|x| [-1.5, 1.5].map(|y| Vec3::new(x, y, 0.7)));
        let hull = Hull::of(corners.flat_map(|p| [p, Vec3 { z: -0.7, ..p }]), 0.0);
        // Of so many planes none lies just on a side, and those beside it are held off by the corners.
        for (to, reached) in
            [(Vec3::X, 1.0), (Vec3::Y, 1.5), (-Vec3::Z, 0.7), (Vec3::new(1.0, 1.0, 0.0), 2.0f32.sqrt())]
        {
            let found = hull.reached(0.1 * to).length();
            assert!((reached..1.15 * reached).contains(&found), "{to}: {found}");
        }
    }
}
