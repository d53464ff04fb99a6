//! The pose of one picture, refined against an avatar that stands otherwise as it is: shape, texture and light are not
//! touched. The picture is one that the fit has not seen; what remains then is the avatar's own error, without that of a pose
//! from elsewhere (another body's joints, another rest pose).

use std::sync::Arc;

use super::config::{FitConfig, Phase, Rates};
use super::scene::Scene;
use super::schedule::{Step, Work, decay};
use super::stage::StageWork;
use super::state::{FitState, Stage};
use super::{FitError, Inputs, check_finite, frames};
use crate::body::Body;
use crate::camera::Camera;
use crate::capture::{Capture, Frame};
use crate::gpu::Gpu;

/// Steps at half, then at full resolution.
const STEPS: [u32; 2] = [24, 24];

/// Rates of the pose, radians, and of the place, metres.
const POSE_RATE: f32 = 6e-3;
const PLACE_RATE: f32 = 4e-3;

/// Refines pose and place of a state with one frame, in which `picture` (its crop and mask) shows the person before
/// `camera`. Waits.
///
/// # Errors
/// [`FitError::Diverged`] where the pose is no longer finite.
///
/// # Panics
/// When the state has not one frame.
pub fn refine_pose(
    gpu: &Arc<Gpu>,
    body: &Body,
    camera: &Camera,
    picture: Frame,
    mut state: FitState,
    config: &FitConfig,
) -> Result<FitState, FitError> {
    assert_eq!(state.n_frames(), 1, "frames");
    state.stage = Stage::Texture;
    state.stage_poses.clone_from(&state.poses);
    state.stage_transl.clone_from(&state.transl);
    let config = &frozen(config);
    let capture = Capture {
        camera: camera.clone(),
        uploaded_side_px: camera.width.max(camera.height),
        camera_estimated: false,
        fps: 1.0,
        frames: vec![picture],
        keypoint_format: String::new(),
        given_keypoint_format: String::new(),
        poses: None,
        warnings: Vec::new(),
    };
    let levels = frames::upload(gpu, &capture, camera, STEPS.len(), config.white());
    let inputs = Inputs { body, capture: &capture, camera, config };
    let scene = Scene::new(gpu, &inputs, levels, &state.transl);
    // A phase is not started: that would solve the light anew from this very picture.
    let mut work = StageWork::new(&scene, &inputs, &state)?;
    work.cast_shadows()?;
    let phases: &[Phase] = &config.texture.phases;
    let all: u32 = STEPS.iter().sum();
    let mut number = 0;
    for (phase, steps) in phases.iter().zip(STEPS) {
        for _ in 0..steps {
            number += 1;
            work.step(&Step {
                phase,
                frames: &[0],
                trust: &[1.0],
                rate: decay(number, all, config.texture.rate_end),
                number,
            })?;
            state.step = number;
        }
    }
    work.read_into(&mut state)?;
    check_finite(&state)?;
    Ok(state)
}

/// `config` with nothing but poses to move, at half and at full resolution, and every pixel looked at.
fn frozen(config: &FitConfig) -> FitConfig {
    let mut config = config.clone().with_shape_standing();
    config.rates = Rates {
        betas: 0.0,
        pose: POSE_RATE,
        transl: PLACE_RATE,
        offsets: 0.0,
        face_colours: 0.0,
        texcoords: 0.0,
        field: 0.0,
    };
    config.pose_smoothing = 0.0;
    config.pixel_rate = 1.0;
    let [fine, coarse] = [config.geometry.phases.last(), config.geometry.phases.first()].map(|phase| phase.cloned());
    let phases = coarse.into_iter().map(|p| Phase { level: 1, ..p }).chain(fine.map(|p| Phase { level: 0, ..p }));
    config.texture.phases = phases.map(|phase| Phase { pose_rate: 1.0, rate: 1.0, offsets: false, ..phase }).collect();
    config
}
