//! From the uploaded images to those of the capture: lens distortion removed, scaled down, cropped.

use super::BadInput;
use super::Part;
use super::source::Picture;
use crate::camera::Camera;

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
    /// Samples a rectified pixel takes along each side.
    samples: u32,
    /// Normalised radius up to which distortion keeps the order of points.
    valid_radius: f64,
    distorted: bool,
}

impl Rectify {
    pub fn new(uploaded: Camera, max_side_px: u32) -> Result<Self, BadInput> {
        let scale = (f64::from(max_side_px) / f64::from(uploaded.width.max(uploaded.height))).min(1.0);
        let mut camera = uploaded.clone();
        camera.width = ((f64::from(uploaded.width) * scale).round() as u32).max(1);
        camera.height = ((f64::from(uploaded.height) * scale).round() as u32).max(1);
        let sx = f64::from(camera.width) / f64::from(uploaded.width);
        let sy = f64::from(camera.height) / f64::from(uploaded.height);
        (camera.fx, camera.cx) = (uploaded.fx * sx, uploaded.cx * sx);
        (camera.fy, camera.cy) = (uploaded.fy * sy, uploaded.cy * sy);
        camera.distortion = [0.0; 5];
        let distorted = uploaded.distortion != [0.0; 5];
        let samples = if scale == 1.0 { 1 } else { (1.0 / sx.min(sy)).ceil() as u32 + 1 };
        let valid_radius = valid_radius(&uploaded)?;
        Ok(Self { uploaded, camera, samples, valid_radius, distorted })
    }

    /// From a rectified position to the uploaded one; `None` beyond where the distortion is meaningful.
    fn uploaded_from_rectified(&self, x: f64, y: f64) -> Option<(f64, f64)> {
        let (u, v) = ((x - self.camera.cx) / self.camera.fx, (y - self.camera.cy) / self.camera.fy);
        if self.distorted && u.hypot(v) > self.valid_radius {
            return None;
        }
        let (u, v) = distort(&self.uploaded.distortion, u, v);
        Some((u * self.uploaded.fx + self.uploaded.cx, v * self.uploaded.fy + self.uploaded.cy))
    }

    /// From an uploaded position to the rectified one; `None` where there is none.
    pub fn rectified_from_uploaded(&self, x: f64, y: f64) -> Option<(f64, f64)> {
        let (u, v) = ((x - self.uploaded.cx) / self.uploaded.fx, (y - self.uploaded.cy) / self.uploaded.fy);
        let (u, v) =
            if self.distorted { undistort(&self.uploaded.distortion, u, v, self.valid_radius)? } else { (u, v) };
        Some((u * self.camera.fx + self.camera.cx, v * self.camera.fy + self.camera.cy))
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
        let mut out = Vec::with_capacity(rect.width() as usize * rect.height() as usize * 3);
        if self.samples == 1 && !self.distorted {
            let (row, x0) = (picture.width as usize * 3, rect.x0 as usize * 3);
            for y in rect.y0 as usize..rect.y1 as usize {
                out.extend_from_slice(&picture.data[y * row + x0..y * row + rect.x1 as usize * 3]);
            }
            return out;
        }
        self.each_pixel(rect, |positions| {
            let mut sum = [0.0f32; 3];
            let mut count = 0;
            for (x, y) in positions.flatten() {
                let (corners, weights) = bilinear(picture, x, y);
                for (corner, weight) in corners.into_iter().zip(weights) {
                    let pixel = &picture.data[3 * corner..3 * corner + 3];
                    (0..3).for_each(|c| sum[c] += weight * f32::from(pixel[c]));
                }
                count += 1;
            }
            out.extend(sum.map(|s| (s / count.max(1) as f32).round() as u8));
        });
        out
    }

