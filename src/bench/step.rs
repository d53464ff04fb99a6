//! Whole optimisation steps, as the fit takes them, on a made clip whose frames are as large as their image.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::person::Person;
use super::timing::{Times, profiled, timed};
use crate::body::Body;
use crate::capture::{Capture, Frame};
use crate::fit::detail::refined;
use crate::fit::{FitConfig, FitError, FitState, Inputs, Phase, Stage, with_step};
use crate::gpu::{Gpu, KernelTime};
use crate::math::median;
use crate::ops::hard_rasterize::{HardRasterizeConfig, HardRasterizer};
use crate::ops::skinning::cpu::forward;
use crate::ops::{Corners, Topology};

/// How far the seen person stands beside the body that a step starts with, metres.
const ASIDE_M: f32 = 0.01;
/// How long a device that is not the CPU is warmed up.
const WARM_UP: Duration = Duration::from_millis(500);
const STEPS_IN_A_ROW: u32 = 16;

/// What a step is taken of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Step {
    /// Stage 1's last phase: full resolution.
    Geometry,
    /// Stage 2's.
    Texture,
    /// The detail's last round.
    Detail,
}

impl Step {
    pub const ALL: [Self; 3] = [Self::Geometry, Self::Texture, Self::Detail];

    pub fn name(self) -> &'static str {
        match self {
            Self::Geometry => "step/geometry",
            Self::Texture => "step/texture",
            Self::Detail => "step/detail",
        }
    }
}

/// What a step takes.
#[derive(Clone, Debug, serde::Serialize)]
pub struct StepTimes {
    pub step: Step,
    pub frames: usize,
    pub times: Times,
    pub row: Row,
    /// Kernels, each dispatch timed by itself: sums over a step.
    pub kernels: BTreeMap<String, KernelTime>,
    /// Of all device buffers, so far in this process.
    pub peak_device_bytes: u64,
}

/// Steps in a row of which only the last is awaited, as a fit takes them: the device works while the host records. Medians a step.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct Row {
    pub ms: f64,
    /// What the host took to record and submit.
    pub host_ms: f64,
}

impl Row {
    fn measure(gpu: &Gpu, repeats: u32, step: &mut dyn FnMut() -> Result<(), FitError>) -> Result<Self, FitError> {
        let [mut rows, mut host] = [Vec::new(), Vec::new()];
        for _ in 0..repeats.div_ceil(2) {
            let begun = Instant::now();
            (0..STEPS_IN_A_ROW).try_for_each(|_| step())?;
            host.push(begun.elapsed().as_secs_f64());
            gpu.wait()?;
            rows.push(begun.elapsed().as_secs_f64());
        }
        let ms = |secs| 1e3 * median(secs).expect("a row or more") / f64::from(STEPS_IN_A_ROW);
        let [ms, host_ms] = [rows, host].map(ms);
        Ok(Self { ms, host_ms })
    }
}

impl StepTimes {
    /// Dispatches, clears and copies.
    pub fn commands(&self) -> u64 {
        self.kernels.values().map(|k| k.calls).sum()
    }
}

/// A clip of a standing body, and the state of a fit that starts beside it.
pub struct StepBench {
    gpu: Arc<Gpu>,
    body: Body,
    config: FitConfig,
    capture: Capture,
    state: FitState,
}

impl StepBench {
    /// `n_frames` equal frames of `size` × `size` pixels.
    pub fn new(gpu: &Arc<Gpu>, body: &Body, size: u32, n_frames: usize) -> Result<Self, FitError> {
        let config = FitConfig::standard(1);
        let person = Person::new(body, size);
        let Person { pose, transl, .. } = person;
        let frame = frame(gpu, body, &person)?;
        let poses = vec![pose; n_frames];
        let state =
            FitState::new(body, vec![0.0; body.n_betas], &poses, &vec![transl; n_frames], config.field, config.seed);
        let capture = Capture {
            uploaded_side_px: person.camera.width.max(person.camera.height),
            camera: person.camera,
            camera_estimated: false,
            fps: 30.0,
            frames: (0..n_frames as u32).map(|index| Frame { index, ..frame.clone() }).collect(),
            keypoint_format: "coco17".to_owned(),
            given_keypoint_format: "coco17".to_owned(),
            poses: None,
            warnings: Vec::new(),
        };
        Ok(Self { gpu: gpu.clone(), body: body.clone(), config, capture, state })
    }

