//! Host side of `shaders/anchor/backward.wgsl`.

use std::sync::Arc;

use super::AnchorConfig;
use crate::gpu::{Buffer, Gpu, Kernel, Recorder, linear_groups};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    len: u32,
    stride: u32,
    first: u32,
    factor: f32,
}

/// The gradient of the pull on the device; its value is not needed there.
pub struct Anchor {
    backward: Arc<Kernel>,
    config: AnchorConfig,
    start: Buffer<f32>,
}

impl Anchor {
    /// `start [N, K]`
    pub fn new(gpu: &Gpu, config: AnchorConfig, start: &[f32]) -> Self {
        let backward = kernel!(gpu, "anchor/backward");
        Self { backward, config, start: gpu.upload("anchor/start", start) }
    }

    /// Records `grads += weight · ∂L/∂values`.
    ///
    /// # Panics
    /// When a length differs.
    pub fn backward(&self, recorder: &mut Recorder<'_>, values: &Buffer<f32>, weight: f32, grads: &Buffer<f32>) {
        let len = self.start.len();
        assert!(values.len() == len && grads.len() == len, "{}: length", values.label());
        let AnchorConfig { stride, first, scale } = self.config;
        let params = Params {
            len: len as u32,
            stride: stride as u32,
            first: first as u32,
            factor: (2.0 * f64::from(weight) / (scale * scale)) as f32,
        };
        recorder.dispatch(&self.backward, &params, &[values, &self.start, grads], linear_groups(len, 64));
    }
}
