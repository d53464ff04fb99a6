//! A clip in memory, to be spoiled and written again.

use std::fs::File;
use std::io::{BufReader, BufWriter, Cursor, Read, Write};
use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context as _, Result, ensure};
use image::{GrayImage, ImageFormat, RgbImage};
use serde::{Deserialize, Serialize};

use crate::camera::Camera;
use crate::eval::Subject;
use crate::mask::is_foreground;
use crate::video_writer::{Quality, VideoWriter};

/// Our JSON of keypoints.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Keypoints {
    pub format: String,
    /// `[T][K]` x, y in pixels and confidence
    pub frames: Vec<Vec<[f64; 3]>>,
}

/// The pictures of a clip with all that is uploaded beside them.
#[derive(Clone, Debug)]
pub struct Footage {
    pub frames: Vec<RgbImage>,
    pub masks: Vec<GrayImage>,
    pub keypoints: Keypoints,
    /// Written where it is known.
    pub camera: Option<Camera>,
    pub fps: f64,
    /// Kilobits a second of the video; without it, it is nearly lossless.
    pub bit_rate: Option<u32>,
    /// Frames that the fit may keep.
    pub max_frames: Option<u32>,
    /// `[T][24]`: the true joints in the picture, for perturbations that must know where a part of the body is.
    pub joints_px: Vec<Vec<[f64; 2]>>,
}

impl Footage {
    /// Reads a folder as `effigy synth` lays it out: `video.mp4`, `masks.zip`, `keypoints.json`, `camera.json` and
    /// `truth/joints3d.json`.
    pub fn read(folder: &Path) -> Result<Self> {
        let keypoints: Keypoints = json(&folder.join("keypoints.json"))?;
        let camera: Camera = json(&folder.join("camera.json"))?;
        let subject = Subject::open(folder)?;
        let n = keypoints.frames.len();
        ensure!(subject.joints.len() == n, "truth/joints3d.json: {} frames, expected {n}", subject.joints.len());
        let pixels = |joints: &Vec<[f64; 3]>| joints.iter().map(|p| camera.project(*p)).collect();
        let joints_px = subject.joints.iter().map(pixels).collect();
        let numbers: Vec<u32> = (0..n as u32).collect();
        let masks: Option<Vec<GrayImage>> = subject.masks(&numbers)?.into_iter().collect();
        let masks = masks.filter(|masks| masks.len() == n).context("masks.zip: expected a mask for each frame")?;
        let frames = decode(&folder.join("video.mp4"), camera.width, camera.height)?;
        ensure!(frames.len() == n, "video.mp4: {} frames, expected {n}", frames.len());
        Ok(Self {
            frames,
            masks,
            keypoints,
            camera: Some(camera),
            fps: 30.0,
            bit_rate: None,
            max_frames: None,
            joints_px,
        })
    }

    pub fn size(&self) -> (u32, u32) {
        self.frames.first().map_or((1, 1), |frame| frame.dimensions())
    }

    /// Mean height of the masks' boxes, pixels.
    pub fn person_px(&self) -> f64 {
        let height = |mask: &GrayImage| {
            let row = |y: &u32| (0..mask.width()).any(|x| is_foreground(mask.get_pixel(x, *y).0[0]));
            let (first, last) = ((0..mask.height()).find(row), (0..mask.height()).rev().find(row));
            first.zip(last).map_or(0.0, |(a, b)| f64::from(b + 1 - a))
        };
        self.masks.iter().map(height).sum::<f64>() / self.masks.len().max(1) as f64
    }

    /// Keeps the first `n` frames.
    pub fn shorten(&mut self, n: usize) {
        self.frames.truncate(n);
        self.masks.truncate(n);
        self.keypoints.frames.truncate(n);
        self.joints_px.truncate(n);
    }

    /// Takes `top` and `bottom` rows away from all pictures, and moves all that lies in them.
    pub fn crop_rows(&mut self, top: u32, bottom: u32) {
        let (width, height) = self.size();
        let left = height - top - bottom;
        for frame in &mut self.frames {
            *frame = image::imageops::crop_imm(frame, 0, top, width, left).to_image();
        }
        for mask in &mut self.masks {
            *mask = image::imageops::crop_imm(mask, 0, top, width, left).to_image();
        }
        if let Some(camera) = &mut self.camera {
            (camera.height, camera.cy) = (left, camera.cy - f64::from(top));
        }
        for point in self.keypoints.frames.iter_mut().flatten().filter(|p| p[2] > 0.0) {
            point[1] -= f64::from(top);
            // A detector says nothing of what is not in the picture.
            if !(0.0..f64::from(left)).contains(&point[1]) {
                *point = [0.0; 3];
            }
        }
        self.joints_px.iter_mut().flatten().for_each(|p| p[1] -= f64::from(top));
    }

