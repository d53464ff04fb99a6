//! What of a picture stays the same while a person turns under a light that stands: local contrast and the colours' ratios.

use crate::capture::Frame;
use crate::distance::signed_distance;
use crate::mask::is_foreground;

/// Contrast, and the logarithms of red and of blue over green.
pub const CHANNELS: usize = 3;

/// How far pictures are blurred, metres at the person: noise and the codec's blocks are below that, and what a pixel has too
/// much of its neighbours; pixels at least.
const FINE_M: f64 = 0.0045;
const LEAST_FINE_PX: f64 = 0.7;
/// What varies over more than that is light, for brightness; colours are told from it by themselves and may vary over twice as much.
const COARSE_M: f64 = 0.022;
/// Brightness below which differences are noise, 0..1.
const DARK: f32 = 0.05;

/// One frame's.
pub struct Looks {
    width: usize,
    height: usize,
    values: Vec<[f32; CHANNELS]>,
    /// `[H, W]`: distance from the mask's edge, pixels, positive outside; nothing where it has none.
    pub beyond: Option<Vec<f32>>,
}

/// A channel between its pixels, and how it grows along x and y, a pixel.
#[derive(Clone, Copy)]
pub struct Look {
    pub value: f32,
    pub slope: [f32; 2],
}

impl Looks {
    /// A metre at the person is `metre` pixels long.
    pub fn of(frame: &Frame, metre: f64) -> Self {
        let [width, height] = [frame.width as usize, frame.height as usize];
        let inside: Vec<bool> = frame.mask.iter().map(|&m| is_foreground(m)).collect();
        let mask: Vec<f32> = inside.iter().map(|&inside| f32::from(u8::from(inside))).collect();
        let fine = (FINE_M * metre).max(LEAST_FINE_PX);
        let blur = |values: &[f32], sigma: f64| blurred(values, width, height, sigma);
        // The mean of what the mask has.
        let mean = |values: &[f32], sigma: f64| -> Vec<f32> {
            let within: Vec<f32> = values.iter().zip(&mask).map(|(v, m)| v * m).collect();
            blur(&within, sigma).iter().zip(blur(&mask, sigma)).map(|(v, m)| v / (m + 1e-3)).collect()
        };
        let plane = |of: &dyn Fn([u8; 3]) -> f32| -> Vec<f32> {
            frame.rgb.as_chunks::<3>().0.iter().map(|&rgb| of(rgb) / 255.0).collect()
        };
        let grey = plane(&|rgb| rgb.map(f32::from).iter().sum::<f32>() / 3.0);
        let coarse = mean(&grey, COARSE_M * metre);
        // Beyond the mask there are other things.
        let within: Vec<f32> =
            grey.iter().zip(&coarse).zip(&inside).map(|((g, c), &m)| if m { *g } else { *c }).collect();
        let contrast = blur(&within, fine).iter().zip(&coarse).map(|(f, c)| ((f + DARK) / (c + DARK)).ln()).collect();
        let [red, green, blue] = [0, 1, 2].map(|c| mean(&plane(&|rgb| rgb[c].into()), fine));
        let ratio = |colour: &[f32]| -> Vec<f32> {
            let all: Vec<f32> = colour.iter().zip(&green).map(|(c, g)| ((c + DARK) / (g + DARK)).ln()).collect();
            all.iter().zip(mean(&all, 2.0 * COARSE_M * metre)).map(|(v, mean)| v - mean).collect()
        };
        let channels: [Vec<f32>; CHANNELS] = [contrast, ratio(&red), ratio(&blue)];
        let values = (0..width * height).map(|i| [0, 1, 2].map(|c| channels[c][i])).collect();
        Self { width, height, values, beyond: signed_distance(&inside, width, height) }
    }

    /// At a place of the frame, pixels; `None` near its border and beyond.
    pub fn at(&self, [x, y]: [f64; 2]) -> Option<[Look; CHANNELS]> {
        let (x, y) = (x - 0.5, y - 0.5);
        if !(x >= 1.0 && y >= 1.0 && x + 2.0 < self.width as f64 && y + 2.0 < self.height as f64) {
            return None;
        }
        let first = y as usize * self.width + x as usize;
        let [across, down] = [x.fract() as f32, y.fract() as f32];
        let between = |first: usize, channel: usize| {
            let row = |i: usize| {
                let [left, right] = [i, i + 1].map(|i| self.values[i][channel]);
                left + across * (right - left)
            };
            let [above, below] = [row(first), row(first + self.width)];
            above + down * (below - above)
        };
        Some([0, 1, 2].map(|c| {
            let slope = |by: usize| 0.5 * (between(first + by, c) - between(first - by, c));
            Look { value: between(first, c), slope: [slope(1), slope(self.width)] }
        }))
    }

    /// How far the middle of the pixel at a place lies from the mask's edge, if both are there.
    pub fn beyond(&self, [x, y]: [f64; 2]) -> Option<f32> {
        let within = (0.0..self.width as f64).contains(&x) && (0.0..self.height as f64).contains(&y);
        self.beyond.as_ref().filter(|_| within).map(|beyond| beyond[y as usize * self.width + x as usize])
    }
}

/// `values [H, W]`, blurred by a normal distribution; nothing lies beyond them.
fn blurred(values: &[f32], width: usize, height: usize, sigma: f64) -> Vec<f32> {
    let reach = (3.0 * sigma).ceil() as usize;
    let bell: Vec<f64> = (0..=reach).map(|i| (-0.5 * (i as f64 / sigma).powi(2)).exp()).collect();
    let sum = 2.0 * bell.iter().sum::<f64>() - 1.0;
    let bell: Vec<f32> = bell.iter().map(|b| (b / sum) as f32).collect();
    let mut across = vec![0.0; values.len()];
    for (row, blurred) in values.chunks_exact(width).zip(across.chunks_exact_mut(width)) {
        for (x, value) in row.iter().enumerate().filter(|(_, value)| **value != 0.0) {
            let [from, to] = [x.saturating_sub(reach), (x + reach + 1).min(width)];
            blurred[from..to].iter_mut().enumerate().for_each(|(i, b)| *b += bell[(from + i).abs_diff(x)] * value);
        }
    }
    let mut both = vec![0.0; values.len()];
    for (y, blurred) in both.chunks_exact_mut(width).enumerate() {
        for from in y.saturating_sub(reach)..(y + reach + 1).min(height) {
            let weight = bell[from.abs_diff(y)];
            blurred.iter_mut().zip(&across[from * width..]).for_each(|(b, v)| *b += weight * v);
        }
    }
    both
}
