//! A texture layout for bodies without one: within each part of the body (trunk, head, limbs) faces grow into charts
//! along the six axis directions, each chart is projected along its direction without overlap, stood upright and packed on
//! shelves. Deterministic.

use std::collections::{HashMap, HashSet, VecDeque};

use glam::{Vec2, Vec3};

use super::UvLayout;
use crate::body::{Body, N_JOINTS};

/// A face joins a chart while its normal is within 66° of the chart's direction: areas shrink by 2.5 at most.
const MIN_COSINE: f32 = 0.4;

/// Free space round a chart, in widths of the texture: 8 texels at 2048.
const MARGIN: f32 = 8.0 / 2048.0;

/// Texels a metre of the head's charts relative to the rest: people look at faces.
const HEAD_SCALE: f32 = 1.6;
const HEAD: usize = 1;

/// Part of the body that each joint belongs to: trunk 0, head 1, arms 2 and 3, legs 4 and 5. Parts become charts of
/// their own, because a whole figure packs badly.
const PARTS: [usize; N_JOINTS] = [0, 4, 5, 0, 4, 5, 0, 4, 5, 0, 4, 5, 1, 0, 0, 1, 2, 3, 2, 3, 2, 3, 2, 3];

const DIRECTIONS: [Vec3; 6] = [Vec3::Z, Vec3::NEG_Z, Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y];

/// Faces with their projected corners, the smallest corner at the origin.
struct Chart {
    faces: Vec<u32>,
    points: HashMap<u32, Vec2>,
    size: Vec2,
}

/// Lays out `body` in its T-pose. Every face gets texture corners; each chart covers texture space once.
pub(super) fn unwrap(body: &Body) -> UvLayout {
    let charts = charts(body);
    let (scale, places) = pack(&charts);
    let mut layout = UvLayout { uvs: Vec::new(), uv_faces: vec![[0; 3]; body.faces.len()] };
    for (chart, place) in charts.iter().zip(places) {
        let mut index = HashMap::new();
        for &face in &chart.faces {
            layout.uv_faces[face as usize] = body.faces[face as usize].map(|v| {
                *index.entry(v).or_insert_with(|| {
                    layout.uvs.push((place + chart.points[&v] * scale).to_array());
                    layout.uvs.len() as u32 - 1
                })
            });
        }
    }
    layout
}

/// Corners of a direction's projection plane, so that the picture is not mirrored seen from outside.
fn plane(direction: Vec3) -> (Vec3, Vec3) {
    let down = if direction.y.abs() > 0.5 { Vec3::Z * direction.y } else { Vec3::NEG_Y };
    (direction.cross(down), down)
}

fn charts(body: &Body) -> Vec<Chart> {
    let corner = |v: u32| Vec3::from(body.v_template[v as usize]);
    let normals: Vec<Vec3> = body
        .faces
        .iter()
        .map(|f| (corner(f[1]) - corner(f[0])).cross(corner(f[2]) - corner(f[0])).normalize_or_zero())
        .collect();
    let neighbours = neighbours(&body.faces);
    let parts: Vec<usize> = body.faces.iter().map(|face| part(body, face)).collect();
    let mut free = vec![true; body.faces.len()];
    let mut charts = Vec::new();
    // Faces that look most clearly along an axis begin first, so that the large charts do.
    let clearest = |f: u32| DIRECTIONS.iter().map(|d| d.dot(normals[f as usize])).fold(f32::MIN, f32::max);
    let mut seeds: Vec<u32> = (0..body.faces.len() as u32).collect();
    seeds.sort_by(|&a, &b| clearest(b).total_cmp(&clearest(a)).then(a.cmp(&b)));
    for seed in seeds {
        if !free[seed as usize] {
            continue;
        }
        let normal = normals[seed as usize];
        let direction =
            DIRECTIONS.into_iter().max_by(|a, b| a.dot(normal).total_cmp(&b.dot(normal))).unwrap_or(Vec3::Z);
        let (right, down) = plane(direction);
        let project = |v: u32| Vec2::new(right.dot(corner(v)), down.dot(corner(v)));
        let mut grown = Grown::default();
        let mut queue = VecDeque::from([seed]);
        while let Some(face) = queue.pop_front() {
            let looks = face == seed || normals[face as usize].dot(direction) > MIN_COSINE;
            let looks = looks && parts[face as usize] == parts[seed as usize];
            if !free[face as usize] || !looks || !grown.add(body.faces[face as usize], project) {
                continue;
            }
            free[face as usize] = false;
            grown.faces.push(face);
            queue.extend(&neighbours[face as usize]);
        }
        charts.push(grown.chart(if parts[seed as usize] == HEAD { HEAD_SCALE } else { 1.0 }, project));
    }
    charts
}

