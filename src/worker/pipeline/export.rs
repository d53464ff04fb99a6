//! From fitted parameters to the files that users take away.

use std::path::Path;
use std::sync::Arc;

use image::{GrayImage, Luma};
use serde_json::json;

use super::run::Monitor;
use super::{Outcome, PipelineError, PipelineInput, Stage};
use crate::avatar::{AvatarModel, Background, RenderSpec, Renderer};
use crate::body::Body;
use crate::camera::Camera;
use crate::capture::{Capture, Frame};
use crate::eval::mask_iou;
use crate::fit::stage0::Stage0Result;
use crate::fit::{FitConfig, FitState};
use crate::gpu::Gpu;

/// All that a fit knows at its end.
pub(super) struct Fitted {
    pub body: Body,
    pub capture: Capture,
    pub start: Stage0Result,
    pub state: FitState,
    pub config: FitConfig,
}

/// Writes the avatar's files and `report.json` into `out`.
pub(super) fn export(
    gpu: &Arc<Gpu>,
    fitted: &Fitted,
    input: &PipelineInput,
    out: &Path,
    monitor: &mut Monitor<'_>,
) -> Result<Outcome, PipelineError> {
    monitor.start(Stage::Bake)?;
    let frames: Vec<u32> = fitted.capture.frames.iter().map(|f| f.index).collect();
    let model = Arc::new(model_of(fitted, &frames));
    let renderer = write_files(gpu, &model, input.options.texture_px, out)?;
    monitor.start(Stage::Export)?;
    let scores = score_frames(&renderer, &fitted.capture, &model.camera, monitor)?;
    monitor.end();
    let report = report(gpu, fitted, input, &scores, monitor);
    write_report(&report, out)?;
    Ok(Outcome { frames: frames.len() as u32, camera: model.camera.clone(), metrics: report["metrics"].clone() })
}

fn write_files(gpu: &Arc<Gpu>, model: &Arc<AvatarModel>, texture_px: u32, out: &Path) -> anyhow::Result<Renderer> {
    model.check()?;
    let renderer = Renderer::new(gpu, model)?;
    renderer.export(out, texture_px)?;
    Ok(renderer)
}

fn write_report(report: &serde_json::Value, out: &Path) -> anyhow::Result<()> {
    Ok(std::fs::write(out.join("report.json"), serde_json::to_string_pretty(report)?)?)
}

fn model_of(fitted: &Fitted, frames: &[u32]) -> AvatarModel {
    let state = &fitted.state;
    AvatarModel {
        body: fitted.body.clone(),
        betas: state.betas.clone(),
        offsets: state.offsets.as_chunks().0.to_vec(),
        texcoords: state.texcoords.as_chunks().0.to_vec(),
        texture_config: fitted.config.field,
        texture: state.field.clone(),
        light: state.light,
        face_colours: state.face_colours.as_chunks().0.to_vec(),
        poses: state.poses.as_chunks().0.to_vec(),
        transl: state.transl.as_chunks().0.to_vec(),
        frames: frames.to_vec(),
        fps: fitted.capture.fps,
        camera: fitted.start.camera.clone(),
    }
}

/// Mask overlap and image fidelity of one training frame.
struct FrameScore {
    frame: u32,
    iou: f64,
    psnr: f64,
}

fn score_frames(
    renderer: &Renderer,
    capture: &Capture,
    camera: &Camera,
    monitor: &mut Monitor<'_>,
) -> Result<Vec<FrameScore>, PipelineError> {
    let n = capture.frames.len();
    let mut scores = Vec::with_capacity(n);
    for (k, frame) in capture.frames.iter().enumerate() {
        let spec = RenderSpec {
            camera: crop(camera, frame),
            background: Background::Transparent,
            samples: 2,
            ..RenderSpec::of_frame(renderer.model(), k)
        };
        let picture = renderer.render(&spec).map_err(anyhow::Error::from)?;
        let ours = GrayImage::from_fn(frame.width, frame.height, |x, y| Luma([picture.get_pixel(x, y).0[3]]));
        let theirs =
            GrayImage::from_fn(frame.width, frame.height, |x, y| Luma([frame.mask[(y * frame.width + x) as usize]]));
        let psnr = psnr_on_white(&picture, frame, camera);
        scores.push(FrameScore { frame: frame.index, iou: mask_iou(&ours, &theirs), psnr });
        monitor.tell(Stage::Export, k as u32 + 1, n as u32);
    }
    Ok(scores)
}

