//! A camera that is held in the hand.

use std::f64::consts::TAU;

use glam::{DMat2, DVec2};
use image::{GenericImageView, ImageBuffer, Pixel, imageops};
use rand::RngExt;
use rand_pcg::Pcg64;

use super::footage::Footage;

/// Frames of a sway, of a tremor.
const PERIODS: [f64; 2] = [23.0, 5.0];
/// How far they move the picture, parts of its larger side.
const SHIFTS: [f64; 2] = [0.015, 0.003];
/// How far they turn it, radians.
const ROLLS: [f64; 2] = [0.02, 0.003];

/// What the hand does to one picture: `to = roll (from − middle) + middle + shift`.
struct Jolt {
    middle: DVec2,
    shift: DVec2,
    roll: DMat2,
}

impl Jolt {
    fn to(&self, from: DVec2) -> DVec2 {
        self.roll * (from - self.middle) + self.middle + self.shift
    }

    fn from(&self, to: DVec2) -> DVec2 {
        self.roll.transpose() * (to - self.middle - self.shift) + self.middle
    }

    /// The moved picture; what comes into it repeats the border, or is `outside`.
    fn moved<I, P>(&self, picture: &I, outside: Option<P>) -> ImageBuffer<P, Vec<u8>>
    where
        I: GenericImageView<Pixel = P>,
        P: Pixel<Subpixel = u8>,
    {
        let (width, height) = picture.dimensions();
        let last = DVec2::new(f64::from(width - 1), f64::from(height - 1));
        ImageBuffer::from_fn(width, height, |x, y| {
            // Coordinates of an image have their integers at corners, those of its samples at middles.
            let from = self.from(DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5)) - 0.5;
            let near = from.clamp(DVec2::ZERO, last);
            let sample = imageops::interpolate_bilinear(picture, near.x as f32, near.y as f32);
            match outside {
                Some(outside) if near != from => outside,
                _ => sample.unwrap_or_else(|| picture.get_pixel(near.x as u32, near.y as u32)),
            }
        })
    }
}

/// Pictures sway and tremble, in x, in y and about the middle. The first one stays, since an avatar is compared in its camera.
pub fn shaken(footage: &mut Footage, rng: &mut Pcg64) {
    let (width, height) = footage.size();
    let size = DVec2::new(f64::from(width), f64::from(height));
    let phases: [[f64; 2]; 3] = std::array::from_fn(|_| std::array::from_fn(|_| rng.random::<f64>()));
    let wave = |axis: usize, sizes: [f64; 2], frame: usize| {
        let at = |k: usize, frame: f64| sizes[k] * (TAU * (frame / PERIODS[k] + phases[axis][k])).sin();
        (0..2).map(|k| at(k, frame as f64) - at(k, 0.0)).sum::<f64>()
    };
    for t in 1..footage.frames.len() {
        let shift = size.max_element() * DVec2::new(wave(0, SHIFTS, t), wave(1, SHIFTS, t));
        let jolt = Jolt { middle: size / 2.0, shift, roll: DMat2::from_angle(wave(2, ROLLS, t)) };
        footage.frames[t] = jolt.moved(&footage.frames[t], None);
        footage.masks[t] = jolt.moved(&footage.masks[t], Some(image::Luma([0])));
        for point in footage.keypoints.frames[t].iter_mut().filter(|point| point[2] > 0.0) {
            let at = jolt.to(DVec2::new(point[0], point[1]));
            // A detector says nothing of what is not in the picture.
            let inside = at.cmpge(DVec2::ZERO).all() && at.cmplt(size).all();
            *point = if inside { [at.x, at.y, point[2]] } else { [0.0; 3] };
        }
        for joint in &mut footage.joints_px[t] {
            *joint = jolt.to(DVec2::from_array(*joint)).to_array();
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::super::footage::testing::footage;
    use super::*;
    use crate::mask::is_foreground;

    #[test]
    fn pictures_masks_and_keypoints_are_moved_alike() {
        let clean = footage();
        let mut moved = clean.clone();
        shaken(&mut moved, &mut Pcg64::seed_from_u64(5));
        assert_eq!((&moved.frames[0], &moved.masks[0]), (&clean.frames[0], &clean.masks[0]), "the first picture stays");
        assert_eq!(moved.keypoints.frames[0], clean.keypoints.frames[0]);
        // The mask's middle goes the way of a keypoint next to it.
        let middle = |f: &Footage, t: usize| {
            let inside = || f.masks[t].enumerate_pixels().filter(|(_, _, m)| is_foreground(m.0[0]));
            let sum = inside().fold(DVec2::ZERO, |sum, (x, y, _)| sum + DVec2::new(f64::from(x), f64::from(y)) + 0.5);
            sum / inside().count() as f64
        };
        let points = |f: &Footage, t: usize| DVec2::from_array([0, 1].map(|c| f.keypoints.frames[t][8][c]));
        let way = |f: &Footage, at: &dyn Fn(&Footage, usize) -> DVec2, t: usize| at(f, t) - at(&clean, t);
        let far = (1..12).map(|t| way(&moved, &points, t).length()).fold(0.0, f64::max);
        assert!((1.0..6.0).contains(&far), "the farthest is {far} px away");
        for t in 1..12 {
            let gap = way(&moved, &points, t).distance(way(&moved, &middle, t));
            assert!(gap < 0.5, "frame {t}: mask and keypoints differ by {gap} px");
        }
        let grey = |f: &Footage, t: usize| {
            let at = DVec2::from_array(f.joints_px[t][0]);
            f64::from(f.frames[t].get_pixel(at.x as u32, at.y as u32).0[0])
        };
        (1..12).for_each(|t| assert!((grey(&moved, t) - grey(&clean, t)).abs() < 5.0, "frame {t}: the picture lags"));
    }
}
