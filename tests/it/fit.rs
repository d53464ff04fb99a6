//! The pipeline on a small made clip: it recovers the person, stops when asked and goes on from its checkpoint.

mod resume;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use effigy::avatar::{AvatarModel, RenderSpec, Renderer, UvLayout};
use effigy::body::joints::{LEFT_HIP, LEFT_KNEE, RIGHT_ELBOW, RIGHT_HIP};
use effigy::body::{Body, N_POSE};
use effigy::capture::{Capture, CaptureInputs, CaptureOptions};
use effigy::fit::stage0::{self, Stage0Options};
use effigy::fit::{self, Control, FitConfig, FitError, FitState, Flow, Inputs, StepReport, Texels};
use effigy::gpu::{DeviceSelect, Gpu};
use effigy::jobs::{JobOptions, Preset};
use effigy::mask::is_foreground;
use effigy::synth::{SynthOptions, synthesise};
use effigy::worker::pipeline::{self, Observer, Outcome, PipelineError, PipelineInput};
use effigy::worker::pipeline::{Preview, Progress, Stage, StopReason};

/// A device, or `None` after saying that `test` is ignored; CI requires one.
pub fn gpu(test: &str) -> Option<Arc<Gpu>> {
    match Gpu::open(&DeviceSelect::Auto) {
        Ok(gpu) => Some(gpu),
        Err(reason) => {
            assert!(std::env::var_os("CI").is_none(), "{test}: CI requires a device: {reason}");
            eprintln!("{test}: ignored, {reason}");
            None
        }
    }
}

/// A clip of the test body that turns once, made once for all tests.
pub fn clip(gpu: &Arc<Gpu>) -> &'static Path {
    static CLIP: OnceLock<tempfile::TempDir> = OnceLock::new();
    let made = || {
        let folder = tempfile::tempdir().unwrap();
        let options = SynthOptions { frames: 12, size_px: 96, truths: 1, seed: 5, ..SynthOptions::default() };
        synthesise(gpu, &Body::test_body(), &options, folder.path(), |_, _| {}).unwrap();
        folder
    };
    CLIP.get_or_init(made).path()
}

pub fn input(clip: &Path) -> PipelineInput {
    let file = |name: &str| clip.join(name);
    let files = CaptureInputs {
        video: file("video.mp4"),
        masks: file("masks.zip"),
        keypoints: file("keypoints.json"),
        camera: Some(file("camera.json")),
        poses: None,
    };
    let options = JobOptions { preset: Preset::Draft, body: "test".into(), ..JobOptions::default() };
    PipelineInput { files, options }
}

/// Writes down what it hears; asks to stop at a step of a stage, as a user who cancels unless `lost` is set.
#[derive(Default)]
struct Witness {
    heard: Vec<Progress>,
    stop_at: Option<(Stage, u32)>,
    lost: bool,
    idle: usize,
    previews: Vec<Preview>,
}

impl Observer for Witness {
    fn progress(&mut self, progress: &Progress) {
        self.heard.push(progress.clone());
    }

    fn takes_previews(&self) -> bool {
        true
    }

    fn preview(&mut self, preview: Preview) {
        self.previews.push(preview);
    }

    fn stop(&mut self) -> Option<StopReason> {
        let last = self.heard.last()?;
        let (stage, step) = self.stop_at?;
        let reason = if self.lost { StopReason::LostLease } else { StopReason::Cancel };
        (last.stage == stage && last.step >= step).then_some(reason)
    }

    fn idle(&mut self, _gpu: &Arc<Gpu>) {
        self.idle += 1;
    }
}

fn run(gpu: &Arc<Gpu>, input: &PipelineInput, folder: &Path, witness: &mut Witness) -> Result<Outcome, PipelineError> {
    let (work, out) = (folder.join("work"), folder.join("out"));
    for path in [&work, &out] {
        std::fs::create_dir_all(path).unwrap();
    }
    pipeline::run(gpu, input, Path::new("no-bodies-needed"), &work, &out, witness)
}

fn checkpoint(folder: &Path) -> PathBuf {
    folder.join("work/checkpoint.npz")
}

