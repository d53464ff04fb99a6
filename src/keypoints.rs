//! The keypoint formats that a fit sees: which points they have, in which order.

use Part::{Ankle, BigToe, Ear, Elbow, Eye, Heel, Hip, Knee, MidHip, Neck, Nose, Shoulder, SmallToe, Wrist};
use Side::{Left, Middle, Right};

/// A place on the body that detectors look for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    Nose,
    Eye,
    Ear,
    Neck,
    Shoulder,
    Elbow,
    Wrist,
    MidHip,
    Hip,
    Knee,
    Ankle,
    BigToe,
    SmallToe,
    Heel,
}

/// The person's own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    Left,
    Middle,
    Right,
}

pub type Keypoint = (Part, Side);

/// COCO's.
pub const COCO17: [Keypoint; 17] = [
    (Nose, Middle),
    (Eye, Left),
    (Eye, Right),
    (Ear, Left),
    (Ear, Right),
    (Shoulder, Left),
    (Shoulder, Right),
    (Elbow, Left),
    (Elbow, Right),
    (Wrist, Left),
    (Wrist, Right),
    (Hip, Left),
    (Hip, Right),
    (Knee, Left),
    (Knee, Right),
    (Ankle, Left),
    (Ankle, Right),
];

/// OpenPose's 18 points.
pub const COCO18: [Keypoint; 18] = [
    (Nose, Middle),
    (Neck, Middle),
    (Shoulder, Right),
    (Elbow, Right),
    (Wrist, Right),
    (Shoulder, Left),
    (Elbow, Left),
    (Wrist, Left),
    (Hip, Right),
    (Knee, Right),
    (Ankle, Right),
    (Hip, Left),
    (Knee, Left),
    (Ankle, Left),
    (Eye, Right),
    (Eye, Left),
    (Ear, Right),
    (Ear, Left),
];

/// OpenPose's 25 points.
pub const BODY25: [Keypoint; 25] = [
    (Nose, Middle),
    (Neck, Middle),
    (Shoulder, Right),
    (Elbow, Right),
    (Wrist, Right),
    (Shoulder, Left),
    (Elbow, Left),
    (Wrist, Left),
    (MidHip, Middle),
    (Hip, Right),
    (Knee, Right),
    (Ankle, Right),
    (Hip, Left),
    (Knee, Left),
    (Ankle, Left),
    (Eye, Right),
    (Eye, Left),
    (Ear, Right),
    (Ear, Left),
    (BigToe, Left),
    (SmallToe, Left),
    (Heel, Left),
    (BigToe, Right),
    (SmallToe, Right),
    (Heel, Right),
];

/// The formats by their names. Wider ones are read as body25.
pub const FORMATS: [(&str, &[Keypoint]); 3] = [("coco17", &COCO17), ("coco18", &COCO18), ("body25", &BODY25)];

/// The points of a format in its order, or `None` for one that a fit does not see.
pub fn points_of(format: &str) -> Option<&'static [Keypoint]> {
    FORMATS.into_iter().find(|(name, _)| *name == format).map(|(_, points)| points)
}

/// Where a format has a point.
pub fn index_of(points: &[Keypoint], point: Keypoint) -> Option<usize> {
    points.iter().position(|p| *p == point)
}

/// The same part on the other side; the point's own index in the middle.
pub fn partner(points: &[Keypoint], k: usize) -> usize {
    let (part, side) = points[k];
    index_of(points, (part, side.other())).unwrap_or(k)
}

impl Side {
    pub const fn other(self) -> Self {
        match self {
            Left => Right,
            Middle => Middle,
            Right => Left,
        }
    }
}

impl Part {
    /// Of an arm or a leg, its root among it.
    pub const fn is_of_limb(self) -> bool {
        matches!(self, Shoulder | Elbow | Wrist | Hip | Knee | Ankle)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_point_is_there_once_and_has_its_partner() {
        for (format, points) in FORMATS {
            assert_eq!(points_of(format), Some(points));
            for (k, (part, side)) in points.iter().enumerate() {
                assert_eq!(index_of(points, points[k]), Some(k), "{format}");
                let other = partner(points, k);
                assert_eq!((points[other], other == k), ((*part, side.other()), *side == Middle), "{format}");
            }
            assert_eq!(points.iter().filter(|(part, _)| part.is_of_limb()).count(), 12, "{format}");
        }
        assert_eq!(points_of("halpe26"), None);
    }
}
