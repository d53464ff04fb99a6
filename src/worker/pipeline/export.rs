//! From fitted parameters to the files that users take away.

use std::path::Path;
use std::sync::Arc;

use serde_json::json;

use super::closeups::Filmed;
use super::monitor::Monitor;
use super::page;
use super::quality::Quality;
use super::score::{FrameScore, score_frames};
use super::{Outcome, PipelineError, PipelineInput, Stage};
use crate::avatar::{AvatarModel, Renderer};
use crate::body::Body;
use crate::capture::Capture;
use crate::fit::covered::Covered;
use crate::fit::detail::Detail;
use crate::fit::gains::FrameGains;
use crate::fit::skirt::Skirt;
use crate::fit::stage0::{FocalCheck, Stage0Result};
use crate::fit::{FitConfig, FitState};
use crate::gpu::Gpu;
use crate::quality::FrameMeasures;

/// All that a fit knows at its end.
pub(super) struct Fitted {
    pub body: Body,
    /// By `fit::pelvis`.
    pub pelvis_moved: [f32; 3],
    pub capture: Capture,
    /// Of the clip as it came.
    pub measures: Vec<FrameMeasures>,
    /// What the clip says of the camera that came with it.
    pub focal: Option<FocalCheck>,
    /// What the camera has changed from frame to frame; `capture` has lost it.
    pub gains: Option<FrameGains>,
    pub start: Stage0Result,
    pub state: FitState,
    /// What shoes and hair cover; `body` has lost it.
    pub covered: Covered,
    /// What the person wears, where it hangs from leg to leg; `body` and `state` carry it.
    pub skirt: Option<Skirt>,
    /// What the texture went on with in the end.
    pub detail: Option<Detail>,
    pub config: FitConfig,
}

impl Fitted {
    /// The video's numbers of the frames that stage 0 read with sides swapped.
    pub fn swapped_frames(&self) -> Vec<u32> {
        self.start.report.swapped.iter().map(|&t| self.capture.frames[t].index).collect()
    }
}

/// Writes the avatar's files, `report.json` and `report.html` into `out`.
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
    let mut seen = vec![false; model.body.n_faces()];
    let scores = score_frames(&renderer, &fitted.capture, &mut seen, monitor)?;
    let quality = Quality::of(fitted, &model, &scores, &seen);
    let pictures = page::pictures(&renderer, &fitted.capture, &filmed(fitted), &scores)?;
    monitor.end();
    let report = report(gpu, fitted, input, &scores, &quality, monitor);
    write_report(&report, out)?;
    let html = page::html(&report, &quality, monitor.curves.points(), &pictures);
    std::fs::write(out.join("report.html"), html).map_err(anyhow::Error::from)?;
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

/// The largest pictures that there are.
fn filmed(fitted: &Fitted) -> Filmed<'_> {
    match &fitted.detail {
        Some(detail) => Filmed { camera: &detail.camera, pictures: detail.whole().collect() },
        None => Filmed { camera: &fitted.start.camera, pictures: fitted.capture.frames.iter().enumerate().collect() },
    }
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
        pelvis_moved: fitted.pelvis_moved,
        frames: frames.to_vec(),
        fps: fitted.capture.fps,
        camera: fitted.start.camera.clone(),
    }
}

fn report(
    gpu: &Gpu,
    fitted: &Fitted,
    input: &PipelineInput,
    scores: &[FrameScore],
    quality: &Quality<'_>,
    monitor: &Monitor<'_>,
) -> serde_json::Value {
    let n = scores.len().max(1) as f64;
    let mean = |value: fn(&FrameScore) -> f64| scores.iter().map(value).sum::<f64>() / n;
    let peak_process = peak_process_bytes();
    let secs = monitor.whole_secs();
    let total: f64 = secs.values().sum();
    let gigabyte = 1e9;
    let per_frame: Vec<_> =
        scores.iter().map(|s| json!({ "frame": s.frame, "mask_iou": s.iou, "psnr": s.psnr })).collect();
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
        "secs": secs,
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
            "guessed_height_m": fitted.start.report.guessed_height_m,
            "given_poses": fitted.start.report.given_poses.map(|given| json!({
                "off": { "root": given.off.root, "place_m": given.off.place, "joints": given.off.joints },
                "replaced": given.replaced,
            })),
            "tracked_points": fitted.start.report.tracked_points,
            "swapped_frames": fitted.swapped_frames(),
            "notes": fitted.start.report.notes,
        },
        "frame_gains": fitted.gains.as_ref().map(FrameGains::gains),
        "covered": fitted.covered,
        "detail": fitted.detail.as_ref().map(|detail| json!({
            "side_px": detail.camera.width.max(detail.camera.height),
            "frames": detail.whole().count(),
        })),
        "quality": quality,
        "warnings": fitted.capture.warnings,
        "camera": fitted.start.camera,
        "camera_estimated": fitted.capture.camera_estimated,
        "betas": fitted.state.betas,
        "frames": per_frame,
        "losses": monitor.curves.points(),
    })
}

/// The most memory that this process has had resident, where the system tells.
fn peak_process_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    Some(line.split_whitespace().nth(1)?.parse::<u64>().ok()? * 1024)
}
