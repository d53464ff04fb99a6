//! A small humanoid made in code: for tests and examples, where no body file is at hand.
//!
//! Closed tubes (trunk with head, arms, legs, feet), each watertight by itself, overlapping where limbs meet the
//! trunk. Vertices and joints are linear in the shape parameters, so the shape space is exact.

use std::f32::consts::TAU;

use super::{Body, Landmarks, N_INFLUENCES, N_JOINTS, PARENTS};

const N_BETAS: usize = 3;

/// Size, girth, length of the legs: relative change for a unit of each component.
const STEPS: [f32; N_BETAS] = [0.04, 0.12, 0.05];

/// A closed tube along an axis: rings of `segments` vertices between two poles.
struct Tube {
    /// 0 x, 1 y, 2 z; stations ascend or descend along it.
    axis: usize,
    segments: usize,
    /// `[position along the axis, centre of the two other axes (cyclic order), their radii]`; the first and the
    /// last are the poles, without radius.
    stations: Vec<[f32; 5]>,
    /// Joint that takes over from the one before at this position; the first holds from the start.
    chain: Vec<(u32, f32)>,
    /// Length over which one joint hands over to the next.
    blend: f32,
    /// Rectangle of the texture: u, v, width, height.
    chart: [f32; 4],
}

/// Joints of the template, left and middle; the right side mirrors them.
const JOINTS: [(usize, [f32; 3]); 15] = [
    (0, [0.0, 0.0, 0.0]),
    (1, [0.09, -0.05, 0.0]),
    (3, [0.0, 0.10, 0.0]),
    (4, [0.09, -0.47, 0.0]),
    (6, [0.0, 0.21, 0.0]),
    (7, [0.09, -0.87, 0.0]),
    (9, [0.0, 0.31, 0.0]),
    (10, [0.09, -0.91, 0.12]),
    (12, [0.0, 0.49, 0.0]),
    (13, [0.06, 0.42, 0.0]),
    (15, [0.0, 0.58, 0.0]),
    (16, [0.18, 0.44, 0.0]),
    (18, [0.44, 0.44, 0.0]),
    (20, [0.68, 0.44, 0.0]),
    (22, [0.76, 0.44, 0.0]),
];

fn trunk() -> Tube {
    let rings = [
        [-0.12, 0.0, 0.0, 0.0, 0.0],
        [-0.11, 0.0, 0.0, 0.08, 0.11],
        [-0.04, 0.0, 0.0, 0.11, 0.165],
        [0.03, 0.0, 0.0, 0.11, 0.165],
        [0.10, 0.0, 0.0, 0.10, 0.15],
        [0.17, 0.0, 0.0, 0.10, 0.145],
        [0.24, 0.0, 0.0, 0.105, 0.155],
        [0.31, 0.0, 0.0, 0.11, 0.165],
        [0.38, 0.0, 0.0, 0.11, 0.165],
        [0.44, 0.0, 0.0, 0.085, 0.14],
        [0.48, 0.0, 0.0, 0.06, 0.08],
        [0.54, 0.01, 0.0, 0.055, 0.055],
        [0.58, 0.02, 0.0, 0.085, 0.07],
        [0.63, 0.02, 0.0, 0.10, 0.08],
        [0.68, 0.02, 0.0, 0.105, 0.08],
        [0.74, 0.01, 0.0, 0.08, 0.065],
        [0.77, 0.01, 0.0, 0.0, 0.0],
    ];
    Tube {
        axis: 1,
        segments: 12,
        stations: rings.into(),
        chain: vec![(0, 0.0), (3, 0.10), (6, 0.21), (9, 0.31), (12, 0.49), (15, 0.58)],
        blend: 0.08,
        chart: [0.0, 0.0, 0.5, 0.5],
    }
}

