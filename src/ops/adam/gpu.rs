//! Host side of `adam/step` and `adam/step4`.

use std::ops::Range;
use std::sync::Arc;

use super::AdamConfig;
use crate::gpu::{Buffer, Gpu, Kernel, Recorder, linear_groups};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    offset: u32,
    len: u32,
    lr: f32,
    beta1: f32,
    beta2: f32,
    eps: f32,
    correction1: f32,
    correction2: f32,
}

/// The state of one parameter group.
pub struct Adam {
    kernel: Arc<Kernel>,
    /// Four parameters an invocation.
    by_fours: Arc<Kernel>,
    config: AdamConfig,
    pub exp_avg: Buffer<f32>,
    pub exp_avg_sq: Buffer<f32>,
}

impl Adam {
    /// State for `len` parameters; `label` names the group in buffer labels.
    pub fn new(gpu: &Gpu, label: &str, len: usize, config: AdamConfig) -> Self {
        Self {
            kernel: kernel!(gpu, "adam/step"),
            by_fours: kernel!(gpu, "adam/step4"),
            config,
            exp_avg: gpu.zeros(&format!("adam/{label}/exp_avg"), len),
            exp_avg_sq: gpu.zeros(&format!("adam/{label}/exp_avg_sq"), len),
        }
    }

    /// Records one step over `range`; `step` is counted from 1.
    ///
    /// # Panics
    /// When the buffers and the state differ in length, or the range lies outside.
    pub fn step(
        &self,
        recorder: &mut Recorder<'_>,
        params: &Buffer<f32>,
        grads: &Buffer<f32>,
        range: Range<usize>,
        lr: f32,
        step: u32,
    ) {
        assert!(params.len() == self.exp_avg.len() && grads.len() == params.len(), "{}: length", params.label());
        assert!(range.end <= params.len(), "{}: range {range:?}", params.label());
        // Buffers end with whole vectors; beyond the last parameter they hold zeros, which a step leaves alone.
        let whole = range.len().is_multiple_of(4) || range.end == params.len();
        let (kernel, size) =
            if range.start.is_multiple_of(4) && whole { (&self.by_fours, 4) } else { (&self.kernel, 1) };
        let len = range.len().div_ceil(size);
        let uniform = Params {
            offset: (range.start / size) as u32,
            len: len as u32,
            lr,
            beta1: self.config.beta1 as f32,
            beta2: self.config.beta2 as f32,
            eps: self.config.eps as f32,
            correction1: (1.0 - self.config.beta1.powi(step as i32)) as f32,
            correction2: (1.0 - self.config.beta2.powi(step as i32)) as f32,
        };
        let buffers: [&dyn crate::gpu::AnyBuffer; 4] = [params, grads, &self.exp_avg, &self.exp_avg_sq];
        recorder.dispatch(kernel, &uniform, &buffers, linear_groups(len, 64));
    }
}
