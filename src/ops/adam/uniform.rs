//! Host side of `shaders/adam/uniform_moment.wgsl` and `uniform_step.wgsl`.

use std::sync::Arc;

use super::AdamConfig;
use crate::gpu::{AnyBuffer, Buffer, Gpu, Kernel, Recorder, linear_groups};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct MomentParams {
    n_vertices: u32,
    beta2: f32,
    padding: [u32; 2],
}

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct StepParams {
    len: u32,
    lr: f32,
    beta1: f32,
    eps: f32,
    correction1: f32,
    correction2: f32,
    padding: [u32; 2],
}

/// The state of one vertex field.
pub struct UniformAdam {
    moment: Arc<Kernel>,
    step: Arc<Kernel>,
    config: AdamConfig,
    pub exp_avg: Buffer<f32>,
    pub exp_avg_sq: Buffer<f32>,
}

impl UniformAdam {
    /// State for `n_vertices` × 3 parameters; `label` names the group in buffer labels.
    pub fn new(gpu: &Gpu, label: &str, n_vertices: usize, config: AdamConfig) -> Self {
        let moment = include_str!("../../../shaders/adam/uniform_moment.wgsl");
        Self {
            moment: gpu.kernel("adam/uniform_moment", moment, &[]),
            step: gpu.kernel("adam/uniform_step", include_str!("../../../shaders/adam/uniform_step.wgsl"), &[]),
            config,
            exp_avg: gpu.zeros(&format!("adam/{label}/exp_avg"), n_vertices * 3),
            exp_avg_sq: gpu.zeros(&format!("adam/{label}/exp_avg_sq"), 1),
        }
    }

    /// Records one step over all parameters; `step` is counted from 1.
    ///
    /// # Panics
    /// When the buffers and the state differ in length.
    pub fn step(&self, recorder: &mut Recorder<'_>, params: &Buffer<f32>, grads: &Buffer<f32>, lr: f32, step: u32) {
        assert!(params.len() == self.exp_avg.len() && grads.len() == params.len(), "{}: length", params.label());
        let beta2 = self.config.beta2 as f32;
        let uniform = MomentParams { n_vertices: (params.len() / 3) as u32, beta2, padding: [0; 2] };
        recorder.dispatch(&self.moment, &uniform, &[grads, &self.exp_avg_sq], [1, 1, 1]);
        let uniform = StepParams {
            len: params.len() as u32,
            lr,
            beta1: self.config.beta1 as f32,
            eps: self.config.eps as f32,
            correction1: (1.0 - self.config.beta1.powi(step as i32)) as f32,
            correction2: (1.0 - self.config.beta2.powi(step as i32)) as f32,
            padding: [0; 2],
        };
        let buffers: [&dyn AnyBuffer; 4] = [params, grads, &self.exp_avg, &self.exp_avg_sq];
        recorder.dispatch(&self.step, &uniform, &buffers, linear_groups(params.len(), 64));
    }
}
