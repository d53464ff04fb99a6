//! `effigy robustness` on tiny made clips: cases are fitted, compared, written down, and not run again.

use std::path::{Path, PathBuf};
use std::process::Output;

fn robustness(folder: &Path, more: &[&str]) -> Output {
    let mut command = crate::program::effigy();
    command.args(["robustness", "--body", "test", "--frames", "8", "--size", "64", "--truths", "1"]).args(more);
    command.arg("--work").arg(folder.join("work")).arg("--out").arg(folder.join("docs"));
    command.output().unwrap()
}

#[test]
fn clips_filmed_otherwise_are_compared_with_the_plain_one() {
    if crate::fit::gpu("clips_filmed_otherwise_are_compared_with_the_plain_one").is_none() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let output = robustness(folder.path(), &["--filmed", "--cases", "phone"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let page = std::fs::read_to_string(folder.path().join("docs/filming.md")).unwrap();
    assert!(page.contains("| 1 | a level camera") && page.contains("| 2 | a phone held close"), "{page}");
    assert!(page.contains("(filming/cases.jpg)") && page.contains("Of 1 others"), "{page}");
    let cameras = std::fs::read_dir(folder.path().join("work")).unwrap().filter_map(|entry| {
        let camera = std::fs::read(entry.unwrap().path().join("camera.json")).ok()?;
        Some(serde_json::from_slice::<serde_json::Value>(&camera).unwrap())
    });
    let mut sizes: Vec<_> = cameras.map(|c| (c["width"].as_u64().unwrap(), c["height"].as_u64().unwrap())).collect();
    sizes.sort_unstable();
    assert_eq!(sizes, [(48, 84), (64, 64)], "one of them upright, a third taller");
    let wrong = robustness(folder.path(), &["--filmed", "--cases", "masks-blob"]);
    assert!(!wrong.status.success() && String::from_utf8_lossy(&wrong.stderr).contains("phone"));
}

/// Where a case's result lies, in whichever run's folder.
fn result_of(work: &Path, case: &str) -> PathBuf {
    let mut runs = std::fs::read_dir(work).unwrap().map(|e| e.unwrap().path().join(case).join("result.json"));
    runs.find(|path| path.is_file()).expect("a result")
}

#[test]
fn spoiled_clips_are_compared_with_the_clean_one_and_not_twice() {
    if crate::fit::gpu("spoiled_clips_are_compared_with_the_clean_one_and_not_twice").is_none() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    // Two that share the folder take turns, and each case is fitted once.
    std::thread::scope(|scope| {
        let run = || robustness(folder.path(), &["--cases", "gains,masks-blob"]);
        for output in [scope.spawn(run), scope.spawn(run)].map(|run| run.join().unwrap()) {
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        }
    });
    let page = std::fs::read_to_string(folder.path().join("docs/robustness.md")).unwrap();
    assert!(page.contains("| the clip as it is |") && page.contains("| masks: a second part"), "{page}");
    assert!(page.contains("`second_blob`") && page.contains("Of 2 others"), "{page}");
    let row = |of: &str| page.lines().find(|line| line.contains(of)).unwrap_or_default();
    assert!(row("light changes").contains("`exposure_changes`"), "{page}");
    assert!(!row("a second part").contains("exposure"), "{page}");
    let sheet = image::open(folder.path().join("docs/robustness/cases.jpg")).unwrap();
    assert!(
        sheet.width() > 200 && sheet.height() >= 64,
        "two cases of three pictures: {}×{}",
        sheet.width(),
        sheet.height()
    );

    // A result that is there is believed, if it was made of the same.
    let change = |change: fn(&mut serde_json::Value)| {
        let path = result_of(&folder.path().join("work"), "clean");
        let mut result: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        change(&mut result);
        std::fs::write(&path, result.to_string()).unwrap();
        assert!(robustness(folder.path(), &["--cases", "masks-blob"]).status.success());
        std::fs::read_to_string(folder.path().join("docs/robustness.md")).unwrap()
    };
    let page = change(|result| result["outcome"]["views_db"] = 99.0.into());
    assert!(page.contains("99.00") && page.contains("worse, flagged"), "{page}");
    // What is in the avatar's folder then is not measured again either: it may be another program's.
    let theirs = result_of(&folder.path().join("work"), "clean").with_file_name("avatar").join("theirs");
    std::fs::write(&theirs, "").unwrap();
    let page = change(|result| result["made_of"] = "another program".into());
    assert!(!page.contains("99.00") && !theirs.exists(), "{page}");

    let wrong = robustness(folder.path(), &["--cases", "nothing"]);
    assert!(!wrong.status.success() && String::from_utf8_lossy(&wrong.stderr).contains("masks-blob"));
}
