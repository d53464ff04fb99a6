//! Nearest points of a triangle mesh: a tree of boxes over the triangles.

use glam::DVec3;

/// Triangles a leaf.
const LEAF: usize = 4;

enum Node {
    /// The children are the next node and the one at `second`.
    Inner { low: DVec3, high: DVec3, second: u32 },
    /// `triangles[start..end]`
    Leaf { low: DVec3, high: DVec3, start: u32, end: u32 },
}

impl Node {
    fn distance_squared(&self, p: DVec3) -> f64 {
        let (Self::Inner { low, high, .. } | Self::Leaf { low, high, .. }) = self;
        p.distance_squared(p.clamp(*low, *high))
    }
}

/// A triangle mesh prepared for nearest-point questions.
pub struct Surface {
    nodes: Vec<Node>,
    triangles: Vec<[DVec3; 3]>,
}

impl Surface {
    /// Faces with a corner that is not finite are left out.
    pub fn new(vertices: &[DVec3], faces: &[[u32; 3]]) -> Self {
        let corners = faces.iter().map(|f| f.map(|i| vertices[i as usize]));
        let mut triangles: Vec<[DVec3; 3]> = corners.filter(|t| t.iter().all(|p| p.is_finite())).collect();
        let mut nodes = Vec::new();
        let n = triangles.len();
        if n > 0 {
            build(&mut triangles, 0, n, &mut nodes);
        }
        Self { nodes, triangles }
    }

    /// The nearest point of the surface and its squared distance; `None` for an empty mesh.
    pub fn nearest(&self, p: DVec3) -> Option<(DVec3, f64)> {
        let mut best: Option<(DVec3, f64)> = None;
        let mut stack = vec![0u32];
        if self.nodes.is_empty() {
            return None;
        }
        while let Some(at) = stack.pop() {
            let node = &self.nodes[at as usize];
            if best.is_some_and(|(_, d)| node.distance_squared(p) >= d) {
                continue;
            }
            match node {
                Node::Inner { second, .. } => {
                    let (a, b) = (at + 1, *second);
                    let [da, db] = [a, b].map(|n| self.nodes[n as usize].distance_squared(p));
                    stack.extend(if da < db { [b, a] } else { [a, b] });
                }
                Node::Leaf { start, end, .. } => {
                    for triangle in &self.triangles[*start as usize..*end as usize] {
                        let q = nearest_on_triangle(p, triangle);
                        let d = p.distance_squared(q);
                        if best.is_none_or(|(_, known)| d < known) {
                            best = Some((q, d));
                        }
                    }
                }
            }
        }
        best
    }
}

fn build(triangles: &mut [[DVec3; 3]], first: usize, n: usize, nodes: &mut Vec<Node>) {
    let part = &mut triangles[..n];
    let low = part.iter().flatten().fold(DVec3::INFINITY, |a, &b| a.min(b));
    let high = part.iter().flatten().fold(DVec3::NEG_INFINITY, |a, &b| a.max(b));
    let at = nodes.len();
    nodes.push(Node::Leaf { low, high, start: first as u32, end: (first + n) as u32 });
    if n <= LEAF {
        return;
    }
    let axis = (high - low).max_position();
    let centre = |t: &[DVec3; 3]| t[0][axis] + t[1][axis] + t[2][axis];
    part.select_nth_unstable_by(n / 2, |a, b| centre(a).total_cmp(&centre(b)));
    let (left, right) = part.split_at_mut(n / 2);
    build(left, first, n / 2, nodes);
    let second = nodes.len() as u32;
    build(right, first + n / 2, n - n / 2, nodes);
    nodes[at] = Node::Inner { low, high, second };
}

/// The nearest point of a triangle, by the region of the plane in which `p` lies (Ericson 2005, section 5.1.5).
fn nearest_on_triangle(p: DVec3, &[a, b, c]: &[DVec3; 3]) -> DVec3 {
    let (ab, ac) = (b - a, c - a);
    let (d1, d2) = (ab.dot(p - a), ac.dot(p - a));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let (d3, d4) = (ab.dot(p - b), ac.dot(p - b));
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    let (d5, d6) = (ab.dot(p - c), ac.dot(p - c));
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    let scale = 1.0 / (va + vb + vc);
    a + ab * (vb * scale) + ac * (vc * scale)
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};

    use super::*;
    use crate::body::Body;

    fn vertices(body: &Body) -> Vec<DVec3> {
        body.v_template.iter().map(|v| DVec3::from(v.map(f64::from))).collect()
    }

    /// The nearest point by its definition: the smallest distance over a fine barycentric grid.
    #[test]
    fn a_triangle_agrees_with_a_search_over_its_points() {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(3);
        let mut point = || DVec3::new(rng.random(), rng.random(), rng.random());
        for _ in 0..60 {
            let (triangle, p) = ([point(), point(), point()], 3.0 * point() - 1.0);
            let steps = 60;
            let grid = (0..=steps).flat_map(|i| (0..=steps - i).map(move |j| (i as f64, j as f64)));
            let on = |(i, j): (f64, f64)| {
                let (u, v) = (i / steps as f64, j / steps as f64);
                triangle[0] * (1.0 - u - v) + triangle[1] * u + triangle[2] * v
            };
            let searched = grid.map(|g| p.distance(on(g))).fold(f64::INFINITY, f64::min);
            let ours = p.distance(nearest_on_triangle(p, &triangle));
            assert!(ours <= searched + 1e-12 && ours > searched - 0.03, "{ours} against {searched}");
        }
    }

    #[test]
    fn the_tree_agrees_with_trying_every_triangle() {
        let body = Body::test_body();
        let vertices = vertices(&body);
        let surface = Surface::new(&vertices, &body.faces);
        let mut rng = rand_pcg::Pcg64::seed_from_u64(4);
        for _ in 0..100 {
            let p = DVec3::new(rng.random(), rng.random(), rng.random()) * 2.0 - 1.0;
            let all =
                body.faces.iter().map(|f| p.distance_squared(nearest_on_triangle(p, &f.map(|i| vertices[i as usize]))));
            let want = all.fold(f64::INFINITY, f64::min);
            assert_eq!(surface.nearest(p).unwrap().1, want);
        }
    }

    #[test]
    fn an_empty_mesh_has_no_nearest_point() {
        assert!(Surface::new(&[], &[]).nearest(DVec3::ZERO).is_none());
    }
}
