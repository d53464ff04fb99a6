//! Keypoint formats of the usual detectors, read off a body's joints and a few surface landmarks.

use super::joints::{
    LEFT_ANKLE, LEFT_ELBOW, LEFT_HIP, LEFT_KNEE, LEFT_SHOULDER, LEFT_WRIST, NECK, PELVIS, RIGHT_ANKLE, RIGHT_ELBOW,
    RIGHT_HIP, RIGHT_KNEE, RIGHT_SHOULDER, RIGHT_WRIST,
};
use super::{KeypointSet, KeypointSource};
use crate::keypoints::{FORMATS, Keypoint, Part, Side};
use KeypointSource::{Joint, Vertices};

/// Surface vertices that the detectors' formats need beside the joints; several vertices stand for their mean.
#[derive(Clone, Debug, PartialEq)]
pub struct Landmarks {
    pub nose: Vec<u32>,
    /// Left, right; as all pairs below.
    pub eyes: [Vec<u32>; 2],
    pub ears: [Vec<u32>; 2],
    pub big_toes: [Vec<u32>; 2],
    pub small_toes: [Vec<u32>; 2],
    pub heels: [Vec<u32>; 2],
}

impl Landmarks {
    /// The sets of [`FORMATS`]. Neck and mid-hip are SMPL's neck and pelvis.
    pub fn keypoint_sets(&self) -> Vec<KeypointSet> {
        let set = |(format, points): (&str, &[Keypoint])| KeypointSet {
            format: format.to_owned(),
            points: points.iter().map(|point| self.source(*point)).collect(),
        };
        FORMATS.map(set).into()
    }

    fn source(&self, (part, side): Keypoint) -> KeypointSource {
        let k = usize::from(side == Side::Right);
        let joint = |[left, right]: [usize; 2]| Joint([left, right][k] as u32);
        match part {
            Part::Nose => Vertices(self.nose.clone()),
            Part::Eye => Vertices(self.eyes[k].clone()),
            Part::Ear => Vertices(self.ears[k].clone()),
            Part::BigToe => Vertices(self.big_toes[k].clone()),
            Part::SmallToe => Vertices(self.small_toes[k].clone()),
            Part::Heel => Vertices(self.heels[k].clone()),
            Part::Neck => joint([NECK; 2]),
            Part::MidHip => joint([PELVIS; 2]),
            Part::Shoulder => joint([LEFT_SHOULDER, RIGHT_SHOULDER]),
            Part::Elbow => joint([LEFT_ELBOW, RIGHT_ELBOW]),
            Part::Wrist => joint([LEFT_WRIST, RIGHT_WRIST]),
            Part::Hip => joint([LEFT_HIP, RIGHT_HIP]),
            Part::Knee => joint([LEFT_KNEE, RIGHT_KNEE]),
            Part::Ankle => joint([LEFT_ANKLE, RIGHT_ANKLE]),
        }
    }
}
