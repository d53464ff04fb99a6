//! Spoiled masks.

use image::{GrayImage, Luma};
use rand::RngExt;
use rand_pcg::Pcg64;

use super::footage::Footage;
use crate::body::joints::{LEFT_FOOT, LEFT_HAND, RIGHT_FOOT};
use crate::mask::is_foreground;

fn disc(mask: &mut GrayImage, centre: [f64; 2], radii: [f64; 2], value: u8) {
    let range = |c: f64, r: f64, side: u32| {
        (c - r).floor().clamp(0.0, f64::from(side)) as u32..(c + r).ceil().clamp(0.0, f64::from(side)) as u32
    };
    for y in range(centre[1], radii[1], mask.height()) {
        for x in range(centre[0], radii[0], mask.width()) {
            let [dx, dy] = [(f64::from(x) + 0.5 - centre[0]) / radii[0], (f64::from(y) + 0.5 - centre[1]) / radii[1]];
            if dx * dx + dy * dy <= 1.0 {
                mask.put_pixel(x, y, Luma([value]));
            }
        }
    }
}

/// Three holes of a twenty-fifth of the person's height in each mask, anywhere on the person.
pub fn holes(footage: &mut Footage, rng: &mut Pcg64) {
    let radius = footage.person_px() / 25.0;
    for mask in &mut footage.masks {
        let inside: Vec<(u32, u32)> =
            mask.enumerate_pixels().filter(|(_, _, m)| is_foreground(m.0[0])).map(|(x, y, _)| (x, y)).collect();
        for _ in 0..3.min(inside.len()) {
            let (x, y) = inside[rng.random_range(0..inside.len())];
            disc(mask, [f64::from(x), f64::from(y)], [radius; 2], 0);
        }
    }
}

/// No left hand in any mask.
pub fn missing_hand(footage: &mut Footage, _rng: &mut Pcg64) {
    let radius = 0.055 * footage.person_px();
    for (mask, joints) in footage.masks.iter_mut().zip(&footage.joints_px) {
        disc(mask, joints[LEFT_HAND], [radius; 2], 0);
    }
}

/// Each mask shrunk (`grow` false) or grown by 3 pixels all round.
fn offset(footage: &mut Footage, grow: bool) {
    let reach: Vec<(i64, i64)> =
        (-3..=3).flat_map(|dy| (-3..=3).map(move |dx| (dx, dy))).filter(|(dx, dy)| dx * dx + dy * dy <= 9).collect();
    for mask in &mut footage.masks {
        let old = mask.clone();
        let (width, height) = (i64::from(old.width()), i64::from(old.height()));
        let inside = |x: i64, y: i64| {
            let within = (0..width).contains(&x) && (0..height).contains(&y);
            within && is_foreground(old.get_pixel(x as u32, y as u32).0[0])
        };
        *mask = GrayImage::from_fn(old.width(), old.height(), |x, y| {
            let mut around = reach.iter().map(|(dx, dy)| inside(i64::from(x) + dx, i64::from(y) + dy));
            let set = if grow { around.any(|inside| inside) } else { around.all(|inside| inside) };
            Luma([if set { 255 } else { 0 }])
        });
    }
}

pub fn eroded(footage: &mut Footage, _rng: &mut Pcg64) {
    offset(footage, false);
}

pub fn dilated(footage: &mut Footage, _rng: &mut Pcg64) {
    offset(footage, true);
}

/// In two of five frames, a flat shadow beside the feet belongs to the mask.
pub fn shadow(footage: &mut Footage, rng: &mut Pcg64) {
    let height = footage.person_px();
    for (mask, joints) in footage.masks.iter_mut().zip(&footage.joints_px) {
        if rng.random::<f64>() < 0.4 {
            let [a, b] = [LEFT_FOOT, RIGHT_FOOT].map(|j| joints[j]);
            let centre = [0.5 * (a[0] + b[0]) + 0.1 * height, 0.5 * (a[1] + b[1]) + 0.01 * height];
            disc(mask, centre, [0.16 * height, 0.03 * height], 255);
        }
    }
}

/// A second part, left of the person, in all masks.
pub fn second_blob(footage: &mut Footage, _rng: &mut Pcg64) {
    let radius = 0.07 * footage.person_px();
    let (width, height) = footage.size();
    for mask in &mut footage.masks {
        disc(mask, [0.08 * f64::from(width), 0.6 * f64::from(height)], [radius; 2], 255);
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::super::footage::testing::footage;
    use super::*;

    fn area(mask: &GrayImage) -> usize {
        mask.pixels().filter(|m| is_foreground(m.0[0])).count()
    }

    fn after(spoil: fn(&mut Footage, &mut Pcg64)) -> Vec<usize> {
        let mut footage = footage();
        spoil(&mut footage, &mut Pcg64::seed_from_u64(1));
        footage.masks.iter().map(area).collect()
    }

    #[test]
    fn masks_lose_and_win_what_they_should() {
        assert!(after(holes).iter().all(|&a| a < 1200 && a > 1130));
        assert!(after(missing_hand).iter().all(|&a| (1160..1190).contains(&a)));
        assert_eq!(after(eroded), [14 * 54; 12]);
        // Of a corner's 9 pixels, 4 lie within reach.
        assert_eq!(after(dilated), [26 * 66 - 20; 12]);
        assert!(after(second_blob).iter().all(|&a| a > 1200));
        let shadows = after(shadow).iter().filter(|&&a| a > 1200).count();
        assert!((1..12).contains(&shadows), "{shadows} of 12 frames have a shadow");
    }
}
