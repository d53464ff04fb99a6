//! Reference twin, of one frame.

use super::quaternion::{Quaternion, by_turn, by_vector};
use crate::ops::Real;
use crate::ops::linear::{Vector, accumulate, add, scale};

/// The skeleton, and which joints turn in space.
#[derive(Clone, Copy, Debug)]
pub struct Joints<'a> {
    /// `[J]`: −1 for the root, which comes first, an earlier joint elsewhere.
    pub parents: &'a [i32],
    /// `[J]`
    pub in_space: &'a [bool],
}

/// A posed frame.
struct Posed<T> {
    /// `[J]`: `exp(poses_j)`
    local: Vec<Quaternion<T>>,
    /// `[J]`
    poses: Vec<Vector<T>>,
}

/// The orientation in space of each joint, `[J]`.
pub fn orientations<T: Real>(joints: Joints<'_>, poses: &[Vector<T>]) -> Vec<Quaternion<T>> {
    let mut all: Vec<Quaternion<T>> = Vec::with_capacity(poses.len());
    for (&pose, &parent) in poses.iter().zip(joints.parents) {
        all.push(above(&all, parent).after(Quaternion::exp(pose)));
    }
    all
}

fn above<T: Real>(orientations: &[Quaternion<T>], parent: i32) -> Quaternion<T> {
    usize::try_from(parent).map_or_else(|_| Quaternion::identity(), |parent| orientations[parent])
}

impl<T: Real> Posed<T> {
    fn new(joints: Joints<'_>, start: &[Vector<T>], turns: &[Vector<T>]) -> Self {
        let began = orientations(joints, start);
        let mut now: Vec<Quaternion<T>> = Vec::with_capacity(start.len());
        let mut posed = Self { local: Vec::with_capacity(start.len()), poses: Vec::with_capacity(start.len()) };
        for (j, &parent) in joints.parents.iter().enumerate() {
            let above = above(&now, parent);
            let (local, pose) = if joints.in_space[j] {
                let local = above.inverse().after(began[j].after(Quaternion::exp(turns[j])));
                (local, local.log(Quaternion::exp(start[j])))
            } else {
                let pose = add(start[j], turns[j]);
                (Quaternion::exp(pose), pose)
            };
            now.push(above.after(local));
            posed.local.push(local);
            posed.poses.push(pose);
        }
        posed
    }
}

/// The pose `[J]`.
pub fn forward<T: Real>(joints: Joints<'_>, start: &[Vector<T>], turns: &[Vector<T>]) -> Vec<Vector<T>> {
    Posed::new(joints, start, turns).poses
}

/// Adds to `grad_turns [J]`, given `grad_pose [J]`.
///
/// From the leaves to the root: `by_orientation_j` is the gradient by a turn of `G_j` from the right. A pose in space changes by such a turn of its
/// own bone, and the other way round by a turn of its parent's; a relative one does not change, and hands on what its own
/// orientation moves.
pub fn backward<T: Real>(
    joints: Joints<'_>,
    start: &[Vector<T>],
    turns: &[Vector<T>],
    grad_pose: &[Vector<T>],
    grad_turns: &mut [Vector<T>],
) {
    let posed = Posed::new(joints, start, turns);
    let mut by_orientation = vec![[T::zero(); 3]; start.len()];
    for (j, &parent) in joints.parents.iter().enumerate().rev() {
        let moved = by_orientation[j];
        let handed_on = if joints.in_space[j] {
            let torque = by_turn(posed.poses[j], grad_pose[j]);
            accumulate(&mut grad_turns[j], by_vector(turns[j], add(moved, torque)));
            scale(-T::one(), torque)
        } else {
            accumulate(&mut grad_turns[j], add(grad_pose[j], by_vector(posed.poses[j], moved)));
            moved
        };
        if let Ok(parent) = usize::try_from(parent) {
            accumulate(&mut by_orientation[parent], posed.local[j].rotate(handed_on));
        }
    }
}
