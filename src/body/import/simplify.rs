//! Fewer faces where a body has many more than a video can show: fingers, toes, ears.
//!
//! Edges are collapsed in the order of the quadric error (Garland and Heckbert 1997), each onto one of its ends, so
//! that the vertices that stay keep all they have: position, shape, weights, texture corner. Both sides of the body
//! collapse together, texture seams and landmarks stay as they are, and edges longer than a limit are left alone.

use std::cmp::Ordering;
use std::collections::{BinaryHeap, HashMap, HashSet};

use glam::{DVec2, DVec3};

use crate::body::{Body, KeypointSource, N_INFLUENCES};

/// When to stop.
pub struct Limits {
    pub n_faces: usize,
    /// Edges are collapsed up to this length, metres.
    pub max_edge: f64,
    /// Factor on the cost of changing a vertex that hangs mostly on this joint.
    pub importance: fn(joint: u32) -> f64,
}

/// The smallest dot product of a face's normals before and after.
const MIN_NORMAL_DOT: f64 = 0.6;

/// The smallest quality of a new face: 4√3·area / sum of squared edges, 1 for an equilateral one.
const MIN_QUALITY: f64 = 0.2;

const MAX_VALENCE: usize = 9;

/// The mean squared distance from a set of planes, as a symmetric 4×4 matrix: area-weighted sums of `p pᵀ`.
#[derive(Clone, Copy, Default)]
struct Quadric([f64; 10]);

impl Quadric {
    fn of_face([a, b, c]: [DVec3; 3]) -> Self {
        let normal = (b - a).cross(c - a);
        let area = normal.length() / 2.0;
        let n = normal.normalize_or_zero();
        let p = [n.x, n.y, n.z, -n.dot(a)];
        let mut out = [0.0; 10];
        let pairs = (0..4).flat_map(|i| (i..4).map(move |j| (i, j)));
        for (value, (i, j)) in out.iter_mut().zip(pairs) {
            *value = area * p[i] * p[j];
        }
        Self(out)
    }

    fn add(&mut self, other: &Self) {
        self.0.iter_mut().zip(other.0).for_each(|(a, b)| *a += b);
    }

    fn error(&self, p: DVec3) -> f64 {
        let q = &self.0;
        let square = q[0] * p.x * p.x + q[4] * p.y * p.y + q[7] * p.z * p.z;
        let mixed = q[1] * p.x * p.y + q[2] * p.x * p.z + q[5] * p.y * p.z;
        square + 2.0 * (mixed + q[3] * p.x + q[6] * p.y + q[8] * p.z) + q[9]
    }
}

/// A candidate: `from` moves onto `to`. The heap gives the cheapest first, equal ones by index.
struct Collapse {
    cost: f64,
    from: u32,
    to: u32,
    /// Both ends' stamps when the cost was computed.
    stamps: [u32; 2],
}

impl Collapse {
    fn key(&self) -> (u32, u32) {
        (self.from, self.to)
    }
}

impl Ord for Collapse {
    fn cmp(&self, other: &Self) -> Ordering {
        other.cost.total_cmp(&self.cost).then_with(|| other.key().cmp(&self.key()))
    }
}

