//! What people do besides standing: a hand on the hip, arms crossed, a look over the shoulder.
//!
//! Descent does not find it. A hand far from where hands hang is taken for a wrong detection, and an arm that should bend for it
//! is held by the frames before and after. So it is looked for: where elbow and wrist, or a face, lie far from where the arm or
//! head of a frame puts them, other angles are tried, one frame at a time. Where they explain it better, that arm or head is free
//! from then on.

use glam::DVec3;
use rayon::prelude::*;

use super::landmarks::Part;
use super::problem::{Problem, Scales, geman_mcclure};
use super::sides;
use super::state::{Frame, State};
use crate::body::joints::{HEAD, LEFT_ELBOW, LEFT_SHOULDER, NECK, RIGHT_ELBOW, RIGHT_SHOULDER};

/// Distance of a detection that asks for a look, in σ of the keypoints.
const FAR: f64 = 4.0;
/// What another arm or head must gain in a frame, nats.
const MARGIN: f64 = 8.0;
/// The same where the head as it is hides the face: what a turned one may cost more, which then explains a nose and two eyes.
const HIDDEN_MARGIN: f64 = -5.0;
/// And in so many frames one after the other: a single one is a wrong detection.
const FRAMES: usize = 3;
/// Detections further off than this, in σ, count no more than so.
const RHO: f64 = 12.0;
/// Angles that are tried, radians: an elbow's bend, and what is added to a shoulder's usual ones.
const BENDS: [f64; 5] = [0.2, 0.7, 1.2, 1.7, 2.2];
const ADDED: [f64; 3] = [-0.6, 0.0, 0.6];
/// And a head's turn, of which the neck does a part.
const TURNS: [f64; 8] = [-1.2, -0.9, -0.6, -0.3, 0.3, 0.6, 0.9, 1.2];
const NECKS_PART: f64 = 0.3;
/// The first step in which angles are then improved, radians, and how often it is halved.
const STEP: f64 = 0.3;
const HALVINGS: usize = 5;

/// What is looked at together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Limb {
    LeftArm,
    RightArm,
    Head,
}

/// What does something else in a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lively([bool; 3]);

impl Lively {
    fn only(limb: Limb) -> Self {
        Self(Limb::ALL.map(|other| other == limb))
    }

    pub fn or(self, other: Self) -> Self {
        Self(std::array::from_fn(|limb| self.0[limb] || other.0[limb]))
    }

    /// Whether it moves a joint.
    pub fn moves(self, joint: usize) -> bool {
        Limb::ALL.iter().zip(self.0).any(|(limb, lively)| lively && limb.joints().contains(&joint))
    }
}

impl Limb {
    const ALL: [Limb; 3] = [Limb::LeftArm, Limb::RightArm, Limb::Head];

    /// Whether a point tells of it.
    fn has(self, part: Part, side: f64) -> bool {
        match self {
            Limb::LeftArm => matches!(part, Part::Elbow | Part::Wrist) && side > 0.0,
            Limb::RightArm => matches!(part, Part::Elbow | Part::Wrist) && side < 0.0,
            Limb::Head => matches!(part, Part::Nose | Part::Eye | Part::Ear),
        }
    }

    /// The angles that are looked for: joint and axis.
    fn angles(self) -> &'static [(usize, usize)] {
        match self {
            Limb::LeftArm => &[(LEFT_SHOULDER, 0), (LEFT_SHOULDER, 1), (LEFT_SHOULDER, 2), (LEFT_ELBOW, 1)],
            Limb::RightArm => &[(RIGHT_SHOULDER, 0), (RIGHT_SHOULDER, 1), (RIGHT_SHOULDER, 2), (RIGHT_ELBOW, 1)],
            Limb::Head => &[(HEAD, 1), (HEAD, 0)],
        }
    }

    fn joints(self) -> &'static [usize] {
        match self {
            Limb::LeftArm => &[LEFT_SHOULDER, LEFT_ELBOW],
            Limb::RightArm => &[RIGHT_SHOULDER, RIGHT_ELBOW],
            Limb::Head => &[NECK, HEAD],
        }
    }

    /// `frame` with angles far from its own.
    fn others(self, frame: &Frame, usual: &[DVec3]) -> Vec<Frame> {
        let with = |change: &dyn Fn(&mut Frame)| {
            let mut frame = frame.clone();
            change(&mut frame);
            frame
        };
        let arm = |shoulder: usize, elbow: usize, inwards: f64| {
            let added = ADDED.iter().flat_map(|&x| ADDED.iter().flat_map(move |&y| ADDED.map(|z| DVec3::new(x, y, z))));
            let bent = added.flat_map(|added| BENDS.map(|bend| (added, bend)));
            let arms = bent.map(|(added, bend)| {
                with(&|frame| {
                    frame.theta[shoulder] = usual[shoulder] + added;
                    frame.theta[elbow].y = inwards * bend;
                })
            });
            arms.collect()
        };
        match self {
            Limb::LeftArm => arm(LEFT_SHOULDER, LEFT_ELBOW, -1.0),
            Limb::RightArm => arm(RIGHT_SHOULDER, RIGHT_ELBOW, 1.0),
            Limb::Head => {
                let turned = |turn: f64| {
                    with(&|frame| {
                        frame.theta[NECK].y = NECKS_PART * turn;
                        frame.theta[HEAD].y = (1.0 - NECKS_PART) * turn;
                    })
                };
                TURNS.into_iter().map(turned).collect()
            }
        }
    }
}

