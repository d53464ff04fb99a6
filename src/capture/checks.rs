//! What is looked at in every frame: whether the mask holds a person, and whether keypoints and poses are that person's.

use super::keypoints::{Keypoints, Point};
use super::rectify::Rect;
use super::source::Picture;
use super::{BadInput, KnownPoses, Part};
use crate::camera::Camera;
use crate::mask::is_foreground;

/// The masks seen so far.
#[derive(Default)]
pub(super) struct MaskCheck {
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
/// From here on a value is no longer black: what compression leaves lies below.
const GREY: u8 = 32;
/// Pixels between black and foreground, for each one of the foreground: soft edges of somebody small come to a third.
const MOST_GREY: f64 = 0.75;

const SURROUNDED: &str = "the person's pixels at 128 or more and all others below, best 255 and 0: masks that are inverted, or \
                          pictures of the person on a light background, are the other way round";
const PICTURES: &str = "the person's pixels at 128 or more and all others below 32, best 255 and 0: a person cut out on black is \
                        no mask, but one with transparency (PNG) is";

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
        let grey = mask.data.iter().filter(|&&v| v >= GREY && !is_foreground(v)).count();
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

/// The keypoints seen so far.
#[derive(Default)]
pub(super) struct KeypointCheck {
    seen: usize,
    /// Frames with several people, none of them on the mask.
    beside: usize,
    off_mask: usize,
    outside: usize,
    /// Frames of which nobody but somebody else was told.
    strangers: Vec<usize>,
    /// Frames without anybody on the mask.
    nobody: Vec<usize>,
}

/// Somebody of whose confidence less lies on the mask, and whose points' box has less of the mask's box, is somebody else. A mask that lacks
/// much of its person still lies within that person.
const ON_MASK: f64 = 1.0 / 3.0;
const MASK_WITHIN: f64 = 0.5;

impl KeypointCheck {
    /// The points of the person on the mask: of several, the one with the most confidence there. Points far outside
    /// the image become unseen, and all of somebody who stands beside the mask; unseen points become zero.
    pub fn choose(&mut self, frame: usize, keypoints: &Keypoints, mask: &Picture, bounds: Rect) -> Vec<Point> {
        let mut best: Option<(f64, &Vec<Point>)> = None;
        let people = &keypoints.frames[frame];
        for person in people {
            let on_mask = person.iter().filter(|p| p[2] > 0.0 && is_near_foreground(mask, p));
            let score: f64 = on_mask.map(|p| p[2]).sum();
            // Whether a lone one is the right one is seen below.
            if (score > 0.0 || people.len() == 1) && best.is_none_or(|(most, _)| score > most) {
                best = Some((score, person));
            }
        }
        self.beside += usize::from(best.is_none() && people.len() > 1);
        let nobody = || vec![[0.0; 3]; keypoints.format.points];
        let mut points = best.map_or_else(nobody, |(_, person)| person.clone());
        let confidence: f64 = points.iter().map(|point| point[2]).sum();
        for point in &mut points {
            self.check(point, mask);
        }
        // In a detector's best person of each frame, a bystander comes in place of the one who is filmed.
        let off_mask = best.is_some_and(|(on_mask, _)| confidence > 0.0 && on_mask < ON_MASK * confidence);
        if off_mask && share_within(bounds, &points) < MASK_WITHIN {
            self.strangers.push(frame);
            points = nobody();
        } else if points.iter().all(|point| point[2] == 0.0) {
            self.nobody.push(frame);
        }
        points
    }

    fn check(&mut self, point: &mut Point, mask: &Picture) {
        if point[2] > 0.0 {
            self.seen += 1;
            let (width, height) = (f64::from(mask.width), f64::from(mask.height));
            let margin = 0.05 * width.max(height);
            let inside = |value: f64, side: f64| (-margin..=side + margin).contains(&value);
            if !inside(point[0], width) || !inside(point[1], height) {
                self.outside += 1;
                point[2] = 0.0;
            } else if !is_near_foreground(mask, point) {
                self.off_mask += 1;
            }
        }
        if point[2] == 0.0 {
            *point = [0.0; 3];
        }
    }

