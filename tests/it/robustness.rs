//! `effigy robustness` on a tiny made clip: cases are fitted, compared, written down, and not run again.

use std::path::Path;
use std::process::{Command, Output};

use effigy::gpu::{DeviceSelect, Gpu};

fn robustness(folder: &Path, cases: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_effigy"));
    command.args(["robustness", "--body", "test", "--frames", "8", "--size", "64", "--truths", "1", "--cases", cases]);
    command.arg("--work").arg(folder.join("work")).arg("--out").arg(folder.join("docs"));
    command.output().unwrap()
}

#[test]
fn spoiled_clips_are_compared_with_the_clean_one_and_not_twice() {
    if let Err(reason) = Gpu::open(&DeviceSelect::Auto) {
        assert!(std::env::var_os("CI").is_none(), "CI requires a device: {reason}");
        eprintln!("spoiled_clips_are_compared_with_the_clean_one_and_not_twice: ignored, {reason}");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let output = robustness(folder.path(), "masks-blob");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let page = std::fs::read_to_string(folder.path().join("docs/robustness.md")).unwrap();
    assert!(page.contains("| the clip as it is |") && page.contains("| masks: a second part"), "{page}");
    assert!(page.contains("`second_blob`") && page.contains("Of 1 perturbations"), "{page}");
    let sheet = image::open(folder.path().join("docs/robustness/cases.jpg")).unwrap();
    assert!(
        sheet.width() > 200 && sheet.height() >= 64,
        "two cases of three pictures: {}×{}",
        sheet.width(),
        sheet.height()
    );

    // A result that is there is believed.
    let work = folder.path().join("work/made-test-8x64-1-0-test-draft-1-0/clean/result.json");
    let mut result: serde_json::Value = serde_json::from_slice(&std::fs::read(&work).unwrap()).unwrap();
    result["views_db"] = 99.0.into();
    std::fs::write(&work, result.to_string()).unwrap();
    assert!(robustness(folder.path(), "masks-blob").status.success());
    let page = std::fs::read_to_string(folder.path().join("docs/robustness.md")).unwrap();
    assert!(page.contains("99.00") && page.contains("worse, flagged"), "{page}");

    let wrong = robustness(folder.path(), "nothing");
    assert!(!wrong.status.success() && String::from_utf8_lossy(&wrong.stderr).contains("masks-blob"));
}
