//! How one picture lies over another, place by place, and a picture bent by that. So colours that many pictures have of a surface
//! that is not quite there come to lie over each other (Zhou and Koltun 2014, "Color Map Optimization for 3D Reconstruction with
//! Consumer Depth Cameras", bend pictures as well). The way from place to place is Lucas and Kanade's (1981), in windows, from coarse
//! pictures to fine ones: as stage 0 follows single points of grey pictures, but for every place, by colours and by what each pixel
//! counts.

use glam::{DMat2, DVec2};

use super::registration::{Picture, halves};
use crate::capture::Frame;
use crate::mask::is_foreground;

/// How far a place may be off besides the whole picture's shift, and half the side of the window that tells it, metres at the person.
const REACH_M: f64 = 0.012;
const WINDOW_M: f64 = 0.026;
/// Steps on each picture, of a pixel at most.
const STEPS: usize = 4;
/// Half the side of a window on the coarsest picture at most, pixels.
const COARSEST_PX: f64 = 3.5;
/// A mean squared slope, a pixel of the values 0..1: windows with as little are held back by half.
const FLAT: f64 = 4e-4;
/// A window with less weight tells nothing.
const LEAST: f64 = 1e-6;

/// For each pixel of one picture, by how many pixels the other has it elsewhere.
pub(super) struct Warp {
    width: usize,
    height: usize,
    /// Pixels of a metre at the person.
    metre: f64,
    /// Of the whole picture.
    shift: DVec2,
    /// `[H * W]`, `shift` and what each place adds
    moved: Vec<DVec2>,
}

impl Warp {
    /// From `drawn` to `filmed`, which lies beside it by about `shift`. A metre at the person is `metre` pixels long.
    pub fn between(drawn: &Picture, filmed: &Picture, shift: [f64; 2], metre: f64) -> Self {
        let halves = halves(drawn, filmed, (drawn.longer() as f64 * COARSEST_PX / (WINDOW_M * metre)) as usize);
        let scale = 0.5f64.powi(halves.len() as i32);
        let coarsest = halves.last().map_or(drawn, |[drawn, _]| drawn);
        let mut warp = Self::even(coarsest, scale * DVec2::from(shift), scale * metre);
        for (drawn, filmed) in halves.iter().rev().map(|[drawn, filmed]| (drawn, filmed)).chain([(drawn, filmed)]) {
            warp = warp.finer(drawn);
            (0..STEPS).for_each(|_| warp.step(drawn, filmed));
        }
        warp
    }

    fn even(picture: &Picture, shift: DVec2, metre: f64) -> Self {
        let Picture { width, height, .. } = *picture;
        Self { width, height, metre, shift, moved: vec![shift; width * height] }
    }

    /// The same for a picture that is as large, or twice as large.
    fn finer(self, picture: &Picture) -> Self {
        if picture.width == self.width && picture.height == self.height {
            return self;
        }
        let mut finer = Self::even(picture, 2.0 * self.shift, 2.0 * self.metre);
        for (i, moved) in finer.moved.iter_mut().enumerate() {
            let [x, y] = [(i % finer.width / 2).min(self.width - 1), (i / finer.width / 2).min(self.height - 1)];
            *moved = 2.0 * self.moved[y * self.width + x];
        }
        finer
    }

