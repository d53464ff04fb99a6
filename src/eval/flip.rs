//! FLIP for ordinary pictures (Andersson et al. 2020): how different two pictures look to somebody who flips between them, 0
//! to 1 a pixel, at 67 pixels a degree (0.7 m before a screen that is 0.7 m wide and has 3840 pixels a row).
//!
//! Colours are blurred as the eye blurs them at that distance (contrast sensitivity of the three opponent channels) and
//! compared in Hunt-adjusted L*a*b*; edges and points of the luminance are compared by Gaussian derivatives; where those
//! differ, a difference of colour counts more.

use std::f64::consts::PI;

use image::RgbImage;

/// Pixels a degree of the visual field.
const PPD: f64 = 0.7 * 3840.0 / 0.7 * PI / 180.0;
/// Gaussians of the contrast sensitivity, `a` and `b`, of achromatic, red-green and the two of blue-yellow.
const ACHROMATIC: [f64; 2] = [1.0, 0.0047];
const RED_GREEN: [f64; 2] = [1.0, 0.0053];
const BLUE_YELLOW: [[f64; 2]; 2] = [[34.1, 0.04], [13.5, 0.025]];
/// Of the colour difference.
const QC: f64 = 0.7;
const PC: f64 = 0.4;
const PT: f64 = 0.95;
/// Width of the detected features, degrees, and their exponent.
const FEATURE: f64 = 0.082;
const QF: f64 = 0.5;

/// A plane of numbers, row by row.
type Plane = Vec<f64>;

/// The error of each pixel, `[height, width]`; the picture's FLIP is their mean.
///
/// # Panics
/// When the sizes differ.
pub fn flip_map(reference: &RgbImage, test: &RgbImage) -> Vec<f32> {
    assert_eq!(reference.dimensions(), test.dimensions(), "sizes");
    let width = reference.width() as usize;
    let (a, b) = (opponent(reference), opponent(test));
    let (seen_a, seen_b) = (perceived(&a, width), perceived(&b, width));
    let (features_a, features_b) = (features(&a[0], width), features(&b[0], width));
    let most = hyab(hunt([0.0, 1.0, 0.0]), hunt([0.0, 0.0, 1.0])).powf(QC);
    let error = |i: usize| {
        let colour = redistributed(hyab(seen_a[i], seen_b[i]).powf(QC), most);
        let differs = |k: usize| (features_a[i][k] - features_b[i][k]).abs();
        let feature = (differs(0).max(differs(1)) / 2f64.sqrt()).powf(QF);
        colour.powf(1.0 - feature.min(1.0)) as f32
    };
    (0..seen_a.len()).map(error).collect()
}

/// Differences up to `PC` of the most take the range up to `PT`.
fn redistributed(difference: f64, most: f64) -> f64 {
    let knee = PC * most;
    if difference < knee { PT / knee * difference } else { PT + (difference - knee) / (most - knee) * (1.0 - PT) }
}

const TO_XYZ: [[f64; 3]; 3] = [
    [10135552.0 / 24577794.0, 8788810.0 / 24577794.0, 4435075.0 / 24577794.0],
    [2613072.0 / 12288897.0, 8788810.0 / 12288897.0, 887015.0 / 12288897.0],
    [1425312.0 / 73733382.0, 8788810.0 / 73733382.0, 70074185.0 / 73733382.0],
];

fn times(matrix: &[[f64; 3]; 3], v: [f64; 3]) -> [f64; 3] {
    matrix.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

/// CIE XYZ over that of white, from linear RGB.
fn relative_xyz(rgb: [f64; 3]) -> [f64; 3] {
    let (xyz, white) = (times(&TO_XYZ, rgb), times(&TO_XYZ, [1.0; 3]));
    std::array::from_fn(|k| xyz[k] / white[k])
}

fn linear(byte: u8) -> f64 {
    let c = f64::from(byte) / 255.0;
    if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
}

/// YCxCz, a plane each.
fn opponent(picture: &RgbImage) -> [Plane; 3] {
    let mut planes: [Plane; 3] = std::array::from_fn(|_| Vec::with_capacity(picture.pixels().len()));
    for pixel in picture.pixels() {
        let [x, y, z] = relative_xyz(pixel.0.map(linear));
        let values = [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)];
        planes.iter_mut().zip(values).for_each(|(plane, value)| plane.push(value));
    }
    planes
}

