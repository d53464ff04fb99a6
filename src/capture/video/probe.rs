//! A video file's header, as FFmpeg's `ffprobe` tells it.

use std::path::Path;

use super::ffmpeg::run;
use super::{FORMATS, PROTOCOLS};
use crate::capture::hdr::Colours;
use crate::capture::{BadInput, CaptureError, Part};

/// Phones film slow motion with up to 960.
const MOST_FRAMES_A_SECOND: f64 = 960.0;

pub(super) const READABLE: &str = "a video that FFmpeg reads, or a zip of PNG or JPEG images";

#[derive(serde::Deserialize)]
pub(super) struct Probe {
    #[serde(default)]
    pub streams: Vec<ProbeStream>,
}

#[derive(Default, serde::Deserialize)]
#[serde(default)]
pub(super) struct ProbeStream {
    pub width: u32,
    pub height: u32,
    pub avg_frame_rate: String,
    pub r_frame_rate: String,
    pub nb_frames: Option<String>,
    pub duration: Option<String>,
    pub sample_aspect_ratio: String,
    pub codec_name: String,
    pub pix_fmt: String,
    pub tags: ProbeTags,
    #[serde(flatten)]
    pub colours: Colours,
}

#[derive(Default, serde::Deserialize)]
#[serde(default)]
pub(super) struct ProbeTags {
    #[serde(alias = "ALPHA_MODE")]
    pub alpha_mode: String,
}

impl Probe {
    /// Reads the header of a file, which `url` names for FFmpeg.
    pub fn of(part: Part, path: &Path, url: &str) -> Result<Self, CaptureError> {
        let arguments = [
            "-hide_banner",
            "-v",
            "error",
            "-protocol_whitelist",
            PROTOCOLS,
            "-format_whitelist",
            FORMATS,
            "-select_streams",
            "V",
            "-show_streams",
            "-of",
            "json",
            url,
        ];
        let (json, outcome) = run("ffprobe", &arguments, Some(path), 4 << 20)?;
        if outcome.timed_out {
            let message = "reading its header took too long";
            return Err(BadInput::new(part, message, READABLE).into());
        }
        if !outcome.success {
            return Err(BadInput::new(part, format!("this is no readable video{}", outcome.because()), READABLE).into());
        }
        serde_json::from_slice(&json)
            .map_err(|e| CaptureError::internal("the answer of `ffprobe`", std::io::Error::other(e)))
    }
}

impl ProbeStream {
    /// Frames that the header counts, less what an edit list hides: a clip that was cut without encoding it anew counts the frames
    /// before the cut too, but its duration does not. A duration by itself tells no count, since the rate may be nominal and
    /// timestamps may jump.
    pub fn announced(&self) -> Option<u32> {
        let counted: u32 = self.nb_frames.as_ref()?.parse().ok().filter(|&n| n > 0)?;
        let duration: Option<f64> = self.duration.as_ref().and_then(|duration| duration.parse().ok());
        let shown = duration.zip(self.rate()).map(|(duration, rate)| (duration * rate).floor() as u32);
        Some(shown.map_or(counted, |shown| counted.min(shown)))
    }

    /// The width of a stored pixel over its height, where the header tells of one that is not square.
    pub fn pixel_aspect(&self) -> Option<f64> {
        let (width, height) = self.sample_aspect_ratio.split_once(':')?;
        let aspect = width.parse::<f64>().ok()? / height.parse::<f64>().ok()?;
        (aspect != 1.0 && PIXEL_ASPECTS.contains(&aspect)).then_some(aspect)
    }

    /// Frames a second, where the container tells.
    pub fn rate(&self) -> Option<f64> {
        frame_rate(&self.avg_frame_rate).or(frame_rate(&self.r_frame_rate))
    }
}

/// Transparency beside a video's colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Alpha {
    /// In the pictures themselves.
    Stored,
    /// In a second stream of VP8's or VP9's, which this decoder reads and FFmpeg's own does not.
    Beside(&'static str),
}

impl Alpha {
    pub fn of(stream: &ProbeStream) -> Option<Self> {
        let beside = stream.tags.alpha_mode == "1";
        match stream.codec_name.as_str() {
            "vp8" if beside => return Some(Self::Beside("libvpx")),
            "vp9" if beside => return Some(Self::Beside("libvpx-vp9")),
            _ => {}
        }
        let names = ["yuva", "gbrap", "rgba", "bgra", "argb", "abgr", "ya8", "ya16", "pal8"];
        names.iter().any(|name| stream.pix_fmt.starts_with(name)).then_some(Self::Stored)
    }
}

/// Frames a second; `None` also where the container tells the unit of its clock instead, as files of browsers' recorders do.
fn frame_rate(text: &str) -> Option<f64> {
    let (numerator, denominator) = text.split_once('/')?;
    let rate = numerator.parse::<f64>().ok()? / denominator.parse::<f64>().ok()?;
    (rate > 0.0 && rate <= MOST_FRAMES_A_SECOND).then_some(rate)
}

/// Of stored pictures, which a rotation tag may turn.
#[derive(Clone, Copy, Debug)]
pub(in crate::capture) struct PixelShape {
    pub stored: (u32, u32),
    /// The width of a stored pixel over its height
    pub aspect: f64,
}

impl PixelShape {
    /// The width of a pixel over its height, in decoded pictures of this size.
    pub fn aspect_at(self, size: (u32, u32)) -> f64 {
        if size == self.stored { self.aspect } else { 1.0 / self.aspect }
    }
}

/// What a pixel may be like; beyond it the header is wrong.
const PIXEL_ASPECTS: std::ops::RangeInclusive<f64> = 0.25..=4.0;

/// What is unusual in a header, for the report; `rate` is what it tells of frames a second.
pub(super) fn oddities(stream: &ProbeStream, rate: Option<f64>) -> Vec<String> {
    let mut warnings = Vec::new();
    if rate.is_none() {
        warnings.push("the file tells no frame rate: 30 a second assumed".to_owned());
    }
    if stream.pixel_aspect().is_some() {
        let ratio = &stream.sample_aspect_ratio;
        warnings.push(format!(
            "the pixels are not square ({ratio}): masks, keypoints and a camera are those of the stored pixels, and a camera that is \
             guessed has such pixels"
        ));
    }
    warnings
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clocks_unit_is_no_frame_rate() {
        assert_eq!(frame_rate("30000/1001"), Some(30_000.0 / 1001.0));
        assert_eq!(frame_rate("240/1"), Some(240.0));
        for odd in ["1000/1", "90000/1", "0/0", "1/0", "0/1", "30"] {
            assert_eq!(frame_rate(odd), None, "{odd}");
        }
    }
}
