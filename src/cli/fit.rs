//! `effigy fit`: the pipeline of a job without a server.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, anyhow, bail};
use effigy::capture::CaptureInputs;
use effigy::data_dir::data_dir;
use effigy::gpu::{DeviceSelect, Gpu};
use effigy::jobs::{JobOptions, Preset};
use effigy::worker::pipeline::{self, Observer, PipelineInput, Progress, StopReason};
use indicatif::{ProgressBar, ProgressStyle};
use serde::Deserialize;
use serde::de::IntoDeserializer;

#[derive(clap::Args)]
pub struct Args {
    /// A folder with video.*, masks.*, keypoints.* and, where known, camera.json. The options below name single files
    /// instead.
    clip: Option<PathBuf>,
    /// As it was filmed, or a zip of its pictures.
    #[arg(long)]
    video: Option<PathBuf>,
    /// A video, or a zip of PNG or JPEG.
    #[arg(long)]
    masks: Option<PathBuf>,
    /// JSON, or a zip of OpenPose's JSON a frame.
    #[arg(long)]
    keypoints: Option<PathBuf>,
    /// JSON with `fx`, `fy`, `cx`, `cy`, `width` and `height`, pixels; guessed and fitted without.
    #[arg(long)]
    camera: Option<PathBuf>,
    /// An npz with `poses` and `trans` or `pelvis`. Never taken from the folder: it is the answer to a question.
    #[arg(long)]
    poses: Option<PathBuf>,
    /// draft, standard, paper or silhouette-only.
    #[arg(long, default_value = "standard", value_parser = preset)]
    preset: Preset,
    /// Frames that are kept, spread over the clip; the preset says how many otherwise.
    #[arg(long)]
    max_frames: Option<u32>,
    /// The longer side that pictures are made smaller to before the shape is fitted; the preset says otherwise.
    #[arg(long)]
    max_side_px: Option<u32>,
    /// A body of the data folder.
    #[arg(long, default_value = "default")]
    body: String,
    /// The same seed, files and machine give the same avatar.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// The person's height, metres: one camera cannot tell it.
    #[arg(long)]
    height_m: Option<f64>,
    /// Fit with the given focal length even where the clip contradicts it.
    #[arg(long)]
    trust_camera: bool,
    /// Side of the baked texture: 2048 or 4096.
    #[arg(long, default_value_t = 2048)]
    texture_px: u32,
    /// Where the avatar goes. A checkpoint in it is gone on from if this program made it of the same files and options.
    #[arg(long, default_value = "avatar")]
    out: PathBuf,
    /// The data folder with the bodies, where the service has another one than `$EFFIGY_DATA_DIR`.
    #[arg(long, value_name = "DIR")]
    data_dir: Option<PathBuf>,
    /// Progress as lines of JSON.
    #[arg(long)]
    json: bool,
}

/// In the avatar's folder, while it is fitted. A folder that may have been there before has no such name: all in it goes in the end.
const WORK: &str = ".effigy-work";

pub fn run(args: Args) -> anyhow::Result<()> {
    if let Ok(filter) = std::env::var("EFFIGY_LOG") {
        let filter =
            tracing_subscriber::EnvFilter::try_new(&filter).with_context(|| format!("EFFIGY_LOG={filter:?}"))?;
        tracing_subscriber::fmt().with_writer(std::io::stderr).with_env_filter(filter).init();
    }
    let input = input_of(&args)?;
    let work = args.out.join(WORK);
    let data = args.data_dir.clone().unwrap_or_else(data_dir);
    let gpu = Gpu::open(&DeviceSelect::Auto)?;
    let stopped = stop_on_ctrl_c();
    let mut observer = Follower { bar: bar(args.json), json: args.json, stopped };
    let outcome = pipeline::run(&gpu, &input, &data, &work, &args.out, &mut observer)?;
    observer.bar.finish_and_clear();
    std::fs::remove_dir_all(&work)?;
    for (kernel, time) in gpu.take_timings() {
        eprintln!(
            "{:8.2} s {:8} calls {:8.3} ms  {kernel}",
            time.secs,
            time.calls,
            1e3 * time.secs / time.calls as f64
        );
    }
    if args.json {
        println!("{}", serde_json::json!({ "out": args.out, "metrics": outcome.metrics }));
    } else {
        println!("{}\n{:#}", args.out.join("avatar.glb").display(), outcome.metrics);
    }
    Ok(())
}

fn preset(name: &str) -> Result<Preset, serde::de::value::Error> {
    Preset::deserialize(name.into_deserializer())
}