/// The part that moves the face most.
fn part(body: &Body, face: &[u32; 3]) -> usize {
    let mut shares = [0.0; 6];
    for &v in face {
        for (&joint, weight) in body.lbs_joints[v as usize].iter().zip(body.lbs_weights[v as usize]) {
            shares[PARTS[joint as usize]] += weight;
        }
    }
    (0..6).max_by(|&a, &b| f32::total_cmp(&shares[a], &shares[b])).unwrap_or(0)
}

/// Faces that share an edge with each face.
fn neighbours(faces: &[[u32; 3]]) -> Vec<Vec<u32>> {
    let mut by_edge: HashMap<[u32; 2], Vec<u32>> = HashMap::new();
    let edges = |f: &[u32; 3]| [[f[0], f[1]], [f[1], f[2]], [f[2], f[0]]].map(|[a, b]| [a.min(b), a.max(b)]);
    for (i, face) in faces.iter().enumerate() {
        edges(face).into_iter().for_each(|e| by_edge.entry(e).or_default().push(i as u32));
    }
    let others = |(i, face): (usize, &[u32; 3])| {
        edges(face).iter().flat_map(|e| &by_edge[e]).copied().filter(|&f| f != i as u32).collect()
    };
    faces.iter().enumerate().map(others).collect()
}

/// A chart as it grows, with a coarse grid over its plane to find overlaps.
#[derive(Default)]
struct Grown {
    faces: Vec<u32>,
    triangles: Vec<([u32; 3], [Vec2; 3])>,
    cells: HashMap<[i32; 2], Vec<u32>>,
}

/// Cells of the overlap grid, in metres: about an edge of a body's mesh.
const CELL: f32 = 0.02;

impl Grown {
    /// Takes the face unless its projection overlaps what is there.
    fn add(&mut self, face: [u32; 3], project: impl Fn(u32) -> Vec2) -> bool {
        let points = face.map(project);
        let low = (points[0].min(points[1]).min(points[2]) / CELL).floor();
        let high = (points[0].max(points[1]).max(points[2]) / CELL).floor();
        let cells =
            || (low.x as i32..=high.x as i32).flat_map(move |x| (low.y as i32..=high.y as i32).map(move |y| [x, y]));
        let near: HashSet<u32> = cells().filter_map(|c| self.cells.get(&c)).flatten().copied().collect();
        if near.iter().any(|&i| overlap(&points, &self.triangles[i as usize].1)) {
            return false;
        }
        let index = self.triangles.len() as u32;
        self.triangles.push((face, points));
        cells().for_each(|c| self.cells.entry(c).or_default().push(index));
        true
    }

    fn chart(self, scale: f32, project: impl Fn(u32) -> Vec2) -> Chart {
        let corners = self.triangles.iter().flat_map(|(face, _)| face);
        let mut points: HashMap<u32, Vec2> = corners.map(|&v| (v, project(v) * scale)).collect();
        let low = points.values().fold(Vec2::INFINITY, |a, &b| a.min(b));
        points.values_mut().for_each(|p| *p -= low);
        let mut size = points.values().fold(Vec2::ZERO, |a, &b| a.max(b));
        if size.x > size.y {
            points.values_mut().for_each(|p| *p = Vec2::new(size.y - p.y, p.x));
            size = Vec2::new(size.y, size.x);
        }
        Chart { faces: self.faces, points, size }
    }
}

