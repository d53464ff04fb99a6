//! `effigy synth`: a made clip of a clothed person, with truth.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use effigy::body::Body;
use effigy::data_dir::body_path;
use effigy::gpu::{DeviceSelect, Gpu};
use effigy::synth::{Build, Filming, Outfit, SynthOptions, synthesise};

#[derive(clap::Args)]
pub struct Args {
    /// A body's name in the data folder, its file, or `test` for the small built-in one.
    #[arg(long, default_value = "default")]
    body: String,
    /// Folder for the clip; one that another clip was made in is made anew.
    #[arg(long)]
    out: PathBuf,
    #[arg(long, default_value_t = SynthOptions::default().frames)]
    frames: usize,
    /// The picture's longer side in pixels.
    #[arg(long, default_value_t = SynthOptions::default().size_px)]
    size: u32,
    /// any, tight, loose, breeches, hoodie, hair, skirt or coat.
    #[arg(long, default_value = "any", value_parser = outfit)]
    outfit: Outfit,
    /// Checked cloth, so that there is something to see everywhere.
    #[arg(long)]
    checked: bool,
    /// any, small or heavy.
    #[arg(long, default_value = "any", value_parser = build)]
    build: Build,
    /// Share of the light that comes from one side.
    #[arg(long, default_value_t = SynthOptions::default().side_light)]
    side_light: f32,
    #[arg(long, default_value_t = SynthOptions::default().fps)]
    fps: f64,
    /// Decides shape, clothes, colours and noise.
    #[arg(long, default_value_t = SynthOptions::default().seed)]
    seed: u64,
    /// Standard deviation of the keypoints at 540 pixels.
    #[arg(long, default_value_t = SynthOptions::default().keypoint_noise_px)]
    keypoint_noise: f64,
    /// Frames with a truth surface, novel views and novel poses, each at most.
    #[arg(long, default_value_t = SynthOptions::default().truths)]
    truths: usize,
    /// Focal length over the picture's longer side.
    #[arg(long, default_value_t = Filming::default().focal)]
    focal: f64,
    /// Height of the picture over its width.
    #[arg(long, default_value_t = Filming::default().aspect)]
    aspect: f64,
    /// Height of the person over that of the picture.
    #[arg(long, default_value_t = Filming::default().fill)]
    fill: f64,
    /// Degrees by which the camera looks down.
    #[arg(long, default_value_t = Filming::default().tilt_degrees)]
    tilt: f64,
    /// Turns of the person.
    #[arg(long, default_value_t = Filming::default().turns)]
    turns: f64,
    /// Part of the mean speed by which the turn is faster and slower.
    #[arg(long, default_value_t = Filming::default().speed_change)]
    speed_change: f64,
    /// Degrees by which the arms hang below the horizontal: 49 unless given; at 75 the hands are at the thighs.
    #[arg(long, default_value_t = Filming::default().arms_down_degrees, hide_default_value = true)]
    arms_down: f64,
    /// Degrees by which the arms move up and down.
    #[arg(long, default_value_t = Filming::default().arm_swing_degrees)]
    arm_swing: f64,
    /// Degrees by which a thigh is raised with each step of the turn; at 0 the legs stand and the floor turns.
    #[arg(long, default_value_t = Filming::default().step_degrees)]
    step: f64,
}

fn outfit(name: &str) -> Result<Outfit, serde_json::Error> {
    serde_json::from_value(name.into())
}

fn build(name: &str) -> Result<Build, serde_json::Error> {
    serde_json::from_value(name.into())
}

fn body(name: &str) -> Result<Body> {
    if name == "test" {
        return Ok(Body::test_body());
    }
    let path = if Path::new(name).is_file() { PathBuf::from(name) } else { body_path(name) };
    Body::load(&path)
        .with_context(|| format!("{}: import a body first (`make body`, or `effigy body import FILE`)", path.display()))
}

pub fn run(args: Args) -> Result<()> {
    let options = SynthOptions {
        frames: args.frames,
        size_px: args.size,
        seed: args.seed,
        build: args.build,
        outfit: args.outfit,
        checked: args.checked,
        side_light: args.side_light,
        fps: args.fps,
        keypoint_noise_px: args.keypoint_noise,
        truths: args.truths,
        filming: Filming {
            focal: args.focal,
            aspect: args.aspect,
            fill: args.fill,
            tilt_degrees: args.tilt,
            turns: args.turns,
            speed_change: args.speed_change,
            arms_down_degrees: args.arms_down,
            arm_swing_degrees: args.arm_swing,
            step_degrees: args.step,
        },
    };
    let body = body(&args.body)?;
    let gpu = Gpu::open(&DeviceSelect::Auto)?;
    let bar = super::progress(args.frames as u64, "frames");
    synthesise(&gpu, &body, &options, &args.out, |done, _| bar.set_position(done as u64))?;
    bar.finish_and_clear();
    println!("wrote {}", args.out.display());
    Ok(())
}
