//! What colours the surface: one colour a face in stage 1, a texture in stage 2.

mod albedo;
mod faces;
mod facing;
mod gains;
mod lamp;
mod lit;
mod mean_colours;
mod model;
mod shadows;
mod sky;
#[cfg(test)]
mod testing;
mod texture;
mod unseen;

pub use faces::FaceColours;
pub use facing::cosines;
pub use gains::solve_gains;
pub use lit::Lit;
pub use mean_colours::{solve_face_colours, well_inside};
pub use shadows::cast_shadows;
pub use texture::Texture;

use super::FitError;
use super::checkpointed::Checkpointed;
use super::config::{Phase, Rates};
use super::frame_step::FrameStep;
use super::losses::Losses;
use super::poses::PoseGroups;
use super::scene::Scene;
use super::schedule::Step;
use super::state::FitState;
use crate::gpu::{Buffer, Recorder};
use crate::ops::edge_gradient::RgbGradient;

/// Colours of the surface with their parameters, gradients and optimiser.
pub(super) trait Appearance: Checkpointed {
    /// Before a phase, with the geometry as it is then.
    fn start_phase(&mut self, scene: &Scene, poses: &PoseGroups, phase: &Phase) -> Result<(), FitError>;

    /// Casts the shadows anew, of the light as it is, for poses and geometry as they are. A phase's start does that, too.
    fn cast_shadows(&mut self, scene: &Scene, poses: &PoseGroups) -> Result<(), FitError>;

    /// Records what comes before the frames of a step: gradients are cleared.
    fn start_step(&self, recorder: &mut Recorder<'_>, scene: &Scene);

    /// Records what comes before the images of a frame, with the body in its pose.
    fn start_frame(&self, recorder: &mut Recorder<'_>, scene: &Scene, frame: usize);

    /// Records the L1 loss of the scene's last hard image and its gradients: of the colours, and where `moves` of the
    /// mesh through what the faces show (added to the scene's `grad_view`).
    fn hard(&self, recorder: &mut Recorder<'_>, scene: &Scene, frame: &FrameStep<'_>, moves: bool, losses: &Losses);

    /// The last hard image with its gradient, where the borders in it shall move the mesh.
    fn borders(&self, frame: &FrameStep<'_>) -> Option<RgbGradient<'_>>;

    /// `[F, 3]`: the colours that the soft image is drawn with, and where their gradient is added.
    fn face_colours(&self) -> (&Buffer<f32>, &Buffer<f32>);

    /// Records what comes after the images of a frame.
    fn end_frame(&self, recorder: &mut Recorder<'_>);

    fn step(&mut self, recorder: &mut Recorder<'_>, rates: &Rates, step: &Step<'_>);

    fn read_into(&self, scene: &Scene, state: &mut FitState) -> Result<(), FitError>;
}
