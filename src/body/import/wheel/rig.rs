//! The original rig of 163 bones as SMPL's 24 joints: joints, weights and the way to the zero pose.

use std::collections::HashMap;

use glam::{DQuat, DVec3};

use super::archive::Wheel;
use super::base_mesh::BaseMesh;
use crate::body::import::{ImportError, bad};
use crate::body::{N_INFLUENCES, N_JOINTS, PARENTS};

pub(super) type Joints = [DVec3; N_JOINTS];

/// Influences of a vertex, the largest first; unused places hold joint 0 with weight 0.
pub(super) type Influences = ([u32; N_INFLUENCES], [f32; N_INFLUENCES]);

/// Cubes of the joints in the middle.
const MIDDLE: [(usize, &str); 6] =
    [(0, "pelvis"), (3, "spine-4"), (6, "spine-2"), (9, "spine-1"), (12, "neck"), (15, "head")];

/// Cubes of the left joints; the right ones follow them by one. "hand" is the wrist.
const SIDES: [(usize, &str); 7] =
    [(1, "upper-leg"), (4, "knee"), (7, "ankle"), (13, "clavicle"), (16, "shoulder"), (18, "elbow"), (20, "hand")];

/// Joints of a morphed base mesh in the modeller's rest pose; feet at the toes' base, hands at the knuckles.
pub(super) fn joints(mesh: &BaseMesh, vertices: &[[f32; 3]]) -> Result<Joints, ImportError> {
    let mut out = [DVec3::ZERO; N_JOINTS];
    for (joint, cube) in MIDDLE {
        out[joint] = mesh.cube(vertices, cube)?;
    }
    for (side, letter) in ["l", "r"].into_iter().enumerate() {
        for (joint, cube) in SIDES {
            out[joint + side] = mesh.cube(vertices, &format!("{letter}-{cube}"))?;
        }
        for toe in 1..=5 {
            out[10 + side] += mesh.cube(vertices, &format!("{letter}-toe-{toe}-1"))? / 5.0;
        }
        for finger in 2..=5 {
            out[22 + side] += mesh.cube(vertices, &format!("{letter}-finger-{finger}-1"))? / 4.0;
        }
    }
    Ok(out)
}

/// The joint that takes over a bone's weights.
fn joint_of_bone(bone: &str) -> u32 {
    let (stem, side) = match bone.split_once('.') {
        Some((stem, "R")) => (stem, 1),
        Some((stem, _)) => (stem, 0),
        None => (bone, 0),
    };
    let begins = |prefixes: &[&str]| prefixes.iter().any(|prefix| stem.starts_with(prefix));
    match stem {
        "root" | "spine05" | "pelvis" => 0,
        "spine04" | "spine03" => 3,
        "spine02" | "breast" => 6,
        "spine01" => 9,
        "foot" => 7 + side,
        "clavicle" | "shoulder01" => 13 + side,
        _ if begins(&["neck"]) => 12,
        _ if begins(&["upperleg"]) => 1 + side,
        _ if begins(&["lowerleg"]) => 4 + side,
        _ if begins(&["toe"]) => 10 + side,
        _ if begins(&["upperarm"]) => 16 + side,
        _ if begins(&["lowerarm"]) => 18 + side,
        _ if begins(&["wrist", "metacarpal"]) => 20 + side,
        _ if begins(&["finger"]) => 22 + side,
        // The face has some ninety bones.
        _ => 15,
    }
}

/// Weights of the base mesh's vertices on the 24 joints, cut to the four largest and scaled to sum to 1.
pub(super) fn weights(wheel: &mut Wheel, n_vertices: usize) -> Result<Vec<Influences>, ImportError> {
    #[derive(serde::Deserialize)]
    struct WeightFile {
        weights: HashMap<String, Vec<(usize, f64)>>,
    }
    let part = "weights.default.json";
    let json = wheel.data("mpfb2/rigs/standard/weights.default.json")?;
    let file: WeightFile = serde_json::from_slice(&json).map_err(|e| bad(part, e))?;
    let mut bones: Vec<_> = file.weights.into_iter().collect();
    // The map's order is random, and sums of floats depend on theirs.
    bones.sort_by(|a, b| a.0.cmp(&b.0));
    let mut dense = vec![[0.0; N_JOINTS]; n_vertices];
    for (bone, entries) in bones {
        let joint = joint_of_bone(&bone) as usize;
        for (vertex, weight) in entries {
            let row = dense.get_mut(vertex).ok_or_else(|| bad(part, format!("{bone} names vertex {vertex}")))?;
            row[joint] += weight;
        }
    }
    Ok(dense.iter().map(crate::body::import::prune_weights).collect())
}

/// How each joint turns from the rest pose to the zero pose (global rotations) and where it comes to lie.
pub(super) struct ZeroPose {
    pub rotations: [DQuat; N_JOINTS],
    pub joints: Joints,
}

