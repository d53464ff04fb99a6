//! The stages in order.

use std::path::Path;
use std::sync::Arc;

use anyhow::anyhow;

use super::curves::Curves;
use super::fits::{Fits, PERSON, from_fit};
use super::made_by::begin_anew_for_others;
use super::monitor::Monitor;
use super::{Observer, Outcome, PipelineError, PipelineInput, Stage, StopReason, export};
use crate::body::Body;
use crate::camera::Camera;
use crate::capture::{Capture, CaptureError, CaptureOptions};
use crate::data_dir::body_path_in;
use crate::fit::covered::Covered;
use crate::fit::detail::{Detail, DetailPlan};
use crate::fit::gains::FrameGains;
use crate::fit::skirt::Skirt;
use crate::fit::stage0::{self, FocalCheck, Stage0Error, Stage0Options, Stage0Result};
use crate::fit::{FitConfig, FitState, Inputs, bundle, pelvis};
use crate::gpu::Gpu;
use crate::jobs::{JobOptions, Preset};
use crate::quality;

/// Runs a job. `data_dir` holds `bodies/`; `work_dir` holds the checkpoint and survives restarts: after a
/// stop a later run goes on from there; `out_dir` gets the results.
pub fn run(
    gpu: &Arc<Gpu>,
    input: &PipelineInput,
    data_dir: &Path,
    work_dir: &Path,
    out_dir: &Path,
    observer: &mut dyn Observer,
) -> Result<Outcome, PipelineError> {
    let (checkpoint, curves) = (work_dir.join(PERSON), Curves::new(work_dir));
    let mut monitor = Monitor::new(gpu, observer, input.options.preset, &checkpoint, curves);
    let mut config = config_of(&input.options);
    monitor.start(Stage::Decode)?;
    let body_file = body_path_in(data_dir, &input.options.body);
    // A name that is no body's costs no checkpoint.
    let mut body = load_body(&body_file, &input.options.body)?;
    if begin_anew_for_others(work_dir, input, &body_file).map_err(anyhow::Error::from)? {
        monitor.begin_anew();
    }
    let mut capture = load_capture(input, &mut monitor)?;
    // Of the detections as they were given: what follows reads them anew.
    let measures = quality::measure(&capture);
    quality::settle_masks(&mut capture, &quality::edge_offsets(&measures));
    monitor.start(Stage::Pose)?;
    let focal = settle_focal(&body, &mut capture, &input.options, &mut monitor);
    let start = solve_poses(&body, &capture, &input.options, &mut monitor)?;
    start.reread(&mut capture);
    config.held = start.report.kept_poses();
    let covered = if config.covered { Covered::find(&body, &capture, &start) } else { Covered::default() };
    covered.even_out(&mut body, &start.betas);
    let (poses, transl) = (start.poses.as_slice(), start.transl.as_slice());
    let fresh = FitState::new(&body, start.betas.clone(), poses, transl, config.field, config.seed);
    let gains = settle_gains(gpu, &body, &mut capture, &start.camera, &config, &fresh)?;
    let plan = if config.detail { DetailPlan::to(&capture) } else { None };
    monitor.expect_texture_steps(plan.as_ref().map_or(0, |plan| plan.steps(&config)));
    let alone = config.clone().texture_alone();
    let steps_alone = alone.steps(&alone.texture.phases, capture.frames.len());
    let adjusts = config.bundle && config.held.is_none();
    monitor.expect_texture_steps(if adjusts { steps_alone } else { 0 });
    let (camera, mut fits) = (&start.camera, Fits::new(gpu, work_dir, &mut monitor));
    let mut state = fits.person(&Inputs { body: &body, capture: &capture, camera, config: &config }, fresh)?;
    let adjusted = adjusts
        && adjust(&Inputs { body: &body, capture: &capture, camera, config: &config }, &mut state, fits.monitor)?;
    let skirt = if config.skirts { Skirt::find(&body, &state) } else { None };
    if let Some(skirt) = skirt {
        skirt.tailor(&mut body, &mut state);
    }
    if skirt.is_some() || adjusted {
        fits.monitor.expect_texture_steps(if adjusts { 0 } else { steps_alone });
        state = fits.tailored(&Inputs { body: &body, capture: &capture, camera, config: &alone }, state)?;
    }
    let large = match &plan {
        Some(plan) => larger_pictures(input, plan, &mut capture, &measures, gains.as_ref(), fits.monitor)?,
        None => None,
    };
    let detail =
        plan.zip(large).map(|(plan, large)| Detail::new(&body, &capture, camera, &config, &state, &plan, large));
    if let Some(detail) = &detail {
        let before = Inputs { body: &body, capture: &capture, camera, config: &config };
        state = fits.detailed(&before, detail, state)?;
        config.field = detail.config.field;
    }
    let mut pelvis_moved = [0.0; 3];
    if start.report.kept_poses().is_none() {
        pelvis_moved = pelvis::settle(&mut body, &state.betas, &state.poses, &mut state.transl);
    }
    let done = export::Fitted {
        body,
        pelvis_moved,
        capture,
        measures,
        focal,
        gains,
        start,
        state,
        covered,
        skirt,
        detail,
        config,
    };
    export::export(gpu, &done, input, out_dir, &mut monitor)
}