fn input_of(args: &Args) -> anyhow::Result<PipelineInput> {
    let options = JobOptions {
        preset: args.preset,
        max_frames: args.max_frames,
        max_side_px: args.max_side_px,
        body: args.body.clone(),
        seed: args.seed,
        height_m: args.height_m,
        trust_camera: args.trust_camera,
        texture_px: args.texture_px,
        ..JobOptions::default()
    };
    options.check().map_err(|error| match &error.expected {
        Some(expected) => anyhow!("options: {error}, expected {expected}"),
        None => anyhow!("options: {error}"),
    })?;
    let part = |given: &Option<PathBuf>, name: &str| -> anyhow::Result<Option<PathBuf>> {
        match (given, &args.clip) {
            (Some(path), _) => given_file(path, name).map(Some),
            (None, Some(folder)) => find(folder, name),
            (None, None) => Ok(None),
        }
    };
    let needed = |given: &Option<PathBuf>, name: &str| -> anyhow::Result<PathBuf> {
        part(given, name)?.with_context(|| format!("{name}: give a clip's folder, or --{name} FILE"))
    };
    let files = CaptureInputs {
        video: needed(&args.video, "video")?,
        masks: needed(&args.masks, "masks")?,
        keypoints: needed(&args.keypoints, "keypoints")?,
        camera: part(&args.camera, "camera")?,
        poses: args.poses.as_deref().map(|path| given_file(path, "poses")).transpose()?,
    };
    Ok(PipelineInput { files, options })
}

fn given_file(path: &Path, name: &str) -> anyhow::Result<PathBuf> {
    match path.metadata() {
        Err(error) => bail!("{name}: {}: {error}", path.display()),
        Ok(meta) if meta.is_dir() => bail!("{name}: {} is a folder: make a zip of its files", path.display()),
        Ok(_) => Ok(path.to_path_buf()),
    }
}

/// The file `name.*` of a folder.
fn find(folder: &Path, name: &str) -> anyhow::Result<Option<PathBuf>> {
    let pictures = folder.join(name);
    let entries = std::fs::read_dir(folder).with_context(|| folder.display().to_string())?;
    let mut found: Vec<PathBuf> = entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.is_file() && path.file_stem().is_some_and(|stem| stem == name))
        .collect();
    found.sort();
    if found.is_empty() && pictures.is_dir() {
        bail!("{} is a folder: make {name}.zip of its files", pictures.display());
    }
    Ok(found.into_iter().next())
}

fn stop_on_ctrl_c() -> Arc<AtomicBool> {
    let stopped = Arc::new(AtomicBool::new(false));
    let flag = stopped.clone();
    std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        if runtime.is_ok_and(|r| r.block_on(tokio::signal::ctrl_c()).is_ok()) {
            flag.store(true, Ordering::Relaxed);
        }
    });
    stopped
}

fn bar(json: bool) -> ProgressBar {
    if json {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{prefix:9} [{bar:40}] {percent:>3} %  {msg}");
    ProgressBar::new(1000).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("#> "))
}

/// Shows progress to people or as JSON.
struct Follower {
    bar: ProgressBar,
    json: bool,
    stopped: Arc<AtomicBool>,
}

impl Observer for Follower {
    fn progress(&mut self, p: &Progress) {
        if self.json {
            if p.step == 0 || p.step == p.steps || !p.losses.is_empty() {
                let line = serde_json::json!({
                    "stage": p.stage.name(), "step": p.step, "steps": p.steps, "progress": p.progress,
                    "eta_secs": p.eta_secs, "losses": p.losses,
                });
                println!("{line}");
            }
            return;
        }
        self.bar.set_prefix(p.stage.name());
        self.bar.set_position((p.progress * 1000.0) as u64);
        let losses: Vec<String> = p.losses.iter().map(|(name, value)| format!("{name} {value:.4}")).collect();
        let left = p.eta_secs.map_or(String::new(), |secs| format!("{secs:.0} s left  "));
        self.bar.set_message(format!("{left}{}", losses.join("  ")));
    }

    fn begins_anew(&mut self) {
        self.bar
            .suspend(|| eprintln!("what lay there is of other files, options or another program: the fit begins anew"));
    }

    fn stop(&mut self) -> Option<StopReason> {
        self.stopped.load(Ordering::Relaxed).then_some(StopReason::Shutdown)
    }

    fn idle(&mut self, _gpu: &Arc<Gpu>) {}
}

#[cfg(test)]
mod tests {
    use clap::{Args as _, FromArgMatches};

    use super::*;

    #[test]
    fn options_that_cannot_be_followed_say_what_was_expected() {
        let error = |arguments: [&str; 3]| {
            let matches = Args::augment_args(clap::Command::new("fit")).get_matches_from(arguments);
            input_of(&Args::from_arg_matches(&matches).unwrap()).err().unwrap().to_string()
        };
        assert_eq!(
            error(["fit", "--body", "v1.1.0"]),
            "options: body is \"v1.1.0\", expected 1 to 64 letters, digits, hyphens or underscores"
        );
        assert_eq!(error(["fit", "--texture-px", "7"]), "options: texture_px is 7, expected 2048 or 4096");
    }
}
