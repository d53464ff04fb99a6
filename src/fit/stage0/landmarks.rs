//! What stage 0 knows of the points of a keypoint format.

pub use crate::keypoints::Part;
use crate::keypoints::{Side, partner, points_of};

/// Which limbs a detector swaps together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Group {
    Face,
    Arms,
    Legs,
}

pub const GROUPS: [Group; 3] = [Group::Face, Group::Arms, Group::Legs];

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Landmark {
    pub part: Part,
    /// +1 the person's left, −1 the right, 0 in the middle.
    pub side: f64,
    /// The same part on the other side; its own index in the middle.
    pub partner: usize,
}

/// Parts whose place differs between detectors, rigs and heads: their offsets on the body are fitted too. Those of limbs only
/// where a detector's habits are known: of an unknown one they would be told from lengths by nothing.
pub const N_OFFSETS: usize = 11;
/// The first of them: head, shoulders and hips, which every detector may place elsewhere.
pub const N_ALWAYS_FITTED: usize = 7;

impl Part {
    pub fn group(self) -> Group {
        match self {
            Part::Nose | Part::Eye | Part::Ear | Part::Neck => Group::Face,
            Part::Shoulder | Part::Elbow | Part::Wrist => Group::Arms,
            _ => Group::Legs,
        }
    }

    /// Information of one detection relative to a limb's. Hips and shoulders are placed elsewhere by detectors
    /// than by rigs; with their fitted offsets they still tell the facing.
    pub fn weight(self) -> f64 {
        match self {
            Part::Elbow | Part::Wrist | Part::Knee | Part::Ankle | Part::Nose => 1.0,
            Part::Eye | Part::Ear | Part::Shoulder | Part::Hip => 0.5,
            Part::Neck | Part::MidHip | Part::BigToe | Part::SmallToe | Part::Heel => 0.3,
        }
    }

    /// Which fitted offset the part has.
    pub fn offset(self) -> Option<usize> {
        match self {
            Part::Nose => Some(0),
            Part::Eye => Some(1),
            Part::Ear => Some(2),
            Part::Neck => Some(3),
            Part::Shoulder => Some(4),
            Part::MidHip => Some(5),
            Part::Hip => Some(6),
            Part::Elbow => Some(7),
            Part::Wrist => Some(8),
            Part::Knee => Some(9),
            Part::Ankle => Some(10),
            Part::BigToe | Part::SmallToe | Part::Heel => None,
        }
    }
}

/// The points of a format in its order, or `None` for a format we do not know.
pub fn landmarks(format: &str) -> Option<Vec<Landmark>> {
    let points = points_of(format)?;
    let landmark = |(k, &(part, side)): (usize, &(Part, Side))| {
        let side = match side {
            Side::Left => 1.0,
            Side::Middle => 0.0,
            Side::Right => -1.0,
        };
        Landmark { part, side, partner: partner(points, k) }
    };
    Some(points.iter().enumerate().map(landmark).collect())
}