fn left_limbs() -> [Tube; 3] {
    let arm = [
        [0.10, 0.44, 0.0, 0.0, 0.0],
        [0.12, 0.44, 0.0, 0.045, 0.045],
        [0.18, 0.44, 0.0, 0.055, 0.055],
        [0.26, 0.44, 0.0, 0.05, 0.05],
        [0.36, 0.44, 0.0, 0.045, 0.045],
        [0.44, 0.44, 0.0, 0.042, 0.042],
        [0.52, 0.44, 0.0, 0.04, 0.04],
        [0.61, 0.44, 0.0, 0.034, 0.034],
        [0.68, 0.44, 0.0, 0.026, 0.03],
        [0.76, 0.44, 0.0, 0.018, 0.042],
        [0.83, 0.44, 0.0, 0.012, 0.035],
        [0.86, 0.44, 0.0, 0.0, 0.0],
    ];
    let leg = [
        [0.02, 0.0, 0.09, 0.0, 0.0],
        [-0.01, 0.0, 0.09, 0.07, 0.06],
        [-0.08, 0.0, 0.09, 0.085, 0.08],
        [-0.18, 0.0, 0.09, 0.08, 0.075],
        [-0.30, 0.0, 0.09, 0.07, 0.065],
        [-0.40, 0.0, 0.09, 0.058, 0.055],
        [-0.47, 0.0, 0.09, 0.055, 0.052],
        [-0.56, 0.0, 0.09, 0.055, 0.05],
        [-0.68, 0.0, 0.09, 0.048, 0.044],
        [-0.80, 0.0, 0.09, 0.036, 0.034],
        [-0.87, 0.0, 0.09, 0.036, 0.034],
        [-0.90, 0.0, 0.09, 0.0, 0.0],
    ];
    let foot = [
        [-0.06, 0.09, -0.90, 0.0, 0.0],
        [-0.04, 0.09, -0.90, 0.03, 0.03],
        [0.02, 0.09, -0.895, 0.036, 0.042],
        [0.08, 0.09, -0.905, 0.042, 0.032],
        [0.14, 0.09, -0.915, 0.042, 0.022],
        [0.18, 0.09, -0.92, 0.03, 0.014],
        [0.20, 0.09, -0.92, 0.0, 0.0],
    ];
    [
        Tube {
            axis: 0,
            segments: 8,
            stations: arm.into(),
            chain: vec![(13, 0.0), (16, 0.18), (18, 0.44), (20, 0.68), (22, 0.76)],
            blend: 0.08,
            chart: [0.5, 0.0, 0.25, 0.5],
        },
        Tube {
            axis: 1,
            segments: 10,
            stations: leg.into(),
            chain: vec![(0, 0.0), (1, -0.05), (4, -0.47), (7, -0.87)],
            blend: 0.10,
            chart: [0.0, 0.5, 0.25, 0.5],
        },
        Tube {
            axis: 2,
            segments: 8,
            stations: foot.into(),
            chain: vec![(7, 0.0), (10, 0.12)],
            blend: 0.06,
            chart: [0.5, 0.5, 0.25, 0.25],
        },
    ]
}

/// A tube's faces, their texture corners, and the corners' places.
struct TubeFaces {
    faces: Vec<[u32; 3]>,
    uv_faces: Vec<[u32; 3]>,
    uvs: Vec<[f32; 2]>,
}

impl Tube {
    fn n_vertices(&self) -> usize {
        (self.stations.len() - 2) * self.segments + 2
    }

    fn ascends(&self) -> bool {
        self.stations[0][0] < self.stations[1][0]
    }

    /// Index of a ring's vertex; ring 0 is the first after the pole.
    fn vertex(&self, ring: usize, k: usize) -> u32 {
        (1 + ring * self.segments + k % self.segments) as u32
    }

    /// The other pole is vertex 0.
    fn last_pole(&self) -> u32 {
        self.n_vertices() as u32 - 1
    }

    fn position(&self, station: [f32; 5], angle: f32) -> [f32; 3] {
        let [along, c1, c2, r1, r2] = station;
        let mut p = [0.0; 3];
        p[self.axis] = along;
        p[(self.axis + 1) % 3] = c1 - r1 * angle.cos();
        p[(self.axis + 2) % 3] = c2 + r2 * angle.sin();
        p
    }

