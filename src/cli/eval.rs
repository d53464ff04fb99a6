//! `effigy eval`: an avatar against a folder of truth.

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context, Result};
use effigy::avatar::{AvatarModel, Renderer};
use effigy::eval::{EvalOptions, Lpips, Subject, evaluate};
use effigy::gpu::{DeviceSelect, Gpu};

#[derive(clap::Args)]
pub struct Args {
    /// The truth: novel/, truth/, masks.zip as `effigy synth` lays them out.
    folder: PathBuf,
    /// The avatar: `model.npz` of a job or of `effigy fit`.
    #[arg(long)]
    model: PathBuf,
    /// Print the report as JSON instead of a table.
    #[arg(long)]
    json: bool,
    /// Folder for `eval.json`, `eval.html` and the pictures: truth, ours, absolute error.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Compare novel poses also after refining pose and place on each picture; the avatar itself stands.
    #[arg(long)]
    refine: bool,
    /// Compare also by LPIPS: a network as ONNX, two pictures [1, 3, height, width] in [−1, 1] in, one number out. Needs a
    /// build with `--features lpips`.
    #[arg(long)]
    lpips: Option<PathBuf>,
}

pub fn run(args: Args) -> Result<()> {
    let model = AvatarModel::load(&args.model).with_context(|| args.model.display().to_string())?;
    let subject = Subject::open(&args.folder)?;
    if let Some(out) = &args.out {
        std::fs::create_dir_all(out).with_context(|| out.display().to_string())?;
    }
    let renderer = Renderer::new(&Gpu::open(&DeviceSelect::Auto)?, &Arc::new(model))?;
    let lpips = args.lpips.as_deref().map(Lpips::load).transpose()?;
    let options = EvalOptions { out: args.out.as_deref(), refine: args.refine, lpips: lpips.as_ref() };
    let spinner = super::spinner();
    let report = evaluate(&renderer, &subject, &options, |what| spinner.set_message(what.to_owned()))?;
    spinner.finish_and_clear();
    let json = serde_json::to_string_pretty(&report)?;
    if let Some(out) = &args.out {
        std::fs::write(out.join("eval.json"), &json)?;
    }
    if args.json {
        println!("{json}");
    } else {
        print!("{}", report.table());
        report.warnings.iter().for_each(|warning| println!("note: {warning}"));
    }
    Ok(())
}