    /// `[height, width]` of a rectangle of the rectified mask: 255 where at least half of the pixel is foreground.
    pub fn mask(&self, picture: &Picture, rect: Rect) -> Vec<u8> {
        let mut out = Vec::with_capacity(rect.width() as usize * rect.height() as usize);
        let (width, height) = (f64::from(picture.width), f64::from(picture.height));
        self.each_pixel(rect, |positions| {
            let (mut sum, mut count) = (0.0, 0);
            for position in positions {
                count += 1;
                let Some((x, y)) = position else { continue };
                if x < 0.0 || y < 0.0 || x >= width || y >= height {
                    continue;
                }
                let (corners, weights) = bilinear(picture, x, y);
                let set = |corner: usize| f32::from(u8::from(is_foreground(picture.data[corner])));
                sum += corners.into_iter().zip(weights).map(|(corner, weight)| weight * set(corner)).sum::<f32>();
            }
            out.push(if sum >= 0.5 * count as f32 { 255 } else { 0 });
        });
        out
    }

    /// Calls `pixel` for each pixel of `rect`, row by row, with the uploaded positions of its samples.
    fn each_pixel(&self, rect: Rect, mut pixel: impl FnMut(&mut dyn Iterator<Item = Option<(f64, f64)>>)) {
        let n = self.samples;
        let offset = |i: u32| (f64::from(i) + 0.5) / f64::from(n);
        for y in rect.y0..rect.y1 {
            for x in rect.x0..rect.x1 {
                pixel(
                    &mut (0..n * n).map(|i| {
                        self.uploaded_from_rectified(f64::from(x) + offset(i % n), f64::from(y) + offset(i / n))
                    }),
                );
            }
        }
    }
}

/// Foreground of a mask's pixel.
pub(super) fn is_foreground(value: u8) -> bool {
    value >= 128
}

/// Indices of the four pixels around a position and their weights; positions outside take the border's.
fn bilinear(picture: &Picture, x: f64, y: f64) -> ([usize; 4], [f32; 4]) {
    let (width, height) = (picture.width as usize, picture.height as usize);
    let (x, y) = ((x - 0.5).clamp(0.0, (width - 1) as f64), (y - 0.5).clamp(0.0, (height - 1) as f64));
    let (x0, y0) = (x as usize, y as usize);
    let (x1, y1) = ((x0 + 1).min(width - 1), (y0 + 1).min(height - 1));
    let (fx, fy) = ((x - x0 as f64) as f32, (y - y0 as f64) as f32);
    let corners = [y0 * width + x0, y0 * width + x1, y1 * width + x0, y1 * width + x1];
    (corners, [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy])
}

/// OpenCV's model on normalised coordinates: with r² = u² + v², radial = 1 + k1 r² + k2 r⁴ + k3 r⁶,
/// `u' = u·radial + 2 p1 u v + p2 (r² + 2u²)`, `v' = v·radial + p1 (r² + 2v²) + 2 p2 u v`.
fn distort([k1, k2, p1, p2, k3]: &[f64; 5], u: f64, v: f64) -> (f64, f64) {
    let r2 = u * u + v * v;
    let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
    (u * radial + 2.0 * p1 * u * v + p2 * (r2 + 2.0 * u * u), v * radial + p1 * (r2 + 2.0 * v * v) + 2.0 * p2 * u * v)
}

/// The inverse of [`distort`] by damped Newton steps with a numeric Jacobian.
fn undistort(coefficients: &[f64; 5], u: f64, v: f64, valid_radius: f64) -> Option<(f64, f64)> {
    const STEP: f64 = 1e-6;
    let (mut x, mut y) = (u, v);
    // Far points start on the border of where the inverse exists.
    let radius = x.hypot(y);
    if radius > valid_radius {
        (x, y) = (x * valid_radius / radius, y * valid_radius / radius);
    }
    for _ in 0..50 {
        let (a, b) = distort(coefficients, x, y);
        let (eu, ev) = (a - u, b - v);
        if eu.hypot(ev) < 1e-10 {
            return (x.hypot(y) <= valid_radius * (1.0 + 1e-9)).then_some((x, y));
        }
        let (ax, bx) = distort(coefficients, x + STEP, y);
        let (ay, by) = distort(coefficients, x, y + STEP);
        let (jxx, jyx, jxy, jyy) = ((ax - a) / STEP, (bx - b) / STEP, (ay - a) / STEP, (by - b) / STEP);
        let determinant = jxx * jyy - jxy * jyx;
        if determinant.abs() < 1e-9 {
            return None;
        }
        let (dx, dy) = ((jyy * eu - jxy * ev) / determinant, (jxx * ev - jyx * eu) / determinant);
        // Steps longer than a part of the field would jump over the fold.
        let damping = (0.25 / dx.hypot(dy)).min(1.0);
        (x, y) = (x - damping * dx, y - damping * dy);
    }
    None
}

