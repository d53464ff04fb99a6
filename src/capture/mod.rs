//! Video, masks, keypoints, camera and poses, checked against each other: one [`Capture`].
//!
//! Uploads come from strangers: files are told by content, limits stand before every allocation, and decoders run as
//! child processes behind fences. An error names the part, the frame and what was expected.

mod archive;
mod calibration;
mod checks;
mod child;
mod clip;
mod confine;
mod error;
pub mod fuzz_entries;
mod hdr;
mod images;
mod keypoint_formats;
mod keypoints;
mod labels;
mod lens;
mod limits;
mod masks;
mod openpose;
mod poses;
mod rectify;
mod smoothing;
mod source;
#[cfg(test)]
mod tests;
mod text;
mod video;

pub use calibration::read as read_camera;
pub use clip::{CaptureInputs, CaptureOptions, GoOn, Inspection, inspect};
pub use confine::Confinement;
pub use error::{BadInput, CaptureError, Part};
pub use limits::{MOST_BYTES, MostBytes};
pub use masks::masks;

use crate::camera::Camera;

/// One frame, cropped to the person: the same box in all images of the frame.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Index in the uploaded video, 0-based.
    pub index: u32,
    /// Place of the crop's first pixel in the (undistorted, scaled) image.
    pub x0: u32,
    pub y0: u32,
    pub width: u32,
    pub height: u32,
    /// `[height, width, 3]`, sRGB as stored.
    pub rgb: Vec<u8>,
    /// `[height, width]`, 255 inside the person.
    pub mask: Vec<u8>,
    /// `[K]` x, y in pixels of the whole (undistorted, scaled) image, smoothed in time where frames are left out, and
    /// confidence; confidence 0 = not seen.
    pub keypoints: Vec<[f32; 3]>,
}

/// Known poses, SMPL's convention, one a kept frame.
#[derive(Clone, Debug)]
pub struct KnownPoses {
    /// `[N][72]`
    pub poses: Vec<Vec<f32>>,
    /// `[N]`: SMPL's `transl`, or the pelvis position where `is_pelvis`.
    pub trans: Vec<[f32; 3]>,
    pub is_pelvis: bool,
    pub betas: Option<Vec<f32>>,
}

/// A validated clip, in memory.
#[derive(Clone, Debug)]
pub struct Capture {
    /// Of the undistorted, scaled images.
    pub camera: Camera,
    /// The longer side of the uploaded images.
    pub uploaded_side_px: u32,
    /// True where no camera came with the clip: the focal length is a guess that stage 0 refines.
    pub camera_estimated: bool,
    /// Frames a second of the uploaded video.
    pub fps: f64,
    pub frames: Vec<Frame>,
    /// `coco17`, `coco18` or `body25`, as which wider formats are read
    pub keypoint_format: String,
    /// As the keypoints came: `mediapipe33` where they were read as `body25`.
    pub given_keypoint_format: String,
    pub poses: Option<KnownPoses>,
    /// What was odd but not wrong, for the report: one line each.
    pub warnings: Vec<String>,
}
