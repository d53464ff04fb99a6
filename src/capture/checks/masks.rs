//! Whether masks hold a person, and are masks at all.

use crate::capture::rectify::Rect;
use crate::capture::source::Picture;
use crate::capture::{BadInput, Part};
use crate::mask::{is_black, is_foreground};

/// The masks seen so far.
#[derive(Default)]
pub(in crate::capture) struct MaskCheck {
    frames: usize,
    /// The first frame without a person, and its number of foreground pixels.
    first_empty: Option<(usize, usize)>,
    empty: usize,
    brightest: u8,
    /// Frames whose border is foreground nearly all round, and the first of them.
    surrounded: usize,
    first_surrounded: Option<usize>,
    /// Frames in which much is neither foreground nor black.
    grey: usize,
    first_grey: Option<usize>,
    at_border: usize,
}

/// The part of a picture's border that no person covers.
const MOST_OF_THE_BORDER: f64 = 0.75;
/// Pixels between black and foreground, for each one of the foreground: soft edges of somebody small come to a third.
const MOST_GREY: f64 = 0.75;

const SURROUNDED: &str = "the person's pixels at 128 or more and all others below, best 255 and 0: masks that are inverted, or \
                          pictures of the person on a light background, are the other way round";
const PICTURES: &str = "the person's pixels at 128 or more and all others below 32, best 255 and 0: a person cut out on black is \
                        no mask, but one with transparency (PNG) is, and so are maps of labels that are exactly 0 elsewhere";

/// The part of the outermost pixels that is foreground.
fn border_covered(mask: &Picture) -> f64 {
    let (width, height) = (mask.width as usize, mask.height as usize);
    let (Some(first), Some(last)) = (mask.data.get(..width), mask.data.get(width * (height - 1)..)) else { return 0.0 };
    let sides = mask.data.chunks_exact(width).skip(1).take(height.saturating_sub(2)).flat_map(|r| [r[0], r[width - 1]]);
    let (mut set, mut count) = (0, 0);
    for value in first.iter().chain(last).copied().chain(sides) {
        (set, count) = (set + usize::from(is_foreground(value)), count + 1);
    }
    set as f64 / count as f64
}

impl MaskCheck {
    /// The bounding box of the foreground; `None` where there is (nearly) none: such a frame is left out, and if more than half
    /// are empty, that is an error at the end.
    pub fn look(&mut self, frame: usize, mask: &Picture) -> Option<Rect> {
        let (width, height) = (mask.width as usize, mask.height as usize);
        let (mut x0, mut x1, mut y0, mut y1, mut pixels) = (width, 0, height, 0, 0);
        for (y, row) in mask.data.chunks_exact(width).enumerate() {
            let Some(first) = row.iter().position(|&v| is_foreground(v)) else { continue };
            let last = row.iter().rposition(|&v| is_foreground(v)).unwrap_or(first);
            (x0, x1) = (x0.min(first), x1.max(last + 1));
            (y0, y1) = (y0.min(y), y + 1);
            pixels += row[first..=last].iter().filter(|&&v| is_foreground(v)).count();
        }
        self.frames += 1;
        // A speck is no person either.
        if pixels < (width * height / 20_000).max(4) {
            self.brightest = self.brightest.max(mask.data.iter().copied().max().unwrap_or(0));
            self.first_empty.get_or_insert((frame, pixels));
            self.empty += 1;
            return None;
        }
        if border_covered(mask) > MOST_OF_THE_BORDER {
            self.surrounded += 1;
            self.first_surrounded.get_or_insert(frame);
        }
        let grey = mask.data.iter().filter(|&&v| !is_black(v) && !is_foreground(v)).count();
        if grey as f64 > MOST_GREY * pixels as f64 {
            self.grey += 1;
            self.first_grey.get_or_insert(frame);
        }
        self.at_border += usize::from(x0 == 0 || y0 == 0 || x1 == width || y1 == height);
        Some(Rect { x0: x0 as u32, y0: y0 as u32, x1: x1 as u32, y1: y1 as u32 })
    }

