//! Masks that are maps of labels: tools that tell parts of the body or of the clothes apart write each pixel's part, in colours
//! or as small numbers, and 0, black, for all that is nobody. Masks of 0 and 1 are the least of them.

use image::{DynamicImage, RgbImage};

use crate::mask::is_black;

/// More parts than any such tool tells apart.
const MOST_LABELS: usize = 64;
/// Of a map's pixels so many continue to the right with the same label: noise in what should be black does not.
const FLAT: f64 = 0.8;

/// What one picture tells of how masks are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Labels,
    /// A matte, a picture, anything else
    Other,
    /// Black all over, as both have it where nobody is
    Black,
}

impl Kind {
    pub fn of(image: &DynamicImage) -> Self {
        if image.color().has_alpha() {
            return Self::Other;
        }
        let image = numbers(image);
        let mut labels: Vec<[u8; 3]> = Vec::new();
        let (mut set, mut flat, mut black) = (0, 0, false);
        for row in image.rows() {
            let mut before = [0; 3];
            for pixel in row {
                let here = pixel.0;
                (black, set) = (black || here == [0; 3], set + usize::from(here != [0; 3]));
                flat += usize::from(here != [0; 3] && is_alike(here, before));
                if here != before && here != [0; 3] && !labels.contains(&here) {
                    if labels.len() == MOST_LABELS {
                        return Self::Other;
                    }
                    labels.push(here);
                }
                before = here;
            }
        }
        let is_coloured = labels.iter().any(is_coloured);
        let is_dark = labels.iter().flatten().all(|&value| is_black(value));
        match (set, black && flat as f64 > FLAT * set as f64 && (is_coloured || is_dark)) {
            (0, _) => Self::Black,
            (_, true) => Self::Labels,
            (_, false) => Self::Other,
        }
    }
}

/// The image's own numbers. Those of 16 bits are labels only where 8 bits would do.
fn numbers(image: &DynamicImage) -> RgbImage {
    match image {
        DynamicImage::ImageLuma16(wide) if wide.iter().all(|&value| value < 256) => {
            let narrow = wide.iter().flat_map(|&value| [value as u8; 3]).collect();
            RgbImage::from_raw(wide.width(), wide.height(), narrow).expect("as many numbers")
        }
        other => other.to_rgb8(),
    }
}

fn is_coloured([r, g, b]: &[u8; 3]) -> bool {
    r != g || g != b
}

/// Whether two pixels have one label. Renderers round a colour up here and down there; of numbers each is its own.
fn is_alike(a: [u8; 3], b: [u8; 3]) -> bool {
    a == b || is_coloured(&a) && a.iter().zip(b).all(|(a, b)| a.abs_diff(b) <= 1)
}

/// The mask in a map: whatever has a label.
pub(super) fn mask(image: &DynamicImage) -> Vec<u8> {
    numbers(image).pixels().map(|pixel| if pixel.0 == [0; 3] { 0 } else { 255 }).collect()
}

#[cfg(test)]
mod tests {
    use image::{GrayImage, Rgb, RgbaImage};

    use super::*;

    /// A person of two parts in the middle.
    fn painted(parts: [Rgb<u8>; 2]) -> DynamicImage {
        let paint = |x: u32, y: u32| match (20..40).contains(&x) {
            true => parts[usize::from(y > 30)],
            false => Rgb([0; 3]),
        };
        RgbImage::from_fn(60, 60, paint).into()
    }

    #[test]
    fn colours_that_were_rounded_are_labels() {
        let paint =
            |x: u32, y: u32| if (20..40).contains(&x) { Rgb([254 + (x + y) as u8 % 2, 85, 0]) } else { Rgb([0; 3]) };
        assert_eq!(Kind::of(&RgbImage::from_fn(60, 60, paint).into()), Kind::Labels);
    }

    #[test]
    fn maps_are_told_from_mattes_and_pictures() {
        let grey = |value| Rgb([value; 3]);
        for parts in [[grey(1), grey(1)], [grey(5), grey(19)], [Rgb([255, 85, 0]), Rgb([0, 85, 85])]] {
            let map = painted(parts);
            assert_eq!(Kind::of(&map), Kind::Labels, "{parts:?}");
            let set = mask(&map).chunks(60).flatten().filter(|&&value| value == 255).count();
            assert_eq!((set, mask(&map)[0]), (20 * 60, 0));
        }
        let wide = image::ImageBuffer::from_fn(60, 60, |x, _| image::Luma([u16::from((20..40).contains(&x))]));
        let wide = DynamicImage::ImageLuma16(wide);
        assert_eq!((Kind::of(&wide), mask(&wide)[30], mask(&wide)[0]), (Kind::Labels, 255, 0));
        for parts in [[grey(255), grey(255)], [grey(60), grey(200)]] {
            assert_eq!(Kind::of(&painted(parts)), Kind::Other, "{parts:?}");
        }
        assert_eq!(Kind::of(&GrayImage::new(60, 60).into()), Kind::Black);
        // What is left of a matte where nobody is, somebody cut out on black, and what has transparency.
        let faint = GrayImage::from_fn(60, 60, |x, y| image::Luma([(x * 7 + y * 13) as u8 % 5]));
        assert_eq!(Kind::of(&faint.into()), Kind::Other);
        let shaded = |x: u32, y: u32| if (20..40).contains(&x) { Rgb([x as u8 * 4, y as u8 * 3, 9]) } else { grey(0) };
        assert_eq!(Kind::of(&RgbImage::from_fn(60, 60, shaded).into()), Kind::Other);
        assert_eq!(Kind::of(&RgbaImage::from_pixel(60, 60, image::Rgba([9, 9, 9, 255])).into()), Kind::Other);
        // A label everywhere is no map of somebody.
        assert_eq!(Kind::of(&RgbImage::from_pixel(60, 60, Rgb([1; 3])).into()), Kind::Other);
    }
}
