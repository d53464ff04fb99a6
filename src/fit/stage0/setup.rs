//! From a capture to problems with a first guess each.

use std::f64::consts::TAU;

use glam::{DMat3, DVec2, DVec3};

use super::habits::Habits;
use super::landmarks::N_OFFSETS;
use super::landmarks::landmarks;
use super::placement::{self, Placement};
use super::prior::{self, Prior};
use super::problem::{Observation, Pinhole, Problem, Scales, Stature};
use super::rig::{MOST_BETAS, Point, Rig};
use super::sides;
use super::state::{Frame, Layout, Shared, State};
use super::steps::Steps;
use super::tracks::Tracks;
use super::{Candidate, Stage0Error};
use crate::body::Body;
use crate::capture::Capture;

/// Spread of a guessed focal length's logarithm, and of a known one's.
const GUESSED_FOCAL: f64 = 0.15;
const KNOWN_FOCAL: f64 = 1e-6;
/// Readings this much worse than the best (log-odds) are not followed.
const READING_MARGIN: f64 = 40.0;

/// The problem of a capture, without contours.
pub fn problem(body: &Body, capture: &Capture) -> Result<Problem, Stage0Error> {
    if capture.frames.is_empty() {
        return Err(Stage0Error::NoFrames);
    }
    let unknown = || Stage0Error::UnknownFormat(capture.keypoint_format.clone(), body.name.clone());
    let landmarks = landmarks(&capture.keypoint_format).ok_or_else(unknown)?;
    let set = body.keypoint_set(&capture.keypoint_format).ok_or_else(unknown)?;
    let points: Vec<Point> = set.points.iter().map(|source| Point::new(body, source)).collect();
    if points.len() != landmarks.len() {
        return Err(unknown());
    }
    let mut observations = Vec::with_capacity(capture.frames.len());
    for (t, frame) in capture.frames.iter().enumerate() {
        if frame.keypoints.len() != landmarks.len() {
            let found = frame.keypoints.len();
            return Err(Stage0Error::KeypointCount { frame: t, found, expected: landmarks.len() });
        }
        let observe = |(k, seen): (usize, &[f32; 3])| {
            let [x, y, confidence] = seen.map(f64::from);
            let usable = x.is_finite() && y.is_finite() && confidence > 0.0;
            let weight = if usable { landmarks[k].part.weight() * confidence.min(1.0) } else { 0.0 };
            Observation { at: DVec2::new(x, y), weight }
        };
        observations.push(frame.keypoints.iter().enumerate().map(observe).collect());
    }
    let index = |t: usize| f64::from(capture.frames[t].index);
    let span = (index(capture.frames.len() - 1) - index(0)).max(1.0);
    let gaps = (1..capture.frames.len()).map(|t| (index(t) - index(t - 1)).max(1.0) * 100.0 / span).collect();
    let prior = Prior::standing();
    let rig = Rig::new(body);
    let habits = Habits::of(&capture.given_keypoint_format);
    Ok(Problem {
        layout: Layout::new(&prior, rig.n_betas()),
        rig,
        prior,
        camera: Pinhole::of(&capture.camera),
        stature: stature(body),
        focal_sigma: if capture.camera_estimated { GUESSED_FOCAL } else { KNOWN_FOCAL },
        landmarks,
        offsets: habits.offsets,
        offset_sigma: habits.sigma,
        known_detector: habits.known,
        points,
        observations,
        gaps,
        surface: Vec::new(),
        contours: Vec::new(),
        tracks: Tracks::default(),
        given: None,
        stance: None,
        lively: Vec::new(),
        steps: Steps::default(),
    })
}

