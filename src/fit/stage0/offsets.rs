//! Whether the keypoints of hips and shoulders are the rig's own joints.
//!
//! Detectors place them a few centimetres elsewhere on the body, so each pair has an offset, and its prior is wide. But a person
//! who turns hardly bends the hips: an offset, a wider pelvis and longer thighs look nearly the same, and with a wide prior the
//! mean body's proportions decide. Keypoints that come from a rig (motion capture, renderers, models that regress a
//! body) have no offset and tell those lengths. Both readings are descended to, and no offset is believed
//! where that costs next to nothing.

use super::landmarks::Part;
use super::{Candidate, RoundProgress, Stage0Error, prior};

/// Parts whose keypoints are read alike.
const TOGETHER: [&[Part]; 2] = [&[Part::Hip, Part::MidHip], &[Part::Shoulder]];
/// By how much the cost may rise (log-odds). The narrow prior alone is worth `3 ln(25 mm / 0.3 mm)` = 13 where keypoints have
/// no offset, less as far as they cannot tell.
const MARGIN: f64 = 4.0;

/// Rounds of descent that settling takes.
pub const ROUNDS: usize = TOGETHER.len();

/// Narrows the prior of the offsets that are not needed.
pub fn settle(best: &mut Candidate, progress: &mut RoundProgress<'_>) -> Result<(), Stage0Error> {
    if best.problem.known_detector {
        progress.round += ROUNDS;
        return if progress.goes_on() { Ok(()) } else { Err(Stage0Error::Stopped) };
    }
    for parts in TOGETHER {
        let (state, cost, sigma) = (best.state.clone(), best.cost, best.problem.offset_sigma);
        for slot in parts.iter().filter_map(|part| part.offset()) {
            best.problem.offset_sigma[slot] = prior::NO_OFFSET_SIGMA;
        }
        best.descend(1e-4, progress)?;
        if best.cost > cost + MARGIN {
            (best.state, best.cost, best.problem.offset_sigma) = (state, cost, sigma);
        } else {
            believe(best, parts);
        }
    }
    Ok(())
}

/// Joints of a rig tell as much as any other joint: they counted less because detectors place them elsewhere.
fn believe(best: &mut Candidate, parts: &[Part]) {
    let Candidate { problem, state, scales, cost, .. } = best;
    for (k, landmark) in problem.landmarks.iter().enumerate().filter(|(_, l)| parts.contains(&l.part)) {
        let share = landmark.part.weight();
        problem.observations.iter_mut().for_each(|frame| frame[k].weight /= share);
    }
    *cost = problem.evaluate(state, scales, None);
}
