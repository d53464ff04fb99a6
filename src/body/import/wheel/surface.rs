//! From the base mesh to the body's surface: what can be seen from outside, closed, as triangles.
//!
//! The base mesh has deep eye sockets and an open mouth. Both are cut at their rims: the mouth's rim is sewn up behind
//! the lips, and each eye gets a small dome that lies on the eyeball's sphere.

use std::collections::{HashMap, HashSet};

use glam::{DVec3, Vec2};

use super::base_mesh::{BaseMesh, Corner};
use super::rig::Influences;
use crate::body::import::{ImportError, bad};

/// The joint that the eyes follow.
const HEAD: u32 = 15;

/// A dome over an eye socket: a ring of new vertices half way in (one to every second vertex of the rim), and one in
/// the middle.
struct Eye {
    /// Base vertices, counter-clockwise from outside, an even number.
    rim: Vec<u32>,
    /// The joint cube in the eyeball's middle.
    cube: &'static str,
}

impl Eye {
    fn n_ring(&self) -> usize {
        self.rim.len() / 2
    }
}

pub(super) struct Surface {
    /// Base vertex of each vertex; the eyes' new vertices (left ring, left middle, right ring, right middle) follow.
    kept: Vec<u32>,
    eyes: [Eye; 2],
    pub faces: Vec<[u32; 3]>,
    /// glTF's convention: v runs down.
    pub uvs: Vec<[f32; 2]>,
    pub uv_faces: Vec<[u32; 3]>,
    pub mirror: Vec<u32>,
    /// Vertex of each base vertex that was kept.
    of_base: HashMap<u32, u32>,
}

impl Surface {
    pub(super) fn build(mesh: &BaseMesh) -> Result<Self, ImportError> {
        let hidden = |quad: &[Corner; 4]| quad.iter().all(|(v, _)| mesh.in_cavity[*v as usize]);
        let (cavities, visible): (Vec<_>, Vec<_>) = mesh.quads.iter().partition(|quad| hidden(quad));
        let [left_eye, right_eye, mouth] = rims(mesh, &cavities)?;
        // The layout has no seam at the rims, so a rim's vertex has one texture corner.
        let corner_of: HashMap<u32, u32> = cavities.iter().copied().flatten().copied().collect();

        let used: HashSet<u32> = visible.iter().copied().flatten().map(|(v, _)| *v).collect();
        let mut kept: Vec<u32> = used.into_iter().collect();
        kept.sort_unstable();
        let of_base = kept.iter().zip(0..).map(|(&base, i)| (base, i)).collect();
        let mut surface = Surface {
            kept,
            eyes: [Eye { rim: left_eye, cube: "l-eye" }, Eye { rim: right_eye, cube: "r-eye" }],
            faces: Vec::new(),
            uvs: mesh.uvs.iter().map(|[u, v]| [*u, 1.0 - v]).collect(),
            uv_faces: Vec::new(),
            mirror: Vec::new(),
            of_base,
        };
        for quad in visible {
            for triangle in split(mesh, quad) {
                surface.push(triangle);
            }
        }
        for triangle in sew(mesh, &mouth) {
            surface.push(triangle.map(|v| (v, corner_of[&v])));
        }
        surface.mirror = surface.kept.iter().map(|&base| surface.of_base[&mesh.mirror[base as usize]]).collect();
        surface.add_eyes(&corner_of);
        surface.drop_unused_uvs();
        Ok(surface)
    }

    fn push(&mut self, triangle: [Corner; 3]) {
        self.faces.push(triangle.map(|(v, _)| self.of_base[&v]));
        self.uv_faces.push(triangle.map(|(_, t)| t));
    }

    /// First new vertex of each eye.
    fn eye_starts(&self) -> [u32; 2] {
        let left = self.kept.len() as u32;
        [left, left + self.eyes[0].n_ring() as u32 + 1]
    }

    /// The vertices in the middle of the eyes, left and right.
    pub(super) fn pupils(&self) -> [u32; 2] {
        let starts = self.eye_starts();
        [0, 1].map(|side| starts[side] + self.eyes[side].n_ring() as u32)
    }

    /// The vertex that a base vertex became.
    pub(super) fn vertex(&self, base: u32) -> Result<u32, ImportError> {
        self.of_base.get(&base).copied().ok_or_else(|| bad(format!("base vertex {base}"), "is not on the surface"))
    }

