//! Rigid motion into camera space and the pinhole.
//!
//! `view = R x + t`, `screen = (fx X/Z + cx, fy Y/Z + cy)`. OpenCV's axes (x right, y down, z forward), pixel centres at
//! half integers, no distortion: frames of a capture are undistorted. A crop moves the principal point
//! ([`Camera::cropped`](crate::camera::Camera::cropped)), coarser images scale it
//! ([`Camera::scaled`](crate::camera::Camera::scaled)).
//!
//! | buffer | shape | space |
//! |---|---|---|
//! | `points`, `grad_points` | `[P, 3]` | world, metres |
//! | `view`, `grad_view` | `[P, 3]` | camera, metres |
//! | `screen`, `grad_screen` | `[P, 2]` | pixels |
//!
//! Z is taken as at least [`Z_MIN`]: a point at or behind the camera gets a finite, meaningless pixel and no gradient
//! along z.

pub mod cpu;
mod gpu;

pub use gpu::Project;

/// The least depth that is divided by, metres.
pub const Z_MIN: f64 = 1e-4;

#[cfg(test)]
mod tests;