/// The camera that sees the frame's crop.
pub(super) fn crop(camera: &Camera, frame: &Frame) -> Camera {
    Camera {
        width: frame.width,
        height: frame.height,
        cx: camera.cx - frame.x0 as f64,
        cy: camera.cy - frame.y0 as f64,
        ..camera.clone()
    }
}

/// PSNR over the whole image, both on white; outside the crop both are white.
fn psnr_on_white(picture: &image::RgbaImage, frame: &Frame, camera: &Camera) -> f64 {
    let mut squares = 0.0;
    for ((pixel, rgb), &mask) in picture.pixels().zip(frame.rgb.as_chunks::<3>().0).zip(&frame.mask) {
        let alpha = pixel.0[3] as f64 / 255.0;
        for (ours, theirs) in pixel.0[..3].iter().zip(rgb) {
            let ours = alpha * *ours as f64 / 255.0 + (1.0 - alpha);
            let theirs = if mask >= 128 { *theirs as f64 / 255.0 } else { 1.0 };
            squares += (ours - theirs).powi(2);
        }
    }
    -10.0 * (squares / (3.0 * camera.width as f64 * camera.height as f64)).max(1e-10).log10()
}

fn report(
    gpu: &Gpu,
    fitted: &Fitted,
    input: &PipelineInput,
    scores: &[FrameScore],
    monitor: &Monitor<'_>,
) -> serde_json::Value {
    let n = scores.len().max(1) as f64;
    let mean = |value: fn(&FrameScore) -> f64| scores.iter().map(value).sum::<f64>() / n;
    let peak_process = peak_process_bytes();
    let total: f64 = monitor.secs.values().sum();
    let gigabyte = 1e9;
    let per_frame: Vec<_> =
        scores.iter().map(|s| json!({ "frame": s.frame, "mask_iou": s.iou, "psnr": s.psnr })).collect();
    let curves: Vec<_> = monitor
        .curves
        .iter()
        .map(|(stage, step, losses)| json!({ "stage": stage.name(), "step": step, "losses": losses }))
        .collect();
    json!({
        "effigy": env!("CARGO_PKG_VERSION"),
        "options": input.options,
        "metrics": {
            "mask_iou": mean(|s| s.iou),
            "psnr": mean(|s| s.psnr),
            "frames": scores.len(),
            "secs": total,
            "peak_device_bytes": gpu.peak_bytes(),
        },
        "secs": monitor.secs,
        "device": gpu.info(),
        "memory": {
            "peak_process_bytes": peak_process,
            "peak_device_bytes": gpu.peak_bytes(),
            "gigabyte_hours": peak_process.map(|bytes| bytes as f64 / gigabyte * total / 3600.0),
        },
        "stage0": {
            "turn_degrees": fitted.start.report.turn_degrees,
            "mask_iou": fitted.start.report.mask_iou,
            "sigma_px": fitted.start.report.sigma_px,
            "residual_px": fitted.start.report.residual_px,
            "swapped_frames": fitted.start.report.swapped,
            "notes": fitted.start.report.notes,
        },
        "warnings": fitted.capture.warnings,
        "camera": fitted.start.camera,
        "camera_estimated": fitted.capture.camera_estimated,
        "betas": fitted.state.betas,
        "frames": per_frame,
        "losses": curves,
    })
}

/// The most memory that this process has had resident, where the system tells.
fn peak_process_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    Some(line.split_whitespace().nth(1)?.parse::<u64>().ok()? * 1024)
}