/// The zero pose of a person: arms along ±X, legs along −Y, feet heading +Z with the pitch they were modelled with,
/// everything else as modelled, the pelvis at the origin.
///
/// A limb is straightened along its chain: each bone's rotation is its parent's, followed by the smallest that takes
/// the bone to its axis. (Smallest rotations bone by bone, without the parent's, would twist the forearms.)
pub(super) fn zero_pose(rest: &Joints) -> ZeroPose {
    let mut rotations = [DQuat::IDENTITY; N_JOINTS];
    for (side, outward) in [DVec3::X, DVec3::NEG_X].into_iter().enumerate() {
        let mut straighten = |chain: &[usize], axis: DVec3| {
            let mut turn = DQuat::IDENTITY;
            for bone in chain.windows(2) {
                let (from, to) = (bone[0] + side, bone[1] + side);
                let direction = (turn * (rest[to] - rest[from])).normalize();
                turn = (DQuat::from_rotation_arc(direction, axis) * turn).normalize();
                rotations[from] = turn;
            }
            turn
        };
        let hand = straighten(&[16, 18, 20, 22], outward);
        straighten(&[1, 4, 7], DVec3::NEG_Y);
        rotations[22 + side] = hand;
        let foot = rest[10 + side] - rest[7 + side];
        let heading = DQuat::from_rotation_y(-foot.x.atan2(foot.z));
        (rotations[7 + side], rotations[10 + side]) = (heading, heading);
    }
    let mut joints = [DVec3::ZERO; N_JOINTS];
    for joint in 1..N_JOINTS {
        let parent = PARENTS[joint] as usize;
        joints[joint] = joints[parent] + rotations[parent] * (rest[joint] - rest[parent]);
    }
    ZeroPose { rotations, joints }
}

/// Takes vertices from the rest pose to the zero pose. Half linear blending, half dual quaternions (Kavan et al.
/// 2007): the one loses volume where a joint turns, the other gains some.
pub(super) fn repose(
    vertices: &[[f32; 3]],
    influences: &[Influences],
    rest: &Joints,
    zero: &ZeroPose,
) -> Vec<[f32; 3]> {
    let shifts: Joints = std::array::from_fn(|j| zero.joints[j] - zero.rotations[j] * rest[j]);
    let duals: [DQuat; N_JOINTS] = std::array::from_fn(|j| {
        let shift = shifts[j] * 0.5;
        DQuat::from_xyzw(shift.x, shift.y, shift.z, 0.0) * zero.rotations[j]
    });
    let skin = |(point, (joints, weights)): (&[f32; 3], &Influences)| {
        let point = DVec3::from(point.map(f64::from));
        let (mut linear, mut real, mut dual) =
            (DVec3::ZERO, DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0), DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0));
        for (&joint, &weight) in joints.iter().zip(weights).filter(|(_, weight)| **weight > 0.0) {
            let (joint, weight) = (joint as usize, f64::from(weight));
            linear += weight * (zero.rotations[joint] * point + shifts[joint]);
            // No joint turns by more than a right angle here, so all quaternions lie in one hemisphere.
            real += zero.rotations[joint] * weight;
            dual += duals[joint] * weight;
        }
        let (dual, real) = (dual * real.length().recip(), real.normalize());
        let shift = dual * real.conjugate() * 2.0;
        let blended = real * point + DVec3::new(shift.x, shift.y, shift.z);
        ((linear + blended) * 0.5).to_array().map(|x| x as f32)
    };
    vertices.iter().zip(influences).map(skin).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A rest pose with bent, asymmetric limbs.
    fn rest() -> Joints {
        std::array::from_fn(|j| {
            let point = DVec3::from(crate::body::Body::test_body().j_template[j].map(f64::from));
            let j = j as f64;
            point + 0.05 * DVec3::new((3.1 * j).sin(), (1.7 * j).cos(), (2.3 * j).sin())
        })
    }

    #[test]
    fn limbs_lie_on_the_axes_and_bones_keep_their_length() {
        let rest = rest();
        let zero = zero_pose(&rest);
        let bone = |from: usize, to: usize| zero.joints[to] - zero.joints[from];
        for (side, outward) in [DVec3::X, DVec3::NEG_X].into_iter().enumerate() {
            for (from, to, axis) in [(16, 18, outward), (18, 20, outward), (20, 22, outward)] {
                assert!(bone(from + side, to + side).normalize().distance(axis) < 1e-9);
            }
            for (from, to) in [(1, 4), (4, 7)] {
                assert!(bone(from + side, to + side).normalize().distance(DVec3::NEG_Y) < 1e-9);
            }
            let foot = bone(7 + side, 10 + side);
            let modelled = rest[10 + side] - rest[7 + side];
            assert!(foot.x.abs() < 1e-9 && foot.z > 0.0 && (foot.y - modelled.y).abs() < 1e-9);
        }
        assert_eq!(zero.joints[0], DVec3::ZERO);
        for joint in 1..N_JOINTS {
            let parent = PARENTS[joint] as usize;
            let length = (rest[joint] - rest[parent]).length();
            assert!((bone(parent, joint).length() - length).abs() < 1e-9);
        }
    }

    #[test]
    fn a_vertex_on_one_joint_moves_rigidly_with_it() {
        let rest = rest();
        let zero = zero_pose(&rest);
        let point = [0.3f32, 0.5, 0.1];
        let out = repose(&[point], &[([18, 0, 0, 0], [1.0, 0.0, 0.0, 0.0])], &rest, &zero)[0];
        let expected = zero.joints[18] + zero.rotations[18] * (DVec3::from(point.map(f64::from)) - rest[18]);
        assert!(DVec3::from(out.map(f64::from)).distance(expected) < 1e-6);
    }

    #[test]
    fn bones_go_to_the_joint_that_moves_them() {
        let cases = [("spine05", 0), ("breast.R", 6), ("upperleg02.L", 1), ("lowerleg01.R", 5), ("toe3-2.R", 11)];
        let more = [("metacarpal2.L", 20), ("finger1-1.R", 23), ("orbicularis03.L", 15), ("shoulder01.R", 14)];
        for (bone, joint) in cases.into_iter().chain(more) {
            assert_eq!(joint_of_bone(bone), joint, "{bone}");
        }
    }
}
