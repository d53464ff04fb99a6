//! The unknowns and where each stands in the normal equations.

use glam::{DMat3, DVec3};

use super::landmarks::N_OFFSETS;
use super::prior::Prior;
use super::rotation;
use crate::body::N_JOINTS;

/// One frame.
#[derive(Clone, Debug)]
pub struct Frame {
    /// `R(θ₀)`: from the body to the camera.
    pub root: DMat3,
    /// The pelvis joint in camera space, metres.
    pub pelvis: DVec3,
    /// Radians a unit of time by which the body turns about its own up axis.
    pub turn_rate: f64,
    /// Rotation vectors; entry 0 is unused.
    pub theta: [DVec3; N_JOINTS],
    /// Of the left and the right leg, the part of hip's and knee's bends (x of θ, radians) that is a step: what goes on from
    /// frame to frame is the rest.
    pub step: [[f64; 2]; 2],
}

/// What all frames share.
#[derive(Clone, Debug)]
pub struct Shared {
    pub betas: Vec<f64>,
    /// Displacements of keypoints on the body (left side), metres in the zero pose.
    pub offsets: [DVec3; N_OFFSETS],
    /// `[P]`: displacements of the tracked points from their vertices, metres in the zero pose.
    pub tracked: Vec<DVec3>,
    /// The focal length is `camera's · exp(log_focal)`.
    pub log_focal: f64,
}

#[derive(Clone, Debug)]
pub struct State {
    pub frames: Vec<Frame>,
    pub shared: Shared,
}

/// A step of all unknowns: `[N · n_frame]` and `[n_shared]`.
pub struct Step {
    pub frames: Vec<f64>,
    pub shared: Vec<f64>,
}

/// Columns of a frame: root 0–2 (a turn in the body's axes), pelvis 3–5, turn rate 6, steps 7–10, then three for each
/// joint that the prior lets move. Shared columns: betas, offsets, focal length, then three for each tracked point.
#[derive(Clone, Debug)]
pub struct Layout {
    columns: [Option<usize>; N_JOINTS],
    pub n_frame: usize,
    pub n_betas: usize,
    pub n_shared: usize,
}

impl Layout {
    pub const PELVIS: usize = 3;
    pub const TURN_RATE: usize = 6;
    pub const STEP: usize = 7;

    pub fn new(prior: &Prior, n_betas: usize) -> Self {
        let mut columns = [None; N_JOINTS];
        columns[0] = Some(0);
        let mut n_frame = Self::STEP + 4;
        for j in prior.joints() {
            columns[j] = Some(n_frame);
            n_frame += 3;
        }
        Self { columns, n_frame, n_betas, n_shared: n_betas + 3 * N_OFFSETS + 1 }
    }

    /// First of the three columns of a joint; the root's are 0–2.
    pub fn joint_column(&self, joint: usize) -> Option<usize> {
        self.columns[joint]
    }

    pub fn beta_column(&self, b: usize) -> usize {
        b
    }

    pub fn offset_column(&self, slot: usize) -> usize {
        self.n_betas + 3 * slot
    }

    pub fn focal_column(&self) -> usize {
        self.n_betas + 3 * N_OFFSETS
    }

    pub fn tracked_column(&self, point: usize) -> usize {
        self.focal_column() + 1 + 3 * point
    }

    /// Adds columns for `points` tracked points.
    pub fn track(&mut self, points: usize) {
        self.n_shared = self.tracked_column(points);
    }
}

fn vec3(values: &[f64]) -> DVec3 {
    DVec3::new(values[0], values[1], values[2])
}

impl State {
    /// The state after a step.
    pub fn stepped(&self, layout: &Layout, step: &Step) -> State {
        let mut next = self.clone();
        for (frame, d) in next.frames.iter_mut().zip(step.frames.chunks_exact(layout.n_frame)) {
            frame.root *= rotation::exp(vec3(d));
            frame.pelvis += vec3(&d[Layout::PELVIS..]);
            frame.turn_rate += d[Layout::TURN_RATE];
            let step = frame.step.as_flattened_mut().iter_mut();
            step.zip(&d[Layout::STEP..]).for_each(|(bend, d)| *bend += d);
            for j in 1..N_JOINTS {
                if let Some(column) = layout.joint_column(j) {
                    frame.theta[j] += vec3(&d[column..]);
                }
            }
        }
        for (b, beta) in next.shared.betas.iter_mut().enumerate() {
            *beta += step.shared[layout.beta_column(b)];
        }
        for (slot, offset) in next.shared.offsets.iter_mut().enumerate() {
            *offset += vec3(&step.shared[layout.offset_column(slot)..]);
        }
        for (point, offset) in next.shared.tracked.iter_mut().enumerate() {
            *offset += vec3(&step.shared[layout.tracked_column(point)..]);
        }
        next.shared.log_focal += step.shared[layout.focal_column()];
        next
    }
}
