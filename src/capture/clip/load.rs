//! A clip for a fit: which frames are kept, and what of them.

use std::path::Path;
use std::time::Instant;

use super::walk::{SmallParts, Still};
use super::{CaptureInputs, CaptureOptions, GoOn};
use crate::camera::Camera;
use crate::capture::checks::MaskCheck;
use crate::capture::keypoints::Point;
use crate::capture::limits::LOAD_TIME;
use crate::capture::rectify::{Rect, Rectify};
use crate::capture::source::{Pixels, Source};
use crate::capture::{BadInput, Capture, CaptureError, Frame, Part, calibration, smoothing};

/// The masks' part of a look at a clip of which not all frames are kept.
const MASKS_SHARE: f32 = 0.2;

impl Capture {
    /// Decodes, checks, undistorts, scales, subsamples and crops a clip; keypoints of frames that are left out smooth those of
    /// the others. Only the crops of the frames kept are ever in memory together. `go_on` is asked at each frame, and told the
    /// part of the clip that has been read; where it says no, that is [`CaptureError::Stopped`].
    pub fn load(inputs: &CaptureInputs, options: &CaptureOptions, go_on: GoOn<'_>) -> Result<Self, CaptureError> {
        let deadline = Instant::now() + LOAD_TIME;
        let parts = SmallParts::read(inputs)?;
        let (count, most) = (parts.keypoints.frames.len(), options.max_frames as usize);
        let (shown, before): (Vec<usize>, f32) = if count > most {
            let shown = with_somebody(&inputs.masks, count, deadline, &mut |read| go_on(MASKS_SHARE * read))?;
            (shown, MASKS_SHARE)
        } else {
            ((0..count).collect(), 0.0)
        };
        let kept: Vec<usize> = subsample(shown.len(), most).into_iter().map(|i| shown[i]).collect();
        let go_on = &mut |read| go_on(before + (1.0 - before) * read);
        Self::of(parts, inputs, &kept, options.max_side_px, deadline, go_on)
    }

    /// As [`Capture::load`], but of the frames with these numbers in the video, which rise.
    pub fn load_frames(
        inputs: &CaptureInputs,
        frames: &[u32],
        max_side_px: u32,
        go_on: GoOn<'_>,
    ) -> Result<Self, CaptureError> {
        let kept: Vec<usize> = frames.iter().map(|&frame| frame as usize).collect();
        Self::of(SmallParts::read(inputs)?, inputs, &kept, max_side_px, Instant::now() + LOAD_TIME, go_on)
    }

    /// Makes the focal length the guess that it is where no camera came with a clip; pixels that are not square stay so.
    pub fn forget_focal(&mut self) {
        let Camera { width, height, fx, fy, .. } = self.camera;
        let factor = calibration::guess(width, height, fy / fx).fx / fx;
        (self.camera.fx, self.camera.fy) = (self.camera.fx * factor, self.camera.fy * factor);
        self.camera_estimated = true;
    }

