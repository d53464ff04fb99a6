//! Image metrics: PSNR and SSIM of RGB pictures in [0, 1], over the whole picture or over a mask's foreground, and the overlap
//! of masks.

use image::{GrayImage, Rgb, RgbImage};

use crate::mask::is_foreground;

/// `10 log₁₀(1 / MSE)` in dB over all pixels and channels, range 1; infinite for equal pictures.
///
/// # Panics
/// When the sizes differ.
pub fn psnr(a: &RgbImage, b: &RgbImage) -> f64 {
    assert_eq!(a.dimensions(), b.dimensions(), "sizes");
    decibels(a.pixels().zip(b.pixels()).map(|(p, q)| squares(p, q)))
}

/// As [`psnr`], over the pixels that `mask` marks (≥ 128); `None` where there are none.
///
/// # Panics
/// When the sizes differ.
pub fn psnr_inside(a: &RgbImage, b: &RgbImage, mask: &GrayImage) -> Option<f64> {
    assert!(a.dimensions() == b.dimensions() && a.dimensions() == mask.dimensions(), "sizes");
    let inside = a.pixels().zip(b.pixels()).zip(mask.pixels()).filter(|(_, m)| is_foreground(m.0[0]));
    let mut inside = inside.map(|((p, q), _)| squares(p, q)).peekable();
    inside.peek()?;
    Some(decibels(inside))
}

/// Mean of the three squared differences.
fn squares(p: &Rgb<u8>, q: &Rgb<u8>) -> f64 {
    p.0.iter().zip(q.0).map(|(&x, y)| ((x as f64 - y as f64) / 255.0).powi(2)).sum::<f64>() / 3.0
}

fn decibels(squares: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = squares.fold((0.0, 0u64), |(sum, count), s| (sum + s, count + 1));
    -10.0 * (sum / count as f64).log10()
}

/// Radius and σ of SSIM's window: 11×11 pixels.
const RADIUS: usize = 5;
const SIGMA: f64 = 1.5;

/// Structural similarity (Wang et al. 2004): Gaussian window 11×11, σ = 1.5, K₁ = 0.01, K₂ = 0.03, range 1, population
/// covariances; the mean over the pixels whose whole window lies in the picture and over the channels.
///
/// # Panics
/// When the sizes differ or a side is shorter than 11.
pub fn ssim(a: &RgbImage, b: &RgbImage) -> f64 {
    let map = ssim_map(a, b);
    map.iter().sum::<f64>() / map.len() as f64
}

/// As [`ssim`], over the pixels that `mask` marks (≥ 128) and whose window lies in the picture; `None` where there are none.
///
/// # Panics
/// When the sizes differ or a side is shorter than 11.
pub fn ssim_inside(a: &RgbImage, b: &RgbImage, mask: &GrayImage) -> Option<f64> {
    assert_eq!(a.dimensions(), mask.dimensions(), "sizes");
    let fit = a.width() - 2 * RADIUS as u32;
    let marked = |i: u32| is_foreground(mask.get_pixel(i % fit + RADIUS as u32, i / fit + RADIUS as u32).0[0]);
    let map = ssim_map(a, b);
    let inside: Vec<f64> = map.iter().zip(0..).filter(|(_, i)| marked(*i)).map(|(s, _)| *s).collect();
    (!inside.is_empty()).then(|| inside.iter().sum::<f64>() / inside.len() as f64)
}

/// `[height − 10, width − 10]`: the channels' mean similarity of each window.
fn ssim_map(a: &RgbImage, b: &RgbImage) -> Vec<f64> {
    assert_eq!(a.dimensions(), b.dimensions(), "sizes");
    let (width, height) = (a.width() as usize, a.height() as usize);
    assert!(width > 2 * RADIUS && height > 2 * RADIUS, "SSIM needs at least 11 pixels a side");
    let channel = |image: &RgbImage, k: usize| -> Vec<f64> { image.pixels().map(|p| p.0[k] as f64 / 255.0).collect() };
    let [r, g, b] = std::array::from_fn(|k| ssim_channel(&channel(a, k), &channel(b, k), width));
    r.iter().zip(&g).zip(&b).map(|((r, g), b)| (r + g + b) / 3.0).collect()
}

fn ssim_channel(x: &[f64], y: &[f64], width: usize) -> Vec<f64> {
    const C1: f64 = 0.01 * 0.01;
    const C2: f64 = 0.03 * 0.03;
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).collect::<Vec<f64>>();
    let mean = |v: &[f64]| window_means(v, width);
    let (ux, uy) = (mean(x), mean(y));
    let (xx, yy, xy) = (mean(&product(x, x)), mean(&product(y, y)), mean(&product(x, y)));
    let similarity = |i: usize| {
        let (vx, vy, cov) = (xx[i] - ux[i] * ux[i], yy[i] - uy[i] * uy[i], xy[i] - ux[i] * uy[i]);
        (2.0 * ux[i] * uy[i] + C1) * (2.0 * cov + C2) / ((ux[i] * ux[i] + uy[i] * uy[i] + C1) * (vx + vy + C2))
    };
    (0..ux.len()).map(similarity).collect()
}

