//! Host side of `shaders/temporal/backward.wgsl`.

use std::sync::Arc;

use super::{Given, TemporalConfig};
use crate::gpu::{Buffer, Gpu, Kernel, Recorder, linear_groups};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    n_frames: u32,
    stride: u32,
    weight: f32,
    inverse_scale2: f32,
    max_change: f32,
    first: u32,
    padding: [u32; 2],
}

pub(in crate::ops) fn upload_spacing(gpu: &Gpu, spacing: &[[f64; 2]]) -> Buffer<f32> {
    let factors: Vec<f32> = spacing.as_flattened().iter().map(|&factor| factor as f32).collect();
    gpu.upload("temporal/spacing", &factors)
}

/// The gradient of the penalty on the device; its value is not needed there.
pub struct Temporal {
    backward: Arc<Kernel>,
    config: TemporalConfig,
    expected: Buffer<f32>,
    spacing: Buffer<f32>,
}

impl Temporal {
    pub fn new(gpu: &Gpu, config: TemporalConfig, given: Given<'_, f32>) -> Self {
        let source = include_str!("../../../shaders/temporal/backward.wgsl");
        Self {
            backward: gpu.kernel("temporal/backward", source, &[]),
            config,
            expected: gpu.upload("temporal/expected", given.expected),
            spacing: upload_spacing(gpu, given.spacing),
        }
    }

    /// Records `grads += weight · ∂L/∂values`.
    ///
    /// # Panics
    /// When the lengths differ or are no multiple of the stride.
    pub fn backward(&self, recorder: &mut Recorder<'_>, values: &Buffer<f32>, weight: f32, grads: &Buffer<f32>) {
        let TemporalConfig { stride, first, scale, max_change } = self.config;
        let alike = values.len() == grads.len() && values.len() == self.expected.len();
        let whole = values.len().is_multiple_of(stride) && 2 * (values.len() / stride) == self.spacing.len();
        assert!(alike && whole, "{}: length", values.label());
        let params = Params {
            n_frames: (values.len() / stride) as u32,
            stride: stride as u32,
            weight,
            inverse_scale2: (1.0 / (scale * scale)) as f32,
            max_change: max_change as f32,
            first: first as u32,
            padding: [0; 2],
        };
        recorder.dispatch(
            &self.backward,
            &params,
            &[values, &self.expected, &self.spacing, grads],
            linear_groups(values.len(), 64),
        );
    }
}
