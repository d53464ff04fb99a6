//! Spoiled pictures.

use image::{Rgb, RgbImage};
use rand::RngExt;
use rand_pcg::Pcg64;

use super::footage::Footage;
use crate::mask::is_foreground;

/// Pixels of a smear.
const SMEAR_PX: u32 = 9;

/// Every picture smeared along its rows.
pub fn motion_blur(footage: &mut Footage, _rng: &mut Pcg64) {
    for frame in &mut footage.frames {
        let (sharp, last) = (frame.clone(), frame.width() - 1);
        *frame = RgbImage::from_fn(sharp.width(), sharp.height(), |x, y| {
            let near = |k: u32| (x + k).saturating_sub(SMEAR_PX / 2).min(last);
            let sum = |c: usize| (0..SMEAR_PX).map(|k| u32::from(sharp.get_pixel(near(k), y).0[c])).sum::<u32>();
            Rgb(std::array::from_fn(|c| (sum(c) / SMEAR_PX) as u8))
        });
    }
}

/// The light of each picture changes by up to a fifth.
pub fn gains(footage: &mut Footage, rng: &mut Pcg64) {
    for frame in &mut footage.frames {
        let gain = 0.8 + 0.4 * rng.random::<f32>();
        frame.pixels_mut().for_each(|p| p.0 = p.0.map(|c| (gain * f32::from(c)).round().min(255.0) as u8));
    }
}

/// A tenth of the person is cut off below.
pub fn feet_cut(footage: &mut Footage, _rng: &mut Pcg64) {
    let (_, high) = rows(footage);
    let rows = 0.1 * footage.person_px() + f64::from(footage.size().1 - high);
    footage.crop_rows(0, even(rows));
}

/// A tenth of the person is cut off above.
pub fn head_cut(footage: &mut Footage, _rng: &mut Pcg64) {
    let (low, _) = rows(footage);
    footage.crop_rows(even(0.1 * footage.person_px() + f64::from(low)), 0);
}

/// Video codecs take even sizes.
fn even(rows: f64) -> u32 {
    2 * (0.5 * rows).round() as u32
}

/// The first row of any mask, and the row after the last.
fn rows(footage: &Footage) -> (u32, u32) {
    let pixels = footage.masks.iter().flat_map(|m| m.enumerate_pixels()).filter(|(_, _, m)| is_foreground(m.0[0]));
    pixels.fold((u32::MAX, 0), |(low, high), (_, y, _)| (low.min(y), high.max(y + 1)))
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::super::footage::testing::footage;
    use super::*;

    fn after(spoil: fn(&mut Footage, &mut Pcg64)) -> Footage {
        let mut footage = footage();
        spoil(&mut footage, &mut Pcg64::seed_from_u64(3));
        footage
    }

    #[test]
    fn pictures_smear_and_flicker() {
        let clean = footage();
        let step = |f: &Footage| f.frames[0].get_pixel(20, 40).0[0].abs_diff(f.frames[0].get_pixel(19, 40).0[0]);
        assert!(step(&after(motion_blur)) < step(&clean) / 4);
        assert_eq!(after(motion_blur).masks, clean.masks);
        let light: std::collections::BTreeSet<u8> =
            after(gains).frames.iter().map(|frame| frame.get_pixel(30, 40).0[0]).collect();
        assert!(light.len() > 6, "{light:?}");
    }

    #[test]
    fn a_tenth_of_the_person_is_cut_off() {
        for (spoil, border) in [(feet_cut as fn(&mut Footage, &mut Pcg64), 63), (head_cut, 0)] {
            let cut = after(spoil);
            assert_eq!((cut.size().1, cut.person_px()), (64, 54.0));
            assert_eq!(cut.masks[0].get_pixel(30, border).0[0], 255, "the person touches the border");
        }
    }
}