/// Gaussian means over all windows that fit, separably.
fn window_means(values: &[f64], width: usize) -> Vec<f64> {
    let weights: Vec<f64> =
        (0..=2 * RADIUS).map(|i| (-0.5 * ((i as f64 - RADIUS as f64) / SIGMA).powi(2)).exp()).collect();
    let total: f64 = weights.iter().sum();
    let (height, fit) = (values.len() / width, width - 2 * RADIUS);
    let mut rows = Vec::with_capacity(height * fit);
    for row in values.chunks(width) {
        rows.extend(
            row.windows(2 * RADIUS + 1).map(|w| w.iter().zip(&weights).map(|(v, g)| v * g).sum::<f64>() / total),
        );
    }
    let mut out = Vec::with_capacity((height - 2 * RADIUS) * fit);
    for y in 0..height - 2 * RADIUS {
        out.extend(
            (0..fit).map(|x| weights.iter().enumerate().map(|(k, g)| g * rows[(y + k) * fit + x]).sum::<f64>() / total),
        );
    }
    out
}

/// Intersection over union of two masks, foreground ≥ 128; 1 where both are empty.
///
/// # Panics
/// When the sizes differ.
pub fn mask_iou(a: &GrayImage, b: &GrayImage) -> f64 {
    assert_eq!(a.dimensions(), b.dimensions(), "sizes");
    let (mut both, mut either) = (0u64, 0u64);
    for (x, y) in a.as_raw().iter().zip(b.as_raw()) {
        let (x, y) = (is_foreground(*x), is_foreground(*y));
        both += (x && y) as u64;
        either += (x || y) as u64;
    }
    if either == 0 { 1.0 } else { both as f64 / either as f64 }
}

#[cfg(test)]
mod tests {
    use image::Luma;

    use super::*;

    /// Two fixed pictures, made by integer arithmetic so that any language can make them again.
    fn pair() -> (RgbImage, RgbImage) {
        let a = RgbImage::from_fn(32, 24, |x, y| Rgb([(x * 7 + y * 3) as u8, (x * y) as u8, (255 - x * 5) as u8]));
        let b = RgbImage::from_fn(32, 24, |x, y| {
            let p = a.get_pixel(x, y).0;
            let noise = |k: u32| ((x * 31 + y * 17 + k * 13) % 23) as i32 - 11;
            Rgb(std::array::from_fn(|k| (p[k] as i32 + noise(k as u32)).clamp(0, 255) as u8))
        });
        (a, b)
    }

    const PSNR: f64 = 31.859439607962994;
    const SSIM: f64 = 0.8836898428977723;

    /// Expected values: the definition of scikit-image (`gaussian_weights`, σ 1.5, no sample covariance, range 1),
    /// computed once in float64 with SciPy's filter.
    #[test]
    fn values_agree_with_the_reference() {
        let (a, b) = pair();
        assert!((psnr(&a, &b) - PSNR).abs() < 1e-9, "{}", psnr(&a, &b));
        assert!((ssim(&a, &b) - SSIM).abs() < 1e-9, "{}", ssim(&a, &b));
    }

    #[test]
    fn equal_pictures_are_perfect() {
        let (a, _) = pair();
        assert_eq!(psnr(&a, &a), f64::INFINITY);
        assert!((ssim(&a, &a) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_foreground_counts_alone() {
        let (a, b) = pair();
        // What is outside of the mask may be anything.
        let mask = GrayImage::from_fn(32, 24, |x, _| Luma([if x < 20 { 255 } else { 0 }]));
        let far = RgbImage::from_fn(32, 24, |x, y| if x < 20 { *b.get_pixel(x, y) } else { Rgb([0; 3]) });
        let crop = |image: &RgbImage| image::imageops::crop_imm(image, 0, 0, 20, 24).to_image();
        let want = psnr(&crop(&a), &crop(&b));
        assert!((psnr_inside(&a, &far, &mask).unwrap() - want).abs() < 1e-9);
        let windows = GrayImage::from_fn(32, 24, |x, _| Luma([if x < 15 { 255 } else { 0 }]));
        assert!((ssim_inside(&a, &far, &windows).unwrap() - ssim(&crop(&a), &crop(&b))).abs() < 1e-9);
        let all = GrayImage::from_pixel(32, 24, Luma([255]));
        assert!((psnr_inside(&a, &b, &all).unwrap() - PSNR).abs() < 1e-9);
        assert!((ssim_inside(&a, &b, &all).unwrap() - SSIM).abs() < 1e-9);
        let none = GrayImage::new(32, 24);
        assert_eq!((psnr_inside(&a, &b, &none), ssim_inside(&a, &b, &none)), (None, None));
    }

    #[test]
    fn masks_overlap_by_counting() {
        let left = GrayImage::from_fn(4, 1, |x, _| Luma([if x < 2 { 255 } else { 0 }]));
        let middle = GrayImage::from_fn(4, 1, |x, _| Luma([if (1..3).contains(&x) { 128 } else { 127 }]));
        assert_eq!(mask_iou(&left, &middle), 1.0 / 3.0);
        assert_eq!(mask_iou(&GrayImage::new(2, 2), &GrayImage::new(2, 2)), 1.0);
    }
}
