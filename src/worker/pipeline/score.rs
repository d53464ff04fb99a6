//! How well the avatar shows the frames that it was fitted to.

use image::{GrayImage, Luma};

use super::monitor::Monitor;
use super::{PipelineError, Stage};
use crate::avatar::{RenderSpec, Renderer};
use crate::camera::Camera;
use crate::capture::{Capture, Frame};
use crate::eval::mask_iou;
use crate::mask::is_foreground;
use crate::picture::Background;

/// Mask overlap and image fidelity of one training frame.
pub(super) struct FrameScore {
    pub frame: u32,
    pub iou: f64,
    pub psnr: f64,
}

/// Scores all frames; sets `seen [F]` for the faces that one shows.
pub(super) fn score_frames(
    renderer: &Renderer,
    capture: &Capture,
    seen: &mut [bool],
    monitor: &mut Monitor<'_>,
) -> Result<Vec<FrameScore>, PipelineError> {
    let n = capture.frames.len();
    let mut scores = Vec::with_capacity(n);
    for (k, frame) in capture.frames.iter().enumerate() {
        let picture = renderer.render_marking(&spec_of(renderer, k, frame), seen).map_err(anyhow::Error::from)?;
        let ours = GrayImage::from_fn(frame.width, frame.height, |x, y| Luma([picture.get_pixel(x, y).0[3]]));
        let theirs =
            GrayImage::from_fn(frame.width, frame.height, |x, y| Luma([frame.mask[(y * frame.width + x) as usize]]));
        let psnr = psnr_on_white(&picture, frame, &capture.camera);
        scores.push(FrameScore { frame: frame.index, iou: mask_iou(&ours, &theirs), psnr });
        monitor.tell(Stage::Export, k as u32 + 1, n as u32);
        monitor.check()?;
    }
    Ok(scores)
}

/// Frame `k` as the avatar shows it in the frame's crop, transparent.
pub(super) fn spec_of(renderer: &Renderer, k: usize, frame: &Frame) -> RenderSpec {
    RenderSpec {
        camera: crop(&renderer.model().camera, frame),
        background: Background::Transparent,
        samples: 2,
        ..RenderSpec::of_frame(renderer.model(), k)
    }
}

/// The camera that sees the frame's crop.
pub(super) fn crop(camera: &Camera, frame: &Frame) -> Camera {
    camera.cropped(frame.x0 as i32, frame.y0 as i32, frame.width, frame.height)
}

/// PSNR over the whole image, both on white; outside the crop both are white.
fn psnr_on_white(picture: &image::RgbaImage, frame: &Frame, camera: &Camera) -> f64 {
    let mut squares = 0.0;
    for ((pixel, rgb), &mask) in picture.pixels().zip(frame.rgb.as_chunks::<3>().0).zip(&frame.mask) {
        let alpha = pixel.0[3] as f64 / 255.0;
        for (ours, theirs) in pixel.0[..3].iter().zip(rgb) {
            let ours = alpha * *ours as f64 / 255.0 + (1.0 - alpha);
            let theirs = if is_foreground(mask) { *theirs as f64 / 255.0 } else { 1.0 };
            squares += (ours - theirs).powi(2);
        }
    }
    -10.0 * (squares / (3.0 * camera.width as f64 * camera.height as f64)).max(1e-10).log10()
}
