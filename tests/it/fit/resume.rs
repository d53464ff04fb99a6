//! Fits that are stopped and go on.

use effigy::body::N_POSE;
use effigy::body::joints::LEFT_ELBOW;
use effigy::fit::detail::rounds;
use effigy::fit::{self, Control, FitConfig, FitError, FitState, Flow, Inputs, StepReport};
use effigy::npz::{Npz, NpzWriter};
use effigy::worker::pipeline::{PipelineError, Progress, Stage, StopReason};

use super::{Start, Witness, checkpoint, clip, gpu, input, run, short};

#[test]
fn a_stopped_fit_goes_on_from_its_checkpoint() {
    let Some(gpu) = gpu("a_stopped_fit_goes_on_from_its_checkpoint") else { return };
    let folder = tempfile::tempdir().unwrap();
    let clip_made = input(clip(&gpu));
    let before = gpu.bytes();
    let mut witness = Witness { stop_at: Some((Stage::Geometry, 20)), ..Witness::default() };
    let stopped = run(&gpu, &clip_made, folder.path(), &mut witness);
    assert!(matches!(stopped, Err(PipelineError::Stopped(StopReason::Cancel))), "{stopped:?}");
    assert!(checkpoint(folder.path()).exists());
    assert!(gpu.peak_bytes() > before);
    assert_eq!(gpu.bytes(), before, "the device's memory is free again");
    let fresh = Start::new(&gpu, 12).state;
    let saved = || fresh.resume(&checkpoint(folder.path())).unwrap().unwrap();
    let first = saved();
    assert_ne!(first.poses, first.stage_poses);

    let mut witness = Witness { stop_at: Some((Stage::Geometry, 23)), ..Witness::default() };
    let stopped = run(&gpu, &input(clip(&gpu)), folder.path(), &mut witness);
    assert!(matches!(stopped, Err(PipelineError::Stopped(_))), "{stopped:?}");
    let steps: Vec<u32> =
        witness.heard.iter().filter(|p| p.stage == Stage::Geometry && p.step > 0).map(|p| p.step).collect();
    assert_eq!(steps, [21, 22, 23]);
    // Joints are held near where the stage began, not near where it was stopped.
    let second = saved();
    assert_eq!(second.stage_poses, first.stage_poses);
    assert_ne!(second.poses, first.poses);

    // Another clip's checkpoint, or a torn one, is not followed.
    std::fs::write(checkpoint(folder.path()), b"torn").unwrap();
    let mut witness = Witness { stop_at: Some((Stage::Geometry, 2)), ..Witness::default() };
    run(&gpu, &input(clip(&gpu)), folder.path(), &mut witness).unwrap_err();
    assert!(witness.heard.iter().any(|p| p.stage == Stage::Geometry && p.step == 1));
}

