//! From the uploaded images to those of the capture: lens distortion removed, scaled down, cropped.

use super::BadInput;
use super::lens::{undistort, valid_radius};
use super::source::Picture;
use crate::camera::Camera;
use crate::mask::is_foreground;

/// Pixels as a rectangle; `x1`, `y1` are exclusive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Rect {
    pub x0: u32,
    pub y0: u32,
    pub x1: u32,
    pub y1: u32,
}

impl Rect {
    pub fn width(&self) -> u32 {
        self.x1 - self.x0
    }

    pub fn height(&self) -> u32 {
        self.y1 - self.y0
    }

    /// Grown by `margin` on every side, within a `width`×`height` image.
    pub fn grown(&self, margin: u32, width: u32, height: u32) -> Self {
        Self {
            x0: self.x0.saturating_sub(margin),
            y0: self.y0.saturating_sub(margin),
            x1: (self.x1 + margin).min(width),
            y1: (self.y1 + margin).min(height),
        }
    }
}

/// The way between uploaded (distorted, large) and rectified images. Coordinates are continuous: the pixel in column
/// j covers [j, j+1), so that scaling is a plain multiplication.
#[derive(Debug)]
pub(super) struct Rectify {
    uploaded: Camera,
    /// Of the rectified images: no distortion.
    pub camera: Camera,
    /// Normalised radius up to which distortion keeps the order of points.
    valid_radius: f64,
    distorted: bool,
    scaled: bool,
}

impl Rectify {
    pub fn new(uploaded: Camera, max_side_px: u32) -> Result<Self, BadInput> {
        let scale = (f64::from(max_side_px) / f64::from(uploaded.width.max(uploaded.height))).min(1.0);
        let [width, height] =
            [uploaded.width, uploaded.height].map(|side| ((f64::from(side) * scale).round() as u32).max(1));
        let camera = Camera { distortion: [0.0; 5], ..uploaded.scaled(width, height) };
        let distorted = uploaded.has_lens();
        let valid_radius = valid_radius(&uploaded)?;
        Ok(Self { uploaded, camera, valid_radius, distorted, scaled: scale < 1.0 })
    }

    /// From a rectified position to the one in the scaled but still distorted image; `None` beyond where the
    /// distortion is meaningful.
    fn distorted_from_rectified(&self, x: f64, y: f64) -> Option<(f64, f64)> {
        let [u, v, _] = self.camera.ray([x, y]);
        if u.hypot(v) > self.valid_radius {
            return None;
        }
        let [u, v] = self.uploaded.distorted([u, v]);
        Some(self.camera.project([u, v, 1.0]).into())
    }

    /// From an uploaded position to the rectified one; `None` where there is none.
    pub fn rectified_from_uploaded(&self, x: f64, y: f64) -> Option<(f64, f64)> {
        let [u, v, _] = self.uploaded.ray([x, y]);
        let [u, v] = if self.distorted { undistort(&self.uploaded, [u, v], self.valid_radius)? } else { [u, v] };
        Some(self.camera.project([u, v, 1.0]).into())
    }

    /// The bounding box of the pixels that are set in an uploaded mask, in rectified pixels and a little generous.
    pub fn bounds(&self, uploaded: Rect) -> Rect {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for i in 0..=16 {
            let t = f64::from(i) / 16.0;
            let x = f64::from(uploaded.x0) + t * f64::from(uploaded.width());
            let y = f64::from(uploaded.y0) + t * f64::from(uploaded.height());
            let border = [
                (x, f64::from(uploaded.y0)),
                (x, f64::from(uploaded.y1)),
                (f64::from(uploaded.x0), y),
                (f64::from(uploaded.x1), y),
            ];
            for (x, y) in border.into_iter().filter_map(|(x, y)| self.rectified_from_uploaded(x, y)) {
                low = [low[0].min(x), low[1].min(y)];
                high = [high[0].max(x), high[1].max(y)];
            }
        }
        // A border bends by less than this between two of its samples.
        let slack =
            2.0 + if self.distorted { 0.01 * f64::from(self.camera.width.max(self.camera.height)) } else { 0.0 };
        let clamp = |value: f64, side: u32| value.clamp(0.0, f64::from(side)) as u32;
        let (width, height) = (self.camera.width, self.camera.height);
        if low[0] > high[0] {
            return Rect { x0: 0, y0: 0, x1: width, y1: height };
        }
        Rect {
            x0: clamp(low[0] - slack, width),
            y0: clamp(low[1] - slack, height),
            x1: clamp((high[0] + slack).ceil(), width),
            y1: clamp((high[1] + slack).ceil(), height),
        }
    }