/// How the height between the template's lowest and highest vertices grows with each beta.
fn stature(body: &Body) -> Stature {
    let by_height = |a: &usize, b: &usize| body.v_template[*a][1].total_cmp(&body.v_template[*b][1]);
    let lowest = (0..body.n_vertices()).min_by(by_height).unwrap_or(0);
    let highest = (0..body.n_vertices()).max_by(by_height).unwrap_or(0);
    let rise = |v: usize, b: usize| f64::from(body.shapedirs[(v * 3 + 1) * body.n_betas + b]);
    let template = f64::from(body.v_template[highest][1] - body.v_template[lowest][1]);
    Stature {
        template,
        slopes: (0..body.n_betas.min(MOST_BETAS)).map(|b| rise(highest, b) - rise(lowest, b)).collect(),
        expected: prior::ADULT_STATURE,
        sigma: prior::STATURE_SIGMA,
    }
}

pub fn mean_shape(n_betas: usize) -> Shared {
    Shared { betas: vec![0.0; n_betas], offsets: [DVec3::ZERO; N_OFFSETS], tracked: Vec::new(), log_focal: 0.0 }
}

/// Wide scales for a first descent.
pub fn rough_scales(problem: &Problem, state: &State) -> Scales {
    Scales {
        sigma_px: 0.025 * problem.height_px(state),
        rho: 3.0,
        contour_weight: 0.0,
        contour_outside_px: 1.0,
        contour_inside_px: 1.0,
        track_px: 1.0,
        shape_weight: 1.0,
        stature_weight: 1.0,
    }
}

/// The readings of a clip without poses that are worth a descent.
pub fn candidates(body: &Body, capture: &Capture) -> Result<Vec<Candidate>, Stage0Error> {
    let blank = problem(body, capture)?;
    let readings = {
        let standing = Frame {
            root: DMat3::IDENTITY,
            pelvis: DVec3::ZERO,
            turn_rate: 0.0,
            step: [[0.0; 2]; 2],
            theta: blank.prior.mean_pose(),
        };
        let shape = mean_shape(blank.rig.n_betas());
        let posed = blank.rig.pose(&standing, &shape);
        let template: Vec<DVec3> =
            blank.points.iter().map(|point| posed.place(point, &shape.betas, DVec3::ZERO)).collect();
        placement::readings(&blank.landmarks, &template, &blank.observations, &blank.gaps)
    };
    let limit = readings.first().ok_or(Stage0Error::NobodyFound)?.cost + READING_MARGIN;
    let mut candidates = Vec::new();
    for reading in readings.iter().filter(|r| r.cost <= limit) {
        candidates.push(candidate(problem(body, capture)?, reading));
    }
    Ok(candidates)
}

fn candidate(mut problem: Problem, reading: &Placement) -> Candidate {
    let swapped: Vec<[bool; 3]> = reading.swapped.iter().map(|s| [*s; 3]).collect();
    for (t, groups) in swapped.iter().enumerate() {
        for (group, _) in groups.iter().enumerate().filter(|(_, s)| **s) {
            sides::swap_group(&mut problem, t, group);
        }
    }
    let turns = reading.yaws.first().zip(reading.yaws.last()).map_or(0.0, |(first, last)| (last - first).abs() / TAU);
    problem.gaps.iter_mut().for_each(|gap| *gap *= turns.max(1.0));
    let state = first_state(&problem, reading);
    let scales = rough_scales(&problem, &state);
    Candidate { problem, state, swapped, hidden: Vec::new(), scales, cost: f64::INFINITY }
}

/// The mean body in its mean pose, placed and turned as read.
fn first_state(problem: &Problem, reading: &Placement) -> State {
    let camera = &problem.camera;
    let rate = |t: usize| match problem.gaps.get(t) {
        Some(gap) => (reading.yaws[t + 1] - reading.yaws[t]) / gap,
        None => 0.0,
    };
    let n = reading.yaws.len();
    let frame = |t: usize| {
        let depth = camera.fy / reading.scales[t];
        Frame {
            root: DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)) * DMat3::from_rotation_y(reading.yaws[t]),
            pelvis: camera.ray(reading.centres[t]) * depth,
            turn_rate: rate(t.min(n.saturating_sub(2))),
            step: [[0.0; 2]; 2],
            theta: problem.prior.mean_pose(),
        }
    };
    let shared = Shared { offsets: problem.offsets, ..mean_shape(problem.rig.n_betas()) };
    State { frames: (0..n).map(frame).collect(), shared }
}