    fn add_eyes(&mut self, corner_of: &HashMap<u32, u32>) {
        let starts = self.eye_starts();
        for (side, first) in starts.into_iter().enumerate() {
            let eye = &self.eyes[side];
            let (rim, n) = (&eye.rim, eye.n_ring());
            let rim_uv: Vec<Vec2> = rim.iter().map(|v| self.uvs[corner_of[v] as usize].into()).collect();
            let middle: Vec2 = rim_uv.iter().sum::<Vec2>() / rim.len() as f32;
            let first_uv = self.uvs.len() as u32;
            self.uvs.extend((0..n).map(|k| rim_uv[2 * k].lerp(middle, 0.5).to_array()));
            self.uvs.push(middle.to_array());

            let outer = |i: usize| {
                let base = rim[i % rim.len()];
                (self.of_base[&base], corner_of[&base])
            };
            let ring = |k: usize| (first + (k % n) as u32, first_uv + (k % n) as u32);
            let pupil = (first + n as u32, first_uv + n as u32);
            let mut triangles = Vec::new();
            for k in 0..n {
                triangles.push([outer(2 * k), outer(2 * k + 1), ring(k)]);
                triangles.push([outer(2 * k + 1), ring(k + 1), ring(k)]);
                triangles.push([outer(2 * k + 1), outer(2 * k + 2), ring(k + 1)]);
                triangles.push([ring(k), ring(k + 1), pupil]);
            }
            self.faces.extend(triangles.iter().map(|t| t.map(|(v, _)| v)));
            self.uv_faces.extend(triangles.iter().map(|t| t.map(|(_, uv)| uv)));

            // The right rim runs as the mirrored left one, backwards.
            let other = starts[1 - side];
            self.mirror.extend((0..n).map(|k| other + ((n - k) % n) as u32));
            self.mirror.push(other + n as u32);
        }
    }

    fn drop_unused_uvs(&mut self) {
        let mut used: Vec<u32> = self.uv_faces.as_flattened().to_vec();
        used.sort_unstable();
        used.dedup();
        let new_of: HashMap<u32, u32> = used.iter().zip(0..).map(|(&old, new)| (old, new)).collect();
        self.uvs = used.iter().map(|&old| self.uvs[old as usize]).collect();
        for corner in self.uv_faces.as_flattened_mut() {
            *corner = new_of[corner];
        }
    }

    /// The surface's vertices on a morphed base mesh, in its pose.
    pub(super) fn vertices(&self, mesh: &BaseMesh, morphed: &[[f32; 3]]) -> Result<Vec<[f32; 3]>, ImportError> {
        let mut out: Vec<[f32; 3]> = self.kept.iter().map(|&base| morphed[base as usize]).collect();
        for eye in &self.eyes {
            let rim: Vec<DVec3> = eye.rim.iter().map(|&v| DVec3::from(morphed[v as usize].map(f64::from))).collect();
            let centre = mesh.cube(morphed, eye.cube)?;
            // The nearest point of the rim gives the radius, so that the dome lies under the lids everywhere.
            let radius = rim.iter().map(|p| p.distance(centre)).fold(f64::INFINITY, f64::min);
            let middle = rim.iter().sum::<DVec3>() / rim.len() as f64;
            let on_sphere = |p: DVec3| (centre + radius * (p - centre).normalize()).to_array().map(|x| x as f32);
            out.extend((0..eye.n_ring()).map(|k| on_sphere(rim[2 * k].lerp(middle, 0.5))));
            out.push(on_sphere(middle));
        }
        Ok(out)
    }

    /// The surface's weights from the base mesh's.
    pub(super) fn influences(&self, base: &[Influences]) -> Vec<Influences> {
        let mut out: Vec<Influences> = self.kept.iter().map(|&v| base[v as usize]).collect();
        let new = self.eyes.iter().map(|eye| eye.n_ring() + 1).sum::<usize>();
        out.resize(out.len() + new, ([HEAD, 0, 0, 0], [1.0, 0.0, 0.0, 0.0]));
        out
    }
}

/// Two triangles along the shorter diagonal.
fn split(mesh: &BaseMesh, quad: &[Corner; 4]) -> [[Corner; 3]; 2] {
    let [a, b, c, d] = *quad;
    let length = |(p, _): Corner, (q, _): Corner| {
        let [p, q] = [p, q].map(|v| glam::Vec3::from(mesh.vertices[v as usize]));
        p.distance_squared(q)
    };
    if length(a, c) <= length(b, d) { [[a, b, c], [a, c, d]] } else { [[a, b, d], [b, c, d]] }
}

