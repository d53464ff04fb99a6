//! The first guess: where the person stands and which way they face, from the keypoints of a clip in which
//! they turn once. Every frame scores every facing against a standing template; a path through time that
//! turns steadily one way (or the other, or not at all) joins the frames. A frame may also be read with left
//! and right swapped, since detectors do that when they see a back.

use std::f64::consts::{PI, TAU};

use glam::{DVec2, DVec3};

use super::landmarks::{Landmark, Part};
use super::problem::Observation;
use crate::math::median;

/// Facings tried a frame.
const BINS: usize = 72;
const BIN: f64 = TAU / BINS as f64;
/// The template's misfit: torso and head, arms, metres.
const BODY_SIGMA: f64 = 0.045;
const ARM_SIGMA: f64 = 0.12;
/// Log-odds of a frame read with sides swapped, and of a change between the two readings.
const SWAPPED_COST: f64 = 1.5;
const TOGGLE_COST: f64 = 2.0;
/// Penalty of a clip that does not turn.
const NO_TURN_COST: f64 = 12.0;

/// One reading of the whole clip.
#[derive(Clone, Debug)]
pub struct Placement {
    /// Radians about the body's up axis, unwrapped; 0 faces the camera, a quarter turn points the left side away.
    pub yaws: Vec<f64>,
    pub swapped: Vec<bool>,
    /// Pixels a metre at the pelvis.
    pub scales: Vec<f64>,
    /// The pelvis in the image.
    pub centres: Vec<DVec2>,
    pub cost: f64,
}

/// Scale and height of a frame, from the image rows alone: turning does not move them.
#[derive(Clone, Copy)]
struct Rows {
    scale: f64,
    y: f64,
}

/// The readings turning left, right and not at all; the likeliest first. Empty where no frame shows enough.
/// `template [K]`: landmarks of the mean body in its mean pose, pelvis at the origin, facing +Z.
pub fn readings(
    landmarks: &[Landmark],
    template: &[DVec3],
    observations: &[Vec<Observation>],
    gaps: &[f64],
) -> Vec<Placement> {
    let Some(rows) = rows_of(landmarks, template, observations) else { return Vec::new() };
    let scores: Vec<Vec<Score>> =
        observations.iter().zip(&rows).map(|(seen, row)| score_frame(landmarks, template, seen, row)).collect();
    let mut readings: Vec<Placement> = [1.0, -1.0, 0.0]
        .iter()
        .map(|direction| {
            let (path, cost) = best_path(&scores, gaps, *direction);
            let yaws = smoothed(&unwrapped(&path));
            let at = |t: usize| &scores[t][path[t]];
            Placement {
                yaws,
                swapped: path.iter().map(|state| *state >= BINS).collect(),
                scales: rows.iter().map(|r| r.scale).collect(),
                centres: (0..rows.len()).map(|t| DVec2::new(at(t).x, rows[t].y)).collect(),
                cost,
            }
        })
        .collect();
    for reading in &mut readings {
        let xs: Vec<f64> = reading.centres.iter().map(|c| c.x).collect();
        for (centre, x) in reading.centres.iter_mut().zip(running_median(&xs, 3)) {
            centre.x = x;
        }
    }
    readings.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    readings
}

fn running_median(values: &[f64], half: usize) -> Vec<f64> {
    let window = |t: usize| &values[t.saturating_sub(half)..(t + half + 1).min(values.len())];
    (0..values.len()).map(|t| median(window(t).iter().copied()).unwrap_or(values[t])).collect()
}

