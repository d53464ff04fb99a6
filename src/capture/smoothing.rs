//! Keypoints smoothed in time, over all frames of the video: a detector's noise is new in each frame, where a joint goes is
//! not, and frames that a fit does not keep tell of it too. What it keeps it had better see as it is: smoothed keypoints have
//! errors in common with their neighbours', which the fit takes for new in each frame.

use glam::{DMat3, DVec2, DVec3};

use super::keypoints::Point;
use crate::math::median;

/// The frames of a clip of fewer lie too far apart: over five of them a joint's way is no parabola.
const LEAST_FRAMES: usize = 30;

/// Half widths of the windows that are tried, frames.
const HALF_WIDTHS: [usize; 9] = [2, 3, 4, 5, 7, 10, 14, 20, 28];

/// Detections that a parabola is fitted to, at least.
const LEAST_POINTS: usize = 5;

/// Geman & McClure's scale over the noise, from the first round to the last: beginning wide, a fit is not caught by the
/// wrong detections.
const RHO: [f64; 5] = [32.0, 16.0, 8.0, 4.0, 4.0];

/// Detections that lie further than this, over the noise, from the parabola through the others are wrong, or of a move too quick for
/// it, as a foot's that is lifted, and stay as they are, for all to see.
const WRONG: f64 = 4.0;

/// Of detections with a standard deviation of one a coordinate (400,000 random ones), see [`noise`].
const MEDIAN_OF_NEAREST: f64 = 0.913;

/// Part of the detections that a window is judged by: those that it tells best. The others may be wrong.
const JUDGES: f64 = 0.75;

/// A window may be worse than the best by this part: of windows that tell about as much, the narrowest bends a way least, and
/// leaves neighbouring frames the least error in common.
const AS_GOOD: f64 = 0.05;

/// No noise is below this, pixels.
const LEAST_NOISE: f64 = 0.05;

/// Moves every seen point of `frames [N][K]` onto a parabola through its detections in the frames around (a robust local
/// regression, Cleveland 1979). A point's window is the narrowest of those whose parabolas tell best where detections lie that
/// they were not fitted to. Confidences, unseen points and wrong detections stay.
pub(super) fn smooth(frames: &mut [Vec<Point>]) {
    let n_points = frames.first().map_or(0, Vec::len);
    if frames.len() < LEAST_FRAMES {
        return;
    }
    for point in 0..n_points {
        let track: Vec<Point> = frames.iter().map(|points| points[point]).collect();
        let Some(noise) = noise(&track) else { continue };
        let smoothed = HALF_WIDTHS.map(|half| Smoothed::new(&track, half, noise));
        let chosen = &smoothed[narrowest(smoothed.each_ref().map(|smoothed| smoothed.error))];
        for (points, at) in frames.iter_mut().zip(&chosen.places) {
            if let Some(at) = at {
                points[point][..2].copy_from_slice(&at.to_array());
            }
        }
    }
}

/// Of windows with these errors, widening, the first that is as good as the best.
fn narrowest(errors: [f64; HALF_WIDTHS.len()]) -> usize {
    let least = errors.into_iter().fold(f64::INFINITY, f64::min);
    errors.iter().position(|&error| error <= (1.0 + AS_GOOD) * least).unwrap_or(0)
}

fn place(point: &Point) -> DVec2 {
    DVec2::new(point[0], point[1])
}

/// Standard deviation a coordinate of the detections, pixels. A detection of a steady motion lies in the middle of the two
/// before and after it, but for noise; of three such pairs around it the nearest is compared, so that the median does not
/// mind if every fourth detection is wrong. `None` where no three frames, evenly spaced, have the point.
fn noise(track: &[Point]) -> Option<f64> {
    let seen = |frame: usize| track.get(frame).filter(|point| point[2] > 0.0).map(place);
    let off_middle = |frame: usize, step: usize| {
        let (before, after) = (seen(frame.checked_sub(step)?)?, seen(frame + step)?);
        Some(seen(frame)?.distance(before.midpoint(after)))
    };
    let nearest = |frame| (1..=3).filter_map(|step| off_middle(frame, step)).min_by(f64::total_cmp);
    median((0..track.len()).filter_map(nearest)).map(|median| (median / MEDIAN_OF_NEAREST).max(LEAST_NOISE))
}

