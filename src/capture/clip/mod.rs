//! Clips, read: looked at whole, or loaded for a fit.

mod load;
mod walk;

use std::path::{Path, PathBuf};
use std::time::Instant;

use self::walk::SmallParts;
use super::limits::INSPECT_TIME;
use super::source::{Pixels, Source};
use super::{CaptureError, Part};

/// The files of an upload. Their names mean nothing: each is told by its content.
#[derive(Clone, Debug)]
pub struct CaptureInputs {
    /// A single file that FFmpeg reads, or a zip of PNG or JPEG images.
    pub video: PathBuf,
    /// A video or a zip of images, one a frame of the video and of its size; foreground ≥ 128.
    pub masks: PathBuf,
    /// Our JSON, or a zip of OpenPose's.
    pub keypoints: PathBuf,
    /// JSON; without it the focal length is guessed.
    pub camera: Option<PathBuf>,
    /// npz of known poses, one a frame of the video.
    pub poses: Option<PathBuf>,
}

impl CaptureInputs {
    /// Files of `folder` that are called as their parts are; of those that may be missing, the ones that `came`.
    pub fn in_folder(folder: &Path, came: impl Fn(&str) -> bool) -> Self {
        let optional = |part: &str| came(part).then(|| folder.join(part));
        Self {
            video: folder.join("video"),
            masks: folder.join("masks"),
            keypoints: folder.join("keypoints"),
            camera: optional("camera"),
            poses: optional("poses"),
        }
    }
}

/// How much of a clip a fit takes.
#[derive(Clone, Copy, Debug)]
pub struct CaptureOptions {
    /// At most this many frames are kept, evenly spread.
    pub max_frames: u32,
    /// Images are scaled down until their longer side is no longer than this.
    pub max_side_px: u32,
}

/// Told the part of a clip that has been read; whether to go on.
pub type GoOn<'a> = &'a mut dyn FnMut(f32) -> bool;

/// What a clip holds, found without keeping any picture.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Inspection {
    pub frames: u32,
    /// Of the video after its rotation tag, pixels.
    pub width: u32,
    pub height: u32,
    pub fps: f64,
    /// `coco17`, `coco18` or `body25`, as which wider formats are read
    pub keypoint_format: String,
    pub has_camera: bool,
    pub has_poses: bool,
    pub warnings: Vec<String>,
}

/// Checks a clip whole, before a job is accepted: safe on hostile files and cheaper than [`Capture::load`].
pub fn inspect(inputs: &CaptureInputs) -> Result<Inspection, CaptureError> {
    let deadline = Instant::now() + INSPECT_TIME;
    let parts = SmallParts::read(inputs)?;
    let mut clip =
        parts.open(Source::open(Part::Video, &inputs.video, Pixels::Mask, true, deadline)?, inputs, deadline)?;
    clip.walk(|_| false, |_, _| Ok(()), &mut |_| true)?;
    let (width, height) = clip.size;
    Ok(Inspection {
        frames: clip.video.count as u32,
        width,
        height,
        fps: clip.fps(),
        keypoint_format: clip.keypoints.format.name.to_owned(),
        has_camera: clip.camera.is_some(),
        has_poses: clip.poses.is_some(),
        warnings: clip.warnings,
    })
}
