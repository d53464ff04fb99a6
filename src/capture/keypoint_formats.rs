//! Conventions of 2D keypoints, and how those with more points than a fit looks at are read.

use super::keypoints::Point;
use crate::keypoints as order;

/// A convention of keypoints.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Format {
    pub name: &'static str,
    pub points: usize,
    /// `[25]`: which of its points are body25's; [`NONE`] where it has none. `None` for a format that is used as it is.
    as_body25: Option<&'static [usize; 25]>,
}

const NONE: usize = usize::MAX;

pub(super) const COCO17: Format = Format { name: "coco17", points: order::COCO17.len(), as_body25: None };
pub(super) const COCO18: Format = Format { name: "coco18", points: order::COCO18.len(), as_body25: None };
pub(super) const BODY25: Format = Format { name: "body25", points: order::BODY25.len(), as_body25: None };
/// BlazePose's, which MediaPipe gives. It has no small toes; the hands' and most of the face's points are not used.
const MEDIAPIPE33: Format = Format {
    name: "mediapipe33",
    points: 33,
    as_body25: Some(&[
        0, NONE, 12, 14, 16, 11, 13, 15, NONE, 24, 26, 28, 23, 25, 27, 5, 2, 8, 7, 31, NONE, 29, 32, NONE, 30,
    ]),
};
/// Halpe-FullBody's body and feet, which AlphaPose and RTMPose give.
const HALPE26: Format = Format {
    name: "halpe26",
    points: 26,
    as_body25: Some(&[0, 18, 6, 8, 10, 5, 7, 9, 19, 12, 14, 16, 11, 13, 15, 2, 1, 4, 3, 20, 22, 24, 21, 23, 25]),
};
/// COCO-WholeBody: coco17, six points of the feet, then face and hands, which are not used.
const WHOLEBODY133: Format = Format {
    name: "wholebody133",
    points: 133,
    as_body25: Some(&[0, NONE, 6, 8, 10, 5, 7, 9, NONE, 12, 14, 16, 11, 13, 15, 2, 1, 4, 3, 17, 18, 19, 20, 21, 22]),
};

const ALL: [Format; 6] = [COCO17, COCO18, BODY25, HALPE26, MEDIAPIPE33, WHOLEBODY133];

/// All names, for messages.
pub(super) const NAMES: &str = "coco17, coco18, body25, halpe26, mediapipe33 or wholebody133";

impl Format {
    /// By its name, whatever its case, hyphens and underscores.
    pub fn named(name: &str) -> Option<Self> {
        let plain: String = name.chars().filter(char::is_ascii_alphanumeric).map(|c| c.to_ascii_lowercase()).collect();
        let plain = match plain.as_str() {
            "mediapipe" | "blazepose" | "blazepose33" => MEDIAPIPE33.name,
            "cocowholebody" | "cocowholebody133" => WHOLEBODY133.name,
            other => other,
        };
        ALL.into_iter().find(|format| format.name == plain)
    }

    /// The one with this number of points, which differ.
    pub fn of_count(points: usize) -> Option<Self> {
        ALL.into_iter().find(|format| format.points == points)
    }

    /// The format that a fit sees: this one, or body25.
    pub fn used(self) -> Self {
        if self.as_body25.is_some() { BODY25 } else { self }
    }

    /// A person's points in [`Format::used`]; body25's that this format lacks are unseen.
    pub fn to_used(self, person: Vec<Point>) -> Vec<Point> {
        match self.as_body25 {
            Some(from) => from.iter().map(|&k| person.get(k).copied().unwrap_or([0.0; 3])).collect(),
            None => person,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_match_without_case_and_hyphens() {
        for name in ["coco17", "COCO-17", "coco_17"] {
            assert_eq!(Format::named(name), Some(COCO17));
        }
        assert_eq!(Format::named("BODY_25"), Some(BODY25));
        assert_eq!(Format::named("BlazePose"), Some(MEDIAPIPE33));
        assert_eq!(Format::named("COCO-WholeBody"), Some(WHOLEBODY133));
        assert_eq!(Format::named("coco19"), None);
        assert!(
            ALL.iter().all(|format| NAMES.contains(format.name) && Format::of_count(format.points) == Some(*format))
        );
    }

    /// `left_big_toe`
    fn name((part, side): order::Keypoint) -> String {
        let mut name = match side {
            order::Side::Middle => String::new(),
            side => format!("{side:?}").to_lowercase(),
        };
        for c in format!("{part:?}").chars() {
            if c.is_uppercase() && !name.is_empty() {
                name.push('_');
            }
            name.push(c.to_ascii_lowercase());
        }
        name
    }

    /// The names as MediaPipe, Halpe-FullBody and COCO-WholeBody document them, against those of body25's points.
    #[test]
    fn points_of_wider_formats_are_what_body25_calls_them() {
        let mediapipe = "nose left_eye_inner left_eye left_eye_outer right_eye_inner right_eye right_eye_outer left_ear right_ear \
            mouth_left mouth_right left_shoulder right_shoulder left_elbow right_elbow left_wrist right_wrist left_pinky \
            right_pinky left_index right_index left_thumb right_thumb left_hip right_hip left_knee right_knee left_ankle \
            right_ankle left_heel right_heel left_big_toe right_big_toe";
        let coco = order::COCO17.map(name).join(" ");
        let halpe = format!(
            "{coco} head neck mid_hip left_big_toe right_big_toe left_small_toe right_small_toe left_heel right_heel"
        );
        let feet = "left_big_toe left_small_toe left_heel right_big_toe right_small_toe right_heel";
        let whole = format!("{coco} {feet}{}", " other".repeat(110));
        for (format, names) in [(MEDIAPIPE33, mediapipe), (HALPE26, &halpe), (WHOLEBODY133, &whole)] {
            let names: Vec<&str> = names.split_whitespace().collect();
            assert_eq!(names.len(), format.points, "{}", format.name);
            let person = (0..format.points).map(|k| [k as f64, 0.0, 1.0]).collect();
            let used = format.to_used(person);
            for (point, want) in used.iter().zip(order::BODY25.map(name)) {
                match names.iter().position(|name| *name == want) {
                    Some(k) => assert_eq!(*point, [k as f64, 0.0, 1.0], "{}: {want}", format.name),
                    None => assert_eq!(*point, [0.0; 3], "{}: {want}", format.name),
                }
            }
            assert_eq!((format.used(), used.len()), (BODY25, 25));
        }
    }
}