impl PartialOrd for Collapse {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Collapse {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Collapse {}

struct Mesh<'a> {
    body: &'a Body,
    points: Vec<DVec3>,
    /// Faces and their texture corners; `None` once collapsed.
    faces: Vec<Option<([u32; 3], [u32; 3])>>,
    n_faces: usize,
    /// Faces at each vertex.
    around: Vec<Vec<u32>>,
    /// Landmarks and vertices on texture seams.
    fixed: Vec<bool>,
    quadrics: Vec<Quadric>,
    stamps: Vec<u32>,
    /// Cost factors.
    importance: Vec<f64>,
    max_edge: f64,
}

/// The joint with the largest weight.
fn main_joint(joints: &[u32; N_INFLUENCES], weights: &[f32; N_INFLUENCES]) -> u32 {
    let largest = (0..N_INFLUENCES).max_by(|&a, &b| weights[a].total_cmp(&weights[b]));
    largest.map_or(0, |k| joints[k])
}

impl<'a> Mesh<'a> {
    fn new(body: &'a Body, limits: &Limits) -> Self {
        let n = body.n_vertices();
        let points: Vec<DVec3> = body.v_template.iter().map(|v| DVec3::from(v.map(f64::from))).collect();
        let mut mesh = Mesh {
            body,
            faces: body.faces.iter().copied().zip(body.uv_faces.iter().copied()).map(Some).collect(),
            n_faces: body.n_faces(),
            around: vec![Vec::new(); n],
            fixed: vec![false; n],
            quadrics: vec![Quadric::default(); n],
            stamps: vec![0; n],
            points,
            importance: body
                .lbs_joints
                .iter()
                .zip(&body.lbs_weights)
                .map(|(j, w)| (limits.importance)(main_joint(j, w)))
                .collect(),
            max_edge: limits.max_edge,
        };
        let mut corners: Vec<Option<u32>> = vec![None; n];
        for (i, (face, uv_face)) in body.faces.iter().zip(&body.uv_faces).enumerate() {
            let quadric = Quadric::of_face(face.map(|v| mesh.points[v as usize]));
            for (&v, &corner) in face.iter().zip(uv_face) {
                let v = v as usize;
                mesh.around[v].push(i as u32);
                mesh.quadrics[v].add(&quadric);
                mesh.fixed[v] |= *corners[v].get_or_insert(corner) != corner;
            }
        }
        for point in body.keypoints.iter().flat_map(|set| &set.points) {
            if let KeypointSource::Vertices(vertices) = point {
                vertices.iter().for_each(|&v| mesh.fixed[v as usize] = true);
            }
        }
        // What is fixed on one side is fixed on the other.
        for v in 0..n {
            mesh.fixed[v] |= mesh.fixed[body.mirror[v] as usize];
        }
        mesh
    }

    fn mirror(&self, v: u32) -> u32 {
        self.body.mirror[v as usize]
    }

    fn faces_at(&self, v: u32) -> impl Iterator<Item = ([u32; 3], [u32; 3])> {
        self.around[v as usize].iter().filter_map(|&i| self.faces[i as usize])
    }

    fn neighbours(&self, v: u32) -> HashSet<u32> {
        self.faces_at(v).flat_map(|(face, _)| face).filter(|&u| u != v).collect()
    }

    fn collapse(&self, from: u32, to: u32) -> Collapse {
        let mut quadric = self.quadrics[from as usize];
        quadric.add(&self.quadrics[to as usize]);
        let at = self.points[to as usize];
        // Where the surface is flat, short edges go first.
        let length = at.distance_squared(self.points[from as usize]);
        let cost = quadric.error(at).max(0.0) + 1e-4 * length * length;
        let cost = cost * self.importance[from as usize];
        Collapse { cost, from, to, stamps: [self.stamps[from as usize], self.stamps[to as usize]] }
    }

    /// Whether a collapse keeps the surface closed, unfolded and symmetric.
    fn allows(&self, from: u32, to: u32) -> bool {
        let (other_from, other_to) = (self.mirror(from), self.mirror(to));
        let near = self.neighbours(from);
        let apart = if other_from == from {
            other_to == to
        } else {
            // The two collapses must not meet.
            other_to != to && other_to != from && !near.contains(&other_from) && !near.contains(&other_to)
        };
        apart
            && self.mirror(other_from) == from
            && self.mirror(other_to) == to
            && self.keeps_shape(from, to, &near)
            && (other_from == from || self.keeps_shape(other_from, other_to, &self.neighbours(other_from)))
    }

    fn keeps_shape(&self, from: u32, to: u32, near: &HashSet<u32>) -> bool {
        let far = self.neighbours(to);
        let common = near.intersection(&far).count();
        let valence = near.len() + far.len() - 2 - common;
        if self.fixed[from as usize] || common != 2 || near.len() < 4 || valence > MAX_VALENCE {
            return false;
        }
        let target = self.points[to as usize];
        let corner = self.faces_at(from).find_map(|(face, uv)| Some(uv[face.iter().position(|&v| v == to)?]));
        let Some(corner) = corner else { return false };
        let uv = |corner: u32| DVec2::from(self.body.uvs[corner as usize].map(f64::from));
        self.faces_at(from).filter(|(face, _)| !face.contains(&to)).all(|(face, uv_face)| {
            let before = face.map(|v| self.points[v as usize]);
            let after = face.map(|v| if v == from { target } else { self.points[v as usize] });
            let [old, new] = [before, after].map(|[a, b, c]| (b - a).cross(c - a));
            let [a, b, c] = after;
            let squares = [b - a, c - b, a - c].map(|edge| edge.length_squared());
            let quality = 2.0 * 3f64.sqrt() * new.length() / squares.iter().sum::<f64>();
            let uv_before = uv_face.map(uv);
            let uv_after: [DVec2; 3] = std::array::from_fn(|k| if face[k] == from { uv(corner) } else { uv_before[k] });
            let [uv_old, uv_new] = [uv_before, uv_after].map(|[a, b, c]| (b - a).perp_dot(c - a));
            old.normalize_or_zero().dot(new.normalize_or_zero()) > MIN_NORMAL_DOT
                && quality > MIN_QUALITY
                && squares.iter().all(|square| square.sqrt() < 1.6 * self.max_edge)
                && uv_old * uv_new > 0.0
                && uv_new.abs() > 1e-9
        })
    }