/// Hunt-adjusted L*a*b* of linear RGB.
fn hunt(rgb: [f64; 3]) -> [f64; 3] {
    let delta: f64 = 6.0 / 29.0;
    let f = |t: f64| if t > delta.powi(3) { t.cbrt() } else { t / (3.0 * delta * delta) + 4.0 / 29.0 };
    let [x, y, z] = relative_xyz(rgb).map(f);
    let lightness = 116.0 * y - 16.0;
    [lightness, 0.01 * lightness * 500.0 * (x - y), 0.01 * lightness * 200.0 * (y - z)]
}

fn hyab(a: [f64; 3], b: [f64; 3]) -> f64 {
    (a[0] - b[0]).abs() + (a[1] - b[1]).hypot(a[2] - b[2])
}

/// What the eye makes of the colours: blurred, back in gamut, Hunt-adjusted.
fn perceived(planes: &[Plane; 3], width: usize) -> Vec<[f64; 3]> {
    let luma = blurred(&planes[0], width, &[ACHROMATIC]);
    let red_green = blurred(&planes[1], width, &[RED_GREEN]);
    let blue_yellow = blurred(&planes[2], width, &BLUE_YELLOW);
    let white = times(&TO_XYZ, [1.0; 3]);
    let back = glam::DMat3::from_cols_array_2d(&TO_XYZ).transpose().inverse();
    let pixel = |i: usize| {
        let y = (luma[i] + 16.0) / 116.0;
        let xyz = [y + red_green[i] / 500.0, y, y - blue_yellow[i] / 200.0];
        let rgb = back * glam::DVec3::from(std::array::from_fn::<f64, 3, _>(|k| xyz[k] * white[k]));
        hunt(rgb.to_array().map(|c| c.clamp(0.0, 1.0)))
    };
    (0..luma.len()).map(pixel).collect()
}

/// The weighted sum of Gaussians `a √(π/b) exp(−π² d² / b)` of the distance d in degrees, normalised as a whole.
fn blurred(plane: &Plane, width: usize, gaussians: &[[f64; 2]]) -> Plane {
    let widest = BLUE_YELLOW.iter().chain([&ACHROMATIC, &RED_GREEN]).map(|g| g[1]).fold(0.0, f64::max);
    let radius = (3.0 * (widest / (2.0 * PI * PI)).sqrt() * PPD).ceil() as i64;
    let kernel =
        |b: f64| -> Vec<f64> { (-radius..=radius).map(|i| (-(PI * i as f64 / PPD).powi(2) / b).exp()).collect() };
    let mut total = 0.0;
    let mut sum = vec![0.0; plane.len()];
    for [a, b] in gaussians {
        let (kernel, weight) = (kernel(*b), a * (PI / b).sqrt());
        total += weight * kernel.iter().sum::<f64>().powi(2);
        let part = convolved(plane, width, &kernel, &kernel);
        sum.iter_mut().zip(part).for_each(|(s, p)| *s += weight * p);
    }
    sum.iter_mut().for_each(|s| *s /= total);
    sum
}

/// Strengths of edges and of points of the luminance.
fn features(luma: &Plane, width: usize) -> Vec<[f64; 2]> {
    let sd = 0.5 * FEATURE * PPD;
    let radius = (3.0 * sd).ceil() as i64;
    let gauss = |x: f64| (-x * x / (2.0 * sd * sd)).exp();
    let sample = |f: &dyn Fn(f64) -> f64| -> Vec<f64> { (-radius..=radius).map(|x| f(x as f64)).collect() };
    let smooth = normalised(sample(&gauss));
    let edge = normalised(sample(&|x| -x * gauss(x)));
    let point = normalised(sample(&|x| (x * x / (sd * sd) - 1.0) * gauss(x)));
    let luma: Plane = luma.iter().map(|y| (y + 16.0) / 116.0).collect();
    let strength = |kernel: &[f64]| -> Plane {
        let (along, across) = (convolved(&luma, width, kernel, &smooth), convolved(&luma, width, &smooth, kernel));
        along.into_iter().zip(across).map(|(x, y)| x.hypot(y)).collect()
    };
    strength(&edge).into_iter().zip(strength(&point)).map(|(e, p)| [e, p]).collect()
}