    /// Goes on to where the squared difference in each window is less, but for the window's mean difference.
    fn step(&mut self, drawn: &Picture, filmed: &Picture) {
        let (width, height) = (self.width, self.height);
        let there: Vec<([f64; 3], f64)> = (0..width * height)
            .map(|i| sample(filmed, DVec2::new((i % width) as f64, (i / width) as f64) + self.moved[i]))
            .collect();
        let windows = Windows::new(
            [width, height, (WINDOW_M * self.metre).ceil() as usize],
            drawn.weights.iter().zip(&there).map(|(&weight, (_, there))| f64::from(weight) * there).collect(),
        );
        // Of the normal equations: slopes by slopes, and slopes by differences.
        let mut sums = vec![[0.0; 5]; width * height];
        for channel in 0..3 {
            let slope = |i: usize, by: usize, within: bool| {
                let told = within && there[i - by].1 > 0.0 && there[i + by].1 > 0.0;
                if told { 0.5 * (there[i + by].0[channel] - there[i - by].0[channel]) } else { 0.0 }
            };
            let across = |i: usize| slope(i, 1, (1..width - 1).contains(&(i % width)));
            let down = |i: usize| slope(i, width, (1..height - 1).contains(&(i / width)));
            let values: Vec<[f64; 3]> = (0..width * height)
                .map(|i| [across(i), down(i), f64::from(drawn.rgb[i][channel]) - there[i].0[channel]])
                .collect();
            let means = [0, 1, 2].map(|k| windows.means(|i| values[i][k]));
            for (sum, [a, b]) in [[0, 0], [0, 1], [1, 1], [0, 2], [1, 2]].into_iter().enumerate() {
                let products = windows.means(|i| values[i][a] * values[i][b]);
                let covariances = products.iter().zip(means[a].iter().zip(&means[b])).map(|(ab, (a, b))| ab - a * b);
                sums.iter_mut().zip(covariances).for_each(|(sums, covariance)| sums[sum] += covariance);
            }
        }
        let reach = DVec2::splat(REACH_M * self.metre);
        for (moved, [xx, xy, yy, x, y]) in self.moved.iter_mut().zip(sums) {
            let slopes = DMat2::from_cols(DVec2::new(xx + FLAT, xy), DVec2::new(xy, yy + FLAT));
            let step = (slopes.inverse() * DVec2::new(x, y)).clamp(-DVec2::ONE, DVec2::ONE);
            *moved = (*moved + step).clamp(self.shift - reach, self.shift + reach);
        }
        // Neighbours move alike.
        let [x, y] = [0, 1].map(|axis| windows.means(|i| self.moved[i][axis]));
        for (i, moved) in self.moved.iter_mut().enumerate() {
            *moved = if windows.totals[i] > LEAST { DVec2::new(x[i], y[i]) } else { self.shift };
        }
    }

    /// What a place adds to the shift; nothing beyond the picture.
    fn bent(&self, place: DVec2) -> DVec2 {
        let DVec2 { x, y } = place.round();
        let within = (0.0..self.width as f64).contains(&x) && (0.0..self.height as f64).contains(&y);
        if within { self.moved[y as usize * self.width + x as usize] - self.shift } else { DVec2::ZERO }
    }
}

/// Weighted means in the square windows around all pixels.
struct Windows {
    width: usize,
    height: usize,
    half: usize,
    weights: Vec<f64>,
    totals: Vec<f64>,
}

impl Windows {
    fn new([width, height, half]: [usize; 3], weights: Vec<f64>) -> Self {
        let mut windows = Self { width, height, half, weights, totals: Vec::new() };
        windows.totals = windows.sums(windows.weights.clone());
        windows
    }

    fn means(&self, value: impl Fn(usize) -> f64) -> Vec<f64> {
        let sums = self.sums((0..self.weights.len()).map(|i| self.weights[i] * value(i)).collect());
        sums.iter().zip(&self.totals).map(|(sum, &total)| if total > LEAST { sum / total } else { 0.0 }).collect()
    }

    fn sums(&self, mut values: Vec<f64>) -> Vec<f64> {
        let Self { width, height, half, .. } = *self;
        let mut before = vec![0.0; width + 1];
        for row in values.chunks_exact_mut(width) {
            (0..width).for_each(|x| before[x + 1] = before[x] + row[x]);
            (0..width).for_each(|x| row[x] = before[(x + half + 1).min(width)] - before[x.saturating_sub(half)]);
        }
        // Row by row, as they lie in memory.
        let mut above = vec![0.0; (height + 1) * width];
        for i in 0..height * width {
            above[i + width] = above[i] + values[i];
        }
        for y in 0..height {
            let (to, from) = ((y + half + 1).min(height) * width, y.saturating_sub(half) * width);
            (0..width).for_each(|x| values[y * width + x] = above[to + x] - above[from + x]);
        }
        values
    }
}