    /// Every vertex: its position on the tube and its distance vector from the axis (which girth scales).
    fn vertices(&self) -> Vec<([f32; 3], [f32; 3])> {
        let centre = |s: [f32; 5]| self.position([s[0], s[1], s[2], 0.0, 0.0], 0.0);
        let last = self.stations.len() - 1;
        let mut out = vec![(centre(self.stations[0]), [0.0; 3])];
        for &station in &self.stations[1..last] {
            for k in 0..self.segments {
                let p = self.position(station, TAU * k as f32 / self.segments as f32);
                let c = centre(station);
                out.push((p, std::array::from_fn(|i| p[i] - c[i])));
            }
        }
        out.push((centre(self.stations[last]), [0.0; 3]));
        out
    }

    fn weights(&self, along: f32) -> ([u32; N_INFLUENCES], [f32; N_INFLUENCES]) {
        let sign = if self.ascends() { 1.0 } else { -1.0 };
        let (mut joints, mut weights) = ([self.chain[0].0, 0, 0, 0], [1.0, 0.0, 0.0, 0.0]);
        for &(joint, start) in &self.chain[1..] {
            let share = (sign * (along - start) / self.blend + 0.5).clamp(0.0, 1.0);
            if share >= 1.0 {
                (joints, weights) = ([joint, 0, 0, 0], [1.0, 0.0, 0.0, 0.0]);
            } else if share > 0.0 {
                (joints, weights) = ([joints[0], joint, 0, 0], [1.0 - share, share, 0.0, 0.0]);
            }
        }
        (joints, weights)
    }

    /// Faces with their texture corners and the corners themselves. The texture's columns are the segments with the
    /// first repeated at the seam; a pole has one corner a segment.
    fn faces(&self, chart: [f32; 4]) -> TubeFaces {
        let (n, rings) = (self.segments, self.stations.len() - 2);
        let margin = 0.01;
        let corner = |column: f32, row: usize| {
            let (u, v) = (column / n as f32, row as f32 / (rings + 1) as f32);
            [chart[0] + margin + u * (chart[2] - 2.0 * margin), chart[1] + margin + v * (chart[3] - 2.0 * margin)]
        };
        let mut uvs = Vec::new();
        for ring in 0..rings {
            uvs.extend((0..=n).map(|k| corner(k as f32, ring + 1)));
        }
        uvs.extend((0..n).map(|k| corner(k as f32 + 0.5, 0)));
        uvs.extend((0..n).map(|k| corner(k as f32 + 0.5, rings + 1)));
        let at = |ring: usize, k: usize| (ring * (n + 1) + k) as u32;
        let pole = |end: usize, k: usize| (rings * (n + 1) + end * n + k) as u32;

        let (mut faces, mut uv_faces) = (Vec::new(), Vec::new());
        let mut push = |face: [u32; 3], uv: [u32; 3]| {
            let turn = |[a, b, c]: [u32; 3]| if self.ascends() { [a, b, c] } else { [a, c, b] };
            faces.push(turn(face));
            uv_faces.push(turn(uv));
        };
        for k in 0..n {
            let v = |ring, k| self.vertex(ring, k);
            push([0, v(0, k), v(0, k + 1)], [pole(0, k), at(0, k), at(0, k + 1)]);
            for r in 0..rings - 1 {
                push([v(r, k), v(r + 1, k), v(r, k + 1)], [at(r, k), at(r + 1, k), at(r, k + 1)]);
                push([v(r, k + 1), v(r + 1, k), v(r + 1, k + 1)], [at(r, k + 1), at(r + 1, k), at(r + 1, k + 1)]);
            }
            let r = rings - 1;
            push([self.last_pole(), v(r, k + 1), v(r, k)], [pole(1, k), at(r, k + 1), at(r, k)]);
        }
        TubeFaces { faces, uv_faces, uvs }
    }
}

