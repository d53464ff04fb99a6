//! How sharp the person's picture is, told apart from how much there is to see on it: the energy of second differences inside
//! the mask at full over that at half resolution, along rows and along columns (motion smears along one). Sharp edges give
//! some 0.4; what is blurred over several pixels comes near 1/16, since a smooth picture's second difference is a quarter as
//! large at twice the resolution.

use crate::mask::is_foreground;

/// By itself, without the clip's other frames, a direction tells something where it has this part of the other's energy: an even
/// surface has no edges that could be sharp, and one with stripes has them in one direction only.
const LESSER: f64 = 0.1;
/// Energies below are none.
const LEAST: f64 = 1e-6;

/// A frame's sharpness.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sharpness {
    /// Along rows and along columns; `None` where there is nothing to see. How much a pattern's edges give there differs from cloth to cloth
    /// and is alike in the frames of a clip.
    pub along: [Option<f64>; 2],
    /// The lesser of those that tell something by themselves.
    pub least: Option<f64>,
}

/// Luma and mask of one resolution.
struct Level {
    width: usize,
    height: usize,
    luma: Vec<f32>,
    inside: Vec<bool>,
}

impl Level {
    fn of(width: usize, height: usize, rgb: &[u8], mask: &[u8]) -> Self {
        let luma = |p: &[u8; 3]| (0.299 * f32::from(p[0]) + 0.587 * f32::from(p[1]) + 0.114 * f32::from(p[2])) / 255.0;
        let luma = rgb.as_chunks::<3>().0.iter().map(luma).collect();
        Self { width, height, luma, inside: mask.iter().map(|&v| is_foreground(v)).collect() }
    }

    fn half(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let mut half = Self { width, height, luma: Vec::new(), inside: Vec::new() };
        for y in 0..height {
            for x in 0..width {
                let four = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| (2 * y + dy) * self.width + 2 * x + dx);
                half.luma.push(four.iter().map(|&i| self.luma[i]).sum::<f32>() / 4.0);
                half.inside.push(four.iter().all(|&i| self.inside[i]));
            }
        }
        half
    }

    /// Mean squares of the second differences along rows and columns, where these and `margin` pixels more lie inside; `None`
    /// where hardly anything does.
    fn energies(&self, margin: usize) -> Option<[f64; 2]> {
        let (mut sums, mut count) = ([0.0; 2], 0u32);
        let reach = margin + 1;
        for y in reach..self.height.saturating_sub(reach) {
            for x in reach..self.width.saturating_sub(reach) {
                let i = y * self.width + x;
                let ends = [i - reach, i + reach, i - reach * self.width, i + reach * self.width];
                if !self.inside[i] || !ends.iter().all(|&e| self.inside[e]) {
                    continue;
                }
                for (sum, step) in sums.iter_mut().zip([1, self.width]) {
                    *sum += f64::from(self.luma[i - step] + self.luma[i + step] - 2.0 * self.luma[i]).powi(2);
                }
                count += 1;
            }
        }
        (count > 400).then(|| sums.map(|sum| sum / f64::from(count)))
    }
}

/// Sharpness of a crop `[height, width, 3]` inside its mask; `None` where there is too little of it.
pub fn sharpness(width: usize, height: usize, rgb: &[u8], mask: &[u8]) -> Option<Sharpness> {
    let whole = Level::of(width, height, rgb, mask);
    let (fine, coarse) = (whole.energies(3)?, whole.half().energies(1)?);
    let beyond = |least: f64| [0, 1].map(|k| (coarse[k] > least).then_some(fine[k] / coarse[k]));
    let telling = beyond((LESSER * coarse[0].max(coarse[1])).max(LEAST));
    Some(Sharpness { along: beyond(LEAST), least: telling.into_iter().flatten().reduce(f64::min) })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A checked cloth, blurred by a box of `2·radii + 1` pixels along rows and columns.
    fn cloth(radii: [usize; 2]) -> Vec<u8> {
        let check = |x: usize, y: usize| if (x / 9 + y / 9).is_multiple_of(2) { 60.0 } else { 190.0 };
        let [wide, high] = radii.map(|radius| 2 * radius + 1);
        let mean = |x: usize, y: usize| {
            let window = (0..high).flat_map(|dy| (0..wide).map(move |dx| (dx, dy)));
            window.map(|(dx, dy)| check(x + dx, y + dy)).sum::<f64>() / (wide * high) as f64
        };
        (0..120 * 120).flat_map(|i| [mean(i % 120, i / 120) as u8; 3]).collect()
    }

    #[test]
    fn blur_lowers_it_step_by_step() {
        let mask = vec![255; 120 * 120];
        let of = |radii| sharpness(120, 120, &cloth(radii), &mask).and_then(|s| s.least).unwrap();
        let [sharp, soft, smeared] = [[0, 0], [1, 1], [3, 0]].map(of);
        assert!(sharp > 0.3 && soft < 0.6 * sharp && smeared < 0.6 * sharp, "{sharp} {soft} {smeared}");
    }

    #[test]
    fn stripes_are_as_sharp_as_their_edges() {
        let stripe = |y: usize| if (y / 9).is_multiple_of(2) { 60 } else { 190 };
        // A slow ramp along the stripes, as light has it.
        let rgb: Vec<u8> = (0..120 * 120).flat_map(|i| [stripe(i / 120) + (i % 120 / 6) as u8; 3]).collect();
        assert!(sharpness(120, 120, &rgb, &[255; 120 * 120]).unwrap().least.unwrap() > 0.3);
    }

    #[test]
    fn what_is_even_or_too_small_cannot_be_told() {
        let even = sharpness(120, 120, &vec![90; 3 * 120 * 120], &vec![255; 120 * 120]);
        assert_eq!(even, Some(Sharpness { along: [None; 2], least: None }));
        assert_eq!(sharpness(6, 6, &[0; 108], &[255; 36]), None);
    }
}