/// Adjusts poses and the surface to all frames at once. A fit that is gone on with does it again, and alike.
fn adjust(inputs: &Inputs<'_>, state: &mut FitState, monitor: &mut Monitor<'_>) -> Result<bool, PipelineError> {
    let adjusted = bundle::adjust(inputs, state, &mut || monitor.go_on());
    adjusted.map_err(|error| from_fit(error, monitor.stopped))
}

/// The pictures that the texture goes on with after the fit, if they can be had.
fn larger_pictures(
    input: &PipelineInput,
    plan: &DetailPlan,
    capture: &mut Capture,
    measures: &[quality::FrameMeasures],
    gains: Option<&FrameGains>,
    monitor: &mut Monitor<'_>,
) -> Result<Option<Capture>, PipelineError> {
    if let Some(own) = plan.own(capture) {
        return Ok(Some(own));
    }
    let go_on = &mut |_| monitor.go_on();
    let large = Capture::load_frames(&input.files, &plan.frames, plan.side_px, go_on);
    let mut large = match large {
        Ok(large) => large,
        // The fit is done, and without detail it is still a whole avatar.
        Err(error) if error.bad_input().is_some() => {
            capture.warnings.push(format!("the texture gets no detail: larger pictures cannot be had: {error}"));
            return Ok(None);
        }
        Err(error) => return Err(from_capture(error, monitor)),
    };
    let offsets = plan.of(&quality::edge_offsets(measures)).into_iter();
    let offsets: Vec<_> = offsets.map(|px| px.map(|px| px * plan.gain)).collect();
    quality::settle_masks(&mut large, &offsets);
    if let Some(gains) = gains {
        gains.even_out(&mut large);
    }
    Ok(Some(large))
}

/// Frames and pixels that a preset looks at.
fn capture_options(options: &JobOptions) -> CaptureOptions {
    let (max_frames, max_side_px) = match options.preset {
        Preset::Draft => (40, 360),
        Preset::Standard | Preset::SilhouetteOnly => (120, 720),
        Preset::Paper => (120, 1080),
    };
    CaptureOptions {
        max_frames: options.max_frames.unwrap_or(max_frames),
        max_side_px: options.max_side_px.unwrap_or(max_side_px),
    }
}

fn config_of(options: &JobOptions) -> FitConfig {
    match options.preset {
        Preset::Draft => FitConfig::draft(options.seed),
        Preset::Standard => FitConfig::standard(options.seed),
        Preset::Paper => FitConfig::paper(options.seed),
        Preset::SilhouetteOnly => FitConfig::silhouette_only(options.seed),
    }
}

fn load_body(path: &Path, name: &str) -> Result<Body, PipelineError> {
    if name == "test" {
        return Ok(Body::test_body());
    }
    Body::load(path).map_err(|e| {
        let path = path.display();
        PipelineError::Internal(anyhow!("body {name:?}: {e}; `make body`, or `effigy body import FILE`, makes {path}"))
    })
}

fn load_capture(input: &PipelineInput, monitor: &mut Monitor<'_>) -> Result<Capture, PipelineError> {
    let mut told = 0;
    let loaded = Capture::load(&input.files, &capture_options(&input.options), &mut |read| {
        let percent = (read * 100.0) as u32;
        if percent > told {
            told = percent;
            monitor.tell(Stage::Decode, percent, 100);
        }
        monitor.go_on()
    });
    loaded.map_err(|error| from_capture(error, monitor))
}

fn from_capture(error: CaptureError, monitor: &Monitor<'_>) -> PipelineError {
    match error {
        CaptureError::Stopped => PipelineError::Stopped(monitor.stopped.unwrap_or(StopReason::Shutdown)),
        other => other.into(),
    }
}

fn solve_poses(
    body: &Body,
    capture: &Capture,
    job: &JobOptions,
    monitor: &mut Monitor<'_>,
) -> Result<Stage0Result, PipelineError> {
    let use_pictures = job.preset != Preset::SilhouetteOnly;
    let options = Stage0Options { height_m: job.height_m, use_pictures, ..Stage0Options::default() };
    let solved = stage0::solve(body, capture, &options, &mut |done| {
        monitor.tell(Stage::Pose, (done * 100.0) as u32, 100);
        monitor.go_on()
    });
    solved.map_err(|error| match error {
        Stage0Error::Stopped => PipelineError::Stopped(monitor.stopped.unwrap_or(StopReason::Shutdown)),
        other => PipelineError::Unfit(other.to_string()),
    })
}

/// Takes out of the pictures what the camera has changed from one to the next.
fn settle_gains(
    gpu: &Arc<Gpu>,
    body: &Body,
    capture: &mut Capture,
    camera: &Camera,
    config: &FitConfig,
    start: &FitState,
) -> Result<Option<FrameGains>, PipelineError> {
    if !config.gains {
        return Ok(None);
    }
    let found = FrameGains::find(gpu, &Inputs { body, capture, camera, config }, start);
    let gains = found.map_err(|error| from_fit(error, None))?;
    if let Some(gains) = &gains {
        gains.even_out(capture);
    }
    Ok(gains)
}

/// Asks the clip for its focal length. Where that contradicts the given one, it is found as if none had been given: a wrong one
/// shifts the whole person in depth and bends the body.
fn settle_focal(
    body: &Body,
    capture: &mut Capture,
    options: &JobOptions,
    monitor: &mut Monitor<'_>,
) -> Option<FocalCheck> {
    let check = FocalCheck::of(body, capture, &mut || monitor.go_on())?;
    if check.contradicts() && !options.trust_camera {
        capture.forget_focal();
    }
    Some(check)
}