    pub fn finish(&self, warnings: &mut Vec<String>) -> Result<(), BadInput> {
        let expected = "pixels of the video's images, x from the left and y from the top, on the person of the masks";
        let Self { seen, beside, off_mask, outside, strangers, nobody } = self;
        if *seen == 0 && *beside > 0 {
            let message = "none of the people in any frame lies on the masks";
            return Err(BadInput::new(Part::Keypoints, message, expected));
        }
        if *seen == 0 {
            let message = "no point of any frame has a confidence above 0";
            return Err(BadInput::new(Part::Keypoints, message, "the confidence of each point, 0 only where not seen"));
        }
        if 2 * outside > *seen {
            let message = format!("{outside} of {seen} points lie far outside the images");
            return Err(BadInput::new(Part::Keypoints, message, expected));
        }
        if 2 * off_mask > seen - outside {
            let message = format!("{off_mask} of {seen} points lie off the masks");
            return Err(BadInput::new(Part::Keypoints, message, expected));
        }
        if *outside > 0 {
            warnings.push(format!("keypoints: {outside} points far outside the images are taken as not seen"));
        }
        if 5 * off_mask > *seen {
            warnings.push(format!("keypoints: {off_mask} of {seen} points lie off the masks"));
        }
        if let Some(first) = strangers.first() {
            let count = strangers.len();
            warnings.push(format!(
                "keypoints: in {count} frames, the first of them {first}, they are of somebody beside the mask: taken as not seen"
            ));
        }
        if let Some(first) = nobody.first() {
            let count = nobody.len();
            warnings.push(format!("keypoints: nobody is seen in {count} frames, the first of them {first}"));
        }
        Ok(())
    }
}

/// The part of a box that lies within the box of the seen points, and around it: joints lie inside of a body.
fn share_within(bounds: Rect, points: &[Point]) -> f64 {
    let range = |axis: usize| {
        let seen = points.iter().filter(|point| point[2] > 0.0).map(|point| point[axis]);
        seen.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)))
    };
    let ranges = [range(0), range(1)];
    let around = 0.1 * ranges.iter().map(|(low, high)| high - low).fold(0.0, f64::max);
    let overlap = |axis: usize, low: u32, high: u32| {
        let (first, last) = ranges[axis];
        ((last + around).min(f64::from(high)) - (first - around).max(f64::from(low))).max(0.0)
    };
    let area = f64::from(bounds.width()) * f64::from(bounds.height());
    overlap(0, bounds.x0, bounds.x1) * overlap(1, bounds.y0, bounds.y1) / area.max(1.0)
}

/// The known poses seen so far.
#[derive(Default)]
pub(super) struct PoseCheck {
    frames: usize,
    off: usize,
    first_off: Option<usize>,
}

impl PoseCheck {
    /// Whether the body lies where its mask is: before the camera, and in the picture no further from the mask's box
    /// than half the box (SMPL's `transl` is not quite the pelvis). A guessed camera tells only before from behind.
    pub fn look(&mut self, frame: usize, poses: &KnownPoses, camera: Option<&Camera>, bounds: Rect) {
        self.frames += 1;
        let place = poses.trans[frame].map(f64::from);
        let on = match camera {
            None => place[2] > 0.0,
            Some(camera) => pixel(camera, place).is_some_and(|[x, y]| {
                let slack = 0.5 * f64::from(bounds.width().max(bounds.height()));
                let within = |value: f64, low: u32, high: u32| {
                    (f64::from(low) - slack..=f64::from(high) + slack).contains(&value)
                };
                within(x, bounds.x0, bounds.x1) && within(y, bounds.y0, bounds.y1)
            }),
        };
        if !on {
            self.off += 1;
            self.first_off.get_or_insert(frame);
        }
    }

    pub fn finish(&self, warnings: &mut Vec<String>) -> Result<(), BadInput> {
        let Some(first) = self.first_off else { return Ok(()) };
        let message = format!("the body of {} of {} frames does not lie on its mask", self.off, self.frames);
        if 2 * self.off > self.frames {
            let expected = "places in metres in the camera's world: x right, y down, z forward for a camera without \
                            rotation and translation";
            return Err(BadInput::new(Part::Poses, message, expected).at(first));
        }
        warnings.push(format!("poses: {message}, the first of them {first}"));
        Ok(())
    }
}

