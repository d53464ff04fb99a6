//! Whether a clip contradicts the focal length that came with it.
//!
//! A body's perspective tells its distance in parts of its size, and with it the focal length: from a given one that is 30 % wrong,
//! stage 0 left free ends within 7 % of the true one on every clip with truth (docs/lab/stage0.md, "A focal length that is wrong").

use super::{Stage0Options, solve};
use crate::body::Body;
use crate::capture::{Capture, Frame};

/// Frames that tell the focal length well enough.
const FRAMES: usize = 24;
/// The focal lengths that are found for right ones lie within this factor.
pub const FOCAL_OFF: f64 = 1.13;

/// What a clip says of the focal length that came with it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FocalCheck {
    /// As it came, pixels of the fitted images.
    pub given_px: f64,
    /// What the clip looks like, over the given one.
    pub ratio: f64,
}

impl FocalCheck {
    /// Finds the focal length anew from keypoints and masks of some frames, near the given one where they tell little: a long lens has
    /// hardly a perspective. `None` where none was given, where poses were (they belong to
    /// it), where nothing is found, or where `go_on` says no.
    pub fn of(body: &Body, capture: &Capture, go_on: &mut dyn FnMut() -> bool) -> Option<Self> {
        if capture.camera_estimated || capture.poses.is_some() {
            return None;
        }
        let (all, kept) = (capture.frames.len(), capture.frames.len().min(FRAMES));
        let thin = |frame: &Frame| Frame {
            rgb: Vec::new(),
            mask: frame.mask.clone(),
            keypoints: frame.keypoints.clone(),
            ..*frame
        };
        let free = Capture {
            camera: capture.camera.clone(),
            uploaded_side_px: capture.uploaded_side_px,
            camera_estimated: true,
            fps: capture.fps,
            frames: (0..kept).map(|i| thin(&capture.frames[i * all / kept])).collect(),
            keypoint_format: capture.keypoint_format.clone(),
            given_keypoint_format: capture.given_keypoint_format.clone(),
            poses: None,
            warnings: Vec::new(),
        };
        let found = solve(body, &free, &Stage0Options::default(), &mut |_| go_on()).ok()?;
        Some(Self { given_px: capture.camera.fx, ratio: found.camera.fx / capture.camera.fx })
    }

    /// Whether the given focal length is further off than what is found for a right one.
    pub fn contradicts(&self) -> bool {
        !(1.0 / FOCAL_OFF..=FOCAL_OFF).contains(&self.ratio)
    }
}
