//! Host side of `shaders/keypoints/forward.wgsl` and `backward.wgsl`.

use std::sync::Arc;

use crate::gpu::{Buffer, Gpu, Kernel, Recorder, linear_groups};
use crate::ops::LossSlot;

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct ForwardParams {
    n_keypoints: u32,
    frame: u32,
    inverse_rho2: f32,
    slot: u32,
}

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct BackwardParams {
    n_keypoints: u32,
    frame: u32,
    inverse_rho2: f32,
    weight: f32,
}

/// The loss of a frame's keypoints.
pub struct KeypointLoss {
    forward: Arc<Kernel>,
    backward: Arc<Kernel>,
    inverse_rho2: f32,
}

impl KeypointLoss {
    /// Squared distances, or with `rho_px` Geman & McClure's of that scale.
    pub fn new(gpu: &Gpu, rho_px: Option<f32>) -> Self {
        Self {
            forward: kernel!(gpu, "keypoints/forward"),
            backward: kernel!(gpu, "keypoints/backward"),
            inverse_rho2: rho_px.map_or(0.0, |rho| 1.0 / (rho * rho)),
        }
    }

    /// Records the loss of `screen [K, 2]` against frame `frame` of `targets [N, K, 3]`.
    pub fn forward(
        &self,
        recorder: &mut Recorder<'_>,
        screen: &Buffer<f32>,
        targets: &Buffer<f32>,
        frame: usize,
        loss: LossSlot<'_>,
    ) {
        let params = ForwardParams {
            n_keypoints: n_keypoints(screen, targets, frame),
            frame: frame as u32,
            inverse_rho2: self.inverse_rho2,
            slot: loss.index as u32,
        };
        recorder.dispatch(&self.forward, &params, &[screen, targets, loss.losses], [1, 1, 1]);
    }

    /// Records the gradient, times `weight`, into `grad_screen [K, 2]`.
    pub fn backward(
        &self,
        recorder: &mut Recorder<'_>,
        screen: &Buffer<f32>,
        targets: &Buffer<f32>,
        frame: usize,
        weight: f32,
        grad_screen: &Buffer<f32>,
    ) {
        assert!(grad_screen.len() == screen.len(), "{}: length", grad_screen.label());
        let n_keypoints = n_keypoints(screen, targets, frame);
        let params = BackwardParams { n_keypoints, frame: frame as u32, inverse_rho2: self.inverse_rho2, weight };
        let groups = linear_groups(n_keypoints as usize, 64);
        recorder.dispatch(&self.backward, &params, &[screen, targets, grad_screen], groups);
    }
}

fn n_keypoints(screen: &Buffer<f32>, targets: &Buffer<f32>, frame: usize) -> u32 {
    let n = screen.len() / 2;
    assert!((frame + 1) * 3 * n <= targets.len(), "{}: frame {frame}", targets.label());
    n as u32
}
