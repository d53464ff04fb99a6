//! Where known detectors see joints: not where a rig has them.
//!
//! One person's clip hardly tells a knee that is seen too low from a long thigh, and what is taken for the wrong one comes out in new
//! poses. A detector's habits were measured on other people instead (docs/lab/detector.md, "How far off they are").

use glam::DVec3;

use super::landmarks::{N_OFFSETS, Part};
use super::offsets;

/// What is expected of the keypoints' offsets, metres.
pub struct Habits {
    pub offsets: [DVec3; N_OFFSETS],
    pub sigma: [f64; N_OFFSETS],
    /// False where detections may as well be a rig's own joints.
    pub known: bool,
}

/// Part, place (out from the middle, up, to the front, in the zero pose) and its spread over people.
type Habit = (Part, [f64; 3], f64);

/// BlazePose, as MediaPipe 0.10 runs it: the middle of what five clothed persons had, and how far they were from it.
const BLAZEPOSE: [Habit; 6] = [
    (Part::Shoulder, [-0.025, 0.022, 0.0], 0.006),
    (Part::Elbow, [0.003, 0.0, 0.005], 0.006),
    (Part::Wrist, [0.01, 0.0, 0.01], 0.006),
    (Part::Hip, [-0.004, -0.026, 0.025], 0.006),
    (Part::Knee, [0.0, -0.012, 0.003], 0.006),
    (Part::Ankle, [0.0, 0.02, 0.002], 0.006),
];

impl Habits {
    /// Of the detector whose points came in this format.
    pub fn of(format: &str) -> Self {
        let known: &[Habit] = if format == "mediapipe33" { &BLAZEPOSE } else { &[] };
        let (mut offsets, mut sigma) = ([DVec3::ZERO; N_OFFSETS], offsets::UNKNOWN);
        for &(part, place, spread) in known {
            let slot = part.offset().expect("a part with habits has an offset");
            (offsets[slot], sigma[slot]) = (DVec3::from_array(place), spread);
        }
        Self { offsets, sigma, known: !known.is_empty() }
    }
}
