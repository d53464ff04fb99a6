//! The body as the solver sees it: a kinematic chain in double precision and points that ride on it,
//! with the analytic derivatives of those points.

use glam::{DMat3, DVec3};

use super::rotation;
use super::state::{Frame, Layout, Shared};
use crate::body::{Body, KeypointSource, N_JOINTS, PARENTS};

/// Shape components that are fitted: the first ones, which hold nearly all of the variance.
pub const MOST_BETAS: usize = 16;

/// One joint's share of a point under linear blend skinning.
#[derive(Clone, Debug)]
struct Influence {
    joint: usize,
    weight: f64,
    /// `weight · p` in the zero pose.
    rest: DVec3,
    /// How `rest` moves with each beta.
    dirs: Vec<DVec3>,
}

/// A point that rides on the body: the mean of vertices or joints.
#[derive(Clone, Debug)]
pub struct Point {
    influences: Vec<Influence>,
}

/// The chain and the shape space of its joints.
#[derive(Clone, Debug)]
pub struct Rig {
    joints: [DVec3; N_JOINTS],
    /// `[24][B]`
    joint_dirs: Vec<Vec<DVec3>>,
}

/// The chain in one pose.
pub struct Posed {
    pub rotations: [DMat3; N_JOINTS],
    pub positions: [DVec3; N_JOINTS],
    rest: [DVec3; N_JOINTS],
    /// Columns: the axes in space about which the parameters of the joint turn.
    axes: [DMat3; N_JOINTS],
    /// `[24][B]`: how positions move with the shape, the pelvis held.
    d_positions: Vec<Vec<DVec3>>,
}

/// How a point moves with the parameters: the columns that move it at all.
#[derive(Default)]
pub struct PointJacobian {
    pub frame: Vec<(usize, DVec3)>,
    pub shared: Vec<(usize, DVec3)>,
}

fn dvec(v: [f32; 3]) -> DVec3 {
    DVec3::new(v[0].into(), v[1].into(), v[2].into())
}

/// The fitted shape directions of item `i` of a `[N, 3, B]` array.
fn dirs_of(dirs: &[f32], i: usize, n_betas: usize) -> Vec<DVec3> {
    let at = |axis: usize, b: usize| f64::from(dirs[(i * 3 + axis) * n_betas + b]);
    (0..n_betas.min(MOST_BETAS)).map(|b| DVec3::new(at(0, b), at(1, b), at(2, b))).collect()
}

impl Rig {
    pub fn new(body: &Body) -> Self {
        let mut joints = [DVec3::ZERO; N_JOINTS];
        for (joint, template) in joints.iter_mut().zip(&body.j_template) {
            *joint = dvec(*template);
        }
        let joint_dirs = (0..N_JOINTS).map(|j| dirs_of(&body.j_shapedirs, j, body.n_betas)).collect();
        Self { joints, joint_dirs }
    }

    /// Of the fit; the body may have more.
    pub fn n_betas(&self) -> usize {
        self.joint_dirs[0].len()
    }

    /// Joints of the shaped body in the zero pose.
    pub fn rest_joints(&self, betas: &[f64]) -> [DVec3; N_JOINTS] {
        let mut rest = self.joints;
        for (joint, dirs) in rest.iter_mut().zip(&self.joint_dirs) {
            *joint += dirs.iter().zip(betas).map(|(d, b)| *d * *b).sum::<DVec3>();
        }
        rest
    }

    pub fn pose(&self, frame: &Frame, shared: &Shared) -> Posed {
        let rest = self.rest_joints(&shared.betas);
        let n_betas = self.n_betas();
        let mut posed = Posed {
            rotations: [frame.root; N_JOINTS],
            positions: [frame.pelvis; N_JOINTS],
            rest,
            axes: [frame.root; N_JOINTS],
            d_positions: vec![vec![DVec3::ZERO; n_betas]; N_JOINTS],
        };
        for j in 1..N_JOINTS {
            let parent = PARENTS[j] as usize;
            let to_space = posed.rotations[parent];
            posed.positions[j] = posed.positions[parent] + to_space * (rest[j] - rest[parent]);
            posed.rotations[j] = to_space * rotation::exp(frame.theta[j]);
            posed.axes[j] = to_space * rotation::left_jacobian(frame.theta[j]);
            for b in 0..n_betas {
                posed.d_positions[j][b] =
                    posed.d_positions[parent][b] + to_space * (self.joint_dirs[j][b] - self.joint_dirs[parent][b]);
            }
        }
        posed
    }

