//! How a made clip is filmed, and how the person turns before the camera.

use glam::{DQuat, DVec3};

use super::SynthError;
use crate::camera::Camera;

/// Shoulders of an A-pose, radians below the T-pose.
const A_POSE: f64 = 0.85;

/// Lens, place and motion. The default: a level camera some way off, one steady turn with quiet arms.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Filming {
    /// Focal length over the picture's longer side
    pub focal: f64,
    /// Height of the picture over its width
    pub aspect: f64,
    /// Height of the person over that of the picture
    pub fill: f64,
    /// Degrees by which the camera looks down
    pub tilt_degrees: f64,
    /// Turns of the person from the first to the last frame
    pub turns: f64,
    /// Part of the mean speed by which the turn is faster and slower
    pub speed_change: f64,
    /// Degrees by which the arms hang below the horizontal: at 0 they are stretched out, at 75 the hands are at the thighs
    pub arms_down_degrees: f64,
    /// Degrees by which the arms move up and down
    pub arm_swing_degrees: f64,
    /// Degrees by which a thigh is raised with each step of the turn; at 0 the legs stand and the floor turns
    pub step_degrees: f64,
}

impl Default for Filming {
    fn default() -> Self {
        Self {
            focal: 1.425,
            aspect: 1.0,
            fill: 0.84,
            tilt_degrees: 0.0,
            turns: 1.0,
            speed_change: 0.0,
            arms_down_degrees: A_POSE.to_degrees(),
            arm_swing_degrees: 0.0,
            step_degrees: 0.0,
        }
    }
}

/// What is asked for, its value, and the values that it may have.
pub(super) fn check_ranges(ranges: &[(&str, f64, std::ops::RangeInclusive<f64>)]) -> Result<(), SynthError> {
    match ranges.iter().find(|(_, value, range)| !range.contains(value)) {
        Some((what, value, range)) => {
            let expected = format!("{} to {}", range.start(), range.end());
            Err(SynthError::Options(format!("{what} of {value}, expected {expected}")))
        }
        None => Ok(()),
    }
}

impl Filming {
    pub(super) fn check(&self) -> Result<(), SynthError> {
        let ranges = [
            ("a focal length", self.focal, 0.3..=10.0),
            ("an aspect", self.aspect, 0.4..=2.5),
            ("a fill", self.fill, 0.1..=0.95),
            ("a tilt", self.tilt_degrees, -45.0..=45.0),
            ("turns", self.turns, 0.0..=20.0),
            ("a change of speed", self.speed_change, 0.0..=0.95),
            ("arms that hang", self.arms_down_degrees, 0.0..=80.0),
            ("a swing of the arms", self.arm_swing_degrees, 0.0..=60.0),
            ("a raised thigh", self.step_degrees, 0.0..=60.0),
        ];
        check_ranges(&ranges)
    }

    /// Width and height in pixels; the longer side is `size_px`. Even, as video has it.
    pub fn size(&self, size_px: u32) -> (u32, u32) {
        let short = |ratio: f64| 2 * (f64::from(size_px) * ratio / 2.0).round() as u32;
        if self.aspect >= 1.0 { (short(1.0 / self.aspect), size_px) } else { (size_px, short(self.aspect)) }
    }

    /// What takes directions of a level camera to those of the tilted one.
    pub(super) fn tilt(&self) -> DQuat {
        DQuat::from_rotation_x(self.tilt_degrees.to_radians())
    }

    /// A camera that sees a person whole who reaches from `low` to `high` (metres), and where a pelvis at height `pelvis`
    /// is before it: the T-pose's middle lies on the optical axis.
    pub(super) fn camera(&self, size_px: u32, low: f64, high: f64, pelvis: f64) -> (Camera, DVec3) {
        let (width, height) = self.size(size_px);
        let focal = self.focal * f64::from(size_px);
        let (sin, cos) = self.tilt_degrees.to_radians().abs().sin_cos();
        // The end that leans towards the camera reaches furthest.
        let distance = 0.5 * (high - low) * (2.0 * focal * cos / (self.fill * f64::from(height)) + sin);
        let camera = Camera::pinhole(width, height, [focal, focal, 0.5 * f64::from(width), 0.5 * f64::from(height)]);
        let above = DVec3::new(0.0, 0.5 * (low + high) - pelvis, 0.0);
        (camera, DVec3::new(0.0, 0.0, distance) + self.tilt() * above)
    }

    /// Radians that the person has turned through at a part of the clip.
    pub(super) fn facing(&self, at: f64) -> f64 {
        let full = std::f64::consts::TAU;
        full * self.turns * (at + self.speed_change * (full * at).sin() / full)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_person_is_seen_whole_however_the_camera_is_held() {
        for (tilt_degrees, focal, aspect) in [(0.0, 1.425, 1.0), (15.0, 0.6, 16.0 / 9.0), (-20.0, 2.0, 0.75)] {
            let filming = Filming { tilt_degrees, focal, aspect, ..Filming::default() };
            let (camera, pelvis) = filming.camera(480, -0.9, 0.8, -0.05);
            assert_eq!(camera.width.max(camera.height), 480);
            let seen = |y: f64| {
                let at = pelvis + filming.tilt() * DVec3::new(0.0, -(y + 0.05), 0.0);
                camera.fy * at.y / at.z + camera.cy
            };
            let (top, bottom) = (seen(0.8), seen(-0.9));
            let half = 0.5 * filming.fill * f64::from(camera.height);
            let reach = (camera.cy - top).max(bottom - camera.cy);
            assert!((reach - half).abs() < 1e-6, "{tilt_degrees}: {top} to {bottom}");
            assert_eq!(
                tilt_degrees > 0.0,
                camera.cy - top > bottom - camera.cy + 1e-9,
                "looking down, the head is near"
            );
        }
    }

    #[test]
    fn a_turn_of_changing_speed_goes_forward_and_ends_where_it_should() {
        let filming = Filming { turns: 1.5, speed_change: 0.6, ..Filming::default() };
        let facings: Vec<f64> = (0..=40).map(|i| filming.facing(f64::from(i) / 40.0)).collect();
        assert!(facings.windows(2).all(|pair| pair[1] > pair[0]));
        assert!((facings[40] - 3.0 * std::f64::consts::PI).abs() < 1e-9);
    }
}
