//! The captured motion in glTF's world.

use glam::{Mat3, Mat4, Quat, Vec3};

use crate::avatar::{AvatarModel, pose};
use crate::body::N_JOINTS;
use crate::math::median_f32;

/// A camera that looks up or down, or stands aslant, by more than this is levelled: the person's mean up becomes +Y. Who turns all the
/// way round leans to all sides, and the mean is right to a degree (13 fits with a level camera have 0.1° to 1.0°); who does not may lean.
const LEVEL_ABOVE_RADIANS: f32 = 8.0 * std::f32::consts::PI / 180.0;
const LEVEL_ABOVE_RADIANS_AFTER_A_TURN: f32 = 2.0 * std::f32::consts::PI / 180.0;
/// Between neighbouring headings of a turn.
const WIDEST_GAP_RADIANS: f32 = std::f32::consts::FRAC_PI_3;

/// Frames that decide where the ground is, at most.
const GROUND_FRAMES: usize = 16;

/// Keyframes of the joints.
pub(super) struct Motion {
    /// `[N]` seconds, the first is 0
    pub times: Vec<f32>,
    /// `[N, 3]`: position of the pelvis node
    pub root: Vec<[f32; 3]>,
    /// `[24][N, 4]`: x y z w, neighbours in one hemisphere
    pub rotations: Vec<Vec<[f32; 4]>>,
    pub gltf_from_world: Mat4,
}

/// # Panics
/// When the model has no frames.
pub(super) fn convert(model: &AvatarModel) -> Motion {
    let n = model.poses.len();
    assert!(n > 0, "an avatar has at least one frame");
    let turn = upright(model);
    let pelvis = Vec3::from(model.body.shaped_joints(&model.betas)[0]);
    let path: Vec<Vec3> = model.transl.iter().map(|&t| turn * (pelvis + Vec3::from(t))).collect();
    let centre = path.iter().sum::<Vec3>() / n as f32;
    let shift = Vec3::new(-centre.x, -ground(model, turn), -centre.z);

    let rotations = (0..N_JOINTS).map(|j| {
        let mut last = Quat::IDENTITY;
        let keys = model.poses.iter().map(|pose| {
            let local = pose::joint_rotation(pose, j);
            let q = if j == 0 { (turn * local).normalize() } else { local };
            last = if q.dot(last) < 0.0 { -q } else { q };
            last.to_array()
        });
        keys.collect()
    });
    Motion {
        times: model.times(),
        root: path.iter().map(|&p| (p + shift).to_array()).collect(),
        rotations: rotations.collect(),
        gltf_from_world: Mat4::from_rotation_translation(turn, shift),
    }
}

/// The rotation from the capture's world to +Y up: 180° about x where the world's y runs down, and the levelling of a
/// tilted camera.
fn upright(model: &AvatarModel) -> Quat {
    let ups = model.poses.iter().map(|p| pose::joint_rotation(p, 0) * Vec3::Y);
    let up = ups.sum::<Vec3>().try_normalize().unwrap_or(-Vec3::Y);
    let flip = if up.y < 0.0 { Quat::from_rotation_x(std::f32::consts::PI) } else { Quat::IDENTITY };
    let seen = flip * up;
    let most = if turns_round(model) { LEVEL_ABOVE_RADIANS_AFTER_A_TURN } else { LEVEL_ABOVE_RADIANS };
    if seen.angle_between(Vec3::Y) > most { Quat::from_rotation_arc(seen, Vec3::Y) * flip } else { flip }
}

/// Whether the frames show the person from all sides.
fn turns_round(model: &AvatarModel) -> bool {
    let heading = |p| {
        let ahead = pose::joint_rotation(p, 0) * Vec3::Z;
        ahead.x.atan2(ahead.z)
    };
    let mut headings: Vec<f32> = model.poses.iter().map(heading).collect();
    headings.sort_by(f32::total_cmp);
    let round = headings.iter().skip(1).copied().chain(headings.first().map(|first| first + std::f32::consts::TAU));
    headings.iter().zip(round).all(|(a, b)| b - a < WIDEST_GAP_RADIANS)
}

/// The height on which the feet stand: the median over frames of the lowest vertex.
fn ground(model: &AvatarModel, turn: Quat) -> f32 {
    let height = Mat3::from_quat(turn).row(1);
    let step = model.poses.len().div_ceil(GROUND_FRAMES);
    let lows = (0..model.poses.len()).step_by(step).map(|i| {
        let posed = model.posed(&model.poses[i], model.transl[i]);
        posed.vertices.iter().map(|&v| height.dot(Vec3::from(v))).fold(f32::INFINITY, f32::min)
    });
    median_f32(lows).expect("a model has frames")
}
