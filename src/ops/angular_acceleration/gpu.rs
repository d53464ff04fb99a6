//! Host side of `shaders/angular_acceleration/backward.wgsl`.

use std::sync::Arc;

use super::{AngularAccelerationConfig, Given};
use crate::gpu::{Buffer, Gpu, Kernel, Recorder, linear_groups};
use crate::ops::temporal::upload_spacing;

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    n_frames: u32,
    stride: u32,
    factor: f32,
    least_trace: f32,
}

/// The gradient of the penalty on the device; its value is not needed there.
pub struct AngularAcceleration {
    backward: Arc<Kernel>,
    config: AngularAccelerationConfig,
    expected: Buffer<f32>,
    spacing: Buffer<f32>,
}

impl AngularAcceleration {
    pub fn new(gpu: &Gpu, config: AngularAccelerationConfig, given: Given<'_, f32>) -> Self {
        let backward = kernel!(gpu, "angular_acceleration/backward");
        let expected = gpu.upload("angular_acceleration/expected", given.expected);
        Self { backward, config, expected, spacing: upload_spacing(gpu, given.spacing) }
    }

    /// Records `grads += weight · ∂L/∂values`.
    ///
    /// # Panics
    /// When the lengths differ or are no multiple of the stride.
    pub fn backward(&self, recorder: &mut Recorder<'_>, values: &Buffer<f32>, weight: f32, grads: &Buffer<f32>) {
        let AngularAccelerationConfig { stride, scale, max_turn } = self.config;
        assert!(values.len() == grads.len() && values.len().is_multiple_of(stride), "{}: length", values.label());
        let n_frames = values.len() / stride;
        let given = (self.expected.len(), self.spacing.len());
        assert_eq!(given, (3 * n_frames, 2 * n_frames), "{}: frames", values.label());
        let params = Params {
            n_frames: n_frames as u32,
            stride: stride as u32,
            factor: (2.0 / (scale * scale)) as f32 * weight,
            least_trace: (1.0 + 2.0 * max_turn.cos()) as f32,
        };
        recorder.dispatch(
            &self.backward,
            &params,
            &[values, &self.expected, &self.spacing, grads],
            linear_groups(n_frames, 64),
        );
    }
}
