//! The fit of a body and its looks to a clip (paper §3): stage 0 on the CPU finds poses and shape from keypoints and
//! masks, stage 1 on the device fits geometry with one colour a face, stage 2 the hash texture.

mod colours;
pub mod config;
mod control;
mod frames;
mod geometry;
mod groups;
mod keypoint_term;
mod losses;
mod mesh_losses;
mod motion;
mod scene;
mod silhouette;
mod soft;
pub mod stage0;
mod state;
mod texture;

use std::path::Path;
use std::sync::Arc;

pub use config::FitConfig;
pub use control::{Control, Flow, StepReport};
pub use state::{FitState, Stage};

use crate::body::Body;
use crate::camera::Camera;
use crate::capture::Capture;
use crate::gpu::{Gpu, GpuError};
use crate::npz::NpzError;
use crate::ops::Topology;
use scene::Scene;

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

/// Runs stages 1 and 2 from `state` on; `camera` is stage 0's. The state of every checkpoint goes to `checkpoint`.
#[expect(clippy::too_many_arguments, reason = "a fit reads a body, a clip, its settings and its controls")]
pub fn run(
    gpu: &Arc<Gpu>,
    body: &Body,
    capture: &Capture,
    camera: &Camera,
    config: &FitConfig,
    mut state: FitState,
    checkpoint: &Path,
    control: &mut dyn Control,
) -> Result<FitState, FitError> {
    let n_levels = config.geometry.iter().chain(&config.texture).map(|p| p.level + 1).max().unwrap_or(1);
    let frames = frames::upload(gpu, capture, camera, n_levels);
    let topology = Topology::new(body.n_vertices(), &body.faces);
    let scene = Scene::new(gpu, body, &topology, frames, camera, &state.transl);
    if state.stage == Stage::Geometry {
        geometry::run(&scene, body, &topology, capture, camera, config, &mut state, checkpoint, control)?;
        check_finite(&state)?;
        state.stage = Stage::Texture;
        state.step = 0;
        state.save(checkpoint)?;
    }
    if state.stage == Stage::Texture {
        texture::run(&scene, config, &mut state, checkpoint, control)?;
        check_finite(&state)?;
        state.stage = Stage::Done;
        state.save(checkpoint)?;
    }
    Ok(state)
}

/// The losses of a step may still be finite when its update is not.
fn check_finite(state: &FitState) -> Result<(), FitError> {
    if state.is_finite() {
        return Ok(());
    }
    Err(FitError::Diverged { stage: state.stage, step: state.step, losses: Default::default() })
}
