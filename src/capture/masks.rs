//! A clip's masks by themselves, as what is compared with them sees them.

use std::path::Path;
use std::time::Instant;

use image::GrayImage;

use super::rectify::{Rect, Rectify};
use super::source::{Picture, Pixels, Source};
use super::{CaptureError, Part, calibration, limits};

/// The masks of the frames with these numbers in the video, at their own size, read by the rules of a clip; `None` for a number
/// beyond the last. Where the clip's camera is given, they are without its lens's distortion.
pub fn masks(file: &Path, camera: Option<&Path>, frames: &[u32]) -> Result<Vec<Option<GrayImage>>, CaptureError> {
    let rectify = match camera.map(calibration::read).transpose()? {
        Some(camera) if camera.distortion != [0.0; 5] => Some(Rectify::new(camera, u32::MAX)?),
        _ => None,
    };
    let mut source = Source::open(Part::Masks, file, Pixels::Mask, false, Instant::now() + limits::LOAD_TIME)?;
    let mut masks = vec![None; frames.len()];
    let last = frames.iter().max().map_or(0, |last| last + 1);
    for index in 0..last {
        let wanted = frames.contains(&index);
        let Some(picture) = source.next(wanted)? else { break };
        if wanted {
            let mask = GrayImage::from_raw(picture.width, picture.height, pixels(rectify.as_ref(), picture));
            frames
                .iter()
                .zip(&mut masks)
                .filter(|(frame, _)| **frame == index)
                .for_each(|(_, to)| to.clone_from(&mask));
        }
    }
    Ok(masks)
}

fn pixels(rectify: Option<&Rectify>, picture: Picture) -> Vec<u8> {
    match rectify.filter(|r| (r.camera.width, r.camera.height) == (picture.width, picture.height)) {
        Some(rectify) => rectify.mask(&picture, Rect { x0: 0, y0: 0, x1: picture.width, y1: picture.height }),
        None => picture.data,
    }
}
