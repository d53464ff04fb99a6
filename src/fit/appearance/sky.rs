//! The world's directions as a clip has them, and what light from them is.

use super::albedo::Weights;
use crate::ops::light::Light;

/// Ambient light is brighter from the camera's side, or not; that side is this far above the horizon.
const CAMERA_SIDE_DEG: f64 = 20.0;

/// The world's directions as the clip has them.
#[derive(Clone, Copy)]
pub struct Sky {
    up: glam::DVec3,
    /// Level, towards the camera
    back: glam::DVec3,
    side: glam::DVec3,
}

impl Sky {
    /// `up`: against gravity; `forward`: the camera's view.
    pub fn new(up: [f32; 3], forward: [f32; 3]) -> Self {
        let vector = |v: [f32; 3]| glam::DVec3::from(v.map(f64::from));
        let up = vector(up).normalize();
        let back = -vector(forward).reject_from(up).normalize();
        Self { up, back, side: up.cross(back) }
    }

    /// The unit vector `azimuth` (radians) round the vertical from straight towards the camera, above the horizon.
    pub fn direction(&self, azimuth: f64, elevation_deg: f64) -> [f32; 3] {
        let elevation = elevation_deg.to_radians();
        let flat = self.back * azimuth.cos() + self.side * azimuth.sin();
        (flat * elevation.cos() + self.up * elevation.sin()).to_array().map(|x| x as f32)
    }

    /// How much of ambient light from the camera's side, [`CAMERA_SIDE_DEG`] above the horizon, and from above a unit normal
    /// gets, 0 to 1.
    pub fn slopes(&self, n: [f32; 3]) -> [f32; 2] {
        self.sides().map(|side| 0.5 + 0.5 * side.dot(n.into()))
    }

    pub fn sides(&self) -> [glam::Vec3; 2] {
        [self.direction(0.0, CAMERA_SIDE_DEG).into(), self.up.as_vec3()]
    }

    /// The light of the weights of [`TERMS`]; without a normal it is `ambient`, so half of what comes from one side counts there.
    pub fn light(&self, direction: [f32; 3], [everywhere, front, above, strength]: Weights) -> Light {
        let ambient = everywhere + 0.5 * (front + above);
        let [camera, up] = self.sides();
        let slope = if ambient > 0.0 { 0.5 * (front * camera + above * up) / ambient } else { glam::Vec3::ZERO };
        let slope = slope.to_array();
        Light { ambient: [ambient; 3], strength: [strength; 3], direction, occlusion: 0.0, slope }
    }

    pub fn azimuth(&self, direction: [f32; 3]) -> f64 {
        let direction = glam::DVec3::from(direction.map(f64::from));
        direction.dot(self.side).atan2(direction.dot(self.back))
    }
}
