//! Whom the measurements look at: a body with hanging arms, three metres before the camera, as tall as nine tenths of a
//! square image.

use std::f32::consts::PI;

use crate::body::joints::{LEFT_SHOULDER, RIGHT_SHOULDER};
use crate::body::{Body, N_POSE};
use crate::camera::Camera;
use crate::ops::skinning::cpu::forward;

const DISTANCE_M: f32 = 3.0;

pub struct Person {
    pub camera: Camera,
    pub pose: [f32; N_POSE],
    pub transl: [f32; 3],
}

impl Person {
    pub fn new(body: &Body, size: u32) -> Self {
        let mut pose = [0.0; N_POSE];
        // Half a turn about x: from +Y up, facing +Z, to y down, facing the camera.
        pose[0] = PI;
        (pose[3 * LEFT_SHOULDER + 2], pose[3 * RIGHT_SHOULDER + 2]) = (-1.0, 1.0);
        let at_origin = forward(body, &[], None, &pose, [0.0; 3]).vertices;
        let [x, y, _] = [0, 1, 2].map(|axis| extent(&at_origin, axis));
        let s = f64::from(size);
        let focal = 0.9 * s * f64::from(DISTANCE_M / (y[1] - y[0]));
        Self {
            camera: Camera::pinhole(size, size, [focal, focal, 0.5 * s, 0.5 * s]),
            pose,
            transl: [-0.5 * (x[0] + x[1]), -0.5 * (y[0] + y[1]), DISTANCE_M],
        }
    }
}

/// Lowest and highest value along an axis.
pub fn extent(points: &[[f32; 3]], axis: usize) -> [f32; 2] {
    let values = points.iter().map(|p| p[axis]);
    values.fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], x| [low.min(x), high.max(x)])
}