/// Up to which normalised radius the radial part grows. It must reach most of the way to the image's corners: a
/// polynomial that turns back earlier is no calibration of these images.
fn valid_radius(camera: &Camera) -> Result<f64, BadInput> {
    let [k1, k2, _, _, k3] = camera.distortion;
    let far = |centre: f64, side: u32, focal: f64| centre.abs().max((f64::from(side) - centre).abs()) / focal;
    let corner = far(camera.cx, camera.width, camera.fx).hypot(far(camera.cy, camera.height, camera.fy));
    let most = 2.0 * corner;
    for i in 1..=512 {
        let r = most * f64::from(i) / 512.0;
        let r2 = r * r;
        // d/dr of r (1 + k1 r² + k2 r⁴ + k3 r⁶)
        let growth = 1.0 + r2 * (3.0 * k1 + r2 * (5.0 * k2 + r2 * 7.0 * k3));
        if growth <= 0.05 {
            if r < 0.7 * corner {
                let message = "the distortion folds the image over within its borders";
                return Err(BadInput::new(Part::Camera, message, "k1, k2, p1, p2, k3 of OpenCV's model"));
            }
            return Ok(r);
        }
    }
    Ok(most)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::calibration::guess;

    fn lens() -> Camera {
        Camera { distortion: [-0.2, 0.08, 0.002, -0.001, -0.01], ..guess(640, 480) }
    }

    #[test]
    fn points_come_back_through_the_distortion() {
        let rectify = Rectify::new(lens(), 320).unwrap();
        assert_eq!((rectify.camera.width, rectify.camera.height), (320, 240));
        for (x, y) in [(0.5, 0.5), (639.0, 479.0), (320.0, 240.0), (100.0, 400.0), (-5.0, 200.0)] {
            let (a, b) = rectify.rectified_from_uploaded(x, y).unwrap();
            let (u, v) = rectify.uploaded_from_rectified(a, b).unwrap();
            assert!((u - x).abs() < 1e-6 && (v - y).abs() < 1e-6, "({x}, {y}) came back as ({u}, {v})");
        }
    }

    #[test]
    fn a_distorted_line_becomes_straight() {
        // A vertical edge at rectified x = 60.5 (of 160), drawn through the lens.
        let camera = Camera { distortion: [-0.25, 0.05, 0.0, 0.0, 0.0], ..guess(160, 120) };
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
        let rectify = Rectify::new(guess(64, 32), 16).unwrap();
        // Blocks of 4×4 pixels of one value; each becomes one pixel.
        let block = |i: u32| ((i % 64) / 4 * 13 + (i / 64) / 4 * 7) as u8;
        let data: Vec<u8> = (0..64 * 32).flat_map(|i| [block(i); 3]).collect();
        let small = rectify.rgb(&Picture { width: 64, height: 32, data }, Rect { x0: 2, y0: 1, x1: 10, y1: 7 });
        let centre = small[3 * (2 * 8 + 3)];
        // Bilinear samples reach a little into the neighbours, evenly on all sides.
        assert!((i32::from(centre) - (5 * 13 + 3 * 7)).abs() <= 1, "{centre}");
    }

    #[test]
    fn images_of_the_right_size_pass_unchanged() {
        let rectify = Rectify::new(guess(8, 4), 100).unwrap();
        let data: Vec<u8> = (0..8 * 4 * 3).collect();
        let cut = rectify.rgb(&Picture { width: 8, height: 4, data }, Rect { x0: 6, y0: 1, x1: 8, y1: 3 });
        assert_eq!(cut, [42, 43, 44, 45, 46, 47, 66, 67, 68, 69, 70, 71]);
    }

    #[test]
    fn a_lens_that_folds_the_image_is_refused() {
        let camera = Camera { distortion: [-5.0, 0.0, 0.0, 0.0, 0.0], ..guess(640, 480) };
        assert!(Rectify::new(camera, 320).unwrap_err().message.contains("folds"));
    }
}