    /// `[height, width, 3]` of a rectangle of the rectified image. Beyond the uploaded image its border goes on.
    pub fn rgb(&self, picture: &Picture, rect: Rect) -> Vec<u8> {
        if !self.scaled && !self.distorted {
            let row = picture.width as usize * 3;
            let columns = rect.x0 as usize * 3..rect.x1 as usize * 3;
            let rows = picture.data.chunks_exact(row).take(rect.y1 as usize).skip(rect.y0 as usize);
            return rows.flat_map(|row| &row[columns.clone()]).copied().collect();
        }
        let plain = std::array::from_fn(|value| value as f32);
        self.resample::<3>(picture, rect, &plain, false).into_iter().map(|value| value.round() as u8).collect()
    }

    /// `[height, width]` of a rectangle of the rectified mask: 255 where at least half of the pixel is foreground.
    pub fn mask(&self, picture: &Picture, rect: Rect) -> Vec<u8> {
        let coverage = std::array::from_fn(|value| f32::from(u8::from(is_foreground(value as u8))));
        let covered = self.resample::<1>(picture, rect, &coverage, true);
        covered.into_iter().map(|value| if value >= 0.5 { 255 } else { 0 }).collect()
    }

    /// `[height, width, C]` of a rectangle: `values` of the stored bytes, averaged over each scaled pixel's area, then
    /// taken where the lens had put them. Positions outside the image count as 0 or take the border's value.
    fn resample<const C: usize>(
        &self,
        picture: &Picture,
        rect: Rect,
        values: &[f32; 256],
        zero_outside: bool,
    ) -> Vec<f32> {
        let (width, height) = (self.camera.width, self.camera.height);
        if !self.distorted {
            return shrink::<C>(picture, (width, height), rect, values);
        }
        let whole = shrink::<C>(picture, (width, height), Rect { x0: 0, y0: 0, x1: width, y1: height }, values);
        let mut out = Vec::with_capacity(rect.width() as usize * rect.height() as usize * C);
        for y in rect.y0..rect.y1 {
            for x in rect.x0..rect.x1 {
                let position = self.distorted_from_rectified(f64::from(x) + 0.5, f64::from(y) + 0.5);
                let inside = |&(x, y): &(f64, f64)| {
                    let across = 0.0..f64::from(width);
                    !zero_outside || (across.contains(&x) && (0.0..f64::from(height)).contains(&y))
                };
                match position.filter(inside) {
                    Some((x, y)) => out.extend(bilinear::<C>(&whole, (width as usize, height as usize), x, y)),
                    None => out.extend([0.0; C]),
                }
            }
        }
        out
    }
}

/// A rectangle of a picture that is scaled down to `size`: the mean of `values` over the area of each new pixel.
fn shrink<const C: usize>(picture: &Picture, size: (u32, u32), rect: Rect, values: &[f32; 256]) -> Vec<f32> {
    let columns: Vec<Span> = (rect.x0..rect.x1).map(|x| Span::new(x, picture.width, size.0)).collect();
    let (Some(first), Some(last)) = (columns.first(), columns.last()) else { return Vec::new() };
    let used = first.start..last.start + last.weights.len();
    let row_bytes = picture.width as usize * C;
    let mut sums = vec![0.0f32; used.len() * C];
    let mut out = Vec::with_capacity(columns.len() * rect.height() as usize * C);
    for y in rect.y0..rect.y1 {
        sums.fill(0.0);
        let rows = Span::new(y, picture.height, size.1);
        for (row, weight) in (rows.start..).zip(&rows.weights) {
            let bytes = &picture.data[row * row_bytes + used.start * C..row * row_bytes + used.end * C];
            sums.iter_mut().zip(bytes).for_each(|(sum, &byte)| *sum += weight * values[byte as usize]);
        }
        for column in &columns {
            let mut mean = [0.0f32; C];
            let start = (column.start - used.start) * C;
            for (pixel, weight) in sums[start..].chunks_exact(C).zip(&column.weights) {
                (0..C).for_each(|c| mean[c] += weight * pixel[c]);
            }
            out.extend(mean);
        }
    }
    out
}

/// The old pixels under one new pixel along an axis, and how much of it each covers (together 1).
struct Span {
    start: usize,
    weights: Vec<f32>,
}

impl Span {
    fn new(index: u32, old: u32, new: u32) -> Self {
        let scale = f64::from(old) / f64::from(new);
        let (low, high) = (f64::from(index) * scale, (f64::from(index) + 1.0) * scale);
        let start = low.floor() as usize;
        // A sliver that only rounding has made is no pixel.
        let end = ((high - 1e-9).ceil() as usize).min(old as usize);
        let overlap = |i: usize| ((i as f64 + 1.0).min(high) - (i as f64).max(low)).max(0.0);
        let total: f64 = (start..end).map(overlap).sum();
        Self { start, weights: (start..end).map(|i| (overlap(i) / total) as f32).collect() }
    }
}

