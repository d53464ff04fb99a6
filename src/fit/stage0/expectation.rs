//! What is expected before anything is seen: shape, pose, nearness to given poses, smoothness.

use glam::{DMat3, DVec3};

use super::landmarks::N_OFFSETS;
use super::lively::Lively;
use super::normal::Normal;
use super::prior;
use super::problem::{NEAR, Problem, Scales, Stance, heavy_tailed};
use super::rotation;
use super::state::{Frame, Layout, Shared, State};
use super::steps;
use super::tracks;
use super::trust::Given;
use crate::body::N_JOINTS;
use crate::body::joints::PELVIS;

/// `(x/z, y/z, ln z)` and its Jacobian: in these coordinates a walk costs the same at every size of the scene,
/// which one camera cannot tell, so that smoothness does not favour small bodies.
fn relative_place(p: DVec3) -> (DVec3, DMat3) {
    let z = p.z.max(NEAR);
    let (x, y) = (p.x / z, p.y / z);
    (DVec3::new(x, y, z.ln()), DMat3::from_cols(DVec3::X, DVec3::Y, DVec3::new(-x, -y, 1.0)) * (1.0 / z))
}

impl Problem {
    pub(super) fn shared_prior(&self, shared: &Shared, scales: &Scales, mut normal: Option<&mut Normal>) -> f64 {
        let taller = self.stature.of(&shared.betas) - self.stature.expected;
        let weight = scales.stature_weight / (self.stature.sigma * self.stature.sigma);
        let mut cost = 0.5 * weight * taller * taller;
        if let Some(normal) = normal.as_deref_mut() {
            let slopes: Vec<_> =
                self.stature.slopes.iter().enumerate().map(|(b, s)| (self.layout.beta_column(b), *s)).collect();
            normal.add(0, &[], &slopes, taller, weight);
        }
        let mut pull = |column: usize, value: f64, sigma: f64| {
            let weight = 1.0 / (sigma * sigma);
            cost += 0.5 * weight * value * value;
            if let Some(normal) = normal.as_deref_mut() {
                normal.add(0, &[], &[(column, 1.0)], value, weight);
            }
        };
        for (b, beta) in shared.betas.iter().enumerate() {
            pull(self.layout.beta_column(b), *beta, scales.shape_weight.sqrt().recip());
        }
        for slot in 0..N_OFFSETS {
            for axis in 0..3 {
                let unexpected = shared.offsets[slot][axis] - self.offsets[slot][axis];
                pull(self.layout.offset_column(slot) + axis, unexpected, self.offset_sigma[slot]);
            }
        }
        pull(self.layout.focal_column(), shared.log_focal, self.focal_sigma);
        cost + self.tracked_prior(shared, normal)
    }

    /// In parts of the height: one in metres would favour small bodies, whose every displacement is small.
    pub(super) fn tracked_prior(&self, shared: &Shared, mut normal: Option<&mut Normal>) -> f64 {
        let height = self.stature.of(&shared.betas);
        let weight = 1.0 / (tracks::OFFSET_SIGMA * tracks::OFFSET_SIGMA);
        let mut cost = 0.0;
        let mut slopes = vec![(0, 0.0)];
        slopes.extend((0..shared.betas.len()).map(|b| (self.layout.beta_column(b), 0.0)));
        for (point, (offset, expected)) in shared.tracked.iter().zip(&self.tracks.expected).enumerate() {
            for axis in 0..3 {
                let relative = offset[axis] / height;
                let unexpected = relative - expected[axis];
                cost += 0.5 * weight * unexpected * unexpected;
                if let Some(normal) = normal.as_deref_mut() {
                    slopes[0] = (self.layout.tracked_column(point) + axis, 1.0 / height);
                    for (slope, growth) in slopes[1..].iter_mut().zip(&self.stature.slopes) {
                        slope.1 = -relative * growth / height;
                    }
                    normal.add(0, &[], &slopes, unexpected, weight);
                }
            }
        }
        cost
    }

