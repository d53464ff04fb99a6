//! Pictures for pages.

use std::io::Cursor;

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use image::codecs::jpeg::JpegEncoder;
use image::{Rgb, RgbImage, RgbaImage};

use super::escape;

/// An `img` with the picture inside.
pub fn inline_jpeg(picture: &RgbImage, quality: u8, alt: &str) -> String {
    let mut bytes = Cursor::new(Vec::new());
    // Into memory, a picture of a valid size is always written.
    let written = picture.write_with_encoder(JpegEncoder::new_with_quality(&mut bytes, quality));
    debug_assert!(written.is_ok(), "{written:?}");
    let (width, height) = picture.dimensions();
    let data = BASE64_STANDARD.encode(bytes.get_ref());
    let alt = escape(alt);
    format!("<img width=\"{width}\" height=\"{height}\" alt=\"{alt}\" src=\"data:image/jpeg;base64,{data}\">")
}

/// A picture with straight alpha over another of its size.
pub fn over(front: &RgbaImage, back: &RgbImage) -> RgbImage {
    RgbImage::from_fn(back.width(), back.height(), |x, y| {
        let ([r, g, b, a], behind) = (front.get_pixel(x, y).0, back.get_pixel(x, y).0);
        let mix =
            |c: u8, d: u8| ((u32::from(c) * u32::from(a) + u32::from(d) * (255 - u32::from(a)) + 127) / 255) as u8;
        Rgb([mix(r, behind[0]), mix(g, behind[1]), mix(b, behind[2])])
    })
}

/// No larger than `side` pixels along its longer side.
pub fn shrunk(picture: &RgbImage, side: u32) -> RgbImage {
    let longer = picture.width().max(picture.height());
    if longer <= side {
        return picture.clone();
    }
    let size = |x: u32| (x * side / longer).max(1);
    let (width, height) = (size(picture.width()), size(picture.height()));
    image::imageops::resize(picture, width, height, image::imageops::FilterType::Triangle)
}

/// Pictures side by side, centred, on `background`.
pub fn strip(pictures: &[RgbImage], gap: u32, background: [u8; 3]) -> RgbImage {
    let height = pictures.iter().map(RgbImage::height).max().unwrap_or(1);
    let gaps = gap * pictures.len().saturating_sub(1) as u32;
    let width = pictures.iter().map(RgbImage::width).sum::<u32>() + gaps;
    let mut strip = RgbImage::from_pixel(width.max(1), height, Rgb(background));
    let mut x = 0;
    for picture in pictures {
        image::imageops::replace(&mut strip, picture, x, i64::from((height - picture.height()) / 2));
        x += i64::from(picture.width() + gap);
    }
    strip
}

/// Stops of the heat map: dark blue, violet, red, orange, near white; evenly spaced.
const STOPS: [[f32; 3]; 6] = [
    [8.0, 8.0, 24.0],
    [72.0, 16.0, 110.0],
    [170.0, 40.0, 100.0],
    [230.0, 90.0, 50.0],
    [250.0, 175.0, 60.0],
    [255.0, 250.0, 210.0],
];

/// Errors as colours, from dark to light: `errors [height, width]`, of which `most` and above are lightest.
///
/// # Panics
/// When there are not `width` × `height` errors.
pub fn heat_map(errors: &[f32], width: u32, height: u32, most: f32) -> RgbImage {
    assert_eq!(errors.len(), width as usize * height as usize, "pixels");
    RgbImage::from_fn(width, height, |x, y| {
        let t = (errors[(y * width + x) as usize] / most).clamp(0.0, 1.0) * (STOPS.len() - 1) as f32;
        let below = (t as usize).min(STOPS.len() - 2);
        let part = t - below as f32;
        let mix = |k: usize| (STOPS[below][k] * (1.0 - part) + STOPS[below + 1][k] * part).round() as u8;
        Rgb([mix(0), mix(1), mix(2)])
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgba;

    #[test]
    fn a_front_lies_over_a_back_by_its_alpha() {
        let front = RgbaImage::from_fn(3, 1, |x, _| Rgba([200, 100, 0, [0, 255, 128][x as usize]]));
        let back = RgbImage::from_pixel(3, 1, Rgb([0, 100, 200]));
        let mixed = over(&front, &back);
        assert_eq!(mixed.get_pixel(0, 0).0, [0, 100, 200]);
        assert_eq!(mixed.get_pixel(1, 0).0, [200, 100, 0]);
        assert_eq!(mixed.get_pixel(2, 0).0, [100, 100, 100]);
    }

    #[test]
    fn strips_are_as_wide_as_their_pictures() {
        let picture = |w, h| RgbImage::from_pixel(w, h, Rgb([9; 3]));
        let strip = strip(&[picture(4, 10), picture(6, 4)], 2, [255; 3]);
        assert_eq!(strip.dimensions(), (12, 10));
        assert_eq!((strip.get_pixel(8, 0).0, strip.get_pixel(8, 5).0), ([255; 3], [9; 3]));
        assert_eq!(shrunk(&picture(400, 100), 200).dimensions(), (200, 50));
        assert_eq!(shrunk(&picture(40, 100), 200).dimensions(), (40, 100));
    }

    #[test]
    fn heat_grows_lighter_with_the_error() {
        let map = heat_map(&[0.0, 0.05, 0.1, 0.2, 9.0], 5, 1, 0.2);
        let light: Vec<u32> = map.pixels().map(|p| p.0.iter().map(|&c| u32::from(c)).sum()).collect();
        assert!(light.is_sorted() && light[0] < light[1] && light[2] < light[3], "{light:?}");
        assert_eq!(light[3], light[4]);
    }
}
