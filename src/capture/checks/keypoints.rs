//! Whose keypoints they are, and whether they lie where the masks are.

use crate::capture::keypoints::{Keypoints, Point};
use crate::capture::rectify::Rect;
use crate::capture::source::Picture;
use crate::capture::{BadInput, Part};
use crate::mask::is_foreground;

/// The keypoints seen so far.
#[derive(Default)]
pub(in crate::capture) struct KeypointCheck {
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
pub(in crate::capture) fn check_not_normalised(keypoints: &Keypoints) -> Result<(), BadInput> {
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
    use super::*;
    use crate::capture::checks::testing::{BOUNDS, mask};
    use crate::capture::keypoint_formats::COCO17;

    fn people(people: Vec<Vec<Point>>) -> Keypoints {
        Keypoints { format: COCO17, given: COCO17, frames: vec![people], canvas: None, gap: None, warnings: Vec::new() }
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
    fn fractions_are_recognised() {
        assert!(check_not_normalised(&people(vec![vec![[0.5, 0.9, 1.0]; 17]])).is_err());
        assert!(check_not_normalised(&people(vec![vec![[0.0, 0.0, 0.0]; 17]])).is_ok());
        assert!(check_not_normalised(&people(vec![vec![[0.5, 90.0, 1.0]; 17]])).is_ok());
    }
}