    pub(super) fn pose_prior(&self, t: usize, frame: &Frame, lively: Lively, mut normal: Option<&mut Normal>) -> f64 {
        // The body's up axis leans along x and z of its own frame: the camera's up is −y.
        let up = frame.root.transpose() * DVec3::NEG_Y;
        let weight = 1.0 / (prior::UPRIGHT_SIGMA * prior::UPRIGHT_SIGMA);
        let mut cost = 0.5 * weight * (up.x * up.x + up.z * up.z);
        if let Some(normal) = normal.as_deref_mut() {
            // d(Rᵀ u) = up × δ
            let turns = rotation::skew(up);
            for axis in [0, 2] {
                let slopes = [0, 1, 2].map(|c| (c, turns.col(c)[axis]));
                normal.add(t, &slopes, &[], up[axis], weight);
            }
        }
        let mut pull = |slopes: &[(usize, f64)], residual: f64, sigma: f64| {
            let weight = 1.0 / (sigma * sigma);
            cost += 0.5 * weight * residual * residual;
            if let Some(normal) = normal.as_deref_mut() {
                normal.add(t, slopes, &[], residual, weight);
            }
        };
        if let Some(stance) = &self.stance {
            let share = self.sway_share(t).sqrt();
            let turns = rotation::skew(up);
            for axis in [0, 2] {
                let slopes = [0, 1, 2].map(|c| (c, turns.col(c)[axis]));
                pull(&slopes, up[axis] - stance.up[axis], stance.sway[PELVIS] / share);
            }
            for p in self.prior.joints.iter().filter(|p| self.layout.joint_column(p.joint).is_some()) {
                if lively.moves(p.joint) {
                    continue;
                }
                for axis in 0..3 {
                    let (stood, slopes, n) = self.without_steps(t, frame, p.joint, axis);
                    pull(&slopes[..n], stood - stance.theta[p.joint][axis], stance.sway[p.joint] / share);
                }
            }
        }
        for p in &self.prior.joints {
            let Some(column) = self.layout.joint_column(p.joint) else { continue };
            for axis in 0..3 {
                let angle = frame.theta[p.joint][axis];
                let (stood, slopes, n) = self.without_steps(t, frame, p.joint, axis);
                // Elbows are hinges whatever they do.
                let free = lively.moves(p.joint) && p.sigma[axis] > prior::HINGE_SIGMA;
                pull(&slopes[..n], stood - p.mean[axis], if free { prior::FREE_SIGMA } else { p.sigma[axis] });
                let over = angle - angle.clamp(p.low[axis], p.high[axis]);
                if over != 0.0 {
                    pull(&[(column + axis, 1.0)], over, prior::LIMIT_SIGMA);
                }
            }
        }
        cost
    }

    /// An Ornstein–Uhlenbeck process beside its changes, which are the walk's: a look's worth for the time that it covers, and half of
    /// one more where the clip begins and ends.
    fn sway_share(&self, t: usize) -> f64 {
        let around = [t.checked_sub(1).and_then(|before| self.gaps.get(before)), self.gaps.get(t)];
        let ends = around.iter().filter(|gap| gap.is_none()).count() as f64;
        around.iter().flatten().copied().sum::<f64>() / 2.0 / prior::SWAY_TIME + ends / 2.0
    }

    /// Where the frames stand on average. It is found anew between descents and stands in one. Arms sway as far as they are seen to:
    /// some people swing them.
    pub fn stance_of(&self, state: &State) -> Stance {
        let n = state.frames.len() as f64;
        let (mut up, mut theta, mut squares) = (DVec3::ZERO, [DVec3::ZERO; N_JOINTS], [DVec3::ZERO; N_JOINTS]);
        for (t, frame) in state.frames.iter().enumerate() {
            up += frame.root.transpose() * DVec3::NEG_Y / n;
            for p in &self.prior.joints {
                let stood = DVec3::from_array([0, 1, 2].map(|axis| self.without_steps(t, frame, p.joint, axis).0));
                theta[p.joint] += stood / n;
                squares[p.joint] += stood * stood / n;
            }
        }
        let sway = std::array::from_fn(|joint| {
            let seen = (squares[joint] - theta[joint] * theta[joint]).max_element().max(0.0).sqrt();
            if prior::ARMS.contains(&joint) { seen.max(prior::sway(joint)) } else { prior::sway(joint) }
        });
        Stance { up, theta, sway }
    }

    /// A joint's angle less what of it is a step's bend or twist: what a standing person has, and what goes on from frame to
    /// frame; its slopes, of which the first so many count.
    fn without_steps(&self, t: usize, frame: &Frame, joint: usize, axis: usize) -> (f64, [(usize, f64); 3], usize) {
        let mut angle = frame.theta[joint][axis];
        let mut slopes = [(0, 0.0); 3];
        slopes[0] = (self.layout.joint_column(joint).unwrap_or(0) + axis, 1.0);
        let mut n = 1;
        if axis == 0 {
            for &(part, share) in steps::shares(joint) {
                angle -= share * frame.step.as_flattened()[part];
                slopes[n] = (Layout::STEP + part, -share);
                n += 1;
            }
        } else if axis == 1 {
            angle -= self.steps.twist_of(t, joint);
        }
        (angle, slopes, n)
    }