    fn of(
        parts: SmallParts,
        inputs: &CaptureInputs,
        kept: &[usize],
        max_side_px: u32,
        deadline: Instant,
        go_on: GoOn<'_>,
    ) -> Result<Self, CaptureError> {
        let video = Source::open_kept(&inputs.video, kept, parts.keypoints.frames.len(), deadline)?;
        let mut clip = parts.open(video, inputs, deadline)?;
        let mut rectify = None;
        let mut frames = Vec::with_capacity(kept.len());
        let (mut vanished, mut room) = (Vec::new(), Room::default());
        let (camera, pixels) = (clip.camera.clone(), clip.video.pixels);
        clip.walk(
            |index| kept.binary_search(&index).is_ok(),
            |size, still| {
                if rectify.is_none() {
                    let aspect = pixels.map_or(1.0, |pixels| pixels.aspect_at(size));
                    let camera = camera.clone().unwrap_or_else(|| calibration::guess(size.0, size.1, aspect));
                    rectify = Some(Rectify::new(camera, max_side_px.max(16))?);
                }
                if let (Some(rectify), Some(bounds)) = (&rectify, still.bounds) {
                    match cut_out(rectify, &still, bounds) {
                        Some(frame) => {
                            room.take(&frame)?;
                            frames.push(frame);
                        }
                        None => vanished.push(still.index),
                    }
                }
                Ok(())
            },
            go_on,
        )?;
        let Some(rectify) = rectify else {
            return Err(BadInput::new(Part::Video, "0 frames could be read", "at least one frame").into());
        };
        if let Some(&first) = vanished.first() {
            let (width, height) = (rectify.camera.width, rectify.camera.height);
            let message = format!("nothing of the mask is left at {width}×{height} pixels");
            if frames.is_empty() {
                let expected = "a person that is larger in the image";
                return Err(BadInput::new(Part::Masks, message, expected).at(first).into());
            }
            let count = format!("{} of {}", vanished.len(), vanished.len() + frames.len());
            clip.warnings.push(format!("masks: {message} in {count} frames, the first of them {first}: left out"));
        }
        if frames.is_empty() {
            let message = format!("of the {} frames that are kept, each has an empty mask", kept.len());
            return Err(BadInput::new(Part::Masks, message, "a person in most masks").into());
        }
        if kept.len() < clip.points.len() {
            smoothing::smooth(&mut clip.points);
        }
        for frame in &mut frames {
            frame.keypoints = rectified(&rectify, &clip.points[frame.index as usize]);
        }
        let shown: Vec<usize> = frames.iter().map(|frame| frame.index as usize).collect();
        Ok(Self {
            camera: rectify.camera,
            uploaded_side_px: clip.size.0.max(clip.size.1),
            camera_estimated: clip.camera.is_none(),
            fps: clip.fps(),
            frames,
            keypoint_format: clip.keypoints.format.name.to_owned(),
            given_keypoint_format: clip.keypoints.given.name.to_owned(),
            poses: clip.poses.as_ref().map(|poses| poses.subset(&shown)),
            warnings: clip.warnings,
        })
    }
}

/// Pixels of kept frames that a fit holds at the same time, at some ten bytes each with what is on the device.
#[derive(Default)]
struct Room {
    pixels: u64,
}

impl Room {
    const PIXELS: u64 = 400_000_000;
    /// Of one frame: at 16 bytes each what the smallest allowed binding of a device holds.
    const FRAME_PIXELS: u64 = 8_000_000;

    fn take(&mut self, frame: &Frame) -> Result<(), BadInput> {
        let pixels = u64::from(frame.width) * u64::from(frame.height);
        if pixels > Self::FRAME_PIXELS {
            let message = format!("the person takes up {}×{} pixels", frame.width, frame.height);
            let expected = format!("at most {} million; a smaller `max_side_px`", Self::FRAME_PIXELS / 1_000_000);
            return Err(BadInput::new(Part::Video, message, expected).at(frame.index as usize));
        }
        self.pixels += pixels;
        if self.pixels <= Self::PIXELS {
            return Ok(());
        }
        let message =
            format!("the people in the kept frames have more than {} million pixels", Self::PIXELS / 1_000_000);
        Err(BadInput::new(Part::Video, message, "a smaller `max_frames` or `max_side_px`").at(frame.index as usize))
    }
}

/// The numbers of the frames whose masks are not empty, of the first `count`; a fit that cannot have all frames takes its own
/// from these. Sizes and counts are the walk's to check.
fn with_somebody(masks: &Path, count: usize, deadline: Instant, go_on: GoOn<'_>) -> Result<Vec<usize>, CaptureError> {
    let mut masks = Source::open(Part::Masks, masks, Pixels::Mask, false, deadline)?;
    let (mut check, mut shown) = (MaskCheck::default(), Vec::new());
    for index in 0..count {
        let Some(mask) = masks.next(true)? else { break };
        if !go_on(index as f32 / count as f32) {
            return Err(CaptureError::Stopped);
        }
        if check.look(index, &mask).is_some() {
            shown.push(index);
        }
    }
    Ok(shown)
}

