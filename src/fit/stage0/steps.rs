//! Steps: most people do not turn like a statue on a disc, they lift one foot after the other, and a foot on the floor stays
//! while the body above it turns on.
//!
//! Descent does not find a lifted foot. A straight leg that begins to bend moves its foot up by nothing at first, and thigh
//! and knee towards the camera or away from it, which a front view does not show; and what a standing person's legs may do
//! from frame to frame is little. So a lifted foot is looked for: each frame's leg is bent by some angles, and keypoints and mask
//! tell which of them is right. Where some are, the leg's bends in those frames are free ([`super::state::Frame::step`]), and how far
//! each leg is twisted is looked for in all frames.

use rayon::prelude::*;

use super::problem::{Problem, Scales};
use super::state::{Frame, State};
use crate::body::joints::{LEFT_ANKLE, LEFT_HIP, LEFT_KNEE, RIGHT_ANKLE, RIGHT_HIP, RIGHT_KNEE};
use crate::math::median;

/// Angles by which a thigh is raised, radians; the knee bends by twice as much, so that the sole stays level.
const RAISED: [f64; 4] = [0.15, 0.3, 0.45, 0.6];
/// Angles by which a leg is twisted, radians.
const TWISTED: [f64; 6] = [-0.45, -0.3, -0.15, 0.15, 0.3, 0.45];
/// Hip, knee and ankle: left, right.
const LEGS: [[usize; 3]; 2] = [[LEFT_HIP, LEFT_KNEE, LEFT_ANKLE], [RIGHT_HIP, RIGHT_KNEE, RIGHT_ANKLE]];
/// Spread of a lifted thigh's bend, and of the knee's about twice that, radians.
pub(super) const SIGMA: [f64; 2] = [0.4, 0.15];
/// The same where the foot stands.
pub(super) const STANDING_SIGMA: f64 = 1e-4;
/// What must be gained, nats: by a lifted foot, by a twisted leg.
const MARGIN: f64 = 12.0;
/// Who steps round has a foot off the floor in at least this part of the frames.
const OFTEN: f64 = 0.1;
const TWIST_MARGIN: f64 = 2.0;
/// Detections further off than this, in σ, count no more than so.
const RHO: f64 = 10.0;
/// Area of the picture in which model and mask may differ for one nat, in squares of the person's height.
const AREA: f64 = 1e-4;

/// Which of a frame's four bends (left hip and knee, right hip and knee) move a joint's x, and how.
pub(super) fn shares(joint: usize) -> &'static [(usize, f64)] {
    match joint {
        LEFT_HIP => &[(0, 1.0)],
        LEFT_KNEE => &[(1, 1.0)],
        LEFT_ANKLE => &[(0, -1.0), (1, -1.0)],
        RIGHT_HIP => &[(2, 1.0)],
        RIGHT_KNEE => &[(3, 1.0)],
        RIGHT_ANKLE => &[(2, -1.0), (3, -1.0)],
        _ => &[],
    }
}

/// What a clip's legs do besides standing.
#[derive(Clone, Debug, Default)]
pub struct Steps {
    /// `[N]`: whether the left and the right foot are lifted; empty where nobody steps.
    pub lifted: Vec<[bool; 2]>,
    /// `[N]`: radians by which the left and the right leg are twisted.
    pub twist: Vec<[f64; 2]>,
}

impl Steps {
    /// Whether the left or right foot is lifted in a frame.
    pub fn is_lifted(&self, t: usize, side: usize) -> bool {
        self.lifted.get(t).is_some_and(|lifted| lifted[side])
    }

    /// How far the leg of a hip is twisted in a frame; 0 for other joints.
    pub fn twist_of(&self, t: usize, joint: usize) -> f64 {
        let side = LEGS.iter().position(|leg| leg[0] == joint);
        side.zip(self.twist.get(t)).map_or(0.0, |(side, twist)| twist[side])
    }
}

