//! β and D (paper §3.1), fitted or as they stand.

use super::FitError;
use super::Inputs;
use super::checkpointed::{Checkpointed, Checkpointer};
use super::config::{Phase, Preconditioner, Rates, Weights};
use super::groups::{Group, SmoothCoordinates, VertexGroup};
use super::losses::Losses;
use super::mesh_losses::MeshLosses;
use super::scene::Scene;
use super::schedule::Step;
use super::state::FitState;
use crate::gpu::{Gpu, GpuError, Recorder};
use crate::ops::adam::AdamConfig;
use crate::ops::diffuse::Diffuse;
use crate::ops::large_steps::LargeSteps;
use crate::ops::topology::Rows;

/// The parameters with the losses that look at the mesh alone.
pub(super) struct Shape {
    betas: Group,
    offsets: VertexGroup,
    mesh: MeshLosses,
    diffuse: Diffuse,
    /// The coordinates of a phase with large steps.
    smooth: Option<SmoothCoordinates<LargeSteps>>,
    neighbours: Rows,
}

impl Shape {
    pub fn new(scene: &Scene, inputs: &Inputs<'_>, state: &FitState) -> Self {
        let (gpu, config) = (&scene.gpu, AdamConfig::default());
        let neighbours = &scene.topology.neighbours;
        Self {
            betas: Group::whole(gpu, "betas", &state.betas, config),
            offsets: VertexGroup::new(gpu, "offsets", &state.offsets, config),
            mesh: MeshLosses::new(gpu, inputs.body, &scene.topology),
            diffuse: Diffuse::new(gpu, &neighbours.starts, &neighbours.items),
            smooth: None,
            neighbours: neighbours.clone(),
        }
    }

    /// Puts the shape of `state` on the device once, for a stage that leaves it alone.
    pub fn stand(scene: &Scene, state: &FitState) -> Result<(), FitError> {
        let betas = scene.gpu.upload("fit/betas", &state.betas);
        let offsets = scene.gpu.upload("fit/offsets", &state.offsets);
        let mut recorder = scene.gpu.recorder("fit/shape");
        scene.skinning.shape_forward(&mut recorder, &betas, &offsets, &scene.shape);
        Ok(recorder.submit()?)
    }

    /// Takes up the phase's way of moving D. Waits.
    pub fn start_phase(&mut self, gpu: &Gpu, phase: &Phase) -> Result<(), GpuError> {
        self.smooth = match phase.preconditioner {
            Preconditioner::LargeSteps { lambda } => {
                let solver = LargeSteps::new(gpu, &self.neighbours.starts, &self.neighbours.items, lambda.into());
                Some(SmoothCoordinates::new(gpu, solver, &self.offsets.read(gpu)?))
            }
            _ => None,
        };
        Ok(())
    }

    /// Records the clearing of the gradients, and the body in the T-pose.
    pub fn forward(&self, recorder: &mut Recorder<'_>, scene: &Scene) {
        self.betas.clear(recorder);
        self.offsets.clear(recorder);
        scene.skinning.shape_forward(recorder, &self.betas.values, &self.offsets.values, &scene.shape);
    }

    /// Records the losses of the mesh and the way back from the T-pose to β and D.
    pub fn backward(&self, recorder: &mut Recorder<'_>, scene: &Scene, weights: &Weights, losses: &Losses) {
        let (offsets, shape) = (&self.offsets, &scene.shape);
        self.mesh.record(recorder, weights, shape, &offsets.values, &offsets.grads, losses);
        scene.skinning.shape_backward(recorder, shape, &self.betas.grads, &offsets.grads);
    }

    pub fn step(&mut self, recorder: &mut Recorder<'_>, rates: &Rates, step: &Step<'_>) {
        self.betas.step(recorder, &[0], rates.betas * step.rate);
        if !step.phase.offsets {
            return;
        }
        let rate = rates.offsets * step.rate;
        if let Preconditioner::Diffusion { pairs } = step.phase.preconditioner {
            self.diffuse.apply(recorder, &self.offsets.grads, pairs);
        }
        match &self.smooth {
            Some(smooth) => self.offsets.step_in(recorder, smooth, rate),
            None => self.offsets.step(recorder, rate),
        }
    }

    pub fn read_into(&self, scene: &Scene, state: &mut FitState) -> Result<(), FitError> {
        state.betas = self.betas.read(&scene.gpu)?;
        state.offsets = self.offsets.read(&scene.gpu)?;
        Ok(())
    }
}

impl Checkpointed for Shape {
    fn checkpoint(&mut self, checkpointer: &mut Checkpointer<'_>, name: &str) -> Result<(), FitError> {
        self.betas.checkpoint(checkpointer, &format!("{name}.betas"))?;
        self.offsets.checkpoint(checkpointer, &format!("{name}.offsets"))?;
        self.smooth.as_mut().map_or(Ok(()), |smooth| smooth.checkpoint(checkpointer, &format!("{name}.offsets.smooth")))
    }
}
