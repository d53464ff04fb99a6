//! What is done to a picture: parts of it, more pixels, a smaller mask.

use image::imageops::FilterType::CatmullRom;
use image::imageops::resize;
use image::{GrayImage, RgbImage};

use crate::camera::Camera;
use crate::capture::Frame;
use crate::fit::appearance::well_inside;
use crate::mask::{self, is_foreground};
use crate::ops::project::cpu::forward as project;

/// The square around the vertices of which `part` holds as the camera sees them, `margin` times as large as they need: left, top,
/// side; pixels of the whole image. `None` where none of them is before the camera.
pub fn square_around(
    camera: &Camera,
    vertices: &[[f32; 3]],
    part: impl Fn(usize) -> bool,
    margin: f32,
) -> Option<[f32; 3]> {
    let (view, screen) = project(camera, vertices);
    let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
    for v in (0..view.len()).filter(|&v| view[v][2] > 0.1 && part(v)) {
        (0..2).for_each(|i| (low[i], high[i]) = (low[i].min(screen[v][i]), high[i].max(screen[v][i])));
    }
    let side = margin * (high[0] - low[0]).max(high[1] - low[1]);
    side.is_finite().then(|| [0.5 * (low[0] + high[0] - side), 0.5 * (low[1] + high[1] - side), side])
}

/// The part of a picture in a square of the whole one; `None` where nothing of the person is in it.
pub(super) fn cut(picture: &Frame, [left, top, side]: [f32; 3]) -> Option<Frame> {
    let within = |low: f32, start: u32, size: u32| {
        let end = (low + side).ceil().clamp(start as f32, (start + size) as f32) as u32;
        let low = low.floor().clamp(start as f32, (start + size) as f32) as u32;
        (low - start, end - low)
    };
    let (x, width) = within(left, picture.x0, picture.width);
    let (y, height) = within(top, picture.y0, picture.height);
    let rows = |values: &[u8], channels: usize| -> Vec<u8> {
        let row = |r: u32| {
            let from = (r * picture.width + x) as usize * channels;
            &values[from..from + width as usize * channels]
        };
        (y..y + height).flat_map(row).copied().collect()
    };
    let mask = rows(&picture.mask, 1);
    let some = mask.iter().any(|&m| is_foreground(m));
    some.then(|| Frame {
        x0: picture.x0 + x,
        y0: picture.y0 + y,
        width,
        height,
        rgb: rows(&picture.rgb, 3),
        mask,
        keypoints: picture.keypoints.clone(),
        ..*picture
    })
}

/// Takes from a picture's mask what `part` of it shows, but for `seam` pixels at its border.
pub(super) fn take_out(picture: &mut Frame, part: &Frame, seam: u32) {
    let within = |start: u32, size: u32| start + seam..(start + size).saturating_sub(seam);
    for y in within(part.y0 - picture.y0, part.height) {
        for x in within(part.x0 - picture.x0, part.width) {
            picture.mask[(y * picture.width + x) as usize] = 0;
        }
    }
}

/// A picture with `times` as many pixels along each side; a mask's border lies where it lay.
pub(super) fn enlarge(picture: &Frame, times: u32) -> Frame {
    if times == 1 {
        return picture.clone();
    }
    let [x0, y0, width, height] = [picture.x0, picture.y0, picture.width, picture.height].map(|px| px * times);
    let (from, to) = ((picture.width, picture.height), (width, height));
    let rgb = RgbImage::from_raw(from.0, from.1, picture.rgb.clone()).map(|rgb| resize(&rgb, to.0, to.1, CatmullRom));
    let mask =
        GrayImage::from_raw(from.0, from.1, picture.mask.clone()).map(|mask| resize(&mask, to.0, to.1, CatmullRom));
    let (rgb, mask) = (rgb.unwrap_or_default().into_raw(), mask.unwrap_or_default().into_raw());
    let mask = mask.into_iter().map(mask::binary).collect();
    Frame { x0, y0, width, height, rgb, mask, keypoints: picture.keypoints.clone(), ..*picture }
}

/// Takes the outermost pixels off a picture's mask.
pub(super) fn shrink(picture: &mut Frame, pixels: u32) {
    for _ in 0..pixels {
        let before: Vec<[u8; 4]> = picture.mask.iter().map(|&mask| [0, 0, 0, mask]).collect();
        let inside = well_inside(&before, picture.width as usize);
        picture.mask = inside.map(|inside| if inside { 255 } else { 0 }).collect();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::detail::testing::picture;

    #[test]
    fn a_square_is_cut_where_the_picture_has_pixels() {
        let picture = picture(5, [10, 20, 6, 8]);
        let cut = |square| cut(&picture, square);
        let part = cut([11.2, 21.0, 2.5]).unwrap();
        assert_eq!((part.x0, part.y0, part.width, part.height, part.index), (11, 21, 3, 3, 5));
        assert_eq!(part.rgb[..3], picture.rgb[3 * 7..][..3]);
        assert_eq!(part.mask, [255; 9]);
        let corner = cut([4.0, 14.0, 8.0]).unwrap();
        assert_eq!((corner.x0, corner.y0, corner.width, corner.height), (10, 20, 2, 2));
        assert!(cut([100.0, 100.0, 5.0]).is_none());
    }

    #[test]
    fn a_part_is_taken_out_but_for_a_seam() {
        let mut picture = picture(5, [10, 20, 8, 8]);
        let part = cut(&picture, [9.0, 21.0, 6.0]).unwrap();
        assert_eq!((part.x0, part.y0, part.width, part.height), (10, 21, 5, 6));
        take_out(&mut picture, &part, 1);
        let gone: Vec<usize> = (0..64).filter(|&i| picture.mask[i] == 0).collect();
        let expected: Vec<usize> = (2..6).flat_map(|y| (1..4).map(move |x| 8 * y + x)).collect();
        assert_eq!(gone, expected);
        take_out(&mut picture, &part, 4);
        assert_eq!(picture.mask.iter().filter(|&&mask| mask == 0).count(), 12, "nothing but seam");
    }

    #[test]
    fn an_enlarged_picture_shows_the_same_at_the_same_place() {
        let mut picture = picture(3, [10, 20, 6, 8]);
        picture.rgb = (0..6 * 8).flat_map(|i| [20 * (i % 6) as u8, 10 * (i / 6) as u8, 7]).collect();
        picture.mask = (0..6 * 8).map(|i| if i % 6 < 3 { 255 } else { 0 }).collect();
        let large = enlarge(&picture, 2);
        assert_eq!((large.x0, large.y0, large.width, large.height, large.index), (20, 40, 12, 16, 3));
        // A ramp goes on between the pixels, whose centres lie at 0.5, 1.5, … and now at 0.25, 0.75, …
        let at = |x: usize, y: usize, channel: usize| i32::from(large.rgb[3 * (y * 12 + x) + channel]);
        assert!((at(5, 6, 0) - 45).abs() <= 1 && (at(6, 6, 0) - 55).abs() <= 1, "{} {}", at(5, 6, 0), at(6, 6, 0));
        assert!((at(5, 7, 1) - 33).abs() <= 1, "{}", at(5, 7, 1));
        assert!((0..12 * 16).all(|i| (large.mask[i] == 255) == (i % 12 < 6)));
    }

    #[test]
    fn masks_shrink_all_round() {
        let mut picture = picture(0, [0, 0, 7, 6]);
        shrink(&mut picture, 2);
        let inside: Vec<usize> = (0..42).filter(|&i| picture.mask[i] == 255).collect();
        assert_eq!(inside, [16, 17, 18, 23, 24, 25]);
    }
}