/// Positive weights sum to 1, negative ones to −1.
fn normalised(kernel: Vec<f64>) -> Vec<f64> {
    let sum = |positive: bool| kernel.iter().filter(|w| (**w > 0.0) == positive).map(|w| w.abs()).sum::<f64>();
    let (up, down) = (sum(true), sum(false).max(f64::MIN_POSITIVE));
    kernel.into_iter().map(|w| if w > 0.0 { w / up } else { w / down }).collect()
}

/// Correlation with a kernel along rows and one along columns; the border's value goes on outside.
fn convolved(plane: &Plane, width: usize, along: &[f64], across: &[f64]) -> Plane {
    let height = plane.len() / width;
    let pass = |from: &Plane, kernel: &[f64], step: usize, n: usize, place: &dyn Fn(usize) -> usize| -> Plane {
        let radius = kernel.len() / 2;
        let value = |i: usize| {
            let at = place(i);
            let base = i - at * step;
            let tap = |(k, w): (usize, &f64)| w * from[base + (at + k).saturating_sub(radius).min(n - 1) * step];
            kernel.iter().enumerate().map(tap).sum()
        };
        (0..from.len()).map(value).collect()
    };
    let rows = pass(plane, along, 1, width, &|i| i % width);
    pass(&rows, across, width, height, &|i| i / width)
}

#[cfg(test)]
mod tests {
    use image::Rgb;

    /// Mean of [`flip_map`].
    fn flip(reference: &RgbImage, test: &RgbImage) -> f64 {
        let map = flip_map(reference, test);
        map.iter().map(|&e| f64::from(e)).sum::<f64>() / map.len() as f64
    }

    use super::*;

    /// The pictures of the other metrics' reference values.
    fn pair() -> (RgbImage, RgbImage) {
        let a = RgbImage::from_fn(32, 24, |x, y| Rgb([(x * 7 + y * 3) as u8, (x * y) as u8, (255 - x * 5) as u8]));
        let b = RgbImage::from_fn(32, 24, |x, y| {
            let p = a.get_pixel(x, y).0;
            let noise = |k: u32| ((x * 31 + y * 17 + k * 13) % 23) as i32 - 11;
            Rgb(std::array::from_fn(|k| (p[k] as i32 + noise(k as u32)).clamp(0, 255) as u8))
        });
        (a, b)
    }

    /// Expected values: the authors' program, version 1.7, in single precision.
    #[test]
    fn values_agree_with_the_reference() {
        let (a, b) = pair();
        let map = flip_map(&a, &b);
        let at = |x: usize, y: usize| f64::from(map[32 * y + x]);
        for (got, want) in [
            (flip(&a, &b), 0.036279354244470596),
            (at(7, 5), 0.014206063002347946),
            (at(30, 20), 0.03365490213036537),
            (at(0, 0), 0.08939947187900543),
        ] {
            assert!((got - want).abs() < 2e-5, "{got}, expected {want}");
        }
    }

    #[test]
    fn a_dot_is_a_feature() {
        let black = RgbImage::new(64, 64);
        let mut dot = black.clone();
        dot.put_pixel(32, 32, Rgb([255; 3]));
        let map = flip_map(&black, &dot);
        assert!((flip(&black, &dot) - 0.0034934766590595245).abs() < 2e-6, "{}", flip(&black, &dot));
        assert!((map[64 * 32 + 32] - 0.864_906_5).abs() < 2e-4, "{}", map[64 * 32 + 32]);
    }

    #[test]
    fn equal_pictures_have_none_and_green_against_blue_has_all() {
        let (a, _) = pair();
        assert_eq!(flip(&a, &a), 0.0);
        let [green, blue] = [[0, 255, 0], [0, 0, 255]].map(|c| RgbImage::from_pixel(32, 32, Rgb(c)));
        assert!((flip(&green, &blue) - 1.0).abs() < 1e-6);
    }
}