/// Displacement of a point for a unit of each component: size, girth, length of the legs.
fn shape_steps(point: [f32; 3], off_axis: [f32; 3]) -> [[f32; N_BETAS]; 3] {
    let below_hip = (point[1] + 0.05).min(0.0);
    std::array::from_fn(|axis| {
        let leg = if axis == 1 { below_hip } else { 0.0 };
        [STEPS[0] * point[axis], STEPS[1] * off_axis[axis], STEPS[2] * leg]
    })
}

fn mirrored([x, y, z]: [f32; 3]) -> [f32; 3] {
    [-x, y, z]
}

/// The joint on the other side: left and right stand next to each other in SMPL's order.
fn mirrored_joint(joint: u32) -> u32 {
    match super::JOINT_NAMES[joint as usize].split_once('_') {
        Some(("left", _)) => joint + 1,
        Some(("right", _)) => joint - 1,
        _ => joint,
    }
}

impl Body {
    fn add_tube(&mut self, tube: &Tube, right: bool) {
        let first = self.v_template.len() as u32;
        for (point, off_axis) in tube.vertices() {
            let (mut joints, weights) = tube.weights(point[tube.axis]);
            let (mut point, mut off_axis) = (point, off_axis);
            if right {
                (point, off_axis) = (mirrored(point), mirrored(off_axis));
                for (joint, weight) in joints.iter_mut().zip(weights) {
                    *joint = if weight > 0.0 { mirrored_joint(*joint) } else { 0 };
                }
            }
            self.v_template.push(point);
            self.shapedirs.extend(shape_steps(point, off_axis).as_flattened());
            self.lbs_joints.push(joints);
            self.lbs_weights.push(weights);
        }
        let [u, v, width, height] = tube.chart;
        let chart = if right { [u + width, v, width, height] } else { tube.chart };
        let first_uv = self.uvs.len() as u32;
        let TubeFaces { faces, uv_faces, uvs } = tube.faces(chart);
        let turn = |[a, b, c]: [u32; 3]| if right { [a, c, b] } else { [a, b, c] };
        self.faces.extend(faces.into_iter().map(|f| turn(f).map(|i| i + first)));
        self.uv_faces.extend(uv_faces.into_iter().map(|f| turn(f).map(|i| i + first_uv)));
        self.uvs.extend(uvs);
    }

