//! What lies next to what on a triangle mesh, computed once a body on the host.

use std::collections::BTreeMap;

/// Lists of different lengths in one array: list i is `items[starts[i] .. starts[i + 1]]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rows {
    /// `[n + 1]`
    pub starts: Vec<u32>,
    pub items: Vec<u32>,
}

impl Rows {
    pub fn from_lists<'a>(lists: impl IntoIterator<Item = &'a Vec<u32>>) -> Self {
        let mut rows = Self { starts: vec![0], items: Vec::new() };
        for list in lists {
            rows.items.extend(list);
            rows.starts.push(rows.items.len() as u32);
        }
        rows
    }

    /// How many lists there are.
    pub fn len(&self) -> usize {
        self.starts.len() - 1
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    pub fn row(&self, i: usize) -> &[u32] {
        &self.items[self.starts[i] as usize..self.starts[i + 1] as usize]
    }

    pub fn iter(&self) -> impl Iterator<Item = &[u32]> {
        (0..self.len()).map(|i| self.row(i))
    }
}

/// The topology of a mesh. All lists are sorted.
#[derive(Clone, Debug)]
pub struct Topology {
    /// Undirected edges, the smaller vertex first.
    pub edges: Vec<[u32; 2]>,
    /// Pairs of faces that share an edge, once an edge, the smaller face first. An edge of more than two faces gives each
    /// pair of them.
    pub face_pairs: Vec<[u32; 2]>,
    /// `[F]`: the other faces of each face's pairs.
    pub face_neighbours: Rows,
    /// `[V]`: the corners (3·face + 0, 1 or 2) at each vertex.
    pub corners: Rows,
    /// `[V]`: the vertices that share an edge with each vertex.
    pub neighbours: Rows,
}

impl Topology {
    /// # Panics
    /// When a face names a vertex that is not there.
    pub fn new(n_vertices: usize, faces: &[[u32; 3]]) -> Self {
        let mut by_edge: BTreeMap<[u32; 2], Vec<u32>> = BTreeMap::new();
        let mut corners = vec![Vec::new(); n_vertices];
        for (f, &[a, b, c]) in faces.iter().enumerate() {
            for [i, j] in [[a, b], [b, c], [c, a]] {
                by_edge.entry([i.min(j), i.max(j)]).or_default().push(f as u32);
            }
            for (k, v) in [a, b, c].into_iter().enumerate() {
                corners[v as usize].push((3 * f + k) as u32);
            }
        }
        let mut neighbours = vec![Vec::new(); n_vertices];
        let mut face_pairs = Vec::new();
        for ([i, j], faces) in &by_edge {
            neighbours[*i as usize].push(*j);
            neighbours[*j as usize].push(*i);
            for (k, &f) in faces.iter().enumerate() {
                face_pairs.extend(faces[k + 1..].iter().map(|&g| [f, g]));
            }
        }
        face_pairs.sort_unstable();
        neighbours.iter_mut().for_each(|list| list.sort_unstable());
        Self {
            edges: by_edge.into_keys().collect(),
            face_neighbours: face_neighbours(faces.len(), &face_pairs),
            face_pairs,
            corners: Rows::from_lists(&corners),
            neighbours: Rows::from_lists(&neighbours),
        }
    }

    /// Whether the faces close a volume: along each edge as many of them run one way as the other. A ray that comes and goes then
    /// meets as many fronts as backs, so that fronts alone cover what all cover.
    pub fn is_closed(faces: &[[u32; 3]]) -> bool {
        let mut balance: BTreeMap<[u32; 2], i32> = BTreeMap::new();
        for &[a, b, c] in faces {
            for [i, j] in [[a, b], [b, c], [c, a]] {
                *balance.entry([i.min(j), i.max(j)]).or_default() += if i < j { 1 } else { -1 };
            }
        }
        balance.values().all(|&n| n == 0)
    }

    /// Whether a mesh [closes](Self::is_closed) a volume that its faces look out of.
    pub fn looks_out(vertices: &[[f32; 3]], faces: &[[u32; 3]]) -> bool {
        let volume = |face: &[u32; 3]| -> f64 {
            let [a, b, c] = face.map(|v| glam::DVec3::from_array(vertices[v as usize].map(f64::from)));
            a.dot(b.cross(c))
        };
        Self::is_closed(faces) && faces.iter().map(volume).sum::<f64>() > 0.0
    }

    /// The same mesh, with pairs of those faces alone for which `counts` holds.
    pub fn with_pairs_of(&self, counts: impl Fn(u32) -> bool) -> Self {
        let mut kept = self.clone();
        kept.face_pairs.retain(|pair| pair.iter().all(|&f| counts(f)));
        kept.face_neighbours = face_neighbours(self.face_neighbours.len(), &kept.face_pairs);
        kept
    }
}

fn face_neighbours(n_faces: usize, face_pairs: &[[u32; 2]]) -> Rows {
    let mut lists = vec![Vec::new(); n_faces];
    for &[f, g] in face_pairs {
        lists[f as usize].push(g);
        lists[g as usize].push(f);
    }
    lists.iter_mut().for_each(|list| list.sort_unstable());
    Rows::from_lists(&lists)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fan_of_two_faces_and_a_lonely_vertex() {
        let t = Topology::new(5, &[[0, 1, 2], [2, 1, 3]]);
        assert_eq!(t.edges, [[0, 1], [0, 2], [1, 2], [1, 3], [2, 3]]);
        assert_eq!(t.face_pairs, [[0, 1]]);
        assert_eq!(t.face_neighbours, Rows { starts: vec![0, 1, 2], items: vec![1, 0] });
        assert_eq!(t.corners.iter().collect::<Vec<_>>(), [&[0][..], &[1, 4], &[2, 3], &[5], &[]]);
        assert_eq!(t.neighbours.iter().collect::<Vec<_>>(), [&[1, 2][..], &[0, 2, 3], &[0, 1, 3], &[1, 2], &[]]);
    }

    #[test]
    fn pairs_of_faces_that_do_not_count_are_left_out() {
        let t = Topology::new(5, &[[0, 1, 2], [2, 1, 3], [3, 1, 4]]);
        let kept = t.with_pairs_of(|f| f != 0);
        assert_eq!(kept.face_pairs, [[1, 2]]);
        assert_eq!(kept.face_neighbours, Rows { starts: vec![0, 0, 1, 2], items: vec![2, 1] });
        assert_eq!((kept.edges, kept.corners), (t.edges, t.corners));
    }

    #[test]
    fn a_closed_mesh_has_no_rim_and_no_face_that_is_turned_over() {
        let tetrahedron = [[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]];
        assert!(Topology::is_closed(&tetrahedron));
        assert!(!Topology::is_closed(&tetrahedron[1..]));
        let mut turned = tetrahedron;
        turned[2].swap(0, 1);
        assert!(!Topology::is_closed(&turned));
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]];
        let inwards = tetrahedron.map(|[a, b, c]| [a, c, b]);
        let out = [&tetrahedron, &inwards].map(|faces| Topology::looks_out(&corners, faces));
        assert_eq!(out, [true, false]);
        assert!(!Topology::looks_out(&corners, &tetrahedron[1..]));
    }

    #[test]
    fn an_edge_of_three_faces_gives_three_pairs() {
        let t = Topology::new(5, &[[0, 1, 2], [1, 0, 3], [0, 1, 4]]);
        assert_eq!(t.face_pairs, [[0, 1], [0, 2], [1, 2]]);
    }
}
