//! `effigy bench` as a user runs it.

#[test]
fn a_report_has_a_line_for_each_operator_that_was_asked_for() {
    let output = crate::program::effigy()
        .args(["bench", "interpolate", "--size", "32", "--repeats", "1", "--json"])
        .env("EFFIGY_DATA_DIR", env!("CARGO_TARGET_TMPDIR"))
        .output()
        .unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    if errors.contains("no graphics adapter") && std::env::var_os("CI").is_none() {
        eprintln!("bench: ignored, {errors}");
        return;
    }
    assert!(output.status.success(), "{errors}");
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let scene = &report["scenes"][0];
    let ops = scene["ops"].as_array().unwrap();
    let names: Vec<&str> = ops.iter().map(|op| op["op"].as_str().unwrap()).collect();
    let want = ["interpolate/forward", "interpolate/scatter", "interpolate/gather", "interpolate/backward"];
    assert_eq!(names, want);
    // Nothing beats the device's ceilings by more than the ceilings' own noise.
    assert!(
        ops.iter().all(|op| op["best_ms"].as_f64().unwrap() > 0.0 && op["ratio"].as_f64().unwrap() > 0.5),
        "{ops:?}"
    );
    let covered = scene["scale"]["covered"].as_f64().unwrap();
    assert!((60.0..400.0).contains(&covered), "{covered} pixels are covered");
}