    /// Writes the clip into an existing folder.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let quality = self.bit_rate.map_or(Quality::Fine, Quality::Rate);
        let mut video = VideoWriter::create(&folder.join("video.mp4"), self.size(), self.fps, quality)?;
        self.frames.iter().try_for_each(|frame| video.push(frame))?;
        video.finish()?;
        let mut masks = zip::ZipWriter::new(BufWriter::new(File::create(folder.join("masks.zip"))?));
        let stored = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
        for (i, mask) in self.masks.iter().enumerate() {
            let mut png = Cursor::new(Vec::new());
            mask.write_to(&mut png, ImageFormat::Png)?;
            masks.start_file(format!("masks/{i:04}.png"), stored)?;
            masks.write_all(png.get_ref())?;
        }
        masks.finish()?.flush()?;
        serde_json::to_writer(File::create(folder.join("keypoints.json"))?, &self.keypoints)?;
        if let Some(camera) = &self.camera {
            serde_json::to_writer(File::create(folder.join("camera.json"))?, camera)?;
        }
        Ok(())
    }
}

fn json<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T> {
    let file = File::open(path).with_context(|| path.display().to_string())?;
    serde_json::from_reader(BufReader::new(file)).with_context(|| path.display().to_string())
}

/// All frames of a video whose size is known.
fn decode(path: &Path, width: u32, height: u32) -> Result<Vec<RgbImage>> {
    let mut child = Command::new("ffmpeg")
        .args(["-v", "error", "-i"])
        .arg(path)
        .args(["-f", "rawvideo", "-pix_fmt", "rgb24", "-"])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()
        .context("ffmpeg could not be started")?;
    let mut bytes = Vec::new();
    child.stdout.take().context("ffmpeg has no output")?.read_to_end(&mut bytes)?;
    ensure!(child.wait()?.success(), "{}: ffmpeg failed", path.display());
    let frame = width as usize * height as usize * 3;
    ensure!(bytes.len().is_multiple_of(frame), "{}: expected frames of {width}×{height}", path.display());
    Ok(bytes.chunks_exact(frame).filter_map(|data| RgbImage::from_raw(width, height, data.to_vec())).collect())
}

#[cfg(test)]
pub(super) mod testing {
    use image::{Luma, Rgb};

    use super::*;

    /// Twelve frames of 60×80: a grey box of 20×60 pixels with keypoints down its middle, left ones to the right, on a ramp.
    pub fn footage() -> Footage {
        let inside = |x: u32, y: u32| (20..40).contains(&x) && (10..70).contains(&y);
        let frame = RgbImage::from_fn(60, 80, |x, y| {
            let grey = if inside(x, y) { 60 + 2 * (y as u8) } else { 3 * x as u8 };
            Rgb([grey, grey / 2, 90])
        });
        let mask = GrayImage::from_fn(60, 80, |x, y| Luma([if inside(x, y) { 255 } else { 0 }]));
        let point = |k: usize| [if k % 2 == 1 { 35.0 } else { 25.0 }, 12.0 + 3.4 * k as f64, 0.9];
        // Six frames from the front, six from behind; hands and feet are the box's corners.
        let joints = |t: usize| -> Vec<[f64; 2]> {
            let side = if t < 6 { 1.0 } else { -1.0 };
            let place = |j: usize| match j {
                0 | 16 | 18 | 20 | 22 => [30.0 + 8.0 * side, 40.0],
                10 => [35.0, 68.0],
                11 => [25.0, 68.0],
                _ => [30.0 - 8.0 * side, 40.0],
            };
            (0..24).map(place).collect()
        };
        Footage {
            frames: vec![frame; 12],
            masks: vec![mask; 12],
            keypoints: Keypoints { format: "coco17".to_owned(), frames: vec![(0..17).map(point).collect(); 12] },
            camera: Some(Camera::pinhole(60, 80, [100.0, 100.0, 30.0, 40.0])),
            fps: 30.0,
            bit_rate: None,
            max_frames: None,
            joints_px: (0..12).map(joints).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::testing::footage;

    #[test]
    fn a_crop_moves_all_that_lies_in_the_picture() {
        let mut cut = footage();
        cut.crop_rows(20, 4);
        assert_eq!((cut.size(), cut.masks[0].dimensions()), ((60, 56), (60, 56)));
        let camera = cut.camera.as_ref().unwrap();
        assert_eq!((camera.height, camera.cy), (56, 20.0));
        let (before, after) = (&footage().keypoints.frames[0], &cut.keypoints.frames[0]);
        assert_eq!((after[0], after[16][1]), ([0.0; 3], before[16][1] - 20.0), "what is cut off is not seen");
        assert!((cut.person_px() - 50.0).abs() < 1e-9);
    }
}
