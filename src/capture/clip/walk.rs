//! The walk through a clip: video and masks frame by frame, everything checked against everything.

use std::fmt::Write as _;
use std::time::Instant;

use super::{CaptureInputs, GoOn};
use crate::camera::Camera;
use crate::capture::checks::{FigureCheck, KeypointCheck, MaskCheck, PoseCheck, check_not_normalised};
use crate::capture::keypoints::{Keypoints, Point};
use crate::capture::rectify::{Rect, Rectify};
use crate::capture::source::{Picture, Pixels, Source};
use crate::capture::{BadInput, CaptureError, KnownPoses, Part, calibration, keypoints, poses};

/// One frame of the walk.
pub(super) struct Still<'a> {
    pub index: usize,
    /// Without pixels where the frame is not kept.
    pub image: &'a Picture,
    pub mask: &'a Picture,
    /// Of the mask's foreground.
    pub bounds: Option<Rect>,
}

/// The parts of an upload that are read whole.
pub(super) struct SmallParts {
    pub keypoints: Keypoints,
    camera: Option<Camera>,
    poses: Option<KnownPoses>,
    warnings: Vec<String>,
}

impl SmallParts {
    pub fn read(inputs: &CaptureInputs) -> Result<Self, CaptureError> {
        let camera = inputs.camera.as_deref().map(calibration::read).transpose()?;
        let mut keypoints = keypoints::read(&inputs.keypoints)?;
        check_not_normalised(&keypoints)?;
        let poses = inputs.poses.as_deref().map(poses::read).transpose()?;
        let (poses, odd) = poses.map_or((None, Vec::new()), |(poses, odd)| (Some(poses), odd));
        let mut warnings = std::mem::take(&mut keypoints.warnings);
        warnings.extend(odd);
        Ok(Self { keypoints, camera, poses, warnings })
    }

    /// Goes on with the pictures.
    pub fn open(self, mut video: Source, inputs: &CaptureInputs, deadline: Instant) -> Result<Clip, CaptureError> {
        let Self { keypoints, camera, poses, warnings: small } = self;
        let mut masks = Source::open(Part::Masks, &inputs.masks, Pixels::Mask, false, deadline)?;
        let mut warnings = std::mem::take(&mut video.warnings);
        warnings.append(&mut masks.warnings);
        if video.fps.is_none() {
            warnings.push("video: images tell no frame rate: 30 a second assumed".to_owned());
        }
        warnings.extend(small);
        Ok(Clip { video, masks, keypoints, camera, poses, size: (0, 0), points: Vec::new(), warnings })
    }
}

/// The parts of an upload, opened.
pub(super) struct Clip {
    pub video: Source,
    masks: Source,
    pub keypoints: Keypoints,
    pub camera: Option<Camera>,
    pub poses: Option<KnownPoses>,
    pub size: (u32, u32),
    /// `[N]`: of the person on the mask, for the frames that the walk has seen.
    pub points: Vec<Vec<Point>>,
    pub warnings: Vec<String>,
}

impl Clip {
    pub fn fps(&self) -> f64 {
        self.video.fps.unwrap_or(30.0)
    }

