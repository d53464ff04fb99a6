//! The fit of a body and its looks to a clip (paper §3): stage 0 on the CPU finds poses and shape from keypoints and
//! masks, stage 1 on the device fits geometry with one colour a face, stage 2 the hash texture and, where the
//! configuration has it so, the geometry through it.

mod appearance;
pub mod bundle;
mod checkpointed;
pub mod config;
mod control;
pub mod covered;
pub mod detail;
mod frame_step;
mod frames;
pub mod gains;
mod groups;
mod keypoint_term;
mod losses;
mod mesh_losses;
mod motion;
pub mod pelvis;
mod poses;
mod refine;
mod scene;
mod schedule;
mod shape;
mod silhouette;
pub mod skirt;
mod soft;
mod stage;
pub mod stage0;
mod state;

use std::path::Path;
use std::sync::Arc;

pub use config::{FitConfig, Phase};
pub use control::{Control, Flow, StepReport};
pub use refine::refine_pose;
pub use state::{FitState, Stage, Texels};

use crate::body::Body;
use crate::camera::Camera;
use crate::capture::Capture;
use crate::gpu::{Gpu, GpuError};
use crate::npz::NpzError;
use appearance::{Lit, solve_face_colours};
use poses::PoseGroups;
use scene::Scene;
use schedule::{Outside, Step, Work};
use shape::Shape;
use stage::StageWork;

/// Why a fit did not end.
#[derive(Debug, thiserror::Error)]
pub enum FitError {
    /// [`Control::after_step`] said so; the last checkpoint stands.
    #[error("the fit was stopped")]
    Stopped,
    /// A parameter or a loss is no longer finite.
    #[error("the fit diverged in step {step} of the {stage:?} stage")]
    Diverged { stage: Stage, step: u32, losses: std::collections::BTreeMap<&'static str, f32> },
    #[error(transparent)]
    Device(#[from] GpuError),
    #[error("texture field: {0}")]
    Field(#[from] crate::ops::texture_field::TextureFieldError),
    #[error("checkpoint: {0}")]
    Checkpoint(#[from] NpzError),
}

/// What a fit reads.
#[derive(Clone, Copy)]
pub struct Inputs<'a> {
    pub body: &'a Body,
    pub capture: &'a Capture,
    /// Stage 0's: the clip's own may lack its focal length.
    pub camera: &'a Camera,
    pub config: &'a FitConfig,
}

/// Runs stages 1 and 2 from `state` on. The state of every checkpoint goes to `checkpoint`.
pub fn run(
    gpu: &Arc<Gpu>,
    inputs: &Inputs<'_>,
    mut state: FitState,
    checkpoint: &Path,
    control: &mut dyn Control,
) -> Result<FitState, FitError> {
    if state.stage == Stage::Done {
        return Ok(state);
    }
    let FitConfig { geometry, texture, .. } = inputs.config;
    let to_come = if state.stage == Stage::Geometry { &geometry.phases[..] } else { &[] };
    let n_levels = to_come.iter().chain(&texture.phases).map(|p| p.level + 1).max().unwrap_or(1);
    let frames = frames::upload(gpu, inputs.capture, inputs.camera, n_levels, inputs.config.white());
    if state.run_transl.is_empty() {
        state.run_transl.clone_from(&state.transl);
    }
    let scene = Scene::new(gpu, inputs, frames, &state.run_transl);
    let mut outside = Outside { checkpoint, control };
    for (stage, next) in [(Stage::Geometry, Stage::Texture), (Stage::Texture, Stage::Done)] {
        if state.stage == stage {
            run_stage(&scene, inputs, &mut state, &mut outside)?;
            outside.control.look(&state);
            state.stage = next;
            state.step = 0;
            if next == Stage::Done {
                state.run_transl.clear();
            }
            state.save(checkpoint)?;
        }
    }
    Ok(state)
}

/// Hands `with` a call that records and submits one step of `state.stage` on `frames` in `phase`, as [`run`] takes them but for
/// the learning rates, which are zero: every step finds the same scene. Does not wait. For measurements.
pub fn with_step<R>(
    gpu: &Arc<Gpu>,
    inputs: &Inputs<'_>,
    state: &FitState,
    phase: &Phase,
    frames: &[usize],
    with: impl FnOnce(&mut dyn FnMut() -> Result<(), FitError>) -> Result<R, FitError>,
) -> Result<R, FitError> {
    let levels = frames::upload(gpu, inputs.capture, inputs.camera, phase.level + 1, inputs.config.white());
    let scene = Scene::new(gpu, inputs, levels, &state.transl);
    let mut work = StageWork::new(&scene, inputs, state)?;
    work.start_phase(phase)?;
    let trust = vec![1.0; inputs.capture.frames.len()];
    let mut number = 0;
    with(&mut || {
        number += 1;
        work.step(&Step { phase, frames, trust: &trust, rate: 0.0, number })
    })
}

fn run_stage(
    scene: &Scene,
    inputs: &Inputs<'_>,
    state: &mut FitState,
    outside: &mut Outside<'_>,
) -> Result<(), FitError> {
    let config = inputs.config;
    if state.step == 0 {
        state.stage_poses.clone_from(&state.poses);
        state.stage_transl.clone_from(&state.transl);
    }
    let stage = if state.stage == Stage::Geometry { &config.geometry } else { &config.texture };
    let mut go_on = |begun: FitState, state: &mut FitState| {
        let mut work = StageWork::new(scene, inputs, &begun)?;
        drop(begun);
        schedule::run(scene, config, stage, &mut work, state, outside)
    };
    let now = |state: &FitState| FitState { progress: None, ..state.clone() };
    let begun = match &state.progress {
        Some(progress) => progress.begun.clone().put_into(now(state)),
        None => now(state),
    };
    match go_on(begun, state) {
        Err(FitError::Checkpoint(error @ (NpzError::Missing(_) | NpzError::Array { .. }))) => {
            tracing::warn!(%error, "a checkpoint does not fit the stage, which goes on with optimisers that begin anew");
            // Smoothed poses are where the stage began and what its optimiser has added since.
            state.stage_poses.clone_from(&state.poses);
            state.stage_transl.clone_from(&state.transl);
            go_on(now(state), state)?;
        }
        ended => ended?,
    }
    if state.stage == Stage::Geometry && !stage.weights.compare_colours() {
        solve_colours(scene, inputs, state)?;
    }
    check_finite(state)
}

/// Face colours and light for a geometry that was fitted without looking at colours.
fn solve_colours(scene: &Scene, inputs: &Inputs<'_>, state: &mut FitState) -> Result<(), FitError> {
    Shape::stand(scene, state)?;
    let (faces, poses) = (&inputs.body.faces, PoseGroups::new(&scene.gpu, inputs.config, state));
    let mut lit =
        inputs.config.light.then(|| Lit::new(&scene.gpu, faces, &scene.topology, state.n_frames(), state.light));
    state.face_colours = solve_face_colours(scene, faces, lit.as_mut(), &poses, 0)?.colours;
    state.light = lit.map_or(state.light, |lit| lit.light);
    Ok(())
}

/// The losses of a step may still be finite when its update is not.
fn check_finite(state: &FitState) -> Result<(), FitError> {
    if state.is_finite() {
        return Ok(());
    }
    Err(FitError::Diverged { stage: state.stage, step: state.step, losses: Default::default() })
}
