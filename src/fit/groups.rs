//! Parameter groups: values, gradients and optimiser state on the device.

use super::config::Rates;
use super::schedule::Step;
use super::state::FitState;
use crate::gpu::{Buffer, Gpu, GpuError, Recorder};
use crate::ops::adam::{Adam, AdamConfig, UniformAdam};
use crate::ops::large_steps::LargeSteps;
use crate::ops::skinning::PoseAt;

/// A group that moves as a whole, or frame by frame.
pub struct Group {
    pub values: Buffer<f32>,
    pub grads: Buffer<f32>,
    adam: Adam,
    /// Steps taken, one count a frame (one in all for a group without frames).
    steps: Vec<u32>,
    /// Parameters a frame.
    stride: usize,
}

impl Group {
    /// A group of `start.len()` parameters that moves as a whole.
    pub fn whole(gpu: &Gpu, name: &str, start: &[f32], config: AdamConfig) -> Self {
        Self::per_frame(gpu, name, start, start.len(), config)
    }

    /// A group of frames with `stride` parameters each: a frame moves only in the steps that saw it.
    pub fn per_frame(gpu: &Gpu, name: &str, start: &[f32], stride: usize, config: AdamConfig) -> Self {
        Self {
            values: gpu.upload(&format!("fit/{name}"), start),
            grads: gpu.zeros(&format!("fit/grad_{name}"), start.len()),
            adam: Adam::new(gpu, name, start.len(), config),
            steps: vec![0; start.len() / stride.max(1)],
            stride,
        }
    }

    pub fn clear(&self, recorder: &mut Recorder<'_>) {
        recorder.clear(&self.grads);
    }

    /// Records a step of the given frames (`&[0]` for a group without frames).
    pub fn step(&mut self, recorder: &mut Recorder<'_>, frames: &[usize], rate: f32) {
        for &frame in frames {
            self.steps[frame] += 1;
            let range = frame * self.stride..(frame + 1) * self.stride;
            self.adam.step(recorder, &self.values, &self.grads, range, rate, self.steps[frame]);
        }
    }

    pub fn read(&self, gpu: &Gpu) -> Result<Vec<f32>, GpuError> {
        gpu.read(&self.values)
    }
}

/// A vertex field with one second moment.
pub struct VertexGroup {
    pub values: Buffer<f32>,
    pub grads: Buffer<f32>,
    adam: UniformAdam,
    steps: u32,
}

impl VertexGroup {
    /// `start [V, 3]`
    pub fn new(gpu: &Gpu, name: &str, start: &[f32], config: AdamConfig) -> Self {
        Self {
            values: gpu.upload(&format!("fit/{name}"), start),
            grads: gpu.zeros(&format!("fit/grad_{name}"), start.len()),
            adam: UniformAdam::new(gpu, name, start.len() / 3, config),
            steps: 0,
        }
    }

    pub fn clear(&self, recorder: &mut Recorder<'_>) {
        recorder.clear(&self.grads);
    }

    pub fn step(&mut self, recorder: &mut Recorder<'_>, rate: f32) {
        self.steps += 1;
        self.adam.step(recorder, &self.values, &self.grads, rate, self.steps);
    }

    /// As [`VertexGroup::step`], in the coordinates of `smooth`.
    pub fn step_in(&mut self, recorder: &mut Recorder<'_>, smooth: &SmoothCoordinates, rate: f32) {
        self.steps += 1;
        let SmoothCoordinates { solver, start, u, grad_u, moved } = smooth;
        solver.solve(recorder, &self.grads, grad_u);
        self.adam.step(recorder, u, grad_u, rate, self.steps);
        solver.solve(recorder, u, moved);
        solver.add(recorder, start, moved, &self.values);
    }

    pub fn read(&self, gpu: &Gpu) -> Result<Vec<f32>, GpuError> {
        gpu.read(&self.values)
    }
}

/// `values = start + P u` (see [`crate::ops::large_steps`]): what is optimised is u.
pub struct SmoothCoordinates {
    solver: LargeSteps,
    start: Buffer<f32>,
    u: Buffer<f32>,
    grad_u: Buffer<f32>,
    moved: Buffer<f32>,
}

impl SmoothCoordinates {
    /// u = 0 at the group's values. Waits.
    pub fn new(gpu: &Gpu, solver: LargeSteps, group: &VertexGroup) -> Result<Self, GpuError> {
        let len = group.values.len();
        Ok(Self {
            solver,
            start: gpu.upload("fit/smooth/start", &gpu.read(&group.values)?),
            u: gpu.zeros("fit/smooth/u", len),
            grad_u: gpu.zeros("fit/smooth/grad_u", len),
            moved: gpu.zeros("fit/smooth/moved", len),
        })
    }
}

/// Pose and placement of all frames: the paper's θᵢ, Rᵢ and tᵢ.
pub struct PoseGroups {
    pub poses: Group,
    pub transl: Group,
}

impl PoseGroups {
    pub fn new(gpu: &Gpu, state: &FitState) -> Self {
        let config = AdamConfig::default();
        Self {
            poses: Group::per_frame(gpu, "poses", &state.poses, 72, config),
            transl: Group::per_frame(gpu, "transl", &state.transl, 3, config),
        }
    }

    pub fn at(&self, frame: usize) -> PoseAt<'_> {
        PoseAt { poses: &self.poses.values, transl: &self.transl.values, frame }
    }

    pub fn grad_at(&self, frame: usize) -> PoseAt<'_> {
        PoseAt { poses: &self.poses.grads, transl: &self.transl.grads, frame }
    }

    pub fn clear(&self, recorder: &mut Recorder<'_>) {
        self.poses.clear(recorder);
        self.transl.clear(recorder);
    }

    pub(super) fn step(&mut self, recorder: &mut Recorder<'_>, rates: &Rates, step: &Step<'_>) {
        let rate = step.rate * step.phase.pose_rate;
        self.poses.step(recorder, step.frames, rates.pose * rate);
        self.transl.step(recorder, step.frames, rates.transl * rate);
    }

    pub fn read_into(&self, gpu: &Gpu, state: &mut FitState) -> Result<(), GpuError> {
        state.poses = self.poses.read(gpu)?;
        state.transl = self.transl.read(gpu)?;
        Ok(())
    }
}