/// Theil–Sen over image rows, smoothed over time; `None` where no frame shows enough of the person.
fn rows_of(landmarks: &[Landmark], template: &[DVec3], observations: &[Vec<Observation>]) -> Option<Vec<Rows>> {
    let upright = |k: usize| !matches!(landmarks[k].part, Part::Elbow | Part::Wrist);
    let of_frame = |seen: &Vec<Observation>| -> Option<Rows> {
        let used: Vec<usize> = (0..seen.len()).filter(|&k| upright(k) && seen[k].weight > 0.0).collect();
        let mut slopes = Vec::new();
        for (i, &a) in used.iter().enumerate() {
            for &b in &used[..i] {
                let rise = template[a].y - template[b].y;
                if rise.abs() > 0.3 {
                    slopes.push(-(seen[a].at.y - seen[b].at.y) / rise);
                }
            }
        }
        let scale = median(slopes).filter(|s| *s > 1.0)?;
        let y = median(used.iter().map(|&k| seen[k].at.y + scale * template[k].y))?;
        Some(Rows { scale, y })
    };
    let found: Vec<Option<Rows>> = observations.iter().map(of_frame).collect();
    let known: Vec<usize> = (0..found.len()).filter(|&t| found[t].is_some()).collect();
    if known.is_empty() {
        return None;
    }
    let filled: Vec<Rows> = (0..found.len())
        .filter_map(|t| found[t].or_else(|| found[*known.iter().min_by_key(|k| k.abs_diff(t))?]))
        .collect();
    let scales = running_median(&filled.iter().map(|r| r.scale).collect::<Vec<_>>(), 5);
    let ys = running_median(&filled.iter().map(|r| r.y).collect::<Vec<_>>(), 5);
    Some(scales.into_iter().zip(ys).map(|(scale, y)| Rows { scale, y }).collect())
}

/// One facing of one frame.
#[derive(Clone, Copy)]
struct Score {
    cost: f64,
    /// Column of the pelvis under this facing.
    x: f64,
}

/// `[2 · BINS]`: every facing as read, then with sides swapped.
fn score_frame(landmarks: &[Landmark], template: &[DVec3], seen: &[Observation], row: &Rows) -> Vec<Score> {
    let read = |swapped: bool| -> Vec<Observation> {
        (0..seen.len()).map(|k| seen[if swapped { landmarks[k].partner } else { k }]).collect()
    };
    let mut scores = Vec::with_capacity(2 * BINS);
    for swapped in [false, true] {
        let seen = read(swapped);
        for bin in 0..BINS {
            let mut score = score_facing(landmarks, template, &seen, row, bin as f64 * BIN);
            score.cost += if swapped { SWAPPED_COST } else { 0.0 };
            scores.push(score);
        }
    }
    scores
}

fn score_facing(landmarks: &[Landmark], template: &[DVec3], seen: &[Observation], row: &Rows, yaw: f64) -> Score {
    let (sin, cos) = yaw.sin_cos();
    let turned = |p: DVec3| (p.x * cos + p.z * sin, p.z * cos - p.x * sin);
    let used = || (0..seen.len()).filter(|&k| seen[k].weight > 0.0);
    let is_arm = |k: usize| matches!(landmarks[k].part, Part::Elbow | Part::Wrist);
    let lateral = |k: usize| seen[k].at.x - row.scale * turned(template[k]).0;
    let x = median(used().filter(|&k| !is_arm(k)).map(lateral));
    let Some(x) = x.or_else(|| median(used().map(lateral))) else {
        return Score { cost: 0.0, x: 0.0 };
    };
    let mut cost = 0.0;
    for k in used() {
        let sigma = row.scale * if is_arm(k) { ARM_SIGMA } else { BODY_SIGMA };
        let q = ((lateral(k) - x) / sigma).powi(2);
        // Saturates at 3σ, so that a wrong point costs no more than a missing one explains.
        cost += 0.5 * seen[k].weight * 9.0 * q / (q + 9.0);
    }
    Score { cost: cost + visibility(landmarks, template, seen, turned), x }
}