    /// Calls `with` with one step of `standard` on all frames.
    pub fn with<R>(
        &self,
        step: Step,
        with: impl FnOnce(&mut dyn FnMut() -> Result<(), FitError>) -> Result<R, FitError>,
    ) -> Result<R, FitError> {
        let Self { body, capture, config, state, .. } = self;
        let stage = if step == Step::Geometry { Stage::Geometry } else { Stage::Texture };
        let mut state = FitState { stage, ..state.clone() };
        let config = match step {
            Step::Detail => &refined(config, body, &state, &capture.camera),
            _ => config,
        };
        state.field = state.field.refined(&self.config.field, &config.field, config.seed);
        let phases = if stage == Stage::Geometry { &config.geometry.phases } else { &config.texture.phases };
        let phase: &Phase = phases.last().expect("a stage has phases");
        let frames: Vec<usize> = (0..capture.frames.len()).collect();
        let inputs = Inputs { body, capture, camera: &capture.camera, config };
        with_step(&self.gpu, &inputs, &state, phase, &frames, with)
    }

    /// Times of one step on all frames: `repeats` steps after some that compile and warm up, half as many rows, then a few that
    /// are profiled.
    pub fn run(&self, step: Step, repeats: u32) -> Result<StepTimes, FitError> {
        let gpu = &self.gpu;
        let (times, row, kernels) = self.with(step, |step| {
            // The first compiles; a device that has idled takes a while to run at its full speed.
            let begun = Instant::now();
            loop {
                step()?;
                gpu.wait()?;
                if gpu.info().software || begun.elapsed() > WARM_UP {
                    break;
                }
            }
            let mut awaited = || step().and_then(|()| Ok(gpu.wait()?));
            let pairs = (0..repeats).map(|_| timed(&mut awaited)).collect::<Result<Vec<_>, _>>()?;
            let row = Row::measure(gpu, repeats, &mut *step)?;
            Ok((Times::of(&pairs), row, profiled(gpu, repeats.div_ceil(4), step)?))
        })?;
        Ok(StepTimes {
            step,
            frames: self.capture.frames.len(),
            times,
            row,
            kernels,
            peak_device_bytes: gpu.peak_bytes(),
        })
    }
}

/// The person as a camera sees it, beside its place, with colours that change over the image.
fn frame(gpu: &Arc<Gpu>, body: &Body, person: &Person) -> Result<Frame, FitError> {
    let Person { camera, pose, transl } = person;
    let [x, y, z] = *transl;
    let seen = forward(body, &[], None, pose, [x + ASIDE_M, y, z]).vertices;
    let corners = Arc::new(Corners::new(gpu, &body.faces, &Topology::new(body.n_vertices(), &body.faces)));
    let hard = HardRasterizer::new(gpu, &corners, camera.n_pixels(), HardRasterizeConfig::default());
    let mut recorder = gpu.recorder("bench/frame");
    hard.forward(&mut recorder, camera, &gpu.upload("bench/seen", seen.as_flattened()));
    recorder.submit()?;
    let mask: Vec<u8> = gpu.read(&hard.alpha)?.iter().map(|&a| 255 * u8::from(a > 0.5)).collect();
    let colour = |i: usize| [i % 251, i / 7 % 241, i / 61 % 239].map(|x| x as u8);
    let middle = [camera.cx as f32, camera.cy as f32, 1.0];
    Ok(Frame {
        index: 0,
        x0: 0,
        y0: 0,
        width: camera.width,
        height: camera.height,
        rgb: (0..mask.len()).flat_map(colour).collect(),
        mask,
        keypoints: vec![middle; 17],
    })
}
