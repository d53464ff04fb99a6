//! How far given poses are to be trusted: as far as keypoints bear them out.
//!
//! Poses from motion capture are right to a tenth of a degree, those that a network guesses from a picture are several degrees off, and
//! what a body of another zero pose is off by is the same in all frames. So given numbers are taken for the true ones, less a constant of the
//! number, with an error that is new in each frame: one spread for the joints' angles, one for the root's and one for the
//! place. Constants and spreads are those under which the keypoints are likeliest, found by expectation and maximisation
//! (Dempster, Laird and Rubin 1977) with every frame's keypoints linearised where the descent stands.

use glam::{DMat3, DVec3};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::normal::Normal;
use super::problem::{Problem, Scales};
use super::rotation;
use super::state::{Frame, Layout, State};
use crate::body::N_JOINTS;

/// Poses that came with the clip.
pub struct Given {
    /// `[N]`
    pub frames: Vec<Frame>,
    /// By how much all frames differ from them alike.
    pub constant: Constant,
    pub trust: Trust,
}

/// A difference from given poses that all frames have.
#[derive(Clone, Debug)]
pub struct Constant {
    /// A turn in the body's axes.
    pub root: DVec3,
    /// Metres in the body's axes.
    pub place: DVec3,
    pub theta: [DVec3; N_JOINTS],
}

/// What given poses are off by in one frame, 1σ of one number.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Trust {
    /// Radians.
    pub root: f64,
    /// Metres.
    pub place: f64,
    /// Radians.
    pub joints: f64,
}

impl Trust {
    /// Before keypoints were asked. Poses that are right are soon found to be; were they believed at first, what is wrong with others would
    /// pass for noise of the keypoints.
    pub const AT_FIRST: Self = Self { root: 0.03, place: 0.03, joints: 0.03 };

    /// No pose is known better than this; and further off than that it is none.
    const LEAST: Self = Self { root: 0.003, place: 0.003, joints: 0.003 };
    const MOST: Self = Self { root: 0.3, place: 0.3, joints: 0.3 };

    fn bounded(self) -> Self {
        let Self { root, place, joints } = self;
        Self {
            root: root.clamp(Self::LEAST.root, Self::MOST.root),
            place: place.clamp(Self::LEAST.place, Self::MOST.place),
            joints: joints.clamp(Self::LEAST.joints, Self::MOST.joints),
        }
    }

    fn is_near(&self, other: &Self) -> bool {
        let pairs = [(self.root, other.root), (self.place, other.place), (self.joints, other.joints)];
        pairs.iter().all(|(a, b)| (a / b - 1.0).abs() < SETTLED)
    }

    /// Of a number at `column` of a frame.
    fn of(&self, column: usize) -> f64 {
        match column {
            0..Layout::PELVIS => self.root,
            Layout::PELVIS..Layout::TURN_RATE => self.place,
            _ => self.joints,
        }
    }
}

/// Spread of constants: of angles, radians, and of the pelvis joint's place in another body, metres.
const CONSTANT_ANGLE: f64 = 0.1;
const CONSTANT_PLACE: f64 = 0.02;
/// Expectation and maximisation creep where little is known.
const MOST_ITERATIONS: usize = 100;
const SETTLED: f64 = 2e-3;

impl Given {
    pub fn new(frames: Vec<Frame>) -> Self {
        let constant = Constant { root: DVec3::ZERO, place: DVec3::ZERO, theta: [DVec3::ZERO; N_JOINTS] };
        Self { frames, constant, trust: Trust::AT_FIRST }
    }

    /// By how much a frame differs from the given one besides what all frames do, in a frame's columns: those that count, their values
    /// and spreads.
    pub fn differences<'a>(
        &'a self,
        t: usize,
        frame: &'a Frame,
        problem: &'a Problem,
    ) -> impl Iterator<Item = (usize, f64, f64)> + 'a {
        let raw = differences(problem, frame, &self.frames[t]);
        let constant = self.constant_at(problem, t);
        raw.into_iter()
            .zip(constant)
            .map(|((column, value), constant)| (column, value - constant, self.trust.of(column)))
    }

    /// The constant in the columns of frame t, in the order of [`columns`].
    fn constant_at(&self, problem: &Problem, t: usize) -> Vec<f64> {
        let Constant { root, place, theta } = &self.constant;
        let place = self.frames[t].root * *place;
        let joints = joints(problem).flat_map(|(joint, _)| theta[joint].to_array());
        root.to_array().into_iter().chain(place.to_array()).chain(joints).collect()
    }

    /// Learns constants and spreads from the keypoints, in a state near the given poses.
    pub fn learn(&mut self, problem: &Problem, state: &State, scales: &Scales) {
        let normal = problem.seen_alone(state, scales);
        let look = |(t, frame): (usize, &Frame)| Look::new(problem, &normal, t, frame, &self.frames[t]);
        let looks: Vec<Look> = state.frames.par_iter().enumerate().map(look).collect();
        let columns: Vec<usize> = columns(problem).collect();
        for _ in 0..MOST_ITERATIONS {
            let likely = |(t, look): (usize, &Look)| look.given(&columns, &self.constant_at(problem, t), &self.trust);
            let Some(likely) = looks.par_iter().enumerate().map(likely).collect::<Option<Vec<_>>>() else { return };
            self.constant = self.likeliest_constant(problem, &likely);
            let constants = (0..likely.len()).map(|t| self.constant_at(problem, t));
            let before = self.trust;
            self.trust = likeliest_trust(&columns, &likely, constants).bounded();
            if self.trust.is_near(&before) {
                return;
            }
        }
    }

    /// `likely [N]`: mean and variance of the differences, in the order of [`columns`].
    fn likeliest_constant(&self, problem: &Problem, likely: &[(DVector<f64>, DVector<f64>)]) -> Constant {
        let n = likely.len() as f64;
        let mean = |at: usize, sigma: f64, spread: f64, turn: &dyn Fn(usize) -> DMat3| {
            let values = likely.iter().enumerate().map(|(t, (d, _))| turn(t) * DVec3::new(d[at], d[at + 1], d[at + 2]));
            values.sum::<DVec3>() / (n + (sigma / spread).powi(2))
        };
        let as_it_is = |_| DMat3::IDENTITY;
        let mut theta = [DVec3::ZERO; N_JOINTS];
        for (k, (joint, _)) in joints(problem).enumerate() {
            theta[joint] = mean(Layout::TURN_RATE + 3 * k, self.trust.joints, CONSTANT_ANGLE, &as_it_is);
        }
        Constant {
            root: mean(0, self.trust.root, CONSTANT_ANGLE, &as_it_is),
            place: mean(Layout::PELVIS, self.trust.place, CONSTANT_PLACE, &|t| self.frames[t].root.transpose()),
            theta,
        }
    }
}

