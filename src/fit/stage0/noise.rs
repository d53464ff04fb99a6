//! How noisy the detector is: anew in each frame, and in many frames alike.
//!
//! A descent takes errors for new in each frame. A detector's that last (an elbow is seen too far out from one side, frame after
//! frame) look like motion to it, and it follows them. What it cannot follow of them is left, and is told from noise by its likeness
//! from frame to frame ([`lasting`]; docs/lab/detector.md).

use glam::DVec2;

use super::landmarks::Part;
use super::problem::{Problem, Scales};
use super::sides;
use super::state::State;
use crate::math::{DEVIATION_OVER_MEDIAN, median};

/// Bounds of the noise in multiples of the person's height in pixels: the model's own misfit, and the most that a
/// detector may be off.
const LEAST: f64 = 0.003;
const MOST: f64 = 0.025;

/// Residuals are this much smaller than the noise, because the pose follows a part of it (measured on
/// synthetic clips).
const FOLLOWED: f64 = 1.25;

/// The same of errors that last. They are larger still; but with eight masks took over what keypoints tell of lengths
/// (docs/lab/detector.md).
const LASTING_FOLLOWED: f64 = 5.0;
/// What lasts of residuals because the model is not the person, and keypoints are smoothed in time; over the person's height.
const MISFIT: f64 = 0.0008;

/// The median distance over σ of one coordinate: a Rayleigh distribution's.
pub const MEDIAN_DISTANCE: f64 = 1.1774;

/// σ of one coordinate from the median distance.
pub fn of_each_frame(problem: &Problem, state: &State, scales: &Scales) -> f64 {
    let all: Vec<f64> = sides::distances(problem, state).into_iter().flatten().filter(|d| d.is_finite()).collect();
    let height = problem.height_px(state);
    median(all)
        .map_or(scales.sigma_px, |median| (FOLLOWED * median / MEDIAN_DISTANCE).clamp(LEAST * height, MOST * height))
}

/// σ of one coordinate of errors that neighbouring frames have in common, at the end of a descent that took them for new in each;
/// 0 where there are none. Of elbows, wrists, knees and ankles: other parts' places on the body are fitted.
pub fn lasting(problem: &Problem, state: &State) -> f64 {
    let height = problem.height_px(state);
    let mut errors = sides::errors(problem, state);
    for (k, landmark) in problem.landmarks.iter().enumerate() {
        if !matches!(landmark.part, Part::Elbow | Part::Wrist | Part::Knee | Part::Ankle) {
            errors.iter_mut().for_each(|frame| frame[k] = None);
        }
    }
    let coordinates = |errors: &mut dyn Iterator<Item = DVec2>| errors.flat_map(|e| e.abs().to_array()).collect();
    let all: Vec<f64> = coordinates(&mut errors.iter().flatten().copied().flatten());
    let pairs = errors.windows(2).flat_map(|pair| pair[0].iter().zip(&pair[1]));
    let changes: Vec<f64> = coordinates(&mut pairs.filter_map(|(a, b)| Some((*b)? - (*a)?)));
    let [Some(all), Some(changes)] = [all, changes].map(median) else { return 0.0 };
    // Noise that is new in each frame makes changes √2 times as large as itself.
    let squared = (DEVIATION_OVER_MEDIAN * all).powi(2)
        - (DEVIATION_OVER_MEDIAN * changes).powi(2) / 2.0
        - (MISFIT * height).powi(2);
    (LASTING_FOLLOWED * squared.max(0.0).sqrt()).min(MOST * height)
}