/// The four pixels around a place of a picture with so many, and the part of each; `None` beyond it.
fn around([width, height]: [usize; 2], place: DVec2) -> Option<[(usize, f64); 4]> {
    let within = place.cmpge(DVec2::ZERO).all() && place.x <= (width - 1) as f64 && place.y <= (height - 1) as f64;
    let [x, y] = [place.x as usize, place.y as usize];
    let [right, below] = [(x + 1).min(width - 1), (y + 1).min(height - 1)];
    let part = place.fract();
    within.then_some([
        (y * width + x, (1.0 - part.x) * (1.0 - part.y)),
        (y * width + right, part.x * (1.0 - part.y)),
        (below * width + x, (1.0 - part.x) * part.y),
        (below * width + right, part.x * part.y),
    ])
}

/// A picture's colour between its pixels, and the least that one of them counts.
fn sample(picture: &Picture, place: DVec2) -> ([f64; 3], f64) {
    let Some(four) = around([picture.width, picture.height], place) else { return Default::default() };
    let mean = |channel: usize| four.iter().map(|&(i, part)| part * f64::from(picture.rgb[i][channel])).sum();
    ([0, 1, 2].map(mean), four.iter().map(|&(i, _)| f64::from(picture.weights[i])).fold(f64::INFINITY, f64::min))
}