#[test]
fn a_clip_becomes_an_avatar_that_looks_like_the_person() {
    let Some(gpu) = gpu("a_clip_becomes_an_avatar_that_looks_like_the_person") else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut witness = Witness::default();
    let outcome = run(&gpu, &input(clip(&gpu)), folder.path(), &mut witness).unwrap();
    assert_eq!(outcome.frames, 12);
    assert!(outcome.metrics["mask_iou"].as_f64().unwrap() > 0.9, "{:#}", outcome.metrics);
    assert!(outcome.metrics["psnr"].as_f64().unwrap() > 20.0, "{:#}", outcome.metrics);
    let files = [
        "avatar.glb",
        "avatar.vrm",
        "texture.png",
        "motion.npz",
        "mesh.ply",
        "report.json",
        "report.html",
        "model.npz",
    ];
    for file in files {
        assert!(folder.path().join("out").join(file).metadata().unwrap().len() > 100, "{file}");
    }
    let report = std::fs::read(folder.path().join("out/report.json")).unwrap();
    let mut report: serde_json::Value = serde_json::from_slice(&report).unwrap();
    assert_eq!(report["covered"], serde_json::json!({ "toes": true, "ears": false }), "shoes and short hair");
    let quality = report["quality"].take();
    let codes: Vec<&str> = quality["flags"].as_array().unwrap().iter().map(|f| f["code"].as_str().unwrap()).collect();
    assert!(codes.starts_with(&["few_frames", "low_resolution"]), "12 frames of 96 pixels: {codes:?}");
    assert!(!codes.contains(&"no_full_turn") && !codes.contains(&"focal_estimated"), "{codes:?}");
    assert!(!codes.contains(&"focal_contradicted"), "{codes:?}");
    assert_eq!(quality["frames"].as_array().unwrap().len(), 12);
    let page = std::fs::read_to_string(folder.path().join("out/report.html")).unwrap();
    for shown in [
        "few_frames",
        "Stage 1",
        "Stage 2",
        "face area",
        "frame 11",
        "the avatar from ten sides",
        "geometry",
        "left hand: input",
    ] {
        assert!(page.contains(shown), "report.html does not show `{shown}`");
    }
    // What a report lacks is a dash, or unknown: none of what this page shows of it.
    for lacking in ["—", "unknown"] {
        assert!(!page.contains(lacking), "report.html shows `{lacking}`");
    }
    let pictures = page.matches("<img").count();
    assert!(
        (11..=14).contains(&pictures),
        "a turntable, five spread frames, those of three worst that are none, five close-ups: {pictures}"
    );
    let unseen = quality["surface"]["unseen_area"].as_f64().unwrap();
    assert!(unseen > 0.0 && unseen < 0.5, "soles and armpits are not seen, most else is: {unseen}");
    let model = AvatarModel::load(&folder.path().join("out/model.npz")).unwrap();
    assert_eq!((model.poses.len(), model.frames[11]), (12, 11));

    let progress: Vec<f32> = witness.heard.iter().map(|p| p.progress).collect();
    assert!(progress.is_sorted(), "progress never goes back: {progress:?}");
    assert!(progress[0] < 0.05 && *progress.last().unwrap() > 0.95);
    let texture = witness.heard.iter().filter(|p| p.stage == Stage::Texture && p.step > 0);
    let told: Vec<[u32; 2]> = texture.map(|p| [p.step, p.steps]).collect();
    let [last, all] = *told.last().unwrap();
    assert!(
        last == all && told.iter().all(|t| t[1] == all),
        "the detail's steps are known from the beginning: {told:?}"
    );
    assert!(witness.idle > 20, "the device is lent out between iterations");
    previews_show_the_avatar_emerge(&witness.previews);
    let mut losses = witness.heard.iter().rev().filter(|p| p.stage == Stage::Texture).map(|p| &p.losses);
    assert!(losses.next().is_some_and(|detail| detail["rgb"].is_finite()));
    let silhouette = losses.find_map(|losses| losses.get("silhouette"));
    assert!(silhouette.is_some_and(|&loss| loss < 0.2), "{silhouette:?}");
}

