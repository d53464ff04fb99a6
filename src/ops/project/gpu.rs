//! Host side of `shaders/project/`.

use std::sync::Arc;

use super::Z_MIN;
use crate::camera::Camera;
use crate::gpu::{Buffer, Gpu, Kernel, Recorder, linear_groups};

/// `shaders/shared/pinhole.wgsl`
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Pinhole {
    n_points: u32,
    fx: f32,
    fy: f32,
    cx: f32,
    cy: f32,
    z_min: f32,
    unused: [u32; 2],
    view_from_world: [[f32; 4]; 3],
}

impl Pinhole {
    fn new(camera: &Camera, n_points: usize) -> Self {
        let (r, t) = (camera.rotation.map(|x| x as f32), camera.translation.map(|x| x as f32));
        Self {
            n_points: n_points as u32,
            fx: camera.fx as f32,
            fy: camera.fy as f32,
            cx: camera.cx as f32,
            cy: camera.cy as f32,
            z_min: Z_MIN as f32,
            unused: [0; 2],
            view_from_world: std::array::from_fn(|i| [r[3 * i], r[3 * i + 1], r[3 * i + 2], t[i]]),
        }
    }
}

/// The projection's kernels; the camera is given with each call.
pub struct Project {
    forward: Arc<Kernel>,
    view_backward: Arc<Kernel>,
    screen_backward: Arc<Kernel>,
}

impl Project {
    pub fn new(gpu: &Gpu) -> Self {
        Self {
            forward: kernel!(gpu, "project/forward"),
            view_backward: kernel!(gpu, "project/view_backward"),
            screen_backward: kernel!(gpu, "project/screen_backward"),
        }
    }

    /// Records `points [P, 3]` to `view [P, 3]` and `screen [P, 2]`.
    ///
    /// # Panics
    /// When the lengths do not belong together.
    pub fn forward(
        &self,
        recorder: &mut Recorder<'_>,
        camera: &Camera,
        points: &Buffer<f32>,
        view: &Buffer<f32>,
        screen: &Buffer<f32>,
    ) {
        let n = points.len() / 3;
        assert!(view.len() == 3 * n && screen.len() == 2 * n, "{}, {}: length", view.label(), screen.label());
        let buffers: [&dyn crate::gpu::AnyBuffer; 3] = [points, view, screen];
        recorder.dispatch(&self.forward, &Pinhole::new(camera, n), &buffers, linear_groups(n, 64));
    }

    /// Records the part of the backward pass through `view`.
    pub fn view_backward(
        &self,
        recorder: &mut Recorder<'_>,
        camera: &Camera,
        grad_view: &Buffer<f32>,
        grad_points: &Buffer<f32>,
    ) {
        let n = grad_points.len() / 3;
        assert!(grad_view.len() == 3 * n, "{}: length", grad_view.label());
        let buffers: [&dyn crate::gpu::AnyBuffer; 2] = [grad_view, grad_points];
        recorder.dispatch(&self.view_backward, &Pinhole::new(camera, n), &buffers, linear_groups(n, 64));
    }

    /// Records the part of the backward pass through `screen`.
    pub fn screen_backward(
        &self,
        recorder: &mut Recorder<'_>,
        camera: &Camera,
        points: &Buffer<f32>,
        grad_screen: &Buffer<f32>,
        grad_points: &Buffer<f32>,
    ) {
        let n = points.len() / 3;
        assert!(grad_screen.len() == 2 * n && grad_points.len() == 3 * n, "{}: length", grad_screen.label());
        let buffers: [&dyn crate::gpu::AnyBuffer; 3] = [points, grad_screen, grad_points];
        recorder.dispatch(&self.screen_backward, &Pinhole::new(camera, n), &buffers, linear_groups(n, 64));
    }
}