/// `[height, width, C]` at a continuous position; positions outside take the border's value.
fn bilinear<const C: usize>(image: &[f32], (width, height): (usize, usize), x: f64, y: f64) -> [f32; C] {
    let (x, y) = ((x - 0.5).clamp(0.0, (width - 1) as f64), (y - 0.5).clamp(0.0, (height - 1) as f64));
    let (x0, y0) = (x as usize, y as usize);
    let (x1, y1) = ((x0 + 1).min(width - 1), (y0 + 1).min(height - 1));
    let (fx, fy) = ((x - x0 as f64) as f32, (y - y0 as f64) as f32);
    let at = |x: usize, y: usize, c: usize| image[(y * width + x) * C + c];
    std::array::from_fn(|c| {
        let (top, bottom) =
            (at(x0, y0, c) * (1.0 - fx) + at(x1, y0, c) * fx, at(x0, y1, c) * (1.0 - fx) + at(x1, y1, c) * fx);
        top * (1.0 - fy) + bottom * fy
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::calibration::guess;

    fn lens() -> Camera {
        Camera { distortion: [-0.2, 0.08, 0.002, -0.001, -0.01], ..guess(640, 480, 1.0) }
    }

    #[test]
    fn points_come_back_through_the_distortion() {
        let rectify = Rectify::new(lens(), 320).unwrap();
        assert_eq!((rectify.camera.width, rectify.camera.height), (320, 240));
        for (x, y) in [(0.5, 0.5), (639.0, 479.0), (320.0, 240.0), (100.0, 400.0), (-5.0, 200.0)] {
            let (a, b) = rectify.rectified_from_uploaded(x, y).unwrap();
            let (u, v) = rectify.distorted_from_rectified(a, b).map(|(u, v)| (2.0 * u, 2.0 * v)).unwrap();
            assert!((u - x).abs() < 1e-6 && (v - y).abs() < 1e-6, "({x}, {y}) came back as ({u}, {v})");
        }
    }

    #[test]
    fn a_distorted_line_becomes_straight() {
        // A vertical edge at rectified x = 60.5 (of 160), drawn through the lens.
        let camera = Camera { distortion: [-0.25, 0.05, 0.0, 0.0, 0.0], ..guess(160, 120, 1.0) };
        let rectify = Rectify::new(camera, 160).unwrap();
        let inside = |x: u32, y: u32| {
            let position = rectify.rectified_from_uploaded(f64::from(x) + 0.5, f64::from(y) + 0.5);
            position.is_some_and(|(x, _)| x < 60.5)
        };
        let data = (0..120 * 160).map(|i| if inside(i % 160, i / 160) { 255 } else { 0 }).collect();
        let mask = rectify.mask(&Picture { width: 160, height: 120, data }, Rect { x0: 0, y0: 5, x1: 160, y1: 115 });
        for row in mask.chunks(160) {
            let edge = row.iter().rposition(|&value| value == 255).unwrap();
            assert!((59..=61).contains(&edge), "edge at {edge}");
        }
    }

    #[test]
    fn scaling_down_averages_and_keeps_the_place() {
        let rectify = Rectify::new(guess(64, 32, 1.0), 16).unwrap();
        // Blocks of 4×4 pixels of one value; each becomes one pixel.
        let block = |i: u32| ((i % 64) / 4 * 13 + (i / 64) / 4 * 7) as u8;
        let data: Vec<u8> = (0..64 * 32).flat_map(|i| [block(i); 3]).collect();
        let small = rectify.rgb(&Picture { width: 64, height: 32, data }, Rect { x0: 2, y0: 1, x1: 10, y1: 7 });
        for (i, pixel) in small.chunks(3).enumerate() {
            let (x, y) = (2 + i as u8 % 8, 1 + i as u8 / 8);
            assert_eq!(pixel, [x * 13 + y * 7; 3], "({x}, {y})");
        }
    }

    #[test]
    fn an_uneven_scale_weighs_pixels_by_their_area() {
        // Three pixels become two: each takes one and a half.
        let picture = Picture { width: 3, height: 1, data: vec![30, 60, 120] };
        let plain = std::array::from_fn(|value| value as f32);
        assert_eq!(shrink::<1>(&picture, (2, 1), Rect { x0: 0, y0: 0, x1: 2, y1: 1 }, &plain), [40.0, 100.0]);
        assert_eq!(shrink::<1>(&picture, (2, 1), Rect { x0: 1, y0: 0, x1: 2, y1: 1 }, &plain), [100.0]);
    }

    #[test]
    fn images_of_the_right_size_pass_unchanged() {
        let rectify = Rectify::new(guess(8, 4, 1.0), 100).unwrap();
        let data: Vec<u8> = (0..8 * 4 * 3).collect();
        let cut = rectify.rgb(&Picture { width: 8, height: 4, data }, Rect { x0: 6, y0: 1, x1: 8, y1: 3 });
        assert_eq!(cut, [42, 43, 44, 45, 46, 47, 66, 67, 68, 69, 70, 71]);
    }

    #[test]
    fn a_lens_that_folds_the_image_is_refused() {
        let camera = Camera { distortion: [-5.0, 0.0, 0.0, 0.0, 0.0], ..guess(640, 480, 1.0) };
        assert!(Rectify::new(camera, 320).unwrap_err().message.contains("folds"));
    }
}