    pub(super) fn anchored(&self, t: usize, frame: &Frame, given: &Given, mut normal: Option<&mut Normal>) -> f64 {
        let mut cost = 0.0;
        let turn_rate = (Layout::TURN_RATE, frame.turn_rate - given.frames[t].turn_rate, 1.0);
        for (column, value, sigma) in given.differences(t, frame, self).chain([turn_rate]) {
            let weight = 1.0 / (sigma * sigma);
            cost += 0.5 * weight * value * value;
            if let Some(normal) = normal.as_deref_mut() {
                normal.add(t, &[(column, 1.0)], &[], value, weight);
            }
        }
        cost
    }

    /// A random walk of every angle and of the place; the root turns about its own up axis at a rate that
    /// changes slowly, but for where it stops or goes on: `log(R_tᵀ R_{t+1}) ≈ (0, rate·Δ, 0)`.
    pub(super) fn smoothness(&self, t: usize, state: &State, mut normal: Option<&mut Normal>) -> f64 {
        let (this, next) = (&state.frames[t], &state.frames[t + 1]);
        let gap = self.gaps[t];
        let lively = self.lively_at(t).or(self.lively_at(t + 1));
        let mut cost = 0.0;
        let mut tie = |a: &[(usize, f64)], b: &[(usize, f64)], residual: f64, sigma: f64, tail: Option<f64>| {
            let weight = 1.0 / (sigma * sigma * gap);
            let q = weight * residual * residual;
            let (value, influence) = tail.map_or((0.5 * q, 1.0), |tail| heavy_tailed(q, tail));
            cost += value;
            if let Some(normal) = normal.as_deref_mut() {
                normal.add_pair(t, a, b, residual, influence * weight);
            }
        };
        let turn = rotation::log(this.root.transpose() * next.root);
        let (into_this, into_next): (DMat3, DMat3) =
            (-rotation::left_jacobian_inverse(turn), rotation::left_jacobian_inverse(-turn));
        for axis in 0..3 {
            let mut a = [0, 1, 2, Layout::TURN_RATE].map(|c| (c, 0.0));
            let mut b = [(0, 0.0); 3];
            for c in 0..3 {
                a[c].1 = into_this.col(c)[axis];
                b[c] = (c, into_next.col(c)[axis]);
            }
            let mut residual = turn[axis];
            if axis == 1 {
                residual -= this.turn_rate * gap;
                a[3].1 = -gap;
            }
            tie(&a, &b, residual, prior::TILT_DRIFT, None);
        }
        let (this_place, next_place) = (relative_place(this.pelvis), relative_place(next.pelvis));
        for axis in 0..3 {
            let slopes = |of: DMat3, sign: f64| [0, 1, 2].map(|c| (Layout::PELVIS + c, sign * of.col(c)[axis]));
            let change = next_place.0[axis] - this_place.0[axis];
            tie(&slopes(this_place.1, -1.0), &slopes(next_place.1, 1.0), change, prior::PELVIS_DRIFT, None);
        }
        tie(
            &[(Layout::TURN_RATE, -1.0)],
            &[(Layout::TURN_RATE, 1.0)],
            next.turn_rate - this.turn_rate,
            prior::TURN_DRIFT,
            Some(prior::TURN_TAIL),
        );
        for p in self.prior.joints.iter().filter(|p| self.layout.joint_column(p.joint).is_some()) {
            let tail = lively.moves(p.joint).then(|| prior::free_tail(p.joint));
            for axis in 0..3 {
                let (before, mut a, n) = self.without_steps(t, this, p.joint, axis);
                let (after, b, _) = self.without_steps(t + 1, next, p.joint, axis);
                a.iter_mut().for_each(|slope| slope.1 = -slope.1);
                tie(&a[..n], &b[..n], after - before, p.drift, tail);
            }
        }
        cost
    }

    /// Bends of a lifted leg are free, about those that keep the sole level; a leg that stands has none.
    pub(super) fn step_prior(&self, t: usize, frame: &Frame, mut normal: Option<&mut Normal>) -> f64 {
        let mut cost = 0.0;
        for (side, [hip, knee]) in frame.step.into_iter().enumerate() {
            let [of_hip, of_knee] = [0, 1].map(|part| Layout::STEP + 2 * side + part);
            let [raised, level] = if self.steps.is_lifted(t, side) { steps::SIGMA } else { [steps::STANDING_SIGMA; 2] };
            let mut pull = |slopes: &[(usize, f64)], residual: f64, sigma: f64| {
                let weight = 1.0 / (sigma * sigma);
                cost += 0.5 * weight * residual * residual;
                if let Some(normal) = normal.as_deref_mut() {
                    normal.add(t, slopes, &[], residual, weight);
                }
            };
            pull(&[(of_hip, 1.0)], hip, raised);
            pull(&[(of_hip, 2.0), (of_knee, 1.0)], 2.0 * hip + knee, level);
        }
        cost
    }
}
