//! `effigy robustness`: a clip spoiled in many ways, fitted and compared.

use std::path::PathBuf;

use anyhow::{Context as _, Result, ensure};
use effigy::body::Body;
use effigy::data_dir::{body_path, data_dir};
use effigy::eval::{SynthOptions, synthesise};
use effigy::gpu::{DeviceSelect, Gpu};
use effigy::robustness::{CASES, Case, Outcome, Settings, Status, document, run as run_case, sheet};
use image::codecs::jpeg::JpegEncoder;

#[derive(clap::Args)]
pub struct Args {
    /// A clip with truth, laid out as by `effigy synth`; without it one is made.
    clip: Option<PathBuf>,
    /// Folder for `robustness.md` and its picture.
    #[arg(long, default_value = "docs")]
    out: PathBuf,
    /// Names of cases, separated by commas [default: all]. The clean clip is always among them.
    #[arg(long, value_delimiter = ',')]
    cases: Vec<String>,
    #[arg(long, default_value = "draft")]
    preset: String,
    /// Frames that a fit keeps [default: the preset's].
    #[arg(long)]
    max_frames: Option<u32>,
    /// A body's name in the data folder, or `test`.
    #[arg(long, default_value = "default")]
    body: String,
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Held-out pictures of each kind, and surfaces, that are compared.
    #[arg(long, default_value_t = 4)]
    truths: usize,
    /// Frames and size of a made clip.
    #[arg(long, default_value_t = 60)]
    frames: usize,
    #[arg(long, default_value_t = 360)]
    size: u32,
    /// Folder for what is in between; a case whose result lies there is not run again [default: `robustness` in the data
    /// folder].
    #[arg(long)]
    work: Option<PathBuf>,
}

pub fn run(args: Args) -> Result<()> {
    let chosen = chosen(&args.cases)?;
    let gpu = Gpu::open(&DeviceSelect::Auto)?;
    let work = args.work.clone().unwrap_or_else(|| data_dir().join("robustness"));
    let clip = match &args.clip {
        Some(clip) => clip.clone(),
        None => made(&gpu, &args, &work)?,
    };
    let name = clip.file_name().context("the clip's folder has no name")?.to_string_lossy().into_owned();
    let frames = args.max_frames.map_or(String::new(), |n| format!("-{n}"));
    let settings = Settings {
        // All that a result hangs on: one of other settings is none of this run's.
        work: work.join(format!("{name}-{}-{}{frames}-{}-{}", args.body, args.preset, args.truths, args.seed)),
        clip,
        effigy: std::env::current_exe()?,
        preset: args.preset.clone(),
        body: args.body.clone(),
        max_frames: args.max_frames,
        seed: args.seed,
        truths: args.truths,
    };
    let bar = super::progress(chosen.len() as u64, "cases");
    let mut rows: Vec<(&Case, Outcome)> = Vec::new();
    for case in chosen {
        bar.set_message(case.name);
        let outcome = run_case(&gpu, case, &settings).with_context(|| format!("case {}", case.name))?;
        bar.suspend(|| println!("{}", line(&outcome)));
        rows.push((case, outcome));
        bar.inc(1);
        // After each case, so that a long run shows what it has.
        write(&args, &settings, gpu.info().name.as_str(), &rows)?;
    }
    bar.finish_and_clear();
    println!("wrote {}", args.out.join("robustness.md").display());
    Ok(())
}

/// The cases of these names in their own order, the clean clip first.
fn chosen(names: &[String]) -> Result<Vec<&'static Case>> {
    for name in names {
        let known: Vec<&str> = CASES.iter().map(|case| case.name).collect();
        ensure!(known.contains(&name.as_str()), "case {name:?}: expected one of {}", known.join(", "));
    }
    let wanted = |case: &&Case| names.is_empty() || case.name == CASES[0].name || names.iter().any(|n| n == case.name);
    Ok(CASES.iter().filter(wanted).collect())
}

fn made(gpu: &std::sync::Arc<Gpu>, args: &Args, work: &std::path::Path) -> Result<PathBuf> {
    let folder = work.join(format!("made-{}-{}x{}-{}-{}", args.body, args.frames, args.size, args.truths, args.seed));
    if folder.is_dir() {
        return Ok(folder);
    }
    let body = match args.body.as_str() {
        "test" => Body::test_body(),
        name => Body::load(&body_path(name)).with_context(|| format!("{name}: import a body first (`make body`)"))?,
    };
    let options = SynthOptions {
        frames: args.frames,
        size_px: args.size,
        seed: args.seed,
        truths: args.truths,
        ..SynthOptions::default()
    };
    std::fs::create_dir_all(work).with_context(|| work.display().to_string())?;
    // Under another name until it is whole.
    let making = work.join("making");
    synthesise(gpu, &body, &options, &making, |_, _| {})?;
    std::fs::rename(&making, &folder)?;
    Ok(folder)
}

fn line(outcome: &Outcome) -> String {
    let number = |value: Option<f64>| value.map_or("–".to_owned(), |v| format!("{v:.2}"));
    let status = match &outcome.status {
        Status::Fitted => outcome.flags.join(" "),
        Status::Refused(why) | Status::Crashed(why) => why.clone(),
    };
    let figures = [outcome.views_db, outcome.poses_db, outcome.chamfer_cm].map(number).join("  ");
    format!("{:20} {figures}  {:4.0} s  {status}", outcome.case, outcome.secs)
}

fn write(args: &Args, settings: &Settings, device: &str, rows: &[(&Case, Outcome)]) -> Result<()> {
    let pictures = args.out.join("robustness");
    std::fs::create_dir_all(&pictures).with_context(|| pictures.display().to_string())?;
    let mut jpeg = Vec::new();
    sheet(settings, rows)?.write_with_encoder(JpegEncoder::new_with_quality(&mut jpeg, 80))?;
    std::fs::write(pictures.join("cases.jpg"), jpeg)?;
    let clip = args
        .clip
        .as_ref()
        .and_then(|clip| clip.file_name())
        .map_or(String::new(), |name| format!(" {}", name.to_string_lossy()));
    let mut command = format!("effigy robustness{clip} --preset {} --truths {}", args.preset, args.truths);
    if let Some(frames) = args.max_frames {
        command += &format!(" --max-frames {frames}");
    }
    std::fs::write(args.out.join("robustness.md"), document(settings, &command, device, rows))?;
    Ok(())
}
