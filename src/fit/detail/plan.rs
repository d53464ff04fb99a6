//! Which frames are looked at once more, and how large.

use crate::capture::Capture;
use crate::fit::config::FitConfig;

/// Frames at most: a turn in steps of nine degrees.
const FRAMES: usize = 40;

/// What the longer side of a person's crop has at most, pixels.
const MOST_PX: f64 = 1600.0;

/// Uploaded pictures of less than this many times the fit's resolution are not read again, larger ones of no use.
const LEAST_GAIN: f64 = 1.25;

/// Pictures in which the person has no more than this part of [`MOST_PX`] are enlarged by this.
const ENLARGED: u32 = 2;

/// Passes of each round: a texture that has learned some of pictures in their places shows better where these are.
pub const ROUNDS: [u32; 3] = [2, 2, 6];

/// What the texture's fit has in each round, after a fit with `config`.
pub fn rounds(config: &FitConfig) -> [FitConfig; ROUNDS.len()] {
    ROUNDS.map(|passes| config.clone().detailed(passes))
}

/// Which frames are looked at once more, and how large.
#[derive(Clone, Debug, PartialEq)]
pub struct DetailPlan {
    /// Of the fit's frames.
    pub(super) kept: Vec<usize>,
    /// Their numbers in the video.
    pub frames: Vec<u32>,
    /// The longer side of the whole picture, pixels.
    pub side_px: u32,
    /// Pixels over those of the fit, along a side; one where the fit's own pictures are looked at again.
    pub gain: f64,
    /// How many times larger each picture is made.
    pub(super) enlarged: u32,
}

impl DetailPlan {
    /// `None` where there is nothing larger and nothing to enlarge.
    pub fn to(capture: &Capture) -> Option<Self> {
        let side = f64::from(capture.camera.width.max(capture.camera.height));
        let person = f64::from(capture.frames.iter().map(|frame| frame.width.max(frame.height)).max()?.max(1));
        let larger = (f64::from(capture.uploaded_side_px) / side).min(MOST_PX / person);
        let gain = if larger < LEAST_GAIN { 1.0 } else { larger };
        let enlarged = if person * gain * f64::from(ENLARGED) <= MOST_PX { ENLARGED } else { 1 };
        if gain * f64::from(enlarged) < LEAST_GAIN {
            return None;
        }
        let (all, n) = (capture.frames.len(), capture.frames.len().min(FRAMES));
        let kept: Vec<usize> = (0..n).map(|i| i * all / n).collect();
        let frames = kept.iter().map(|&k| capture.frames[k].index).collect();
        Some(Self { kept, frames, side_px: (side * gain).round() as u32, gain, enlarged })
    }

    /// Steps after a fit with `config`, if each frame has its close-up.
    pub fn steps(&self, config: &FitConfig) -> u32 {
        rounds(config).iter().map(|round| round.steps(&round.texture.phases, 2 * self.kept.len())).sum()
    }

    /// The fit's own pictures of the frames, where there are no larger ones.
    pub fn own(&self, capture: &Capture) -> Option<Capture> {
        (self.gain == 1.0).then(|| Capture {
            camera: capture.camera.clone(),
            uploaded_side_px: capture.uploaded_side_px,
            camera_estimated: capture.camera_estimated,
            fps: capture.fps,
            frames: self.of(&capture.frames),
            keypoint_format: capture.keypoint_format.clone(),
            given_keypoint_format: capture.given_keypoint_format.clone(),
            poses: None,
            warnings: Vec::new(),
        })
    }

    /// Values a frame of the fit, for the frames that are looked at.
    pub fn of<T: Clone>(&self, values: &[T]) -> Vec<T> {
        self.kept.iter().filter_map(|&k| values.get(k).cloned()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::detail::testing::capture;

    #[test]
    fn larger_pictures_are_looked_at_in_some_frames_and_up_to_a_size() {
        assert_eq!(DetailPlan::to(&capture(60, 1080, 1080, 900)), None);
        assert_eq!(DetailPlan::to(&capture(60, 1080, 1300, 900)), None, "hardly larger");
        let small = DetailPlan::to(&capture(60, 360, 440, 300)).unwrap();
        assert_eq!((small.side_px, small.gain, small.enlarged), (360, 1.0, 2));
        let own = small.own(&capture(60, 360, 440, 300)).unwrap();
        assert_eq!(own.frames.iter().map(|frame| frame.index).collect::<Vec<_>>(), small.frames);
        let plan = DetailPlan::to(&capture(120, 720, 1920, 500)).unwrap();
        assert_eq!((plan.side_px, plan.frames.len(), plan.enlarged), (1920, FRAMES, 1));
        assert!(plan.own(&capture(120, 720, 1920, 500)).is_none(), "there are larger ones");
        assert_eq!(plan.frames[..3], [0, 6, 12], "every third, at two frames of the video each");
        assert_eq!(plan.of(&(0..120).collect::<Vec<_>>())[..3], [0, 3, 6]);
        let plan = DetailPlan::to(&capture(8, 720, 3840, 640)).unwrap();
        assert_eq!((plan.side_px, plan.gain, plan.frames.len()), (1800, 2.5, 8), "the person has 1600 pixels");
    }
}
