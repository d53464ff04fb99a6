//! A held-out picture beside ours.

use image::{GrayImage, Rgb, RgbImage, RgbaImage};

use super::flip::flip_map;
use super::image::{psnr, psnr_inside, ssim, ssim_inside};
use super::lpips::Lpips;
use super::report::{ImageFigures, ImageScore};
use super::run::EvalError;
use super::subject::Novel;
use crate::avatar::{RenderSpec, Renderer, Shading};
use crate::mask::is_foreground;
use crate::page::{heat_map, over, strip};
use crate::picture::Background;

/// Samples along a pixel's side of the compared pictures: the truth's are well antialiased.
const SAMPLES: u32 = 4;
const WHITE: [u8; 3] = [255; 3];
const BLACK: [u8; 3] = [0; 3];

/// Truth and ours, of one size.
pub(super) struct Shot {
    name: String,
    truth: RgbImage,
    mask: GrayImage,
    ours: RgbaImage,
}

impl Shot {
    /// Draws `spec` before the novel picture's camera. Waits.
    pub fn draw(renderer: &Renderer, novel: &Novel, spec: RenderSpec) -> Result<Self, EvalError> {
        let spec = RenderSpec {
            camera: novel.camera.clone(),
            background: Background::Transparent,
            samples: SAMPLES,
            shading: Some(Shading::Samples),
            ..spec
        };
        let ours = renderer.render(&spec)?;
        let (truth, mask) = novel.open()?;
        if truth.dimensions() != ours.dimensions() || truth.width().min(truth.height()) < 11 {
            let ((w, h), (want_w, want_h)) = (truth.dimensions(), ours.dimensions());
            let reason = format!("the picture is {w}×{h}, its camera {want_w}×{want_h}, at least 11 a side");
            return Err(EvalError::Picture { picture: novel.name.clone(), reason });
        }
        Ok(Self { name: novel.name.clone(), truth, mask, ours })
    }

    pub fn score(&self, lpips: Option<&Lpips>) -> Result<ImageScore, EvalError> {
        let (truth, ours) = self.on(WHITE);
        let (dark_truth, dark_ours) = self.on(BLACK);
        let errors = flip_map(&truth, &ours);
        let inside = errors.iter().zip(self.mask.pixels()).filter(|(_, m)| is_foreground(m.0[0])).map(|(e, _)| *e);
        let figures = ImageFigures {
            psnr_db: psnr(&truth, &ours),
            ssim: ssim(&truth, &ours),
            psnr_black_db: psnr(&dark_truth, &dark_ours),
            ssim_black: ssim(&dark_truth, &dark_ours),
            psnr_foreground_db: psnr_inside(&truth, &ours, &self.mask),
            ssim_foreground: ssim_inside(&truth, &ours, &self.mask),
            flip: mean(errors.iter().copied()).unwrap_or(0.0),
            flip_foreground: mean(inside),
            lpips: lpips.map(|network| network.distance(&truth, &ours)).transpose()?,
        };
        Ok(ImageScore { name: self.name.clone(), figures })
    }

    /// Both over a colour.
    fn on(&self, background: [u8; 3]) -> (RgbImage, RgbImage) {
        let behind = RgbImage::from_pixel(self.truth.width(), self.truth.height(), Rgb(background));
        (composited(&self.truth, &self.mask, background), over(&self.ours, &behind))
    }

    /// Truth, ours, and their absolute difference, on white.
    pub fn side_by_side(&self) -> RgbImage {
        let (truth, ours) = self.on(WHITE);
        let difference = RgbImage::from_fn(truth.width(), truth.height(), |x, y| {
            let (a, b) = (truth.get_pixel(x, y).0, ours.get_pixel(x, y).0);
            Rgb(std::array::from_fn(|k| a[k].abs_diff(b[k])))
        });
        strip(&[truth, ours, difference], 0, WHITE)
    }

    /// Truth, ours, both outlines over each other (blue: truth alone, red: ours alone), and FLIP as heat; cut to the person.
    pub fn card(&self) -> RgbImage {
        let (truth, ours) = self.on(WHITE);
        let (width, height) = truth.dimensions();
        let outlines = RgbImage::from_fn(width, height, |x, y| {
            let grey = (0.3 * mean(truth.get_pixel(x, y).0.map(f32::from).into_iter()).unwrap_or(0.0) + 178.0) as u8;
            match (is_foreground(self.mask.get_pixel(x, y).0[0]), is_foreground(self.ours.get_pixel(x, y).0[3])) {
                (true, false) => Rgb([30, 90, 220]),
                (false, true) => Rgb([225, 50, 40]),
                _ => Rgb([grey; 3]),
            }
        });
        let heat = heat_map(&flip_map(&truth, &ours), width, height, 1.0);
        let [x, y, w, h] = self.bounds();
        let cut = |picture: RgbImage| image::imageops::crop_imm(&picture, x, y, w, h).to_image();
        strip(&[truth, ours, outlines, heat].map(cut), 4, WHITE)
    }

    /// What either shows, with a little around it: x, y, width, height.
    fn bounds(&self) -> [u32; 4] {
        let (width, height) = self.truth.dimensions();
        let shown = |x: u32, y: u32| {
            is_foreground(self.mask.get_pixel(x, y).0[0]) || is_foreground(self.ours.get_pixel(x, y).0[3])
        };
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).filter(|&(x, y)| shown(x, y));
        let (mut low, mut high) = ([width, height], [0, 0]);
        for (x, y) in pixels {
            (low, high) = ([low[0].min(x), low[1].min(y)], [high[0].max(x + 1), high[1].max(y + 1)]);
        }
        if high[0] == 0 {
            return [0, 0, width, height];
        }
        let low = low.map(|v| v.saturating_sub(6));
        let high = [(high[0] + 6).min(width), (high[1] + 6).min(height)];
        [low[0], low[1], high[0] - low[0], high[1] - low[1]]
    }
}

fn mean(values: impl Iterator<Item = f32>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0u32), |(sum, count), v| (sum + f64::from(v), count + 1));
    (count > 0).then(|| sum / f64::from(count))
}

/// The picture where its mask covers, over a colour elsewhere.
pub(super) fn composited(picture: &RgbImage, mask: &GrayImage, background: [u8; 3]) -> RgbImage {
    RgbImage::from_fn(picture.width(), picture.height(), |x, y| {
        let alpha = mask.get_pixel(x, y).0[0] as f32 / 255.0;
        let colour = picture.get_pixel(x, y).0;
        Rgb(std::array::from_fn(|k| (alpha * colour[k] as f32 + (1.0 - alpha) * background[k] as f32).round() as u8))
    })
}
