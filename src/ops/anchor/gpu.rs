//! Host side of `shaders/anchor/backward.wgsl`.

use std::sync::Arc;

use super::AnchorConfig;
use crate::gpu::{AnyBuffer, Buffer, Gpu, Kernel, Recorder, linear_groups};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    len: u32,
    stride: u32,
    weight: f32,
}

/// The gradient of the pull on the device; its value is not needed there.
pub struct Anchor {
    backward: Arc<Kernel>,
    start: Buffer<f32>,
    /// `[K]`: 2 / scale²
    factors: Buffer<f32>,
}

impl Anchor {
    /// `start [N, K]`
    pub fn new(gpu: &Gpu, config: &AnchorConfig, start: &[f32]) -> Self {
        let factors: Vec<f32> = config.scales.iter().map(|scale| (2.0 / (scale * scale)) as f32).collect();
        Self {
            backward: kernel!(gpu, "anchor/backward"),
            start: gpu.upload("anchor/start", start),
            factors: gpu.upload("anchor/factors", &factors),
        }
    }

    /// Records `grads += weight · ∂L/∂values`.
    ///
    /// # Panics
    /// When a length differs.
    pub fn backward(&self, recorder: &mut Recorder<'_>, values: &Buffer<f32>, weight: f32, grads: &Buffer<f32>) {
        let len = self.start.len();
        assert!(values.len() == len && grads.len() == len, "{}: length", values.label());
        let params = Params { len: len as u32, stride: self.factors.len() as u32, weight };
        let buffers: [&dyn AnyBuffer; 4] = [values, &self.start, &self.factors, grads];
        recorder.dispatch(&self.backward, &params, &buffers, linear_groups(len, 64));
    }
}