    /// A small closed humanoid of 1.7 m with 634 vertices and 3 shape components (size, girth, length of the legs),
    /// weights blended at the joints, a texture layout, all keypoint sets and no pose blend shapes.
    pub fn test_body() -> Body {
        let mut body = Body {
            name: "test".to_owned(),
            v_template: Vec::new(),
            shapedirs: Vec::new(),
            posedirs: Vec::new(),
            j_template: vec![[0.0; 3]; N_JOINTS],
            j_shapedirs: Vec::new(),
            n_betas: N_BETAS,
            parents: PARENTS.to_vec(),
            lbs_joints: Vec::new(),
            lbs_weights: Vec::new(),
            faces: Vec::new(),
            uvs: Vec::new(),
            uv_faces: Vec::new(),
            mirror: Vec::new(),
            keypoints: Vec::new(),
        };
        for (joint, point) in JOINTS {
            body.j_template[joint] = point;
            if point[0] > 0.0 {
                body.j_template[joint + 1] = mirrored(point);
            }
        }
        body.j_shapedirs = body.j_template.iter().flat_map(|&p| shape_steps(p, [0.0; 3])).flatten().collect();

        let trunk = trunk();
        body.add_tube(&trunk, false);
        let n = trunk.segments as u32;
        body.mirror.extend(0..trunk.n_vertices() as u32);
        for ring in 0..trunk.stations.len() - 2 {
            for k in 0..trunk.segments {
                body.mirror[trunk.vertex(ring, k) as usize] = trunk.vertex(ring, (n as usize) - k);
            }
        }
        let mut feet = [0; 2];
        let limbs = left_limbs();
        for tube in &limbs {
            let (left, count) = (body.v_template.len() as u32, tube.n_vertices() as u32);
            body.add_tube(tube, false);
            body.add_tube(tube, true);
            body.mirror.extend(left + count..left + 2 * count);
            body.mirror.extend(left..left + count);
            feet = [left, left + count];
        }

        let foot = &limbs[2];
        let face = |ring, k| vec![trunk.vertex(ring, k)];
        let landmarks = Landmarks {
            nose: face(12, 6),
            eyes: [face(13, 5), face(13, 7)],
            ears: [face(12, 3), face(12, 9)],
            big_toes: feet.map(|first| vec![first + foot.last_pole()]),
            small_toes: feet.map(|first| vec![first + foot.vertex(3, 4)]),
            heels: feet.map(|first| vec![first]),
        };
        body.keypoints = landmarks.keypoint_sets();
        body
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use super::*;
    use glam::Vec3;

    #[test]
    fn every_edge_is_shared_by_two_faces_in_opposite_directions() {
        let body = Body::test_body();
        let mut edges: HashMap<[u32; 2], i32> = HashMap::new();
        for [a, b, c] in &body.faces {
            for edge in [[*a, *b], [*b, *c], [*c, *a]] {
                *edges.entry(edge).or_default() += 1;
            }
        }
        assert!(edges.iter().all(|(&[a, b], &count)| count == 1 && edges.get(&[b, a]) == Some(&1)));
    }

    #[test]
    fn faces_look_away_from_the_axis_of_their_tube() {
        let body = Body::test_body();
        let mut first = 0;
        let limbs = left_limbs().map(|limb| limb.n_vertices()).into_iter().flat_map(|n| [n, n]);
        for n_vertices in std::iter::once(trunk().n_vertices()).chain(limbs) {
            let range = first..first + n_vertices as u32;
            let volume: f32 = body
                .faces
                .iter()
                .filter(|face| range.contains(&face[0]))
                .map(|face| {
                    let [a, b, c] = face.map(|i| Vec3::from(body.v_template[i as usize]));
                    a.cross(b).dot(c) / 6.0
                })
                .sum();
            assert!(volume > 1e-4, "tube at vertex {first} has volume {volume}");
            first = range.end;
        }
        assert_eq!(first as usize, body.n_vertices());
    }

    #[test]
    fn the_mirror_swaps_sides_and_keeps_weights() {
        let body = Body::test_body();
        for (i, &m) in body.mirror.iter().enumerate() {
            let (p, q) = (Vec3::from(body.v_template[i]), Vec3::from(mirrored(body.v_template[m as usize])));
            assert!(p.distance(q) < 1e-5, "vertex {i}");
            assert_eq!(body.mirror[m as usize] as usize, i);
            let joints = |v: usize| std::iter::zip(body.lbs_joints[v], body.lbs_weights[v]).filter(|(_, w)| *w > 0.0);
            assert!(joints(i).eq(joints(m as usize).map(|(j, w)| (mirrored_joint(j), w))), "vertex {i}");
        }
    }

    #[test]
    fn landmarks_lie_where_their_names_say() {
        let body = Body::test_body();
        let point = |format: &str, k: usize| match &body.keypoint_set(format).unwrap().points[k] {
            crate::body::KeypointSource::Vertices(v) => Vec3::from(body.v_template[v[0] as usize]),
            other => panic!("{other:?}"),
        };
        let [nose, left_eye, right_ear] = [0, 1, 4].map(|k| point("coco17", k));
        assert!(nose.z > 0.1 && nose.x.abs() < 1e-6);
        assert!(left_eye.x > 0.0 && left_eye.y > nose.y && right_ear.x < -0.07);
        let [big_toe, small_toe, heel] = [19, 20, 21].map(|k| point("body25", k));
        assert!(big_toe.z > 0.15 && small_toe.x > big_toe.x && heel.z < -0.05 && heel.x > 0.0);
    }
}