#[test]
fn a_fit_that_goes_on_reports_its_losses_from_the_beginning() {
    let Some(gpu) = gpu("a_fit_that_goes_on_reports_its_losses_from_the_beginning") else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut witness = Witness { stop_at: Some((Stage::Texture, 30)), ..Witness::default() };
    run(&gpu, &input(clip(&gpu)), folder.path(), &mut witness).unwrap_err();
    let is_fitted = |p: &&Progress| matches!(p.stage, Stage::Geometry | Stage::Texture) && !p.losses.is_empty();
    let first = witness.heard.iter().find(is_fitted).map(|p| (p.stage.name(), p.step));
    let (stage, step) = first.expect("losses are read once a second");

    // Stopped before it is known what it goes on from; and losses of a step that was not kept.
    let mut witness = Witness { stop_at: Some((Stage::Decode, 0)), ..Witness::default() };
    run(&gpu, &input(clip(&gpu)), folder.path(), &mut witness).unwrap_err();
    let kept = folder.path().join("work/losses.json");
    let mut file: serde_json::Value = serde_json::from_slice(&std::fs::read(&kept).unwrap()).unwrap();
    let lost = serde_json::json!({ "stage": "texture", "step": 31, "losses": { "lost": 1.0 } });
    file["points"].as_array_mut().unwrap().push(lost);
    // And times of before.
    file["secs"] = serde_json::json!({ "pose": 1000.0, "texture": 2000.0 });
    std::fs::write(&kept, serde_json::to_vec(&file).unwrap()).unwrap();

    let mut witness = Witness::default();
    run(&gpu, &input(clip(&gpu)), folder.path(), &mut witness).unwrap();
    let resumed_at = witness.heard.iter().find(|p| p.stage == Stage::Texture && p.step > 0).unwrap().step;
    assert_eq!(resumed_at, 31);
    let report = std::fs::read(folder.path().join("out/report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
    let points: Vec<(&str, u64)> = report["losses"]
        .as_array()
        .unwrap()
        .iter()
        .map(|point| {
            assert!(point["losses"].as_object().is_some_and(|losses| !losses.is_empty()), "{point}");
            (point["stage"].as_str().unwrap(), point["step"].as_u64().unwrap())
        })
        .collect();
    assert_eq!(points[0], (stage, u64::from(step)));
    assert!(!report["losses"].to_string().contains("lost"));
    let secs = |stage: &str| report["secs"][stage].as_f64().unwrap();
    assert!(secs("pose") > 1000.0 && secs("texture") > 2000.0 && secs("geometry") < 1000.0, "{}", report["secs"]);
    assert!(report["metrics"]["secs"].as_f64().unwrap() > 3000.0);
    assert!(points.windows(2).all(|pair| pair[0] < pair[1]), "each step once, in order: {points:?}");
}

#[test]
fn a_fit_that_lost_its_job_leaves_the_checkpoint_to_the_one_that_has_it() {
    let Some(gpu) = gpu("a_fit_that_lost_its_job_leaves_the_checkpoint_to_the_one_that_has_it") else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut witness = Witness { stop_at: Some((Stage::Geometry, 5)), ..Witness::default() };
    run(&gpu, &input(clip(&gpu)), folder.path(), &mut witness).unwrap_err();
    let [kept, losses] = ["checkpoint.npz", "losses.json"].map(|file| folder.path().join("work").join(file));
    std::fs::write(&losses, "[ ]").unwrap();
    let before = std::fs::read(&kept).unwrap();
    let mut witness = Witness { stop_at: Some((Stage::Geometry, 7)), lost: true, ..Witness::default() };
    let stopped = run(&gpu, &input(clip(&gpu)), folder.path(), &mut witness);
    assert!(matches!(stopped, Err(PipelineError::Stopped(StopReason::LostLease))), "{stopped:?}");
    assert!(witness.heard.iter().any(|p| p.stage == Stage::Geometry && p.step == 7), "it had gone on");
    assert!(std::fs::read(&kept).unwrap() == before, "the checkpoint is as it was");
    assert_eq!(std::fs::read(&losses).unwrap(), b"[ ]");
}

/// The passes after the fit as well: on the tailored cloth, and on larger pictures.
#[test]
fn what_comes_after_the_fit_ends_the_same_wherever_it_is_stopped() {
    let Some(gpu) = gpu("what_comes_after_the_fit_ends_the_same_wherever_it_is_stopped") else { return };
    let (whole, stopped) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let start = Start::new(&gpu, 12);
    start.fitted_with_a_skirt(&gpu, whole.path());
    start.fitted_with_a_skirt(&gpu, stopped.path());
    run(&gpu, &input(clip(&gpu)), whole.path(), &mut Witness::default()).unwrap();

    let draft = FitConfig::draft(0);
    let [fit, cloth] = [&draft, &draft.clone().texture_alone()].map(|config| config.steps(&config.texture.phases, 12));
    // Of each frame a close-up and the whole.
    let [first, second, _] = rounds(&draft).map(|round| round.steps(&round.texture.phases, 2 * 12));
    let detail = fit + cloth;
    for at in [fit + 4, fit + 5, detail + 3, detail + first + 2, detail + first + second + 9] {
        let mut witness = Witness { stop_at: Some((Stage::Texture, at)), ..Witness::default() };
        run(&gpu, &input(clip(&gpu)), stopped.path(), &mut witness).unwrap_err();
        let last = witness.heard.last().map(|p| (p.stage, p.step));
        assert_eq!(last, Some((Stage::Texture, at)));
    }
    let kept = [1, 2, 3].map(|round| stopped.path().join(format!("work/detailed-{round}.npz")).exists());
    assert_eq!(kept, [false, true, true], "what the last round began from, and where it is");
    run(&gpu, &input(clip(&gpu)), stopped.path(), &mut Witness::default()).unwrap();
    for file in ["model.npz", "avatar.glb", "avatar.vrm", "texture.png"] {
        let [whole, stopped] =
            [&whole, &stopped].map(|folder| std::fs::read(folder.path().join("out").join(file)).unwrap());
        assert!(whole == stopped, "{file} of a fit that was stopped five times is another");
    }
}

/// Stops a fit after so many steps, and writes down which they were.
struct Stopper {
    after: usize,
    heard: Vec<u32>,
}

impl Stopper {
    fn new(after: usize) -> Self {
        Self { after, heard: Vec::new() }
    }
}

impl Control for Stopper {
    fn after_step(&mut self, report: &StepReport<'_>) -> Flow {
        self.heard.push(report.step);
        if self.heard.len() == self.after { Flow::Stop } else { Flow::Continue }
    }
}

/// Bit by bit, wherever it is stopped: in a pass, at the end of one, of a phase or of a stage.
#[test]
fn a_fit_that_is_stopped_again_and_again_ends_as_one_that_is_not() {
    let Some(gpu) = gpu("a_fit_that_is_stopped_again_and_again_ends_as_one_that_is_not") else { return };
    let start = Start::new(&gpu, 6);
    for (config, after) in [(FitConfig::standard(3), 3), (FitConfig::paper(3), 3)] {
        let (config, folder) = (short(config), tempfile::tempdir().unwrap());
        let whole = start.fit(&gpu, &config, start.state.clone()).0.unwrap();
        let path = folder.path().join("checkpoint.npz");
        let (mut state, mut stops) = (start.state.clone(), 0);
        let ended = loop {
            let Start { body, capture, camera, .. } = &start;
            let inputs = Inputs { body, capture, camera, config: &config };
            match fit::run(&gpu, &inputs, state, &path, &mut Stopper::new(after)) {
                Err(FitError::Stopped) => state = start.state.resume(&path).unwrap().unwrap(),
                ended => break ended.unwrap(),
            }
            stops += 1;
        };
        assert!(stops > 4, "{stops}");
        assert!(ended == whole, "a fit that was stopped {stops} times ends otherwise");
        let again = start.fit(&gpu, &config, ended).0.unwrap();
        assert!(again == whole, "a fit that is done stays as it is");
    }
}

/// As one of another version of the program may be.
#[test]
fn a_checkpoint_without_an_optimiser_is_gone_on_from_all_the_same() {
    let Some(gpu) = gpu("a_checkpoint_without_an_optimiser_is_gone_on_from_all_the_same") else { return };
    let (start, folder) = (Start::new(&gpu, 6), tempfile::tempdir().unwrap());
    let (config, path) = (short(FitConfig::draft(0)), folder.path().join("checkpoint.npz"));
    let Start { body, capture, camera, state } = &start;
    let inputs = Inputs { body, capture, camera, config: &config };
    let run = |state: FitState, stopper: &mut Stopper| fit::run(&gpu, &inputs, state, &path, stopper);
    assert!(matches!(run(state.clone(), &mut Stopper::new(3)), Err(FitError::Stopped)));
    let whole = Npz::open(&path).unwrap();
    let mut writer = NpzWriter::new(std::fs::File::create(&path).unwrap());
    let (gone, rest): (Vec<_>, Vec<_>) = whole.arrays.iter().partition(|(name, _)| name.ends_with("betas.exp_avg"));
    assert_eq!(gone.len(), 1);
    for (name, array) in rest {
        writer.add(name, &array.shape, &array.f32()).unwrap();
    }
    writer.finish().unwrap();
    let resumed = state.resume(&path).unwrap().unwrap();
    let mut stopper = Stopper::new(1);
    assert!(matches!(run(resumed.clone(), &mut stopper), Err(FitError::Stopped)));
    assert_eq!(stopper.heard, [4]);
    let next = state.resume(&path).unwrap().unwrap();
    let between = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f32>().sqrt();
    let (so_far, step) = (between(&resumed.poses, &resumed.stage_poses), between(&next.poses, &resumed.poses));
    assert!(so_far > 0.0 && step < 0.6 * so_far, "poses moved by {so_far} in three steps and then by {step} in one");
    assert_eq!(run(next, &mut Stopper::new(usize::MAX)).unwrap().stage, fit::Stage::Done);
}

#[test]
fn a_resumed_stage_holds_joints_near_where_it_had_begun() {
    const ELBOW_X: usize = 3 * LEFT_ELBOW;
    let Some(gpu) = gpu("a_resumed_stage_holds_joints_near_where_it_had_begun") else { return };
    let start = Start::new(&gpu, 12);
    // As after a first step; the left elbow, a hinge that does not bend there, began elsewhere in the second.
    let resumed = FitState { step: 1, ..start.state.clone() };
    let mut elsewhere = resumed.clone();
    elsewhere.stage_poses.chunks_mut(N_POSE).for_each(|pose| pose[ELBOW_X] += 0.2);
    let [near, far] = [resumed, elsewhere].map(|state| {
        let fitted = start.fit(&gpu, &short(FitConfig::draft(0)), state).0.unwrap();
        fitted.poses.chunks(N_POSE).map(|pose| pose[ELBOW_X]).sum::<f32>() / fitted.n_frames() as f32
    });
    assert!(far - near > 0.02, "{near}, {far} rad");
}