/// `most` of `count` frames, evenly spread from the first one on.
fn subsample(count: usize, most: usize) -> Vec<usize> {
    let kept = count.min(most.max(1));
    (0..kept).map(|i| i * count / kept).collect()
}

/// Uploaded points in the rectified images.
fn rectified(rectify: &Rectify, points: &[Point]) -> Vec<[f32; 3]> {
    let rectified = points.iter().map(|&[x, y, confidence]| {
        let seen = if confidence > 0.0 { rectify.rectified_from_uploaded(x, y) } else { None };
        seen.map_or([0.0; 3], |(x, y)| [x as f32, y as f32, confidence as f32])
    });
    rectified.collect()
}

/// The rectified crop round the person, without keypoints: the mask's box, and a margin of 12 pixels and 4 % of its longer
/// side. `None` where nothing of the mask is left at that size.
fn cut_out(rectify: &Rectify, still: &Still<'_>, bounds: Rect) -> Option<Frame> {
    let (width, height) = (rectify.camera.width, rectify.camera.height);
    let rough = rectify.bounds(bounds);
    let exact = foreground_box(&rectify.mask(still.mask, rough), rough)?;
    let margin = 12 + exact.width().max(exact.height()) / 25;
    let crop = exact.grown(margin, width, height);
    Some(Frame {
        index: still.index as u32,
        x0: crop.x0,
        y0: crop.y0,
        width: crop.width(),
        height: crop.height(),
        rgb: rectify.rgb(still.image, crop),
        mask: rectify.mask(still.mask, crop),
        keypoints: Vec::new(),
    })
}

/// The box of the set pixels of a mask that covers `rect`, in the image's coordinates.
fn foreground_box(mask: &[u8], rect: Rect) -> Option<Rect> {
    let (mut x0, mut y0, mut x1, mut y1) = (u32::MAX, u32::MAX, 0, 0);
    for (row, y) in mask.chunks_exact(rect.width().max(1) as usize).zip(rect.y0..) {
        let Some(first) = row.iter().position(|&v| v > 0) else { continue };
        let last = row.iter().rposition(|&v| v > 0).unwrap_or(first);
        (x0, x1) = (x0.min(rect.x0 + first as u32), x1.max(rect.x0 + last as u32 + 1));
        (y0, y1) = (y0.min(y), y + 1);
    }
    (x0 < x1).then_some(Rect { x0, y0, x1, y1 })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_kept_evenly() {
        assert_eq!(subsample(60, 100), (0..60).collect::<Vec<_>>());
        assert_eq!(subsample(10, 4), [0, 2, 5, 7]);
        assert_eq!(subsample(10, 0), [0]);
        assert!(subsample(0, 4).is_empty());
    }

    #[test]
    fn people_have_room_up_to_a_size_and_a_sum() {
        let (rgb, mask, keypoints) = (Vec::new(), Vec::new(), Vec::new());
        let empty = Frame { index: 7, x0: 0, y0: 0, width: 0, height: 0, rgb, mask, keypoints };
        let frame = |width, height| Frame { width, height, ..empty.clone() };
        let mut room = Room::default();
        for _ in 0..50 {
            room.take(&frame(2000, 4000)).unwrap();
        }
        let message = room.take(&frame(2000, 4000)).unwrap_err().to_string();
        assert!(message.contains("400 million") && message.contains("max_frames"), "{message}");
        let message = Room::default().take(&frame(2001, 4000)).unwrap_err().to_string();
        assert!(message.contains("2001×4000") && message.contains("8 million"), "{message}");
    }

    #[test]
    fn the_box_of_a_part_of_a_mask() {
        let rect = Rect { x0: 10, y0: 20, x1: 14, y1: 23 };
        let mask = [0, 0, 0, 0, 0, 255, 255, 0, 0, 255, 0, 0];
        assert_eq!(foreground_box(&mask, rect), Some(Rect { x0: 11, y0: 21, x1: 13, y1: 23 }));
        assert_eq!(foreground_box(&[0; 12], rect), None);
    }
}
