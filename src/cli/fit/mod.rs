//! `effigy fit`: the pipeline of a job without a server.

mod follower;
mod input;
mod summary;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, anyhow};
use effigy::data_dir::data_dir;
use effigy::gpu::{DeviceSelect, Gpu};
use effigy::jobs::Preset;
use effigy::worker::pipeline::{self, PipelineError};
use serde::Deserialize;
use serde::de::IntoDeserializer;

use self::follower::Follower;
use self::input::input_of;
use self::summary::Report;

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
    let mut observer = Follower::new(args.json, stopped);
    let outcome = pipeline::run(&gpu, &input, &data, &work, &args.out, &mut observer).map_err(ended)?;
    observer.finish();
    std::fs::remove_dir_all(&work)?;
    for (kernel, time) in gpu.take_timings() {
        eprintln!(
            "{:8.2} s {:8} calls {:8.3} ms  {kernel}",
            time.secs,
            time.calls,
            1e3 * time.secs / time.calls as f64
        );
    }
    let report = Report::read(&args.out)?;
    if args.json {
        println!("{}", serde_json::json!({ "out": args.out, "metrics": outcome.metrics, "flags": report.codes() }));
    } else {
        print!("{}", report.text(&args.out));
    }
    Ok(())
}

/// For people: what they can do about a fit that has ended without an avatar.
fn ended(error: PipelineError) -> anyhow::Error {
    match error {
        PipelineError::Stopped(_) => anyhow!("stopped; the same command goes on from the last checkpoint"),
        PipelineError::Internal(error) => error,
        error => error.into(),
    }
}

fn preset(name: &str) -> Result<Preset, serde::de::value::Error> {
    Preset::deserialize(name.into_deserializer())
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
