//! Pictures into a video file, through the system's FFmpeg.

use std::io::Write;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use image::RgbImage;

/// Why no video was written.
#[derive(Debug, thiserror::Error)]
pub enum VideoError {
    #[error("ffmpeg could not be started: {0}")]
    Start(std::io::Error),
    #[error("a picture of {got:?} px in a video of {want:?} px")]
    Size { got: (u32, u32), want: (u32, u32) },
    #[error("ffmpeg failed: {0}")]
    Failed(String),
}

/// H.264 in MP4, full chroma or 4:2:0, one picture after another.
pub struct VideoWriter {
    child: Child,
    size: (u32, u32),
}

/// How colours are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quality {
    /// 4:2:0, which every player shows; needs even sides.
    Playable,
    /// 4:4:4, nearly lossless.
    Fine,
    /// 4:2:0 at so many kilobits a second; needs even sides.
    Rate(u32),
}

impl VideoWriter {
    /// Starts FFmpeg; `path` is overwritten.
    pub fn create(path: &Path, size: (u32, u32), fps: f64, quality: Quality) -> Result<Self, VideoError> {
        let (format, rate) = match quality {
            Quality::Playable => ("yuv420p", ["-crf".to_owned(), "18".to_owned()]),
            Quality::Fine => ("yuv444p", ["-crf".to_owned(), "12".to_owned()]),
            Quality::Rate(kilobits) => ("yuv420p", ["-b:v".to_owned(), format!("{kilobits}k")]),
        };
        // Players take a video of 720 lines or more for BT.709 where it does not say; FFmpeg by itself makes BT.601 of RGB.
        let colours: &[&str] = match quality {
            Quality::Playable => &[
                "-vf",
                "scale=out_color_matrix=bt709:out_range=tv",
                "-colorspace",
                "bt709",
                "-color_primaries",
                "bt709",
                "-color_trc",
                "bt709",
                "-color_range",
                "tv",
            ],
            Quality::Fine | Quality::Rate(_) => &[],
        };
        let input = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s"];
        let child = Command::new("ffmpeg")
            .args(["-v", "error", "-y"])
            .args(input)
            .args([&format!("{}x{}", size.0, size.1), "-r", &fps.to_string(), "-i", "-"])
            .args(["-c:v", "libx264", "-preset", "medium"])
            .args(rate)
            .args(colours)
            .args(["-pix_fmt", format, "-movflags", "+faststart"])
            .arg(path)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(VideoError::Start)?;
        Ok(Self { child, size })
    }

    pub fn push(&mut self, image: &RgbImage) -> Result<(), VideoError> {
        if image.dimensions() != self.size {
            return Err(VideoError::Size { got: image.dimensions(), want: self.size });
        }
        // A broken pipe means that FFmpeg ended: `finish` says why.
        let broken = || VideoError::Failed("it stopped reading pictures".to_owned());
        self.child.stdin.as_mut().ok_or_else(broken)?.write_all(image.as_raw()).map_err(|_| broken())
    }

    /// Waits for the file to be whole.
    pub fn finish(mut self) -> Result<(), VideoError> {
        drop(self.child.stdin.take());
        let mut complaint = String::new();
        if let Some(mut stderr) = self.child.stderr.take() {
            let _ = std::io::Read::read_to_string(&mut stderr, &mut complaint);
        }
        let status = self.child.wait().map_err(|e| VideoError::Failed(e.to_string()))?;
        if status.success() { Ok(()) } else { Err(VideoError::Failed(complaint.trim().to_owned())) }
    }
}

impl Drop for VideoWriter {
    fn drop(&mut self) {
        // After `finish` the child is gone and this does nothing.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_player_is_told_which_colours_it_gets() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("film.mp4");
        let mut film = VideoWriter::create(&path, (64, 64), 10.0, Quality::Playable).unwrap();
        (0..3).for_each(|_| film.push(&RgbImage::from_pixel(64, 64, image::Rgb([200, 120, 90]))).unwrap());
        film.finish().unwrap();
        let entries = "stream=color_range,color_space,color_transfer,color_primaries";
        let probe =
            Command::new("ffprobe").args(["-v", "error", "-of", "csv", "-show_entries", entries]).arg(&path).output();
        assert_eq!(String::from_utf8(probe.unwrap().stdout).unwrap().trim(), "stream,tv,bt709,bt709,bt709");
        // As a player does that heeds them.
        let decode = [
            "-vf",
            "scale=in_color_matrix=bt709:in_range=tv",
            "-frames:v",
            "1",
            "-f",
            "rawvideo",
            "-pix_fmt",
            "rgb24",
            "-",
        ];
        let rgb = Command::new("ffmpeg").args(["-v", "error", "-i"]).arg(&path).args(decode).output().unwrap().stdout;
        let middle = &rgb[3 * (32 * 64 + 32)..][..3];
        assert!(middle.iter().zip([200u8, 120, 90]).all(|(&a, b)| a.abs_diff(b) <= 3), "{middle:?}");
    }
}
