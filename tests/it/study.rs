//! A study that runs the program itself, on a small made clip, down to its page.

use std::path::Path;

use effigy::study::cost::{STUDY, Settings, run};
use effigy::study::{Context, Saved, document};

#[test]
fn the_cost_of_a_small_fit_is_measured_and_shown() {
    let Some(gpu) = crate::fit::gpu("the_cost_of_a_small_fit_is_measured_and_shown") else { return };
    let folder = tempfile::tempdir().unwrap();
    let context = Context {
        gpu,
        body: "test".to_owned(),
        seed: 5,
        work: folder.path().join("work"),
        effigy: Path::new(env!("CARGO_BIN_EXE_effigy")).to_owned(),
        say: &|_| {},
    };
    let settings = Settings { frames: 6, size_px: 96, presets: vec!["draft"], twice: vec!["draft"], picture_px: 64 };
    let report = run(&context, &settings).unwrap();
    let value = |table: usize, column: usize| report.tables[table].rows[0].values[column];
    let (train, job, picture, device) = (value(0, 0), value(0, 1), value(0, 2), value(0, 4));
    assert!(train > Some(0.0) && train < job, "{train:?} min of training in a job of {job:?} min");
    assert!(picture > Some(0.0) && picture < Some(60.0), "{picture:?} s a picture");
    assert!(device > Some(1e-3) && device < Some(10.0), "{device:?} GB on the device");
    assert!(value(1, 0) > Some(0.5), "IoU {:?}", value(1, 0));
    let [mean, max, ..] = report.tables[2].rows[0].values[..] else { panic!("no spread") };
    assert_eq!((mean, max), (Some(0.0), Some(0.0)), "two whole jobs of one seed, mm");

    let out = folder.path().join("results");
    let saved = report.save(&STUDY, &context, 1.0, &out).unwrap();
    let read: Saved = serde_json::from_slice(&std::fs::read(out.join("cost.json")).unwrap()).unwrap();
    assert_eq!(read.study, saved.study);
    assert_eq!(read.command, "effigy study cost --seed 5 --body test");
    assert!(out.join("cost.jpg").is_file());
    let page = document(&out).unwrap();
    assert!(page.contains("## What it costs") && page.contains("| draft "), "{page}");
    assert!(!page.contains("## The dented cube"), "a study without results has no section");
}