/// From the grey body of stage 0 to the coloured one of the end.
fn previews_show_the_avatar_emerge(previews: &[Preview]) {
    let stages: Vec<Stage> = previews.iter().map(|preview| preview.at.stage).collect();
    assert!(stages.is_sorted() && stages[0] == Stage::Pose && stages.ends_with(&[Stage::Texture]), "{stages:?}");
    assert!(stages.contains(&Stage::Geometry), "{stages:?}");
    let pictures: Vec<_> =
        previews.iter().map(|preview| image::load_from_memory(&preview.jpeg).unwrap().to_rgb8()).collect();
    // Mean distance of a pixel's channels from each other, where the person is.
    let person = |picture: &image::RgbImage| -> Vec<f64> {
        let spread = |p: &image::Rgb<u8>| f64::from(p.0.iter().max().unwrap() - p.0.iter().min().unwrap());
        picture.pixels().filter(|p| p.0.iter().all(|&c| c < 230)).map(spread).collect()
    };
    for picture in &pictures {
        assert_eq!(picture.width().max(picture.height()), 320);
        let part = person(picture).len() as f64 / f64::from(picture.width() * picture.height());
        assert!((0.05..0.9).contains(&part), "{part} of the picture show the person");
    }
    let colour = |picture| person(picture).iter().sum::<f64>() / person(picture).len() as f64;
    let (first, last) = (colour(&pictures[0]), colour(&pictures[pictures.len() - 1]));
    assert!(first < 8.0 && last > 15.0, "from grey ({first}) to colours ({last})");
}

#[test]
fn a_wrong_focal_length_is_told_and_replaced() {
    let Some(gpu) = gpu("a_wrong_focal_length_is_told_and_replaced") else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut input = input(clip(&gpu));
    let mut camera: serde_json::Value =
        serde_json::from_slice(&std::fs::read(input.files.camera.as_ref().unwrap()).unwrap()).unwrap();
    let right = camera["fx"].as_f64().unwrap();
    for name in ["fx", "fy"] {
        camera[name] = (0.6 * camera[name].as_f64().unwrap()).into();
    }
    let wrong = folder.path().join("camera.json");
    std::fs::write(&wrong, camera.to_string()).unwrap();
    input.files.camera = Some(wrong);
    for trust in [false, true] {
        input.options.trust_camera = trust;
        run(&gpu, &input, folder.path(), &mut Witness::default()).unwrap();
        let report = std::fs::read(folder.path().join("out/report.json")).unwrap();
        let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
        let flags = report["quality"]["flags"].as_array().unwrap();
        let flag = flags.iter().find(|f| f["code"] == "focal_contradicted").unwrap();
        assert!((flag["value"].as_f64().unwrap() * 0.6 - 1.0).abs() < 0.2, "{flag:#}");
        assert_eq!(flag["message"].as_str().unwrap().contains("trust_camera"), trust, "{flag:#}");
        assert_eq!(report["camera_estimated"], !trust);
        let (taken, expected) = (report["camera"]["fx"].as_f64().unwrap(), if trust { 0.6 * right } else { right });
        assert!((taken / expected - 1.0).abs() < if trust { 1e-6 } else { 0.2 }, "{taken} px, expected {expected}");
    }
}

/// Legs apart in all frames, and the gap between them closed from the crotch to the knees, as where a skirt was fitted.
fn wear_a_skirt(body: &Body, state: &mut FitState) {
    const APART: f32 = 0.12;
    for pose in state.poses.chunks_mut(N_POSE) {
        (pose[3 * LEFT_HIP + 2], pose[3 * RIGHT_HIP + 2]) = (APART, -APART);
    }
    let [hip, knee] = [LEFT_HIP, LEFT_KNEE].map(|joint| body.j_template[joint]);
    for (offset, v) in state.offsets.as_chunks_mut::<3>().0.iter_mut().zip(&body.v_template) {
        let of_leg = (v[0] / hip[0]).abs();
        if of_leg < 1.0 && (knee[1]..hip[1]).contains(&v[1]) {
            // Where the leg's turn brings it to the middle.
            let middle = hip[0] - (hip[0] + (hip[1] - v[1]) * APART.sin()) / APART.cos();
            // A leg's inside is less than half as far from its axis as the middle is.
            let drawn = (2.6 * (1.0 - of_leg)).min(1.0);
            offset[0] = drawn * (middle * v[0].signum() - v[0]);
        }
    }
}

