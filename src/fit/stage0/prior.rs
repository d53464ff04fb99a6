//! What a standing, slowly turning person's pose is like before anything is seen: means, spreads, joint limits
//! and how fast each angle drifts.

use glam::DVec3;

use crate::body::N_JOINTS;
use crate::body::joints::{
    HEAD, LEFT_ANKLE, LEFT_ELBOW, LEFT_HIP, LEFT_KNEE, LEFT_SHOULDER, NECK, RIGHT_ANKLE, RIGHT_ELBOW, RIGHT_HIP,
    RIGHT_KNEE, RIGHT_SHOULDER,
};

/// One joint's prior, in its rotation vector's three components; radians.
#[derive(Clone, Copy, Debug)]
pub struct JointPrior {
    pub joint: usize,
    pub mean: DVec3,
    pub sigma: DVec3,
    /// Spread of the change over one unit of time (a hundredth of the clip). Where the clip begins and ends, keypoints' noise
    /// in depth is held by this alone (docs/lab/fit.md, "What the clip's ends take from stage 0").
    pub drift: f64,
    pub low: DVec3,
    pub high: DVec3,
}

/// Spread of the angles of an arm or a head that does something else than hang and look ahead, radians.
pub const FREE_SIGMA: f64 = 1.0;
/// Degrees of freedom of its changes: it gets there and back at once, and pays for it once. With as few as a head's arms would shake; a head is
/// held so firmly that it could not turn with more.
pub fn free_tail(joint: usize) -> f64 {
    if ARMS.contains(&joint) { 3.0 } else { 1.0 }
}

/// Axes that spread no more do not bend.
pub const HINGE_SIGMA: f64 = 0.02;
/// Softness of joint limits, radians.
pub const LIMIT_SIGMA: f64 = 0.03;
/// How far people sway about their stance, who turn slowly: standard deviation of the axis that moves most, radians (docs/lab/fit.md, "What
/// the clip's ends take from stage 0").
pub fn sway(joint: usize) -> f64 {
    match joint {
        LEFT_HIP | RIGHT_HIP | LEFT_KNEE | RIGHT_KNEE | LEFT_ANKLE | RIGHT_ANKLE => 0.02,
        NECK | HEAD => 0.04,
        LEFT_SHOULDER | RIGHT_SHOULDER => 0.06,
        LEFT_ELBOW | RIGHT_ELBOW => 0.07,
        // Root, spine, collars.
        _ => 0.013,
    }
}
/// Shoulders and elbows.
pub const ARMS: std::ops::RangeInclusive<usize> = LEFT_SHOULDER..=RIGHT_ELBOW;
/// Units of time after which a sway is forgotten.
pub const SWAY_TIME: f64 = 80.0;
/// How the root's tilt and place drift over one unit of time: radians, parts of the distance.
pub const TILT_DRIFT: f64 = 0.004;
pub const PELVIS_DRIFT: f64 = 0.003;
/// Change of the turn rate over one unit of time, radians a unit.
pub const TURN_DRIFT: f64 = 0.005;
/// Degrees of freedom of that: who stops and goes on does so at once, and pays for it once.
pub const TURN_TAIL: f64 = 4.0;
/// Spread of the body's up axis about the camera's, radians.
pub const UPRIGHT_SIGMA: f64 = 0.35;
/// The world's mean height of adults, metres: men 1.71, women 1.59 (NCD-RisC 2016, born in 1996). A body's mean shape need
/// not have it.
pub const ADULT_STATURE: f64 = 1.65;
/// Spread of the body's height about that, metres. Betas alone allow more; but what looks like a
/// child's proportions is more often clothes, shoes and hair.
pub const STATURE_SIGMA: f64 = 0.08;
/// The same where the height is given.
pub const MEASURED_SIGMA: f64 = 0.005;
/// Spread of fitted keypoint offsets, metres.
pub const OFFSET_SIGMA: f64 = 0.025;
/// The same where none is believed.
pub const NO_OFFSET_SIGMA: f64 = 0.0003;
/// Spread of what masks may change about them.
pub const SETTLED_OFFSET_SIGMA: f64 = 0.002;

#[derive(Clone, Debug)]
pub struct Prior {
    pub joints: Vec<JointPrior>,
}

impl Prior {
    /// An A-pose. Wrists, hands and toes stay at rest: no keypoint tells of them.
    pub fn standing() -> Self {
        let v = DVec3::new;
        let free = 4.0;
        let pair = |left: usize, mean: DVec3, sigma: DVec3, drift: f64, low: DVec3, high: DVec3| {
            let right = JointPrior {
                joint: left + 1,
                mean: v(mean.x, -mean.y, -mean.z),
                sigma,
                drift,
                low: v(low.x, -high.y, -high.z),
                high: v(high.x, -low.y, -low.z),
            };
            [JointPrior { joint: left, mean, sigma, drift, low, high }, right]
        };
        let middle = |joint: usize, sigma: DVec3, drift: f64| JointPrior {
            joint,
            mean: DVec3::ZERO,
            sigma,
            drift,
            low: DVec3::splat(-free),
            high: DVec3::splat(free),
        };
        let mut joints = vec![
            middle(3, v(0.05, 0.04, 0.04), 0.003),
            middle(6, v(0.05, 0.04, 0.04), 0.003),
            middle(9, v(0.05, 0.04, 0.04), 0.003),
            middle(12, v(0.08, 0.08, 0.06), 0.005),
            middle(15, v(0.12, 0.12, 0.08), 0.005),
        ];
        let any = (DVec3::splat(-free), DVec3::splat(free));
        // Hips: legs a little apart.
        joints.extend(pair(1, v(0.0, 0.0, 0.1), v(0.25, 0.1, 0.15), 0.0075, v(-2.0, -0.8, -0.5), v(0.6, 0.8, 0.9)));
        // Knees bend backwards only.
        joints.extend(pair(
            4,
            v(0.06, 0.0, 0.0),
            v(0.25, 0.02, 0.02),
            0.0075,
            v(-0.05, -free, -free),
            v(2.4, free, free),
        ));
        // Ankles hold the soles to the floor.
        joints.extend(pair(7, v(0.0, 0.0, -0.1), v(0.1, 0.06, 0.08), 0.005, any.0, any.1));
        joints.extend(pair(13, v(0.0, 0.0, 0.0), v(0.03, 0.04, 0.05), 0.003, any.0, any.1));
        // Shoulders: arms some 43° down; a twist only as far as bent elbows ask for it.
        joints.extend(pair(16, v(0.0, 0.0, -0.75), v(0.25, 0.3, 0.4), 0.035, v(-1.5, -2.0, -1.7), v(1.5, 1.2, 1.6)));
        // Elbows bend forwards only.
        joints.extend(pair(
            18,
            v(0.0, -0.25, 0.0),
            v(0.02, 0.3, 0.02),
            0.0175,
            v(-free, -2.6, -free),
            v(free, 0.05, free),
        ));
        joints.sort_by_key(|p| p.joint);
        Self { joints }
    }

    pub fn joints(&self) -> impl Iterator<Item = usize> {
        self.joints.iter().map(|p| p.joint)
    }

    /// The mean pose; joints without a prior are at rest.
    pub fn mean_pose(&self) -> [DVec3; N_JOINTS] {
        let mut theta = [DVec3::ZERO; N_JOINTS];
        for p in &self.joints {
            theta[p.joint] = p.mean;
        }
        theta
    }
}