/// `frame` with a leg bent.
fn lifted(frame: &Frame, side: usize, angle: f64) -> Frame {
    let mut frame = frame.clone();
    frame.step[side] = [-angle, 2.0 * angle];
    for (joint, share) in LEGS[side].into_iter().zip([-1.0, 2.0, -1.0]) {
        frame.theta[joint].x += share * angle;
    }
    frame
}

/// `frame` with a leg twisted.
fn twisted(frame: &Frame, side: usize, angle: f64) -> Frame {
    let mut frame = frame.clone();
    frame.theta[LEGS[side][0]].y += angle;
    frame
}

/// What the frames look like with other legs.
pub(super) struct Looks<'a> {
    pub problem: &'a Problem,
    pub state: &'a State,
    pub scales: &'a Scales,
    /// The area between mask and model in a frame, squares of the person's height.
    pub differs: &'a (dyn Fn(usize, &Frame) -> Option<f64> + Sync),
}

impl Looks<'_> {
    fn cost(&self, t: usize, frame: &Frame) -> Option<f64> {
        let scales = Scales { rho: RHO, ..*self.scales };
        Some(self.problem.of_frame(t, frame, &self.state.shared, &scales) + (self.differs)(t, frame)? / AREA)
    }

    /// Nats that frame `t` gains by each of some changes; `None` where it has no mask.
    fn gains(&self, t: usize, frame: &Frame, changed: impl Iterator<Item = Frame>) -> Option<Vec<f64>> {
        let as_it_is = self.cost(t, frame)?;
        changed.map(|frame| Some(as_it_is - self.cost(t, &frame)?)).collect()
    }

    /// Bends legs where that explains a frame better by more than it does the clip's usual one, and twists them.
    pub fn find(&self) -> (Steps, Vec<Frame>) {
        let mut frames = self.state.frames.clone();
        let mut steps = Steps { lifted: vec![[false; 2]; frames.len()], twist: vec![[0.0; 2]; frames.len()] };
        for side in 0..2 {
            let gains_of = |(t, frame): (usize, &Frame)| {
                self.gains(t, frame, RAISED.iter().map(|&angle| lifted(frame, side, angle)))
            };
            let gains: Vec<Option<Vec<f64>>> = self.state.frames.par_iter().enumerate().map(gains_of).collect();
            let usual: Vec<f64> = (0..RAISED.len())
                .map(|a| median(gains.iter().flatten().map(|g| g[a])).unwrap_or(0.0).max(0.0))
                .collect();
            for (t, gains) in gains.iter().enumerate() {
                let unusual = gains.iter().flatten().zip(&usual).map(|(gain, usual)| gain - usual);
                if let Some(angle) = best(RAISED.into_iter().zip(unusual), MARGIN) {
                    frames[t] = lifted(&frames[t], side, angle);
                    steps.lifted[t][side] = true;
                }
            }
        }
        let n_lifted = steps.lifted.iter().filter(|feet| feet.contains(&true)).count();
        if (n_lifted as f64) < OFTEN * frames.len() as f64 {
            return (Steps::default(), self.state.frames.clone());
        }
        frames.par_iter_mut().zip(&mut steps.twist).enumerate().for_each(|(t, (frame, twist))| {
            for (side, twist) in twist.iter_mut().enumerate() {
                let gains = self.gains(t, frame, TWISTED.iter().map(|&angle| twisted(frame, side, angle)));
                if let Some(angle) = best(TWISTED.into_iter().zip(gains.into_iter().flatten()), TWIST_MARGIN) {
                    *frame = twisted(frame, side, angle);
                    *twist = angle;
                }
            }
        });
        (steps, frames)
    }
}

/// The angle that gains most, and more than `margin`.
fn best(gains: impl Iterator<Item = (f64, f64)>, margin: f64) -> Option<f64> {
    gains.filter(|(_, gain)| *gain > margin).max_by(|a, b| a.1.total_cmp(&b.1)).map(|(angle, _)| angle)
}
