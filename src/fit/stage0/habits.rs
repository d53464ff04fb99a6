//! Where known detectors see joints: not where a rig has them.
//!
//! One person's clip hardly tells a knee that is seen too low from a long thigh, and what is taken for the wrong one comes out in new
//! poses. A detector's habits were measured on other people instead (docs/lab/detector.md, "How far off they are").

use glam::DVec3;

use super::landmarks::{N_ALWAYS_FITTED, N_OFFSETS, Part};
use super::prior;

/// What is expected of the keypoints' offsets, metres.
pub struct Habits {
    pub offsets: [DVec3; N_OFFSETS],
    pub sigma: [f64; N_OFFSETS],
    /// False where detections may as well be a rig's own joints.
    pub known: bool,
}

/// BlazePose, as MediaPipe 0.10 runs it: the middle of what five clothed persons had (out from the middle, up, to the front, in
/// the zero pose).
const BLAZEPOSE: [(Part, [f64; 3]); 6] = [
    (Part::Shoulder, [-0.025, 0.022, 0.0]),
    (Part::Elbow, [0.003, 0.0, 0.005]),
    (Part::Wrist, [0.01, 0.0, 0.01]),
    (Part::Hip, [-0.004, -0.026, 0.025]),
    (Part::Knee, [0.0, -0.012, 0.003]),
    (Part::Ankle, [0.0, 0.02, 0.002]),
];
/// How far one may be from them. Some of the five were further (knees by 2.7 cm); but twice as wide, offsets are told from lengths, and
/// lengths from the size, by nothing.
const SPREAD: f64 = 0.006;

impl Habits {
    /// Of the detector whose points came in this format. An unknown one's limbs are taken for the rig's.
    pub fn of(format: &str) -> Self {
        let known: &[_] = if format == "mediapipe33" { &BLAZEPOSE } else { &[] };
        let (mut offsets, mut sigma) = ([DVec3::ZERO; N_OFFSETS], [prior::NO_OFFSET_SIGMA; N_OFFSETS]);
        sigma[..N_ALWAYS_FITTED].fill(prior::OFFSET_SIGMA);
        for &(part, place) in known {
            let slot = part.offset().expect("a part with habits has an offset");
            (offsets[slot], sigma[slot]) = (DVec3::from_array(place), SPREAD);
        }
        Self { offsets, sigma, known: !known.is_empty() }
    }
}
