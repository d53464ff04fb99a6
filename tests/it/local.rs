//! The job without a server: `effigy fit`, `effigy eval` and `effigy render`, as somebody types them.

use std::path::Path;

use serde_json::Value;

fn effigy(arguments: &[&str]) -> std::process::Output {
    crate::program::effigy().args(arguments).output().unwrap()
}

/// What a run that must not fail has written.
fn written(arguments: &[&str]) -> String {
    let output = effigy(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn a_folder_becomes_an_avatar_that_can_be_measured_and_rendered() {
    let Some(gpu) = crate::fit::gpu("a_folder_becomes_an_avatar_that_can_be_measured_and_rendered") else { return };
    let clip = crate::fit::clip(&gpu);
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("avatar");
    std::fs::create_dir_all(out.join("work")).unwrap();
    let theirs = out.join("work/theirs.txt");
    std::fs::write(&theirs, "not the fit's").unwrap();

    let checkpoint = out.join(".effigy-work/stage1.npz");
    std::fs::create_dir(checkpoint.parent().unwrap()).unwrap();
    std::fs::write(&checkpoint, "of another body").unwrap();
    let mistyped = effigy(&["fit", text(clip), "--body", "tset", "--out", text(&out)]);
    assert!(!mistyped.status.success() && String::from_utf8_lossy(&mistyped.stderr).contains("tset"));
    assert!(checkpoint.exists(), "a mistyped name costs no checkpoint");

    let fit =
        ["fit", text(clip), "--body", "test", "--preset", "draft", "--max-frames", "4", "--out", text(&out), "--json"];
    let lines: Vec<Value> = written(&fit).lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let (last, heard) = lines.split_last().unwrap();
    assert!(last["metrics"]["mask_iou"].as_f64().unwrap() > 0.9, "{last}");
    assert!(heard.iter().any(|line| line["stage"] == "texture" && line["losses"]["rgb"].is_number()), "{heard:?}");
    assert!(out.join("avatar.glb").is_file());
    assert_eq!(std::fs::read_to_string(&theirs).unwrap(), "not the fit's");
    assert!(!out.join(".effigy-work").exists(), "the fit's own folder goes with its end");

    let model = out.join("model.npz");
    let report: Value =
        serde_json::from_str(&written(&["eval", text(clip), "--model", text(&model), "--json"])).unwrap();
    assert!(report["summary"]["scaled_novel_views"]["psnr_db"].as_f64().unwrap() > 15.0, "{}", report["summary"]);

    let nothing = effigy(&["eval", text(&out.join("work")), "--model", text(&model)]);
    let said = String::from_utf8_lossy(&nothing.stderr);
    assert!(!nothing.status.success() && said.contains("nothing to compare with"), "{said}");

    let pictures = folder.path().join("pictures");
    written(&["render", "--model", text(&model), "--frame", "0", "--out", text(&pictures)]);
    let picture = std::fs::read_dir(&pictures).unwrap().next().unwrap().unwrap().path();
    let shown = image::open(&picture).unwrap().to_rgba8();
    let opaque = shown.pixels().filter(|pixel| pixel.0[3] == 255).count();
    let share = opaque as f64 / f64::from(shown.width() * shown.height());
    assert!((0.02..0.5).contains(&share), "the person fills {share} of the picture");
}

#[test]
fn a_folder_that_lacks_a_part_says_which() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("video.mp4"), "").unwrap();
    let output = effigy(&["fit", text(folder.path()), "--out", text(&folder.path().join("avatar"))]);
    assert!(!output.status.success());
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(error.contains("there is no masks.* in") && error.contains("it has video.mp4"), "{error}");
    let lone = folder.path().join("video.mp4");
    let output = effigy(&["fit", text(&lone), "--out", text(&folder.path().join("avatar"))]);
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success() && error.contains("detect.py"), "{error}");
    for name in ["masks.zip", "masks.mp4", "keypoints.json"] {
        std::fs::write(folder.path().join(name), "").unwrap();
    }
    let output = effigy(&["fit", text(folder.path()), "--out", text(&folder.path().join("avatar"))]);
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success() && error.contains("say which with --masks"), "{error}");
    assert!(!folder.path().join("avatar").exists(), "nothing is begun");
}

#[test]
fn a_made_clip_keeps_no_truth_of_the_one_before() {
    let folder = tempfile::tempdir().unwrap();
    let surfaces = |frames: &str, truths: &str| {
        let size = ["--body", "test", "--size", "64", "--out", text(folder.path())];
        written(&[&["synth", "--frames", frames, "--truths", truths], &size[..]].concat());
        let names = std::fs::read_dir(folder.path().join("truth")).unwrap().map(|entry| entry.unwrap().file_name());
        names.filter(|name| name.to_string_lossy().starts_with("frame_")).count()
    };
    assert_eq!((surfaces("6", "3"), surfaces("4", "1")), (3, 1));
}