/// Detectors are surer of what faces the camera: the nearer of a pair, and the nose of who looks at us.
fn visibility(
    landmarks: &[Landmark],
    template: &[DVec3],
    seen: &[Observation],
    turned: impl Fn(DVec3) -> (f64, f64),
) -> f64 {
    let confidence = |k: usize| seen[k].weight / landmarks[k].part.weight();
    let mut cost = 0.0;
    for (k, landmark) in landmarks.iter().enumerate() {
        if landmark.side > 0.0 {
            let nearer = turned(template[k]).1 - turned(template[landmark.partner]).1;
            let doubt = (confidence(k) - confidence(landmark.partner)).clamp(-0.6, 0.6);
            let both = confidence(k) > 0.0 && confidence(landmark.partner) > 0.0;
            cost -= if both { 1.5 } else { 0.5 } * doubt * (nearer / 0.2).clamp(-1.0, 1.0);
        } else if landmark.part == Part::Nose {
            let (_, forward) = turned(DVec3::Z);
            let sure = confidence(k).min(1.0);
            cost += if sure > 0.0 { 2.5 * (sure - 0.5) * -forward } else { 0.5 * forward };
        }
    }
    cost
}

/// Viterbi over facing and reading. `direction` ±1: a turn of about one round at a varying pace, seldom back.
fn best_path(scores: &[Vec<Score>], gaps: &[f64], direction: f64) -> (Vec<usize>, f64) {
    let mut cost: Vec<f64> = scores[0].iter().map(|s| s.cost).collect();
    let mut from: Vec<Vec<usize>> = Vec::with_capacity(gaps.len());
    for (t, gap) in gaps.iter().enumerate() {
        let steps = steps_of(*gap, direction);
        let mut next = vec![f64::INFINITY; 2 * BINS];
        let mut origin = vec![0; 2 * BINS];
        for state in 0..2 * BINS {
            let (bin, reading) = ((state % BINS) as i64, state / BINS);
            for (step, step_cost) in &steps {
                let previous_bin = (bin - step).rem_euclid(BINS as i64) as usize;
                for previous_reading in 0..2 {
                    let previous = previous_bin + previous_reading * BINS;
                    let toggle = if previous_reading == reading { 0.0 } else { TOGGLE_COST };
                    let total = cost[previous] + step_cost + toggle;
                    if total < next[state] {
                        (next[state], origin[state]) = (total, previous);
                    }
                }
            }
            next[state] += scores[t + 1][state].cost;
        }
        cost = next;
        from.push(origin);
    }
    let mut state = (0..cost.len()).min_by(|a, b| cost[*a].total_cmp(&cost[*b])).unwrap_or(0);
    let total = cost[state] + if direction == 0.0 { NO_TURN_COST } else { 0.0 };
    let mut path = vec![state];
    for origin in from.iter().rev() {
        state = origin[state];
        path.push(state);
    }
    path.reverse();
    (path, total)
}

/// Steps in bins over a gap (hundredths of the clip), and their costs.
fn steps_of(gap: f64, direction: f64) -> Vec<(i64, f64)> {
    let expected = direction * 3.6f64.to_radians() * gap;
    let sigma = (4.0 + 3.0 * gap).to_radians();
    let reach = (((10.0 + 12.0 * gap).to_radians() / BIN).ceil() as i64).min(BINS as i64 / 2 - 1);
    (-reach..=reach)
        .map(|step| {
            let angle = step as f64 * BIN;
            let backwards = (-angle * direction).max(0.0) / BIN;
            (step, 0.5 * ((angle - expected) / sigma).powi(2) + 3.0 * backwards)
        })
        .filter(|(_, cost)| *cost < 20.0)
        .collect()
}

fn unwrapped(path: &[usize]) -> Vec<f64> {
    let mut yaws: Vec<f64> = Vec::with_capacity(path.len());
    for state in path {
        let yaw = (state % BINS) as f64 * BIN;
        let last = yaws.last().copied().unwrap_or(yaw);
        yaws.push(last + (yaw - last + PI).rem_euclid(TAU) - PI);
    }
    yaws
}

/// The bins' steps smoothed away: a mean over five frames, a line at the ends.
fn smoothed(yaws: &[f64]) -> Vec<f64> {
    let n = yaws.len();
    (0..n)
        .map(|t| {
            let half = 2.min(t).min(n - 1 - t);
            let window = &yaws[t - half..=t + half];
            window.iter().sum::<f64>() / window.len() as f64
        })
        .collect()
}
