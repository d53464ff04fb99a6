//! Spoiled keypoints.

use rand::RngExt;
use rand_pcg::Pcg64;

use super::footage::Footage;
use crate::body::joints::{LEFT_SHOULDER, RIGHT_SHOULDER};
use crate::keypoints::{COCO17, Side, partner};
use crate::math::normal;

/// Noise of σ pixels on all points.
pub fn noisy(footage: &mut Footage, sigma: f64, rng: &mut Pcg64) {
    for point in footage.keypoints.frames.iter_mut().flatten().filter(|p| p[2] > 0.0) {
        point[0] += sigma * normal(rng);
        point[1] += sigma * normal(rng);
    }
}

/// A fifth of all points is missing.
pub fn dropped(footage: &mut Footage, rng: &mut Pcg64) {
    for point in footage.keypoints.frames.iter_mut().flatten() {
        if rng.random::<f64>() < 0.2 {
            *point = [0.0; 3];
        }
    }
}

/// Left and right exchanged wherever the person shows the back.
pub fn swapped_backs(footage: &mut Footage, _rng: &mut Pcg64) {
    for (points, joints) in footage.keypoints.frames.iter_mut().zip(&footage.joints_px) {
        // Seen from the front, the left shoulder is to the right.
        let [left, right] = [LEFT_SHOULDER, RIGHT_SHOULDER].map(|j| joints[j][0]);
        if left < right {
            let on_the_left = (0..COCO17.len()).filter(|&k| COCO17[k].1 == Side::Left);
            on_the_left.for_each(|k| points.swap(k, partner(&COCO17, k)));
        }
    }
}

/// In a quarter of the frames the detector has taken another person, who stands to the left.
pub fn second_person(footage: &mut Footage, rng: &mut Pcg64) {
    let away = 0.28 * f64::from(footage.size().0);
    for points in &mut footage.keypoints.frames {
        if rng.random::<f64>() < 0.25 {
            points.iter_mut().filter(|p| p[2] > 0.0).for_each(|p| p[0] -= away);
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::super::footage::testing::footage;
    use super::*;

    fn after(spoil: fn(&mut Footage, &mut Pcg64)) -> Footage {
        let mut footage = footage();
        spoil(&mut footage, &mut Pcg64::seed_from_u64(2));
        footage
    }

    #[test]
    fn points_are_moved_lost_and_exchanged() {
        let clean = footage();
        let moved = after(|f, rng| noisy(f, 6.0, rng)).keypoints.frames;
        let pairs = || moved.iter().flatten().zip(clean.keypoints.frames.iter().flatten());
        let mean = pairs().map(|(a, b)| (a[0] - b[0]).powi(2)).sum::<f64>() / pairs().count() as f64;
        assert!((4.5..7.5).contains(&mean.sqrt()), "σ is {}", mean.sqrt());
        let seen = after(dropped).keypoints.frames.iter().flatten().filter(|p| p[2] > 0.0).count();
        assert!((140..185).contains(&seen), "{seen} of 204 points are left");
        let swapped = after(swapped_backs).keypoints.frames;
        let given = &clean.keypoints.frames[0];
        assert_eq!((swapped[0][9], swapped[8][9], swapped[8][0]), (given[9], given[10], given[0]));
        let away = after(second_person).keypoints.frames;
        let frames = away.iter().filter(|points| points[0][0] < given[0][0] - 10.0).count();
        assert!((1..8).contains(&frames), "{frames} of 12 frames show another person");
    }
}
