//! Parameter groups: values, gradients and optimiser state on the device.

use crate::gpu::{Buffer, Gpu, GpuError, Recorder};
use crate::ops::adam::{Adam, AdamConfig, UniformAdam};
use crate::ops::add::Add;
use crate::ops::large_steps::LargeSteps;
use crate::ops::tridiagonal::Tridiagonal;

/// A group that moves as a whole, or frame by frame.
pub struct Group {
    pub values: Buffer<f32>,
    pub grads: Buffer<f32>,
    pub(super) adam: Adam,
    /// Steps taken, one count a frame (one in all for a group without frames).
    pub(super) steps: Vec<u32>,
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

    pub fn n_frames(&self) -> usize {
        self.steps.len()
    }

    pub fn clear(&self, recorder: &mut Recorder<'_>) {
        recorder.clear(&self.grads);
    }

    /// Records a step of the given frames (`&[0]` for a group without frames), of each one, however often it is given: its
    /// gradient is the sum of all times.
    pub fn step(&mut self, recorder: &mut Recorder<'_>, frames: &[usize], rate: f32) {
        let first_time = |&(nth, frame): &(usize, &usize)| !frames[..nth].contains(frame);
        for (_, &frame) in frames.iter().enumerate().filter(first_time) {
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
    pub(super) adam: UniformAdam,
    pub(super) steps: u32,
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
    pub fn step_in(&mut self, recorder: &mut Recorder<'_>, smooth: &SmoothCoordinates<LargeSteps>, rate: f32) {
        self.steps += 1;
        let (adam, number) = (&self.adam, self.steps);
        smooth.step(recorder, &self.values, &self.grads, |recorder, u, grad_u| {
            adam.step(recorder, u, grad_u, rate, number);
        });
    }

    pub fn read(&self, gpu: &Gpu) -> Result<Vec<f32>, GpuError> {
        gpu.read(&self.values)
    }
}

/// A symmetric positive definite P that spreads a field over its neighbours.
pub trait Spread {
    /// Records `x = P · field`.
    fn spread(&self, recorder: &mut Recorder<'_>, field: &Buffer<f32>, x: &Buffer<f32>);
}

impl Spread for LargeSteps {
    fn spread(&self, recorder: &mut Recorder<'_>, field: &Buffer<f32>, x: &Buffer<f32>) {
        self.solve(recorder, field, x);
    }
}

impl Spread for Tridiagonal {
    fn spread(&self, recorder: &mut Recorder<'_>, field: &Buffer<f32>, x: &Buffer<f32>) {
        self.solve(recorder, field, x);
    }
}

/// `values = start + P u` (see [`crate::ops::large_steps`]): what is optimised is u.
pub struct SmoothCoordinates<P: Spread> {
    solver: P,
    add: Add,
    start: Buffer<f32>,
    pub(super) u: Buffer<f32>,
    grad_u: Buffer<f32>,
    moved: Buffer<f32>,
}

impl<P: Spread> SmoothCoordinates<P> {
    /// u = 0 at `start`.
    pub fn new(gpu: &Gpu, solver: P, start: &[f32]) -> Self {
        let zeros = |name: &str| gpu.zeros(&format!("fit/smooth/{name}"), start.len());
        let start = gpu.upload("fit/smooth/start", start);
        Self { solver, add: Add::new(gpu), start, u: zeros("u"), grad_u: zeros("grad_u"), moved: zeros("moved") }
    }

    /// Records a step of u down the gradient `grads` by the values, as `step` takes it from the gradient by u, and then the
    /// values.
    pub fn step(
        &self,
        recorder: &mut Recorder<'_>,
        values: &Buffer<f32>,
        grads: &Buffer<f32>,
        step: impl FnOnce(&mut Recorder<'_>, &Buffer<f32>, &Buffer<f32>),
    ) {
        self.solver.spread(recorder, grads, &self.grad_u);
        step(recorder, &self.u, &self.grad_u);
        self.solver.spread(recorder, &self.u, &self.moved);
        self.add.record(recorder, &self.start, &self.moved, values);
    }
}