/// A point's track, smoothed with one window.
struct Smoothed {
    /// `[N]`; `None` where the point stays: it is not seen, or wrong, or too little of it is seen around.
    places: Vec<Option<DVec2>>,
    /// Mean square of how far detections lie from the parabolas that were fitted without them, over [`JUDGES`].
    error: f64,
}

impl Smoothed {
    fn new(track: &[Point], half: usize, noise: f64) -> Self {
        let fitted = |frame: usize| if track[frame][2] > 0.0 { parabola(track, frame, half, noise) } else { None };
        let fitted: Vec<_> = (0..track.len()).map(fitted).collect();
        let seen = track.iter().zip(&fitted).filter(|(point, _)| point[2] > 0.0);
        let mut missed: Vec<f64> = seen.map(|(_, fitted)| fitted.map_or(f64::INFINITY, |(_, missed)| missed)).collect();
        missed.sort_by(f64::total_cmp);
        let judges = &missed[..(JUDGES * missed.len() as f64).ceil() as usize];
        let error = judges.iter().map(|missed| missed.powi(2)).sum::<f64>() / judges.len().max(1) as f64;
        let right = |(at, missed)| if missed < WRONG * noise { Some(at) } else { None };
        Self { places: fitted.into_iter().map(|fitted| fitted.and_then(right)).collect(), error }
    }
}