/// Joints that move, and the first of their columns.
fn joints(problem: &Problem) -> impl Iterator<Item = (usize, usize)> + '_ {
    problem.prior.joints().filter_map(|joint| Some((joint, problem.layout.joint_column(joint)?)))
}

/// The columns of root, place and joints.
fn columns(problem: &Problem) -> impl Iterator<Item = usize> + '_ {
    (0..Layout::TURN_RATE).chain(joints(problem).flat_map(|(_, first)| first..first + 3))
}

/// Of [`columns`], how far `frame` differs from the given one.
fn differences(problem: &Problem, frame: &Frame, given: &Frame) -> Vec<(usize, f64)> {
    // Small turns: the difference's own Jacobian is the identity.
    let turn = rotation::log(given.root.transpose() * frame.root).to_array();
    let place = (frame.pelvis - given.pelvis).to_array();
    let theta = joints(problem).flat_map(|(joint, _)| (frame.theta[joint] - given.theta[joint]).to_array());
    columns(problem).zip(turn.into_iter().chain(place).chain(theta)).collect()
}

/// What the keypoints of a frame say of its differences: `½ (d − at)ᵀ H (d − at) + gᵀ (d − at)`.
struct Look {
    information: DMatrix<f64>,
    /// `H at − g`
    pull: DVector<f64>,
}

impl Look {
    fn new(problem: &Problem, normal: &Normal, t: usize, frame: &Frame, given: &Frame) -> Self {
        let at = differences(problem, frame, given);
        let columns: Vec<usize> = at.iter().map(|(column, _)| *column).collect();
        let information =
            DMatrix::from_fn(columns.len(), columns.len(), |i, j| normal.of_frame(t, columns[i], columns[j]));
        let at = DVector::from_iterator(at.len(), at.into_iter().map(|(_, value)| value));
        let gradient =
            DVector::from_iterator(at.len(), columns.iter().map(|&column| normal.gradient_of_frame(t, column)));
        let pull = &information * at - gradient;
        Self { information, pull }
    }

    /// Mean and variance of the differences, if they are so spread about a constant.
    fn given(&self, columns: &[usize], constant: &[f64], trust: &Trust) -> Option<(DVector<f64>, DVector<f64>)> {
        let (mut information, mut pull) = (self.information.clone(), self.pull.clone());
        for (i, (&column, constant)) in columns.iter().zip(constant).enumerate() {
            let known = trust.of(column).powi(-2);
            information[(i, i)] += known;
            pull[i] += known * constant;
        }
        let covariance = information.cholesky()?.inverse();
        Some((&covariance * pull, covariance.diagonal()))
    }
}

fn likeliest_trust(
    columns: &[usize],
    likely: &[(DVector<f64>, DVector<f64>)],
    constants: impl Iterator<Item = Vec<f64>>,
) -> Trust {
    let (mut root, mut place, mut joints) = (Spread::default(), Spread::default(), Spread::default());
    for ((mean, variance), constant) in likely.iter().zip(constants) {
        for (i, &column) in columns.iter().enumerate() {
            let spread = match column {
                0..Layout::PELVIS => &mut root,
                Layout::PELVIS..Layout::TURN_RATE => &mut place,
                _ => &mut joints,
            };
            spread.add((mean[i] - constant[i]).powi(2) + variance[i]);
        }
    }
    Trust { root: root.sigma(), place: place.sigma(), joints: joints.sigma() }
}

#[derive(Default)]
struct Spread {
    squares: f64,
    n: f64,
}

impl Spread {
    fn add(&mut self, square: f64) {
        self.squares += square;
        self.n += 1.0;
    }

    fn sigma(&self) -> f64 {
        (self.squares / self.n).sqrt()
    }
}
