//! Keypoint formats of the usual detectors, read off a body's joints and a few surface landmarks.

use super::{KeypointSet, KeypointSource};
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
    /// The sets `coco17`, `coco18` (OpenPose's 18 points) and `body25`. Neck and mid-hip are SMPL's neck and pelvis.
    pub fn keypoint_sets(&self) -> Vec<KeypointSet> {
        let point = |vertices: &Vec<u32>| Vertices(vertices.clone());
        let nose = point(&self.nose);
        let [left_eye, right_eye] = self.eyes.each_ref().map(point);
        let [left_ear, right_ear] = self.ears.each_ref().map(point);

        let mut coco17 = vec![nose.clone(), left_eye.clone(), right_eye.clone(), left_ear.clone(), right_ear.clone()];
        coco17.extend([16, 17, 18, 19, 20, 21, 1, 2, 4, 5, 7, 8].map(Joint));

        let face = [right_eye, left_eye, right_ear, left_ear];
        let mut coco18 = vec![nose.clone()];
        coco18.extend([12, 17, 19, 21, 16, 18, 20, 2, 5, 8, 1, 4, 7].map(Joint));
        coco18.extend(face.clone());

        let mut body25 = vec![nose];
        body25.extend([12, 17, 19, 21, 16, 18, 20, 0, 2, 5, 8, 1, 4, 7].map(Joint));
        body25.extend(face);
        for side in 0..2 {
            body25.extend([&self.big_toes[side], &self.small_toes[side], &self.heels[side]].map(point));
        }

        [("coco17", coco17), ("coco18", coco18), ("body25", body25)]
            .map(|(format, points)| KeypointSet { format: format.to_owned(), points })
            .into()
    }
}