    /// Goes through all frames; `keep` tells of which the pixels are wanted, and `visit` gets those.
    pub fn walk(
        &mut self,
        keep: impl Fn(usize) -> bool,
        mut visit: impl FnMut((u32, u32), Still<'_>) -> Result<(), BadInput>,
        go_on: GoOn<'_>,
    ) -> Result<(), CaptureError> {
        let (mut mask_check, mut keypoint_check) = (MaskCheck::default(), KeypointCheck::default());
        let (mut pose_check, mut figure_check) = (PoseCheck::default(), FigureCheck::default());
        loop {
            let index = self.video.count;
            let count = self.keypoints.frames.len();
            if !go_on((index as f32 / count.max(1) as f32).min(1.0)) {
                return Err(CaptureError::Stopped);
            }
            let expected = index < count;
            let image = self.video.next(expected && keep(index))?;
            let mask = self.masks.next(true)?;
            if let Some(image) = &image {
                self.check_size(index, image)?;
            }
            if let Some(mask) = &mask {
                self.check_mask_size(self.masks.count - 1, mask)?;
            }
            match (image, mask) {
                (Some(image), Some(mask)) if expected => {
                    let bounds = mask_check.look(index, &mask);
                    let known = self.poses.as_ref().filter(|poses| index < poses.trans.len());
                    if let (Some(poses), Some(bounds)) = (known, bounds) {
                        pose_check.look(index, poses, self.camera.as_ref(), bounds);
                    }
                    // Where the mask tells nobody, a detector may have found somebody else.
                    let points = match bounds {
                        Some(bounds) => keypoint_check.choose(index, &self.keypoints, &mask, bounds),
                        None => vec![[0.0; 3]; self.keypoints.format.points],
                    };
                    let format = self.keypoints.format.name;
                    if let Some(bounds) = bounds {
                        figure_check.look(index, format, &points, &mask, bounds);
                    }
                    if let Some(poses) = known {
                        figure_check.look_at_root(index, poses, self.camera.as_ref(), format, &points);
                    }
                    self.points.push(points);
                    if keep(index) {
                        visit(self.size, Still { index, image: &image, mask: &mask, bounds })?;
                    }
                }
                (None, None) => break,
                // One part is longer than another: the rest is only counted.
                _ => {}
            }
        }
        self.check_counts()?;
        mask_check.finish(&mut self.warnings)?;
        keypoint_check.finish(&mut self.warnings)?;
        pose_check.finish(&mut self.warnings)?;
        figure_check.finish(&mut self.warnings)?;
        Ok(())
    }

    /// The first frame fixes the size, and the camera must be of it, with a lens that makes sense there.
    fn check_size(&mut self, index: usize, image: &Picture) -> Result<(), BadInput> {
        if index == 0 {
            self.size = (image.width, image.height);
            self.keypoints.fit_canvas(image.width, image.height, &mut self.warnings)?;
            let Some(camera) = &self.camera else { return Ok(()) };
            calibration::check_size(camera, image.width, image.height).map_err(|bad| self.video.named(index, bad))?;
            return Rectify::new(camera.clone(), u32::MAX).map(drop);
        }
        let (width, height) = self.size;
        if (image.width, image.height) == self.size {
            return Ok(());
        }
        let message = format!("the image is {}×{}", image.width, image.height);
        let bad = BadInput::new(Part::Video, message, format!("{width}×{height}, as the first image")).at(index);
        Err(self.video.named(index, bad))
    }

    fn check_mask_size(&self, index: usize, mask: &Picture) -> Result<(), BadInput> {
        let (width, height) = self.size;
        if (mask.width, mask.height) == self.size {
            return Ok(());
        }
        let hint = if (mask.height, mask.width) == self.size { ", turned against the video" } else { "" };
        let message = format!("the mask is {}×{}{hint}", mask.width, mask.height);
        let bad = BadInput::new(Part::Masks, message, format!("{width}×{height}, as the video")).at(index);
        Err(self.masks.named(index, bad))
    }

    /// What makes another count of frames, usually.
    fn advice(&self, part: Part) -> &'static str {
        match part {
            Part::Keypoints => "; `[]`, or a file without people, for one in which nobody was found",
            Part::Poses => "",
            // A tool that writes at a constant rate doubles and drops frames of a phone's video.
            _ if self.video.fps.is_some() => {
                "; `ffmpeg -i video -fps_mode passthrough frames/%05d.png` takes it apart frame by frame"
            }
            _ => "",
        }
    }

    fn check_counts(&mut self) -> Result<(), BadInput> {
        let (frames, masks, keypoints) = (self.video.count, self.masks.count, self.keypoints.frames.len());
        let poses = self.poses.as_ref().map_or(frames, |poses| poses.poses.len());
        let counts = [(Part::Masks, masks), (Part::Keypoints, keypoints), (Part::Poses, poses)];
        let odd = counts.into_iter().find(|(_, count)| *count != frames);
        // A damaged file is the better explanation of a count that differs, if it is its own.
        let none_has_its =
            counts.iter().all(|(part, count)| *count != frames || *part == Part::Poses && self.poses.is_none());
        let is_odd = |part| match part {
            Part::Video => none_has_its,
            part => odd.is_some_and(|(odd, _)| odd == part),
        };
        for (part, source) in [(Part::Video, &self.video), (Part::Masks, &self.masks)] {
            let Some(damage) = source.damage() else { continue };
            if is_odd(part) {
                let message = format!("the file is damaged, {} frames could be read: {damage}", source.count);
                return Err(BadInput::new(part, message, "a whole video file"));
            }
            self.warnings.push(format!("{part}: FFmpeg complained, but read {} frames: {damage}", source.count));
        }
        match odd {
            None => Ok(()),
            Some((part, count)) => {
                let mut message = format!("there are {count} frames of {part}, the video has {frames}");
                let expected = format!("{frames}, one for each frame of the video{}", self.advice(part));
                let (ignored, gap) = match part {
                    Part::Masks => (self.masks.ignored(), self.masks.gap()),
                    Part::Keypoints => (0, self.keypoints.gap),
                    _ => (0, None),
                };
                if ignored > 0 {
                    let _ = write!(message, "; {ignored} files of the zip are no PNG or JPEG");
                }
                if let Some(gap) = gap {
                    let _ = write!(message, "; the names of the zip's files leave out {gap}");
                }
                Err(BadInput::new(part, message, expected))
            }
        }
    }
}