#[test]
fn a_skirt_becomes_one_piece_and_learns_its_texture_anew() {
    let Some(gpu) = gpu("a_skirt_becomes_one_piece_and_learns_its_texture_anew") else { return };
    let folder = tempfile::tempdir().unwrap();
    let start = Start::new(&gpu, 12);
    start.fitted_with_a_skirt(&gpu, folder.path());

    let draft = FitConfig::draft(0);
    let before = draft.steps(&draft.texture.phases, 12);
    let mut witness = Witness { stop_at: Some((Stage::Texture, before + 5)), ..Witness::default() };
    let stopped = run(&gpu, &input(clip(&gpu)), folder.path(), &mut witness);
    assert!(matches!(stopped, Err(PipelineError::Stopped(_))), "{stopped:?}");
    let mut witness = Witness::default();
    run(&gpu, &input(clip(&gpu)), folder.path(), &mut witness).unwrap();
    let steps = witness.heard.iter().filter(|p| p.stage == Stage::Texture && p.step > 0).map(|p| p.step);
    assert_eq!(steps.min(), Some(before + 6), "it goes on where it was stopped");
    assert!(witness.heard.iter().map(|p| p.progress).is_sorted());
    assert!(!witness.previews.is_empty());

    let model = AvatarModel::load(&folder.path().join("out/model.npz")).unwrap();
    assert!(model.body.n_faces() < start.body.n_faces(), "no walls inside");
    assert_eq!(model.face_colours.len(), model.body.n_faces());
    assert_ne!(model.texture, start.state.field);
    assert_eq!(model.betas, start.state.betas, "the shape stands");
    let report = std::fs::read(folder.path().join("out/report.json")).unwrap();
    let flags = serde_json::from_slice::<serde_json::Value>(&report).unwrap()["quality"]["flags"].take();
    assert!(flags.as_array().unwrap().iter().any(|f| f["code"] == "cloth_between_legs"), "{flags:#}");
}

/// Mean absolute error of the avatar's pictures against a clip's frames, well inside of the masks, sRGB in 0..255.
fn picture_error(gpu: &Arc<Gpu>, model: AvatarModel, capture: &Capture) -> f64 {
    let model = Arc::new(model);
    let renderer = Renderer::new(gpu, &model).unwrap();
    let (mut sum, mut n) = (0.0, 0);
    for (k, frame) in capture.frames.iter().enumerate() {
        let camera = capture.camera.cropped(frame.x0 as i32, frame.y0 as i32, frame.width, frame.height);
        let picture = renderer.render(&RenderSpec { camera, ..RenderSpec::of_frame(&model, k) }).unwrap();
        let inside = |x: u32, y: u32| frame.mask.get((y * frame.width + x) as usize).is_some_and(|&m| is_foreground(m));
        for (x, y, ours) in picture.enumerate_pixels() {
            let around = x > 0 && y > 0 && inside(x - 1, y) && inside(x + 1, y) && inside(x, y - 1) && inside(x, y + 1);
            if around && ours.0[3] == 255 {
                let theirs = &frame.rgb[3 * (y * frame.width + x) as usize..][..3];
                sum += (0..3).map(|c| f64::from(ours.0[c].abs_diff(theirs[c]))).sum::<f64>();
                n += 3;
            }
        }
    }
    sum / f64::from(n)
}

/// A copy of a job's folder in which the detail has not begun.
fn without_detail(folder: &Path) -> tempfile::TempDir {
    let copy = tempfile::tempdir().unwrap();
    let work = copy.path().join("work");
    std::fs::create_dir(&work).unwrap();
    for entry in std::fs::read_dir(folder.join("work")).unwrap().map(Result::unwrap) {
        if !entry.file_name().to_string_lossy().starts_with("detailed") {
            std::fs::copy(entry.path(), work.join(entry.file_name())).unwrap();
        }
    }
    copy
}