/// Bends a picture: what its places add to the shift is taken out. Its corner lies at `corner` of the filmed one, of which it has `scale`
/// times as many pixels along each side. A pixel that would come from beside the mask leaves it.
pub(super) fn bend(picture: &mut Frame, warp: &Warp, corner: [f64; 2], scale: f64) {
    let [width, height] = [picture.width as usize, picture.height as usize];
    let (rgb, mask) = (picture.rgb.clone(), picture.mask.clone());
    // Whole numbers are the middles of pixels.
    let middle = DVec2::splat(0.5);
    for i in 0..width * height {
        let here = DVec2::new((i % width) as f64, (i / width) as f64);
        let drawn = (here + middle) / scale - middle + DVec2::from(corner) - warp.shift;
        let Some(four) = around([width, height], here + scale * warp.bent(drawn)) else {
            picture.mask[i] = 0;
            continue;
        };
        if four.iter().any(|&(j, part)| part > 0.01 && !is_foreground(mask[j])) {
            picture.mask[i] = 0;
        }
        for channel in 0..3 {
            let mean: f64 = four.iter().map(|&(j, part)| part * f64::from(rgb[3 * j + channel])).sum();
            picture.rgb[3 * i + channel] = mean.round() as u8;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::detail::testing::picture;

    const SIZE: [usize; 2] = [140, 120];
    /// Of a head as large as that.
    const METRE: f64 = 430.0;

    /// Blobs some ten pixels wide, each pixel's taken from where `from` tells.
    fn blobs(light: f32, from: impl Fn(DVec2) -> DVec2) -> Picture {
        let colour = |i: usize| {
            let at = from(DVec2::new((i % SIZE[0]) as f64, (i / SIZE[0]) as f64));
            [0.3 * at.x, 0.35 * at.y, 0.25 * (at.x + at.y)].map(|phase| light + 0.2 * phase.sin() as f32)
        };
        let n = SIZE[0] * SIZE[1];
        Picture::new(SIZE, (0..n).map(colour).collect(), vec![1.0; n])
    }

    /// Left and right lie apart by four pixels less than they should.
    fn squeezed(at: DVec2) -> DVec2 {
        DVec2::new(2.0 - 4.0 * at.x / SIZE[0] as f64, 0.0)
    }

    #[test]
    fn a_warp_is_found_beside_a_shift_and_in_another_light() {
        let shift = DVec2::new(5.0, -3.0);
        // `filmed(x + shift + squeezed(x)) = drawn(x)`, whose inverse is linear.
        let narrower = 1.0 - 4.0 / SIZE[0] as f64;
        let from = |at: DVec2| DVec2::new((at.x - shift.x - 2.0) / narrower, at.y - shift.y);
        let warp = Warp::between(&blobs(0.5, |at| at), &blobs(0.4, from), shift.to_array(), METRE);
        for [x, y] in [[30, 30], [30, 90], [70, 60], [110, 30], [110, 90]] {
            let at = DVec2::new(f64::from(x), f64::from(y));
            let (found, truth) = (warp.bent(at), squeezed(at));
            assert!(found.distance(truth) < 0.4, "at {x}, {y}: {found}, expected {truth}");
        }
    }

    #[test]
    fn what_tells_nothing_is_not_bent_and_nothing_further_than_within_reach() {
        let grey = || Picture::new(SIZE, vec![[0.5; 3]; SIZE[0] * SIZE[1]], vec![1.0; SIZE[0] * SIZE[1]]);
        let warp = Warp::between(&grey(), &grey(), [3.0, 1.0], METRE);
        assert!(warp.moved.iter().all(|moved| moved.distance(DVec2::new(3.0, 1.0)) < 1e-9));
        let far = Warp::between(&blobs(0.5, |at| at), &blobs(0.5, |at| at + DVec2::new(0.0, 7.0)), [0.0; 2], METRE);
        let reach = REACH_M * METRE;
        assert!(far.moved.iter().all(|moved| moved.abs().max_element() <= reach + 1e-9));
    }

    #[test]
    fn what_is_left_of_a_head_at_the_images_border_is_compared_as_well() {
        let size = [3, 140];
        let slope = || Picture::new(size, (0..420).map(|i| [i as f32 / 420.0; 3]).collect(), vec![1.0; 420]);
        let warp = Warp::between(&slope(), &slope(), [0.0; 2], METRE);
        assert_eq!([warp.width, warp.height], size);
        assert!(warp.moved.iter().all(|moved| moved.length() < 0.1));
    }

    #[test]
    fn a_bent_picture_shows_its_places_where_the_drawing_has_them() {
        let mut frame = picture(0, [0, 0, 40, 30]);
        frame.rgb = (0..40 * 30).flat_map(|i| [5 * (i % 40) as u8, 6 * (i / 40) as u8, 9]).collect();
        frame.mask = (0..40 * 30).map(|i| if i % 40 < 30 { 255 } else { 0 }).collect();
        // The picture's corner is the filmed one's [10, 0]; what is drawn at x has been filmed at x + 4, and all of it 1.5 further.
        let even =
            |size: [usize; 2]| Picture::new(size, vec![[0.0; 3]; size[0] * size[1]], vec![1.0; size[0] * size[1]]);
        let mut warp = Warp::even(&even([60, 30]), DVec2::new(4.0, 0.0), METRE);
        warp.moved.iter_mut().for_each(|moved| moved.x += 1.5);
        let fine = frame.clone();
        bend(&mut frame, &warp, [10.0, 0.0], 1.0);
        let at = |x: usize, y: usize| [frame.rgb[3 * (y * 40 + x)], frame.rgb[3 * (y * 40 + x) + 1]];
        assert_eq!([at(10, 7), at(20, 8)], [[58, 42], [108, 48]], "1.5 pixels to the right of each");
        assert!(
            (0..30).all(|y| frame.mask[y * 40 + 27] == 255 && frame.mask[y * 40 + 28] == 0),
            "its mask goes with it"
        );
        // The same found on pictures half as large.
        let mut warp = Warp::even(&even([30, 15]), DVec2::new(2.0, 0.0), 0.5 * METRE);
        warp.moved.iter_mut().for_each(|moved| moved.x += 0.75);
        let mut again = fine;
        bend(&mut again, &warp, [5.0, 0.0], 2.0);
        assert!(again.rgb == frame.rgb && again.mask == frame.mask);
    }
}