    fn apply(&mut self, from: u32, to: u32) {
        let corner = self.faces_at(from).find_map(|(face, uv)| Some(uv[face.iter().position(|&v| v == to)?]));
        for i in std::mem::take(&mut self.around[from as usize]) {
            let Some((face, uv_face)) = &mut self.faces[i as usize] else { continue };
            if face.contains(&to) {
                self.faces[i as usize] = None;
                self.n_faces -= 1;
                continue;
            }
            for (v, uv) in face.iter_mut().zip(uv_face) {
                if *v == from {
                    (*v, *uv) = (to, corner.unwrap_or(*uv));
                }
            }
            self.around[to as usize].push(i);
        }
        let quadric = self.quadrics[from as usize];
        self.quadrics[to as usize].add(&quadric);
        self.stamps[from as usize] += 1;
        for v in self.neighbours(to).into_iter().chain([to]) {
            self.stamps[v as usize] += 1;
        }
    }

    /// Every collapse along the edges at `v`, of either end.
    fn push_candidates(&self, heap: &mut BinaryHeap<Collapse>, v: u32) {
        for u in self.neighbours(v) {
            if self.points[v as usize].distance(self.points[u as usize]) <= self.max_edge {
                heap.push(self.collapse(v, u));
                heap.push(self.collapse(u, v));
            }
        }
    }