#[test]
fn a_texture_goes_on_with_the_uploaded_pictures_where_they_are_larger() {
    let Some(gpu) = gpu("a_texture_goes_on_with_the_uploaded_pictures_where_they_are_larger") else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut small = input(clip(&gpu));
    small.options.max_side_px = Some(64);
    let draft = FitConfig::draft(0);
    let before = draft.steps(&draft.texture.phases, 12);
    let mut witness = Witness { stop_at: Some((Stage::Texture, before + 5)), ..Witness::default() };
    let stopped = run(&gpu, &small, folder.path(), &mut witness);
    assert!(matches!(stopped, Err(PipelineError::Stopped(_))), "{stopped:?}");

    let fresh = Start::new(&gpu, 12);
    let fitted = fresh.state.resume(&checkpoint(folder.path())).unwrap().unwrap();
    assert_eq!(fitted.stage, fit::Stage::Done);
    let uninterrupted = without_detail(folder.path());
    let mut witness = Witness::default();
    run(&gpu, &small, folder.path(), &mut witness).unwrap();
    run(&gpu, &small, uninterrupted.path(), &mut Witness::default()).unwrap();
    let [gone_on, at_once] =
        [&folder, &uninterrupted].map(|f| std::fs::read(f.path().join("out/texture.png")).unwrap());
    assert!(gone_on == at_once, "the detail that was stopped is another one");
    let steps = witness.heard.iter().filter(|p| p.stage == Stage::Texture && p.step > 0).map(|p| p.step);
    assert_eq!(steps.min(), Some(before + 6), "it goes on where it was stopped");
    assert!(witness.heard.iter().map(|p| p.progress).is_sorted());
    let steps: Vec<(u32, u32)> =
        witness.heard.iter().filter(|p| p.stage == Stage::Texture && p.step > 0).map(|p| (p.step, p.steps)).collect();
    let last = steps.last().unwrap().0;
    assert!(steps.iter().all(|(_, steps)| *steps == last), "all rounds' steps are expected in each: {steps:?}");

    let out = folder.path().join("out");
    let report: serde_json::Value = serde_json::from_slice(&std::fs::read(out.join("report.json")).unwrap()).unwrap();
    assert_eq!(report["detail"], serde_json::json!({ "side_px": 192, "frames": 12 }));
    let detailed = AvatarModel::load(&out.join("model.npz")).unwrap();
    assert_eq!(detailed.poses.len(), 12);
    assert_eq!(
        (&detailed.betas, detailed.offsets.as_flattened()),
        (&fitted.betas, &fitted.offsets[..]),
        "shape stands"
    );
    let plain = AvatarModel {
        texture_config: FitConfig::draft(0).field,
        texture: fitted.field,
        texcoords: fitted.texcoords.as_chunks().0.to_vec(),
        face_colours: fitted.face_colours.as_chunks().0.to_vec(),
        light: fitted.light,
        ..AvatarModel::load(&out.join("model.npz")).unwrap()
    };
    let [plain, detailed] = [plain, detailed].map(|model| picture_error(&gpu, model, &fresh.capture));
    // 0.87 of it when this was written.
    assert!(detailed < 0.95 * plain, "{detailed} without detail {plain}");
}

/// Lets the fit run and keeps the last losses of each stage.
#[derive(Default)]
struct Patient {
    losses: BTreeMap<&'static str, BTreeMap<&'static str, f32>>,
    /// Of each stage the colours' losses of all steps, and how many these are: each report is the mean of the steps since the one before,
    /// and when that was the clock decides.
    rgb: BTreeMap<&'static str, (f64, u32)>,
    /// Holds the fit up after each of its first steps for so long.
    dawdles: Duration,
}

impl Control for Patient {
    fn after_step(&mut self, report: &StepReport<'_>) -> Flow {
        if let Some(losses) = report.losses {
            let stage = if report.stage == fit::Stage::Geometry { "geometry" } else { "texture" };
            self.losses.insert(stage, losses.clone());
            if let Some(&rgb) = losses.get("rgb") {
                let (sum, steps) = self.rgb.entry(stage).or_default();
                *sum += f64::from(rgb) * f64::from(report.step - *steps);
                *steps = report.step;
            }
        }
        if report.step <= 12 {
            std::thread::sleep(self.dawdles);
        }
        Flow::Continue
    }
}

/// A clip with its start, for fits without the pipeline around them.
struct Start {
    body: Body,
    capture: Capture,
    camera: effigy::camera::Camera,
    state: FitState,
}

impl Start {
    fn new(gpu: &Arc<Gpu>, max_frames: u32) -> Self {
        let body = Body::test_body();
        let inputs = input(clip(gpu)).files;
        let mut capture =
            Capture::load(&inputs, &CaptureOptions { max_frames, max_side_px: 96 }, &mut |_| true).unwrap();
        let start = stage0::solve(&body, &capture, &Stage0Options::default(), &mut |_| true).unwrap();
        start.reread(&mut capture);
        let field = FitConfig::draft(0).field;
        let state = FitState::new(&body, start.betas, &start.poses, &start.transl, field, 0);
        Self { body, capture, camera: start.camera, state }
    }