/// Pixel of a place in the world, lens distortion left out; `None` behind the camera.
fn pixel(camera: &Camera, place: [f64; 3]) -> Option<[f64; 2]> {
    let seen = camera.view(place);
    (seen[2] > 0.0).then(|| camera.project(seen))
}

/// Whether there is foreground within 2 % of the image's longer side of a point.
fn is_near_foreground(mask: &Picture, point: &Point) -> bool {
    let (width, height) = (i64::from(mask.width), i64::from(mask.height));
    let radius = (width.max(height) / 50).max(3);
    // Casts saturate, so that absurd places are simply far away.
    let (x, y) = (point[0].floor() as i64, point[1].floor() as i64);
    let range = |centre: i64, side: i64| {
        centre.saturating_sub(radius).clamp(0, side) as usize..centre.saturating_add(radius + 1).clamp(0, side) as usize
    };
    let columns = range(x, width);
    let mut rows = range(y, height);
    rows.any(|row| {
        let start = row * width as usize;
        mask.data[start + columns.start..start + columns.end].iter().any(|&v| is_foreground(v))
    })
}

/// Coordinates in [0, 1] are a mistake that all other checks would call something else.
pub(super) fn check_not_normalised(keypoints: &Keypoints) -> Result<(), BadInput> {
    let seen = keypoints.frames.iter().flatten().flatten().filter(|point| point[2] > 0.0);
    let far = seen
        .map(|point| point[0].abs().max(point[1].abs()))
        .fold(None, |most: Option<f64>, far| Some(most.map_or(far, |most| most.max(far))));
    match far {
        Some(far) if far <= 2.0 => {
            let message = format!("no coordinate is above {far}: they seem to be fractions of the image");
            Err(BadInput::new(Part::Keypoints, message, "pixels of the video's images"))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::super::keypoint_formats::COCO17;
    use super::*;

    /// 100×80, foreground where 40 ≤ x < 60 and 10 ≤ y < 70.
    fn mask() -> Picture {
        let inside = |i: usize| (40..60).contains(&(i % 100)) && (10..70).contains(&(i / 100));
        let data = (0..100 * 80).map(|i| if inside(i) { 200 } else { 20 }).collect();
        Picture { width: 100, height: 80, data }
    }

    const BOUNDS: Rect = Rect { x0: 40, y0: 10, x1: 60, y1: 70 };

    fn people(people: Vec<Vec<Point>>) -> Keypoints {
        Keypoints { format: COCO17, given: COCO17, frames: vec![people], warnings: Vec::new() }
    }

    #[test]
    fn the_box_of_a_mask() {
        let mut check = MaskCheck::default();
        assert_eq!(check.look(0, &mask()), Some(Rect { x0: 40, y0: 10, x1: 60, y1: 70 }));
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

    #[test]
    fn somebody_beside_the_mask_is_not_seen() {
        let mut check = KeypointCheck::default();
        let mut person = vec![[50.0, 40.0, 0.9]; 17];
        assert_eq!(check.choose(0, &people(vec![person.clone()]), &mask(), BOUNDS), person);
        // Arms that a mask lacks are no reason.
        person[7..13].fill([10.0, 40.0, 0.9]);
        assert_eq!(check.choose(0, &people(vec![person.clone()]), &mask(), BOUNDS), person);
        // Nor is a mask that lacks nearly all of the person.
        let spread = |i: usize| [40.0 + (i % 3) as f64 * 10.0, 10.0 + 3.5 * i as f64, 0.9];
        let whole: Vec<Point> = (0..17).map(spread).collect();
        let mut shins = mask();
        shins.data[..100 * 62].fill(0);
        let below = Rect { y0: 62, ..BOUNDS };
        assert_eq!(check.choose(0, &people(vec![whole.clone()]), &shins, below), whole);
        person[..13].fill([10.0, 40.0, 0.9]);
        assert_eq!(check.choose(0, &people(vec![person]), &mask(), BOUNDS), vec![[0.0; 3]; 17]);
        let mut warnings = Vec::new();
        check.finish(&mut warnings).unwrap();
        let told =
            "keypoints: in 1 frames, the first of them 0, they are of somebody beside the mask: taken as not seen";
        assert_eq!(warnings.last().unwrap(), told);
        assert!(warnings[0].contains("of 68 points lie off the masks"), "{warnings:?}");
    }

    #[test]
    fn of_several_people_the_one_on_the_mask_is_taken() {
        let beside = vec![[10.0, 40.0, 1.0]; 17];
        let on = vec![[50.0, 40.0, 0.4]; 17];
        let mut check = KeypointCheck::default();
        let points = check.choose(0, &people(vec![beside.clone(), on.clone()]), &mask(), BOUNDS);
        assert_eq!(points, on);
        let points = check.choose(0, &people(vec![beside.clone(), beside]), &mask(), BOUNDS);
        assert_eq!(points, vec![[0.0; 3]; 17]);
        let mut warnings = Vec::new();
        check.finish(&mut warnings).unwrap();
        assert_eq!(warnings, ["keypoints: nobody is seen in 1 frames, the first of them 0"]);
        let mut check = KeypointCheck::default();
        check.choose(0, &people(vec![vec![[10.0, 40.0, 1.0]; 17]; 2]), &mask(), BOUNDS);
        let error = check.finish(&mut Vec::new()).unwrap_err();
        assert_eq!(error.message, "none of the people in any frame lies on the masks");
    }

    #[test]
    fn points_outside_become_unseen_and_most_points_off_the_mask_are_an_error() {
        let mut person = vec![[50.0, 40.0, 1.0]; 17];
        person[3] = [-3.0, 40.0, 1.0];
        person[4] = [1e300, -1e300, 1.0];
        let mut check = KeypointCheck::default();
        let points = check.choose(0, &people(vec![person]), &mask(), BOUNDS);
        assert_eq!((points[3], points[4]), ([-3.0, 40.0, 1.0], [0.0; 3]));
        let mut warnings = Vec::new();
        check.finish(&mut warnings).unwrap();
        assert_eq!(warnings, ["keypoints: 1 points far outside the images are taken as not seen"]);

        let mut check = KeypointCheck::default();
        check.choose(0, &people(vec![vec![[10.0, 40.0, 1.0]; 17]]), &mask(), BOUNDS);
        assert_eq!(check.finish(&mut Vec::new()).unwrap_err().message, "17 of 17 points lie off the masks");
    }

    #[test]
    fn a_body_behind_the_camera_or_off_the_mask_is_found() {
        let bounds = Rect { x0: 40, y0: 10, x1: 60, y1: 70 };
        let camera = crate::capture::calibration::guess(100, 80);
        let check = |place: [f32; 3], camera: Option<&Camera>| {
            let poses = KnownPoses { poses: vec![vec![0.0; 72]], trans: vec![place], is_pelvis: true, betas: None };
            let mut check = PoseCheck::default();
            check.look(0, &poses, camera, bounds);
            check.finish(&mut Vec::new())
        };
        assert_eq!(check([0.0, 0.1, 3.0], Some(&camera)), Ok(()));
        assert!(check([0.0, 0.1, -3.0], Some(&camera)).is_err());
        assert!(check([2.5, 0.1, 3.0], Some(&camera)).is_err());
        assert_eq!(check([2.5, 0.1, 3.0], None), Ok(()));
        // The same place as seen by a camera 3 m behind the world's origin, upside down.
        let rotation = [-1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0];
        let moved = Camera { rotation, translation: [0.0, 0.0, 3.0], ..camera };
        assert_eq!(check([0.0, -0.1, 0.0], Some(&moved)), Ok(()));
        let error = check([0.0, -0.1, -4.0], Some(&moved)).unwrap_err();
        assert_eq!(
            (error.frame, error.message.as_str()),
            (Some(0), "the body of 1 of 1 frames does not lie on its mask")
        );
    }

    #[test]
    fn fractions_are_recognised() {
        assert!(check_not_normalised(&people(vec![vec![[0.5, 0.9, 1.0]; 17]])).is_err());
        assert!(check_not_normalised(&people(vec![vec![[0.0, 0.0, 0.0]; 17]])).is_ok());
        assert!(check_not_normalised(&people(vec![vec![[0.5, 90.0, 1.0]; 17]])).is_ok());
    }
}