/// The cavities' rims: left eye, right eye (the mirrored left one, backwards), mouth; each in the direction in which
/// the cavity's own faces pass it, which is counter-clockwise for what covers it.
fn rims(mesh: &BaseMesh, cavities: &[&[Corner; 4]]) -> Result<[Vec<u32>; 3], ImportError> {
    let edges: HashSet<(u32, u32)> =
        cavities.iter().flat_map(|quad| (0..4).map(|i| (quad[i].0, quad[(i + 1) % 4].0))).collect();
    let next: HashMap<u32, u32> = edges.iter().copied().filter(|&(a, b)| !edges.contains(&(b, a))).collect();
    let mut starts: Vec<u32> = next.keys().copied().collect();
    starts.sort_unstable();
    let mut seen = HashSet::new();
    let (mut left, mut right, mut mouth) = (Vec::new(), Vec::new(), Vec::new());
    for start in starts {
        let mut rim = Vec::new();
        let mut at = start;
        while seen.insert(at) {
            rim.push(at);
            at = *next.get(&at).ok_or_else(|| bad("internal cavities", "a rim is open"))?;
        }
        let sides: Vec<f32> = rim.iter().map(|&v| mesh.vertices[v as usize][0]).collect();
        match rim.is_empty() {
            true => {}
            false if sides.iter().all(|&x| x > 0.0) => left = rim,
            false if sides.iter().all(|&x| x < 0.0) => right = rim,
            false => mouth = rim,
        }
    }
    let mirrored: Vec<u32> =
        (0..left.len()).map(|i| mesh.mirror[left[(left.len() - i) % left.len()] as usize]).collect();
    let same = |a: &[u32], b: &[u32]| a.iter().collect::<HashSet<_>>() == b.iter().collect::<HashSet<_>>();
    if left.len() < 8 || left.len() % 2 != 0 || mouth.len() < 8 || !same(&mirrored, &right) {
        let reason = format!("rims of {}, {} and {} vertices", left.len(), right.len(), mouth.len());
        return Err(bad("internal cavities", format!("{reason}, expected two mirrored eyes and a mouth")));
    }
    Ok([left, mirrored, mouth])
}

/// Triangles between the upper and the lower half of a rim, from corner to corner.
fn sew(mesh: &BaseMesh, rim: &[u32]) -> Vec<[u32; 3]> {
    let x = |i: &usize| mesh.vertices[rim[*i] as usize][0];
    let n = rim.len();
    let left = (0..n).max_by(|a, b| x(a).total_cmp(&x(b))).unwrap_or(0);
    let right = (0..n).min_by(|a, b| x(a).total_cmp(&x(b))).unwrap_or(0);
    let n_forward = (right + n - left) % n;
    let forward = |i: usize| rim[(left + i) % n];
    let backward = |j: usize| rim[(left + n - j) % n];
    let (mut i, mut j, mut out) = (0, 0, Vec::new());
    let n_backward = n - n_forward;
    while i < n_forward || j < n_backward {
        // The half that has come less far goes on.
        let advance = j == n_backward || (i < n_forward && (i + 1) * n_backward <= (j + 1) * n_forward);
        let triangle = match advance {
            true => [forward(i), forward(i + 1), backward(j)],
            false => [backward(j + 1), backward(j), forward(i)],
        };
        (i, j) = if advance { (i + 1, j) } else { (i, j + 1) };
        if triangle[0] != triangle[2] && triangle[1] != triangle[2] {
            out.push(triangle);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use std::f32::consts::TAU;

    use super::*;

    /// A rim of `n` vertices on an ellipse, counter-clockwise seen from +Z.
    fn ellipse(n: usize) -> (BaseMesh, Vec<u32>) {
        let angle = |i: usize| TAU * i as f32 / n as f32;
        let vertices: Vec<[f32; 3]> = (0..n).map(|i| [3.0 * angle(i).cos(), angle(i).sin(), 0.0]).collect();
        let in_cavity = vec![true; n];
        let mirror = Vec::new();
        (BaseMesh { vertices, in_cavity, mirror, ..BaseMesh::default() }, (0..n as u32).collect())
    }

    #[test]
    fn a_sewn_rim_is_covered_once_by_faces_that_look_outward() {
        for (n, start) in [(8, 0), (9, 2), (38, 11)] {
            let (mesh, mut rim) = ellipse(n);
            rim.rotate_left(start);
            let triangles = sew(&mesh, &rim);
            assert_eq!(triangles.len(), n - 2);
            let area = |t: &[u32; 3]| {
                let [a, b, c] = t.map(|v| Vec2::new(mesh.vertices[v as usize][0], mesh.vertices[v as usize][1]));
                (b - a).perp_dot(c - a) / 2.0
            };
            assert!(triangles.iter().all(|t| area(t) > 0.0), "{n} vertices");
            let polygon = 3.0 * n as f32 / 2.0 * (TAU / n as f32).sin();
            assert!((triangles.iter().map(area).sum::<f32>() - polygon).abs() < 1e-4, "{n} vertices");
        }
    }

    #[test]
    fn a_cavity_without_two_eyes_and_a_mouth_is_refused() {
        let (mesh, rim) = ellipse(8);
        let quad = [rim[0], rim[2], rim[4], rim[6]].map(|v| (v, v));
        let error = rims(&mesh, &[&quad]).unwrap_err().to_string();
        assert!(error.contains("expected two mirrored eyes and a mouth"), "{error}");
    }
}