    /// Leaves the checkpoint of a fit that is done and has shaped a skirt of two legs in a job's folder.
    fn fitted_with_a_skirt(&self, gpu: &Arc<Gpu>, folder: &Path) {
        let mut fitted = FitState { stage: fit::Stage::Done, ..self.state.clone() };
        wear_a_skirt(&self.body, &mut fitted);
        // A checkpoint is gone on from where this program has begun.
        let mut witness = Witness { stop_at: Some((Stage::Decode, 1)), ..Witness::default() };
        run(gpu, &input(clip(gpu)), folder, &mut witness).unwrap_err();
        fitted.save(&checkpoint(folder)).unwrap();
    }

    fn fit(&self, gpu: &Arc<Gpu>, config: &FitConfig, state: FitState) -> (Result<FitState, FitError>, Patient) {
        self.fit_by(gpu, config, state, Patient::default())
    }

    fn fit_by(
        &self,
        gpu: &Arc<Gpu>,
        config: &FitConfig,
        state: FitState,
        mut patient: Patient,
    ) -> (Result<FitState, FitError>, Patient) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("checkpoint.npz");
        let Self { body, capture, camera, .. } = self;
        (fit::run(gpu, &Inputs { body, capture, camera, config }, state, &path, &mut patient), patient)
    }
}

/// The configuration with few passes.
fn short(mut config: FitConfig) -> FitConfig {
    for stage in [&mut config.geometry, &mut config.texture] {
        stage.phases.iter_mut().for_each(|phase| phase.epochs = phase.epochs.min(3));
    }
    config
}

#[test]
fn a_fit_that_diverges_says_so() {
    let Some(gpu) = gpu("a_fit_that_diverges_says_so") else { return };
    let start = Start::new(&gpu, 4);
    let mut config = FitConfig::draft(0);
    config.rates.transl = f32::MAX;
    let (result, _) = start.fit(&gpu, &config, start.state.clone());
    assert!(matches!(result, Err(FitError::Diverged { .. })), "{:?}", result.map(|state| state.transl));
}

/// Bit by bit, also where losses are reported at other steps: what a fit becomes does not depend on the clock.
#[test]
fn the_same_seed_gives_the_same_avatar() {
    let Some(gpu) = gpu("the_same_seed_gives_the_same_avatar") else { return };
    let start = Start::new(&gpu, 6);
    let config = short(FitConfig::standard(3));
    let first = start.fit(&gpu, &config, start.state.clone()).0.unwrap();
    // Reports come once a second.
    let slow = Patient { dawdles: Duration::from_millis(350), ..Patient::default() };
    let second = start.fit_by(&gpu, &config, start.state.clone(), slow).0.unwrap();
    assert!(first == second, "two fits of one seed differ");
    let other = start.fit(&gpu, &short(FitConfig::standard(4)), start.state.clone()).0.unwrap();
    assert!(first != other, "another seed gives the same");
}

#[test]
fn silhouettes_alone_fit_the_geometry_without_a_look_at_colours() {
    let Some(gpu) = gpu("silhouettes_alone_fit_the_geometry_without_a_look_at_colours") else { return };
    let start = Start::new(&gpu, 6);
    let (state, patient) = start.fit(&gpu, &short(FitConfig::silhouette_only(0)), start.state.clone());
    let state = state.unwrap();
    let terms = |stage: &str| patient.losses[stage].keys().copied().collect::<Vec<_>>();
    assert_eq!(terms("geometry"), ["face_area", "keypoints", "laplacian", "normal_consistency", "silhouette"]);
    assert_eq!(terms("texture"), ["rgb"]);
    assert!(state.offsets != start.state.offsets && state.field != start.state.field);
    assert!(state.face_colours.iter().any(|c| (c - 0.5).abs() > 0.1), "the faces have taken the clip's colours");
}

