//! How much of everything a clip may hold. Uploads come from strangers: each limit is checked before memory or
//! time is spent on what lies beyond it.

use std::time::Duration;

use super::{BadInput, Part};

pub(super) const FRAMES: usize = 3600;
/// Of one image, 4096².
pub(super) const PIXELS: u64 = 4096 * 4096;
pub(super) const SIDE_PX: u32 = 8192;

pub(super) const ZIP_ENTRIES: usize = 20_000;
pub(super) const ZIP_TOTAL_BYTES: u64 = 16 << 30;
/// Deflate reaches about 1000; images and JSON stay far below this.
pub(super) const ZIP_RATIO: u64 = 200;
pub(super) const IMAGE_BYTES: u64 = 128 << 20;

/// The most bytes of the parts that are read whole, for those who take them.
pub struct MostBytes {
    /// JSON, or a zip of it, which may be as large.
    pub keypoints: u64,
    pub camera: u64,
    pub poses: u64,
}

pub const MOST_BYTES: MostBytes = MostBytes { keypoints: 256 << 20, camera: CAMERA_BYTES, poses: POSES_BYTES };

/// Of JSON.
pub(super) const KEYPOINTS_BYTES: u64 = 64 << 20;
pub(super) const OPENPOSE_FRAME_BYTES: u64 = 1 << 20;
pub(super) const PEOPLE: usize = 64;
pub(super) const CAMERA_BYTES: u64 = 64 << 10;
pub(super) const POSES_BYTES: u64 = 256 << 20;
pub(super) const POSES_VALUES: usize = 16 << 20;

pub(super) const PROBE_TIME: Duration = Duration::from_secs(30);
pub(super) const INSPECT_TIME: Duration = Duration::from_secs(180);
/// Others' renders may have half of it.
pub(super) const LOAD_TIME: Duration = Duration::from_secs(2400);
/// Address space of a decoder: reference frames of 4096² at 10 bits for each thread, and the libraries.
pub(super) const CHILD_MEMORY_BYTES: u64 = 4 << 30;

/// Refuses an image that is empty or too large, before it is decoded.
pub(super) fn check_image_size(part: Part, width: u32, height: u32) -> Result<(), BadInput> {
    let fits = width >= 16 && height >= 16 && width <= SIDE_PX && height <= SIDE_PX;
    if fits && u64::from(width) * u64::from(height) <= PIXELS {
        return Ok(());
    }
    let expected = format!("16 to {SIDE_PX} pixels a side and at most {PIXELS} pixels");
    Err(BadInput::new(part, format!("the images are {width}×{height}"), expected))
}

pub(super) fn too_many_frames(part: Part) -> BadInput {
    BadInput::new(part, format!("there are more than {FRAMES} frames"), format!("a clip of at most {FRAMES} frames"))
}
