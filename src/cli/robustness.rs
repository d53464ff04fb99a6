//! `effigy robustness`: a clip spoiled in many ways, or clips made in many ways, fitted and compared.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context as _, Result, ensure};
use effigy::data_dir::data_dir;
use effigy::gpu::{DeviceSelect, Gpu};
use effigy::robustness::{
    CASES, Case, Comparison, Outcome, Settings, Status, TAKES, Take, document, run as run_case, sheet,
};
use effigy::synth::{KeptClips, SynthOptions};
use image::codecs::jpeg::JpegEncoder;

#[derive(clap::Args)]
pub struct Args {
    /// A clip with truth, laid out as by `effigy synth`; without it one is made.
    clip: Option<PathBuf>,
    /// Folder for the page and its picture.
    #[arg(long, default_value = "docs")]
    out: PathBuf,
    /// Instead of one clip spoiled, clips made as people film them; writes `filming.md`.
    #[arg(long, conflicts_with = "clip")]
    filmed: bool,
    /// Names of cases, separated by commas [default: all]. The first one is always among them.
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
    /// Folder for what is in between; a case whose result lies there, of the same program, clip and body, is not run again [default: `robustness` in the data
    /// folder].
    #[arg(long)]
    work: Option<PathBuf>,
}

pub fn run(args: Args) -> Result<()> {
    let gpu = Gpu::open(&DeviceSelect::Auto)?;
    let work = args.work.clone().unwrap_or_else(|| data_dir().join("robustness"));
    let runs = if args.filmed { takes(&gpu, &args, &work)? } else { spoiled(&gpu, &args, &work)? };
    let bar = super::progress(runs.len() as u64, "cases");
    let mut rows: Vec<(&Case, Outcome)> = Vec::new();
    for (case, settings) in runs {
        bar.set_message(case.name);
        let outcome = run_case(&gpu, case, &settings).with_context(|| format!("case {}", case.name))?;
        bar.suspend(|| println!("{}", line(&outcome)));
        rows.push((case, outcome));
        bar.inc(1);
        // After each case, so that a long run shows what it has.
        write(&args, &settings, gpu.info().name.as_str(), &rows)?;
    }
    bar.finish_and_clear();
    println!("wrote {}", args.out.join(format!("{}.md", comparison(&args).name())).display());
    Ok(())
}

fn comparison(args: &Args) -> Comparison {
    if args.filmed { Comparison::Filmed } else { Comparison::Spoiled }
}

/// Spoiled versions of one clip.
fn spoiled(gpu: &Arc<Gpu>, args: &Args, work: &Path) -> Result<Vec<(&'static Case, Settings)>> {
    let chosen = chosen(&args.cases, CASES.iter().collect())?;
    let clip = match &args.clip {
        Some(clip) => clip.clone(),
        None => made(gpu, args, work, &options(args))?,
    };
    let name = clip.file_name().context("the clip's folder has no name")?.to_string_lossy().into_owned();
    let settings = settings(args, work, &name, clip)?;
    Ok(chosen.into_iter().map(|case| (case, settings.clone())).collect())
}

/// Clips that are made in other ways.
fn takes(gpu: &Arc<Gpu>, args: &Args, work: &Path) -> Result<Vec<(&'static Case, Settings)>> {
    let chosen = chosen(&args.cases, TAKES.iter().map(|take| &take.case).collect())?;
    let with_clip = |take: &'static Take| {
        let mut options = options(args);
        (take.film)(&mut options);
        let clip = made(gpu, args, work, &options)?;
        Ok((&take.case, settings(args, work, &format!("filmed-{}x{}", args.frames, args.size), clip)?))
    };
    let wanted = |take: &&Take| chosen.iter().any(|case| case.name == take.case.name);
    TAKES.iter().filter(wanted).map(with_clip).collect()
}

fn settings(args: &Args, work: &Path, name: &str, clip: PathBuf) -> Result<Settings> {
    let frames = args.max_frames.map_or(String::new(), |n| format!("-{n}"));
    Ok(Settings {
        // Results of other settings stay beside this run's.
        work: work.join(format!("{name}-{}-{}{frames}-{}-{}", args.body, args.preset, args.truths, args.seed)),
        clip,
        effigy: std::env::current_exe()?,
        preset: args.preset.clone(),
        body: args.body.clone(),
        max_frames: args.max_frames,
        seed: args.seed,
        truths: args.truths,
    })
}

/// The cases of these names in their own order, the one that all are compared with first.
fn chosen(names: &[String], cases: Vec<&'static Case>) -> Result<Vec<&'static Case>> {
    for name in names {
        let known: Vec<&str> = cases.iter().map(|case| case.name).collect();
        ensure!(known.contains(&name.as_str()), "case {name:?}: expected one of {}", known.join(", "));
    }
    let first = cases[0].name;
    let wanted = |case: &&Case| names.is_empty() || case.name == first || names.iter().any(|n| n == case.name);
    Ok(cases.into_iter().filter(wanted).collect())
}

fn options(args: &Args) -> SynthOptions {
    SynthOptions {
        frames: args.frames,
        size_px: args.size,
        seed: args.seed,
        truths: args.truths,
        ..SynthOptions::default()
    }
}

/// The folder of a made clip; one that is there is taken.
fn made(gpu: &Arc<Gpu>, args: &Args, work: &Path, options: &SynthOptions) -> Result<PathBuf> {
    Ok(KeptClips { gpu, body: &args.body, folder: work }.clip(options)?)
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
    let comparison = comparison(args);
    let pictures = args.out.join(comparison.name());
    std::fs::create_dir_all(&pictures).with_context(|| pictures.display().to_string())?;
    let mut jpeg = Vec::new();
    sheet(settings, rows)?.write_with_encoder(JpegEncoder::new_with_quality(&mut jpeg, 80))?;
    std::fs::write(pictures.join("cases.jpg"), jpeg)?;
    let clip = args
        .clip
        .as_ref()
        .and_then(|clip| clip.file_name())
        .map_or(String::new(), |name| format!(" {}", name.to_string_lossy()));
    let filmed = if args.filmed { " --filmed" } else { "" };
    let mut command = format!("effigy robustness{clip}{filmed} --preset {} --truths {}", args.preset, args.truths);
    if let Some(frames) = args.max_frames {
        command += &format!(" --max-frames {frames}");
    }
    if args.seed != 0 {
        command += &format!(" --seed {}", args.seed);
    }
    std::fs::write(
        args.out.join(format!("{}.md", comparison.name())),
        document(comparison, settings, &command, device, rows),
    )?;
    Ok(())
}