/// The value at `frame` of the parabola through the detections no more than `half` frames away, and how far the detection
/// of `frame` lies from the one through the others (the residual over 1 − its leverage).
fn parabola(track: &[Point], frame: usize, half: usize, noise: f64) -> Option<(DVec2, f64)> {
    let first = frame.saturating_sub(half);
    let window = &track[first..track.len().min(frame + half + 1)];
    let time = |k: usize| ((first + k) as f64 - frame as f64) / (half + 1) as f64;
    // Tricube, as is usual.
    let share = |k: usize, point: &Point| point[2] * (1.0 - time(k).abs().powi(3)).powi(3);
    if window.iter().filter(|point| point[2] > 0.0).count() < LEAST_POINTS {
        return None;
    }
    let mut weights: Vec<f64> = window.iter().enumerate().map(|(k, point)| share(k, point)).collect();
    let own = frame - first;
    let mut result = None;
    for rho in RHO {
        let (mut normal, mut right) = (DMat3::ZERO, [DVec3::ZERO; 2]);
        for ((k, point), weight) in window.iter().enumerate().zip(&weights) {
            let row = DVec3::new(1.0, time(k), time(k).powi(2));
            let scaled = *weight * row;
            normal += DMat3::from_cols(scaled * row.x, scaled * row.y, scaled * row.z);
            right[0] += scaled * point[0];
            right[1] += scaled * point[1];
        }
        if normal.determinant() <= 1e-9 * normal.x_axis.x.powi(3) {
            return None;
        }
        let inverse = normal.inverse();
        let [x, y] = right.map(|right| inverse * right);
        let missed = |k: usize, point: &Point| {
            let row = DVec3::new(1.0, time(k), time(k).powi(2));
            place(point).distance(DVec2::new(x.dot(row), y.dot(row)))
        };
        let leverage = weights[own] * inverse.x_axis.x;
        result = Some((DVec2::new(x.x, y.x), missed(own, &window[own]) / (1.0 - leverage).max(0.05)));
        let rho2 = (rho * noise).powi(2);
        for ((k, point), weight) in window.iter().enumerate().zip(&mut weights) {
            *weight = share(k, point) / (1.0 + missed(k, point).powi(2) / rho2).powi(2);
        }
    }
    result
}

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng as _};
    use rand_pcg::Pcg32;

    use super::*;

    /// A wrist of somebody who turns once, 100 px from the axis.
    fn truth(frame: usize, frames: usize) -> DVec2 {
        let angle = std::f64::consts::TAU * frame as f64 / frames as f64;
        DVec2::new(200.0 + 100.0 * angle.cos(), 150.0 + 10.0 * angle.sin())
    }

    /// Its detections, with a noise of 1.5 px.
    fn detected(frames: usize) -> Vec<Vec<Point>> {
        let mut rng = Pcg32::seed_from_u64(3);
        // The sum of twelve uniform numbers has a variance of one.
        let mut normal = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
        let at = |frame| truth(frame, frames) + 1.5 * DVec2::new(normal(), normal());
        (0..frames).map(at).map(|at| vec![[at.x, at.y, 0.9]]).collect()
    }

    /// Root mean square distance a coordinate of the seen points from the truth.
    fn error(frames: &[Vec<Point>]) -> f64 {
        let n = frames.len();
        let seen = frames.iter().enumerate().filter(|(_, points)| points[0][2] > 0.0);
        let squares: Vec<f64> = seen.map(|(k, points)| place(&points[0]).distance_squared(truth(k, n))).collect();
        (squares.iter().sum::<f64>() / (2 * squares.len()) as f64).sqrt()
    }

    #[test]
    fn the_noise_is_told_from_the_motion() {
        let track = |n| -> Vec<Point> { detected(n).into_iter().map(|points| points[0]).collect() };
        for n in [60, 300] {
            let noise = noise(&track(n)).unwrap();
            assert!((1.2..1.8).contains(&noise), "{n} frames: {noise} px");
        }
        assert_eq!(noise(&[[1.0, 1.0, 1.0], [1.0, 1.0, 0.0], [1.0, 1.0, 1.0]]), None);
        assert_eq!(noise(&[[1.0, 1.0, 1.0]; 3]), Some(LEAST_NOISE));
    }

    #[test]
    fn a_wider_window_has_to_tell_more() {
        assert_eq!(narrowest([9.0, 6.0, 4.8, 4.15, 4.1, 4.0, 4.1, 6.0, 9.0]), 3);
        assert_eq!(narrowest([1.0; 9]), 0);
        assert_eq!(narrowest([f64::INFINITY; 9]), 0, "too little is seen");
    }

    #[test]
    fn more_frames_tell_more() {
        let left = [60, 120, 300].map(|n| {
            let mut frames = detected(n);
            smooth(&mut frames);
            error(&frames)
        });
        assert!(left[0] < 0.95 && left[1] < 0.8 && left[2] < 0.6, "of 1.5 px are left {left:?}");
    }

    #[test]
    fn wrong_and_missing_detections_stay_and_spoil_nothing() {
        let mut frames = detected(90);
        for k in (0..90).step_by(4) {
            frames[k][0] = [20.0, 30.0, 0.8];
        }
        frames[41][0] = [0.0; 3];
        smooth(&mut frames);
        assert!(frames.iter().step_by(4).all(|points| points[0] == [20.0, 30.0, 0.8]));
        assert_eq!(frames[41][0], [0.0; 3]);
        frames.iter_mut().step_by(4).for_each(|points| points[0][2] = 0.0);
        assert!(error(&frames) < 1.0, "of 1.5 px are left {}", error(&frames));
        assert_eq!(frames[1][0][2], 0.9, "confidences stay");
    }

    #[test]
    fn a_quick_move_is_not_smoothed_away() {
        let mut frames = detected(240);
        let raised = |frame: usize| {
            let at = (frame % 60) as f64 / 8.0;
            if at < 1.0 { 9.0 * (std::f64::consts::PI * at).sin().powi(2) } else { 0.0 }
        };
        frames.iter_mut().enumerate().for_each(|(frame, points)| points[0][1] -= raised(frame));
        smooth(&mut frames);
        let top = (0..240).filter(|&frame| raised(frame) > 8.0);
        let lost: Vec<f64> = top.map(|frame| frames[frame][0][1] - (truth(frame, 240).y - raised(frame))).collect();
        let mean = lost.iter().sum::<f64>() / lost.len() as f64;
        assert!(mean < 1.5, "{mean} of 9 px");
    }

    #[test]
    fn points_without_noise_stay_where_they_are() {
        let frames = |n| -> Vec<Vec<Point>> {
            let at = |frame| truth(frame, n);
            (0..n).map(|frame| vec![[at(frame).x, at(frame).y, 1.0], [0.0; 3]]).collect()
        };
        for n in [30, 90, 600] {
            let mut smoothed = frames(n);
            smooth(&mut smoothed);
            assert!(error(&smoothed) < 0.05, "{n} frames: {}", error(&smoothed));
        }
    }

    #[test]
    fn few_frames_and_no_frames_are_left_alone() {
        let mut frames = detected(29);
        smooth(&mut frames);
        assert_eq!(frames, detected(29));
        smooth(&mut []);
        let mut blind = vec![vec![[0.0; 3]; 17]; 40];
        smooth(&mut blind);
        assert_eq!(blind, vec![vec![[0.0; 3]; 17]; 40]);
    }
}