/// Puts arms and heads that keypoints ask for into the frames of a state. `[N]`: what is lively from now on.
pub(super) fn find(problem: &Problem, state: &mut State, scales: &Scales) -> Vec<Lively> {
    let usual = problem.prior.mean_pose();
    let mut lively: Vec<Lively> = (0..state.frames.len()).map(|t| problem.lively_at(t)).collect();
    for (l, limb) in Limb::ALL.into_iter().enumerate() {
        let look = |(t, frame): (usize, &Frame)| look(problem, state, scales, t, frame, limb, &usual);
        let mut found: Vec<Option<Frame>> = state.frames.par_iter().enumerate().map(look).collect();
        let moves: Vec<bool> = found.iter().zip(&lively).map(|(found, was)| found.is_some() || was.0[l]).collect();
        let mut t = 0;
        for run in moves.chunk_by(|a, b| a == b) {
            if run.len() < FRAMES {
                found[t..t + run.len()].fill(None);
            }
            t += run.len();
        }
        bridge(problem, state, scales, limb, &mut found);
        for ((frame, found), lively) in state.frames.iter_mut().zip(found).zip(&mut lively) {
            if let Some(found) = found {
                *frame = found;
                *lively = lively.or(Lively::only(limb));
            }
        }
    }
    lively
}

/// A frame with another limb, where that explains it better by more than the margin.
fn look(
    problem: &Problem,
    state: &State,
    scales: &Scales,
    t: usize,
    frame: &Frame,
    limb: Limb,
    usual: &[DVec3],
) -> Option<Frame> {
    let camera = problem.camera.zoomed(state.shared.log_focal);
    let posed = problem.rig.pose(frame, &state.shared);
    let places = problem.landmarks_at(&posed, state, &camera);
    let far = FAR * scales.sigma_px;
    let mut points = problem.landmarks.iter().zip(&problem.observations[t]).zip(&places);
    let asks = points.any(|((landmark, seen), place)| {
        seen.weight > 0.0 && limb.has(landmark.part, landmark.side) && seen.at.distance(*place) > far
    });
    if !asks {
        return None;
    }
    let wide = Scales { rho: RHO, ..*scales };
    let lively = problem.lively_at(t).or(Lively::only(limb));
    let cost = |frame: &Frame| problem.of_lively_frame(t, frame, lively, &state.shared, &wide);
    let candidates = limb.others(frame, usual).into_iter().map(|frame| (cost(&frame), frame));
    let best = candidates.min_by(|a, b| a.0.total_cmp(&b.0))?;
    let (least, best) = improved(best, limb.angles(), &cost);
    let as_it_is = problem.of_frame(t, frame, &state.shared, &wide);
    if limb == Limb::Head && sides::hides_face(&posed) {
        // The head as it is hides the face, and pays nothing for it.
        let face = problem.landmarks.iter().zip(&problem.observations[t]).zip(&places);
        let face = face.filter(|((landmark, _), _)| matches!(landmark.part, Part::Nose | Part::Eye));
        let paid = face.map(|((_, seen), place)| {
            let q = seen.at.distance_squared(*place) / (scales.sigma_px * scales.sigma_px);
            seen.weight * geman_mcclure(q, RHO).0
        });
        return (as_it_is - paid.sum::<f64>() - least > HIDDEN_MARGIN).then_some(best);
    }
    (as_it_is - least > MARGIN).then_some(best)
}

/// Between frames with another limb, where points are missing or say little, it is as these have it, if that explains a frame no worse
/// than as it is: what jumps away and back again would stay so.
fn bridge(problem: &Problem, state: &State, scales: &Scales, limb: Limb, found: &mut [Option<Frame>]) {
    let wide = Scales { rho: RHO, ..*scales };
    let seen: Vec<usize> = (0..found.len()).filter(|&t| found[t].is_some()).collect();
    let near = 2..=1 + FRAMES.max(found.len() / 8);
    for ends in seen.windows(2).filter(|ends| near.contains(&(ends[1] - ends[0]))) {
        let [Some(first), Some(last)] = [0, 1].map(|k| found[ends[k]].clone()) else { continue };
        for (t, found) in found.iter_mut().enumerate().take(ends[1]).skip(ends[0] + 1) {
            let at = (t - ends[0]) as f64 / (ends[1] - ends[0]) as f64;
            let mut between = state.frames[t].clone();
            for &joint in limb.joints() {
                between.theta[joint] = first.theta[joint].lerp(last.theta[joint], at);
            }
            let lively = problem.lively_at(t).or(Lively::only(limb));
            let as_it_is = problem.of_frame(t, &state.frames[t], &state.shared, &wide);
            if problem.of_lively_frame(t, &between, lively, &state.shared, &wide) < as_it_is + MARGIN {
                *found = Some(between);
            }
        }
    }
}

/// A pattern search over some angles.
fn improved(
    (mut least, mut best): (f64, Frame),
    angles: &[(usize, usize)],
    cost: &dyn Fn(&Frame) -> f64,
) -> (f64, Frame) {
    let mut step = STEP;
    for _ in 0..HALVINGS {
        loop {
            let before = least;
            for &(joint, axis) in angles {
                for change in [step, -step] {
                    let mut other = best.clone();
                    other.theta[joint][axis] += change;
                    let value = cost(&other);
                    if value < least {
                        (least, best) = (value, other);
                    }
                }
            }
            if least >= before {
                break;
            }
        }
        step *= 0.5;
    }
    (least, best)
}
