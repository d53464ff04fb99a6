//! SMPL's joints: their order, their parents, their names.

/// Joints of every body, in SMPL's order.
pub const N_JOINTS: usize = 24;

/// Numbers of a pose: axis and angle of each joint.
pub const N_POSE: usize = 3 * N_JOINTS;

/// Parents of SMPL's joints; the root has none (−1).
pub const PARENTS: [i32; N_JOINTS] = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21];

/// SMPL's joint names.
pub const JOINT_NAMES: [&str; N_JOINTS] = [
    "pelvis",
    "left_hip",
    "right_hip",
    "spine1",
    "left_knee",
    "right_knee",
    "spine2",
    "left_ankle",
    "right_ankle",
    "spine3",
    "left_foot",
    "right_foot",
    "neck",
    "left_collar",
    "right_collar",
    "head",
    "left_shoulder",
    "right_shoulder",
    "left_elbow",
    "right_elbow",
    "left_wrist",
    "right_wrist",
    "left_hand",
    "right_hand",
];

pub const PELVIS: usize = 0;
pub const LEFT_HIP: usize = 1;
pub const RIGHT_HIP: usize = 2;
pub const SPINE1: usize = 3;
pub const LEFT_KNEE: usize = 4;
pub const RIGHT_KNEE: usize = 5;
pub const SPINE2: usize = 6;
pub const LEFT_ANKLE: usize = 7;
pub const RIGHT_ANKLE: usize = 8;
pub const SPINE3: usize = 9;
pub const LEFT_FOOT: usize = 10;
pub const RIGHT_FOOT: usize = 11;
pub const NECK: usize = 12;
pub const LEFT_COLLAR: usize = 13;
pub const RIGHT_COLLAR: usize = 14;
pub const HEAD: usize = 15;
pub const LEFT_SHOULDER: usize = 16;
pub const RIGHT_SHOULDER: usize = 17;
pub const LEFT_ELBOW: usize = 18;
pub const RIGHT_ELBOW: usize = 19;
pub const LEFT_WRIST: usize = 20;
pub const RIGHT_WRIST: usize = 21;
pub const LEFT_HAND: usize = 22;
pub const RIGHT_HAND: usize = 23;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_constant_is_the_joint_of_its_name() {
        let named = [
            (PELVIS, "pelvis"),
            (LEFT_HIP, "left_hip"),
            (RIGHT_HIP, "right_hip"),
            (SPINE1, "spine1"),
            (LEFT_KNEE, "left_knee"),
            (RIGHT_KNEE, "right_knee"),
            (SPINE2, "spine2"),
            (LEFT_ANKLE, "left_ankle"),
            (RIGHT_ANKLE, "right_ankle"),
            (SPINE3, "spine3"),
            (LEFT_FOOT, "left_foot"),
            (RIGHT_FOOT, "right_foot"),
            (NECK, "neck"),
            (LEFT_COLLAR, "left_collar"),
            (RIGHT_COLLAR, "right_collar"),
            (HEAD, "head"),
            (LEFT_SHOULDER, "left_shoulder"),
            (RIGHT_SHOULDER, "right_shoulder"),
            (LEFT_ELBOW, "left_elbow"),
            (RIGHT_ELBOW, "right_elbow"),
            (LEFT_WRIST, "left_wrist"),
            (RIGHT_WRIST, "right_wrist"),
            (LEFT_HAND, "left_hand"),
            (RIGHT_HAND, "right_hand"),
        ];
        assert_eq!(named.map(|(_, name)| name), JOINT_NAMES, "each once, in order");
        assert!(named.iter().enumerate().all(|(j, (joint, _))| *joint == j));
    }
}