#[test]
fn a_joint_fit_moves_everything_at_once() {
    let Some(gpu) = gpu("a_joint_fit_moves_everything_at_once") else { return };
    let start = Start::new(&gpu, 6);
    let (state, patient) = start.fit(&gpu, &short(FitConfig::draft(0)).joint(), start.state.clone());
    let (after, before) = (state.unwrap(), &start.state);
    assert!(!patient.losses.contains_key("geometry"), "no stage comes before");
    assert_eq!(patient.losses["texture"].len(), 7, "all terms: {:?}", patient.losses);
    let moved = [
        after.betas != before.betas,
        after.offsets != before.offsets,
        after.poses != before.poses,
        after.transl != before.transl,
        after.face_colours != before.face_colours,
        after.texcoords != before.texcoords,
        after.field != before.field,
    ];
    assert_eq!(moved, [true; 7]);
    assert!(patient.losses["texture"]["silhouette"] < 0.3, "{:?}", patient.losses);
}

#[test]
fn a_texel_map_learns_the_clip_as_the_hash_texture_does() {
    let Some(gpu) = gpu("a_texel_map_learns_the_clip_as_the_hash_texture_does") else { return };
    let start = Start::new(&gpu, 6);
    let mut config = short(FitConfig::draft(0));
    config.rates.texcoords = 0.0;
    let hash = start.fit(&gpu, &config, start.state.clone());
    let layout = UvLayout::of_body(&start.body);
    let grey = Texels::grey(layout.uvs, layout.uv_faces, 128);
    let texels = start.fit(&gpu, &config, FitState { texels: Some(grey.clone()), ..start.state.clone() });
    let (hash_state, texel_state) = (hash.0.unwrap(), texels.0.unwrap());
    assert_eq!(hash_state.texcoords, start.state.texcoords, "fixed coordinates stand");
    assert_eq!(texel_state.field, start.state.field, "the field was not touched");
    assert_ne!(texel_state.texels, Some(grey));
    let rgb = |patient: &Patient| {
        let (sum, steps) = patient.rgb["texture"];
        sum / f64::from(steps)
    };
    config.rates.field = 0.0;
    let unlearnt = start.fit(&gpu, &config, start.state.clone());
    let [hash, texels, unlearnt] = [hash.1, texels.1, unlearnt.1].map(|patient| rgb(&patient));
    assert!(unlearnt - texels > 0.5 * (unlearnt - hash), "hash {hash}, texels {texels}, unlearnt {unlearnt}");
}

#[test]
fn a_pose_is_refined_on_its_picture_while_the_avatar_stands() {
    let Some(gpu) = gpu("a_pose_is_refined_on_its_picture_while_the_avatar_stands") else { return };
    let start = Start::new(&gpu, 12);
    let config = FitConfig::draft(0);
    let fitted = start.fit(&gpu, &config, start.state.clone()).0.unwrap();
    let mut alone =
        FitState { poses: fitted.poses[..N_POSE].to_vec(), transl: fitted.transl[..3].to_vec(), ..fitted.clone() };
    // The right elbow and the place are off, as a foreign body's would be.
    alone.poses[3 * RIGHT_ELBOW + 1] += 0.25;
    alone.transl[0] += 0.03;
    let (picture, camera) = (start.capture.frames[0].clone(), &start.camera);
    let refined = fit::refine_pose(&gpu, &start.body, camera, picture, alone.clone(), &config).unwrap();
    let far = |state: &FitState| (state.transl[0] - fitted.transl[0]).abs();
    assert!(far(&refined) < 0.4 * far(&alone), "{} of {} m are left", far(&refined), far(&alone));
    let stood = FitState {
        stage_poses: alone.poses.clone(),
        stage_transl: alone.transl.clone(),
        poses: alone.poses,
        transl: alone.transl,
        stage: refined.stage,
        step: refined.step,
        ..fitted
    };
    assert_eq!(
        FitState { poses: stood.poses.clone(), transl: stood.transl.clone(), ..refined },
        stood,
        "only poses move"
    );
}

#[test]
fn an_unknown_body_says_what_to_do() {
    let Some(gpu) = gpu("an_unknown_body_says_what_to_do") else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut input = input(clip(&gpu));
    input.options.body = "nobody".into();
    let error = run(&gpu, &input, folder.path(), &mut Witness::default()).unwrap_err().to_string();
    assert!(error.contains("nobody") && error.contains("effigy body import"), "{error}");
}