    fn run(&mut self, n_faces: usize) {
        let mut heap = BinaryHeap::new();
        (0..self.points.len() as u32).for_each(|v| self.push_candidates(&mut heap, v));
        while self.n_faces > n_faces {
            let Some(Collapse { from, to, stamps, .. }) = heap.pop() else { return };
            let current = [self.stamps[from as usize], self.stamps[to as usize]];
            if stamps != current || !self.allows(from, to) {
                continue;
            }
            let (other_from, other_to) = (self.mirror(from), self.mirror(to));
            self.apply(from, to);
            if other_from != from {
                self.apply(other_from, other_to);
            }
            for v in [to, other_to] {
                for near in self.neighbours(v) {
                    self.push_candidates(&mut heap, near);
                }
            }
        }
    }
}

/// The body with fewer faces; unchanged where it has no texture layout (seams would be unknown).
pub fn simplify(body: Body, limits: &Limits) -> Body {
    if body.uvs.is_empty() {
        return body;
    }
    let mut mesh = Mesh::new(&body, limits);
    mesh.run(limits.n_faces);
    let (faces, uv_faces): (Vec<_>, Vec<_>) = mesh.faces.iter().flatten().copied().unzip();
    restrict(&body, &faces, &uv_faces)
}

/// Indices in use, ascending, and their new places.
fn used(faces: &[[u32; 3]]) -> (Vec<usize>, HashMap<u32, u32>) {
    let mut kept: Vec<u32> = faces.as_flattened().to_vec();
    kept.sort_unstable();
    kept.dedup();
    let new_of = kept.iter().zip(0..).map(|(&old, new)| (old, new)).collect();
    (kept.into_iter().map(|old| old as usize).collect(), new_of)
}

/// The body with these faces and only the vertices that they use.
fn restrict(body: &Body, faces: &[[u32; 3]], uv_faces: &[[u32; 3]]) -> Body {
    let (kept, new_of) = used(faces);
    let (kept_uvs, new_uv_of) = used(uv_faces);
    let row = 3 * body.n_betas;
    let mut keypoints = body.keypoints.clone();
    for point in keypoints.iter_mut().flat_map(|set| &mut set.points) {
        if let KeypointSource::Vertices(vertices) = point {
            vertices.iter_mut().for_each(|v| *v = new_of[v]);
        }
    }
    let posedirs = body.posedirs.chunks_exact(body.n_vertices() * 3);
    Body {
        name: body.name.clone(),
        v_template: kept.iter().map(|&v| body.v_template[v]).collect(),
        shapedirs: kept.iter().flat_map(|&v| &body.shapedirs[v * row..][..row]).copied().collect(),
        posedirs: posedirs.flat_map(|feature| kept.iter().flat_map(|&v| &feature[v * 3..][..3])).copied().collect(),
        j_template: body.j_template.clone(),
        j_shapedirs: body.j_shapedirs.clone(),
        n_betas: body.n_betas,
        parents: body.parents.clone(),
        lbs_joints: kept.iter().map(|&v| body.lbs_joints[v]).collect(),
        lbs_weights: kept.iter().map(|&v| body.lbs_weights[v]).collect(),
        faces: faces.iter().map(|face| face.map(|v| new_of[&v])).collect(),
        uvs: kept_uvs.iter().map(|&corner| body.uvs[corner]).collect(),
        uv_faces: uv_faces.iter().map(|face| face.map(|corner| new_uv_of[&corner])).collect(),
        mirror: kept.iter().map(|&v| new_of[&body.mirror[v]]).collect(),
        keypoints,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn simplified() -> Body {
        simplify(Body::test_body(), &Limits { n_faces: 700, max_edge: 0.12, importance: |_| 1.0 })
    }

    #[test]
    fn the_surface_stays_closed_and_valid() {
        let body = simplified();
        body.check().unwrap();
        assert!((690..=702).contains(&body.n_faces()), "{} faces", body.n_faces());
        let edges: HashSet<(u32, u32)> =
            body.faces.iter().flat_map(|f| (0..3).map(|i| (f[i], f[(i + 1) % 3]))).collect();
        assert_eq!(edges.len(), body.n_faces() * 3);
        assert!(edges.iter().all(|&(a, b)| edges.contains(&(b, a))));
    }

    #[test]
    fn what_stays_is_what_was_there_on_both_sides() {
        let (before, after) = (Body::test_body(), simplified());
        let row = |body: &Body, v: usize| body.shapedirs[v * 9..][..9].to_vec();
        for (v, point) in after.v_template.iter().enumerate() {
            let old = (0..before.n_vertices())
                .find(|&o| before.v_template[o] == *point && before.lbs_joints[o] == after.lbs_joints[v])
                .unwrap();
            assert_eq!(row(&after, v), row(&before, old));
            let [x, y, z] = after.v_template[after.mirror[v] as usize];
            assert!(glam::Vec3::new(-x, y, z).distance((*point).into()) < 1e-5);
        }
        for (a, b) in after.keypoints.iter().zip(&before.keypoints) {
            for (p, q) in a.points.iter().zip(&b.points) {
                if let (KeypointSource::Vertices(p), KeypointSource::Vertices(q)) = (p, q) {
                    assert_eq!(after.v_template[p[0] as usize], before.v_template[q[0] as usize]);
                }
            }
        }
    }

    #[test]
    fn long_edges_are_left_alone() {
        let body = simplify(Body::test_body(), &Limits { n_faces: 0, max_edge: 1e-4, importance: |_| 1.0 });
        assert_eq!(body, Body::test_body());
    }

    #[test]
    fn important_parts_keep_more() {
        let arms = |importance| {
            let body = simplify(Body::test_body(), &Limits { n_faces: 900, max_edge: 0.12, importance });
            body.lbs_joints.iter().filter(|joints| (16..24).contains(&joints[0])).count()
        };
        assert!(arms(|joint| if joint >= 16 { 100.0 } else { 1.0 }) > arms(|_| 1.0));
    }

    #[test]
    fn the_quadric_is_the_squared_distance_from_the_plane_times_the_area() {
        let face = [DVec3::new(0.0, 0.0, 1.0), DVec3::new(2.0, 0.0, 1.0), DVec3::new(0.0, 1.0, 1.0)];
        let error = Quadric::of_face(face).error(DVec3::new(5.0, -7.0, 4.0));
        assert!((error - 9.0).abs() < 1e-12, "{error}");
    }
}