/// Whether the interiors of two triangles overlap: no edge of either separates them (with a tolerance, so that
/// neighbours along an edge do not).
fn overlap(a: &[Vec2; 3], b: &[Vec2; 3]) -> bool {
    let separated = |a: &[Vec2; 3], b: &[Vec2; 3]| {
        (0..3).any(|k| {
            let (p, q, inside) = (a[k], a[(k + 1) % 3], a[(k + 2) % 3]);
            let normal = (q - p).perp().normalize_or_zero();
            let side = normal.dot(inside - p).signum();
            b.iter().all(|&x| side * normal.dot(x - p) <= 1e-6)
        })
    };
    !separated(a, b) && !separated(b, a)
}

/// Places for all charts on the unit square at the largest scale that fits (shelves, tallest first).
fn pack(charts: &[Chart]) -> (f32, Vec<Vec2>) {
    let mut order: Vec<usize> = (0..charts.len()).collect();
    order.sort_by(|&a, &b| charts[b].size.y.total_cmp(&charts[a].size.y).then(a.cmp(&b)));
    let (mut low, mut high) = (0.0f32, 4.0f32);
    for _ in 0..24 {
        let middle = 0.5 * (low + high);
        match shelves(charts, &order, middle) {
            Some(_) => low = middle,
            None => high = middle,
        }
    }
    let places = shelves(charts, &order, low).unwrap_or_else(|| vec![Vec2::splat(0.5); charts.len()]);
    (low, places)
}

fn shelves(charts: &[Chart], order: &[usize], scale: f32) -> Option<Vec<Vec2>> {
    let mut places = vec![Vec2::ZERO; charts.len()];
    let (mut at, mut shelf) = (Vec2::splat(MARGIN), 0.0f32);
    for &i in order {
        let size = charts[i].size * scale;
        if at.x + size.x + MARGIN > 1.0 {
            at = Vec2::new(MARGIN, at.y + shelf + MARGIN);
            shelf = 0.0;
        }
        if at.x + size.x + MARGIN > 1.0 || at.y + size.y + MARGIN > 1.0 {
            return None;
        }
        places[i] = at;
        at.x += size.x + MARGIN;
        shelf = shelf.max(size.y);
    }
    Some(places)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn layout() -> (Body, UvLayout) {
        let body = Body { uvs: Vec::new(), uv_faces: Vec::new(), ..Body::test_body() };
        let layout = UvLayout::of_body(&body);
        (body, layout)
    }

    #[test]
    fn no_point_of_the_texture_belongs_to_two_faces() {
        let (body, layout) = layout();
        let corners = |f: usize| layout.uv_faces[f].map(|i| Vec2::from(layout.uvs[i as usize]));
        for a in 0..body.n_faces() {
            for b in a + 1..body.n_faces() {
                assert!(!overlap(&corners(a), &corners(b)), "faces {a} and {b} overlap");
            }
        }
    }

    #[test]
    fn the_layout_uses_the_square_and_is_repeatable() {
        let (body, layout) = layout();
        assert!(layout.uvs.iter().flatten().all(|x| (0.0..=1.0).contains(x)));
        let area: f32 = layout
            .uv_faces
            .iter()
            .map(|f| {
                let [a, b, c] = f.map(|i| Vec2::from(layout.uvs[i as usize]));
                0.5 * (b - a).perp_dot(c - a).abs()
            })
            .sum();
        assert!(area > 0.25, "only {area} of the texture is used");
        assert_eq!(UvLayout::of_body(&body), layout);
    }

    #[test]
    fn charts_are_not_mirrored() {
        let (_, layout) = layout();
        // v runs down, so a face that is counter-clockwise seen from outside turns clockwise in (u, v).
        for f in &layout.uv_faces {
            let [a, b, c] = f.map(|i| Vec2::from(layout.uvs[i as usize]));
            assert!((b - a).perp_dot(c - a) <= 1e-7, "{f:?}");
        }
    }
}