    /// The point and how it moves. `offset`: first column and value of a fitted displacement in the zero pose, and the
    /// factors of its axes (x is mirrored on the right, absent in the middle).
    pub fn differentiate(
        &self,
        posed: &Posed,
        point: &Point,
        betas: &[f64],
        offset: Option<(usize, DVec3, DVec3)>,
        layout: &Layout,
        out: &mut PointJacobian,
    ) -> DVec3 {
        out.frame.clear();
        out.shared.clear();
        let added = offset.map_or(DVec3::ZERO, |(_, value, factors)| value * factors);
        // Sums over the influences that hang below each joint.
        let mut below = [(0.0, DVec3::ZERO); N_JOINTS];
        let mut shape = vec![DVec3::ZERO; self.n_betas()];
        let mut turned = DMat3::ZERO;
        let mut total = DVec3::ZERO;
        for influence in &point.influences {
            let (j, w) = (influence.joint, influence.weight);
            let arm = influence.shaped(betas) + (added - posed.rest[j]) * w;
            let place = posed.rotations[j] * arm + posed.positions[j] * w;
            total += place;
            turned += posed.rotations[j] * w;
            for (b, slope) in shape.iter_mut().enumerate() {
                let moved = influence.dirs[b] - self.joint_dirs[j][b] * w;
                *slope += posed.rotations[j] * moved + posed.d_positions[j][b] * w;
            }
            let mut ancestor = j as i32;
            while ancestor >= 0 {
                let entry = &mut below[ancestor as usize];
                entry.0 += w;
                entry.1 += place;
                ancestor = PARENTS[ancestor as usize];
            }
        }
        for (j, (weight, place)) in below.iter().enumerate() {
            let Some(column) = layout.joint_column(j) else { continue };
            if *weight == 0.0 {
                continue;
            }
            let lever = *place - posed.positions[j] * *weight;
            for axis in 0..3 {
                out.frame.push((column + axis, posed.axes[j].col(axis).cross(lever)));
            }
        }
        for axis in 0..3 {
            out.frame.push((Layout::PELVIS + axis, DVec3::AXES[axis]));
        }
        out.shared.extend(shape.iter().enumerate().map(|(b, slope)| (layout.beta_column(b), *slope)));
        if let Some((column, _, factors)) = offset {
            for axis in 0..3 {
                if factors[axis] != 0.0 {
                    out.shared.push((column + axis, turned.col(axis) * factors[axis]));
                }
            }
        }
        total
    }
}

impl Influence {
    fn shaped(&self, betas: &[f64]) -> DVec3 {
        self.rest + self.dirs.iter().zip(betas).map(|(d, b)| *d * *b).sum::<DVec3>()
    }
}

impl Posed {
    /// Every vertex in camera space. `shaped [V]`: in the zero pose.
    pub fn vertices(&self, body: &Body, shaped: &[DVec3]) -> Vec<DVec3> {
        let maps: [(DMat3, DVec3); N_JOINTS] =
            std::array::from_fn(|j| (self.rotations[j], self.positions[j] - self.rotations[j] * self.rest[j]));
        let place = |(v, p): (usize, &DVec3)| {
            let mut total = DVec3::ZERO;
            for (joint, weight) in body.lbs_joints[v].iter().zip(&body.lbs_weights[v]) {
                if *weight > 0.0 {
                    let (turn, shift) = &maps[*joint as usize];
                    total += (*turn * *p + *shift) * f64::from(*weight);
                }
            }
            total
        };
        shaped.iter().enumerate().map(place).collect()
    }

    /// Where the point is.
    pub fn place(&self, point: &Point, betas: &[f64], added: DVec3) -> DVec3 {
        let mut total = DVec3::ZERO;
        for influence in &point.influences {
            let (j, w) = (influence.joint, influence.weight);
            total += self.rotations[j] * (influence.shaped(betas) + (added - self.rest[j]) * w) + self.positions[j] * w;
        }
        total
    }
}

impl Point {
    pub fn new(body: &Body, source: &KeypointSource) -> Self {
        let mut point = Point { influences: Vec::new() };
        match source {
            KeypointSource::Joint(j) => point.add_joint(body, *j as usize, 1.0),
            KeypointSource::Joints(js) => {
                js.iter().for_each(|j| point.add_joint(body, *j as usize, 1.0 / js.len() as f64));
            }
            KeypointSource::Vertices(vs) => {
                vs.iter().for_each(|v| point.add_vertex(body, *v as usize, 1.0 / vs.len() as f64));
            }
        }
        point
    }

    pub fn vertex(body: &Body, v: usize) -> Self {
        let mut point = Point { influences: Vec::new() };
        point.add_vertex(body, v, 1.0);
        point
    }

    fn add_joint(&mut self, body: &Body, j: usize, weight: f64) {
        let dirs = dirs_of(&body.j_shapedirs, j, body.n_betas);
        self.add(j, weight, dvec(body.j_template[j]), &dirs);
    }

    fn add_vertex(&mut self, body: &Body, v: usize, share: f64) {
        let dirs = dirs_of(&body.shapedirs, v, body.n_betas);
        for (joint, weight) in body.lbs_joints[v].iter().zip(&body.lbs_weights[v]) {
            if *weight > 0.0 {
                self.add(*joint as usize, share * f64::from(*weight), dvec(body.v_template[v]), &dirs);
            }
        }
    }

    fn add(&mut self, joint: usize, weight: f64, rest: DVec3, dirs: &[DVec3]) {
        match self.influences.iter_mut().find(|i| i.joint == joint) {
            Some(known) => {
                known.weight += weight;
                known.rest += rest * weight;
                known.dirs.iter_mut().zip(dirs).for_each(|(k, d)| *k += *d * weight);
            }
            None => self.influences.push(Influence {
                joint,
                weight,
                rest: rest * weight,
                dirs: dirs.iter().map(|d| *d * weight).collect(),
            }),
        }
    }
}