    pub fn finish(&self, warnings: &mut Vec<String>) -> Result<(), BadInput> {
        let expected = "the person's pixels at 128 or more, best 255";
        if let Some((frame, pixels)) = self.first_empty {
            if self.empty == self.frames {
                let message =
                    format!("all {} masks are empty; their brightest pixel is {}", self.frames, self.brightest);
                return Err(BadInput::new(Part::Masks, message, expected));
            }
            let count = format!("{} of {}", self.empty, self.frames);
            if 2 * self.empty > self.frames {
                let message = format!("the mask is empty, {pixels} pixels are foreground; {count} masks are");
                return Err(BadInput::new(Part::Masks, message, expected).at(frame));
            }
            warnings.push(format!("masks: {count} are empty, the first of them {frame}: those frames are left out"));
        }
        for (count, first, what, expected) in [
            (self.surrounded, self.first_surrounded, "have the background as foreground", SURROUNDED),
            (self.grey, self.first_grey, "look like pictures: much of them is neither black nor foreground", PICTURES),
        ] {
            let Some(first) = first else { continue };
            let message = format!("{count} of {} {what}", self.frames);
            if 2 * count > self.frames {
                return Err(BadInput::new(Part::Masks, message, expected).at(first));
            }
            warnings.push(format!("masks: {message}, the first of them {first}"));
        }
        if self.at_border > 0 {
            let count = format!("{} of {}", self.at_border, self.frames);
            warnings.push(format!("masks: the person touches the image's border in {count} frames"));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::checks::testing::{BOUNDS, mask};

    #[test]
    fn the_box_of_a_mask() {
        let mut check = MaskCheck::default();
        assert_eq!(check.look(0, &mask()), Some(BOUNDS));
        assert!(check.finish(&mut Vec::new()).is_ok());
        let speck = Picture { width: 100, height: 80, data: vec![1; 8000] };
        assert_eq!(check.look(1, &speck), None);
        let mut warnings = Vec::new();
        check.finish(&mut warnings).unwrap();
        assert_eq!(warnings, ["masks: 1 of 2 are empty, the first of them 1: those frames are left out"]);
        assert_eq!(check.look(2, &speck), None);
        let error = check.finish(&mut Vec::new()).unwrap_err();
        assert_eq!(error.frame, Some(1));
    }

    #[test]
    fn masks_that_are_the_other_way_round_or_pictures_are_refused() {
        let looked = |change: &dyn Fn(usize, u8) -> u8, spoiled: usize| {
            let mut check = MaskCheck::default();
            for frame in 0..5 {
                let mut mask = mask();
                if frame >= 5 - spoiled {
                    mask.data.iter_mut().enumerate().for_each(|(i, v)| *v = change(i, *v));
                }
                check.look(frame, &mask);
            }
            let mut warnings = Vec::new();
            check.finish(&mut warnings).map(|()| warnings)
        };
        let inverted = |_, v: u8| 255 - v;
        // Half of the person is dark.
        let cut_out = |i: usize, v: u8| if is_foreground(v) { 90 + 60 * (i / 800 % 2) as u8 } else { 0 };
        for (change, told) in [
            (&inverted as &dyn Fn(usize, u8) -> u8, "have the background as foreground"),
            (&cut_out, "look like pictures: much of them is neither black nor foreground"),
        ] {
            assert_eq!(looked(change, 2).unwrap()[0], format!("masks: 2 of 5 {told}, the first of them 3"));
            let error = looked(change, 3).unwrap_err();
            assert_eq!((error.frame, error.message), (Some(2), format!("3 of 5 {told}")));
        }
        // A close-up, which three sides of the picture cut.
        let close = |i: usize, _| if (5..95).contains(&(i % 100)) && i / 100 > 20 { 255 } else { 0 };
        assert_eq!(looked(&close, 5).unwrap(), ["masks: the person touches the image's border in 5 of 5 frames"]);
        let edge = |i: usize| (37..63).contains(&(i % 100)) && (10..70).contains(&(i / 100));
        let soft = |i: usize, v: u8| if edge(i) { v.max(100) } else { v };
        assert_eq!(looked(&soft, 5).unwrap().len(), 0);
    }
}
