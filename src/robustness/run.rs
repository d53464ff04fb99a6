//! One case from clip to figures.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context as _, Result};
use image::RgbImage;
use rand::SeedableRng;
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use super::cases::Case;
use super::footage::Footage;
use crate::avatar::{AvatarModel, Renderer};
use crate::eval::{EvalOptions, ImageFigures, Subject, evaluate};
use crate::fingerprint::Fingerprint;
use crate::gpu::Gpu;
use crate::mask::is_foreground;
use crate::page::{shrunk, strip};

/// What all cases share.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The clean clip with its truth.
    pub clip: PathBuf,
    /// Clips, avatars and results; a case whose result is there, of the same things, is not run again.
    pub work: PathBuf,
    /// This program.
    pub effigy: PathBuf,
    pub preset: String,
    pub body: String,
    /// Frames that a fit keeps; the preset's number without it.
    pub max_frames: Option<u32>,
    /// Decides everything random.
    pub seed: u64,
    /// Held-out pictures of each kind, and surfaces, that are compared.
    pub truths: usize,
}

/// How the fit ended.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    Fitted,
    /// With the message for the user.
    Refused(String),
    Crashed(String),
}

/// What came of a case.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    pub case: String,
    pub status: Status,
    /// PSNR on white in our scale.
    pub views_db: Option<f64>,
    /// After the similarity of the frame's surface.
    pub aligned_views_db: Option<f64>,
    pub poses_db: Option<f64>,
    /// Mean of both directions, aligned.
    pub chamfer_cm: Option<f64>,
    pub joints_cm: Option<f64>,
    /// Codes of the report's flags.
    pub flags: Vec<String>,
    /// Of the fit.
    pub secs: f64,
}

/// A result that is kept for the next run, with what it was made of.
#[derive(Serialize, Deserialize)]
struct Kept {
    made_of: String,
    outcome: Outcome,
}

/// Longest side of each of a case's three pictures.
const PIECE_PX: u32 = 150;

/// Runs a case, or reads what it came to before with the same program, clip, body and settings. Leaves `result.json` and, of an
/// avatar, `piece.png` (the first frame as the fit sees it, a held-out view and a held-out pose of the avatar) in the case's
/// folder.
///
/// # Errors
/// Where the clip cannot be read or written; a fit that fails is an outcome.
pub fn run(gpu: &Arc<Gpu>, case: &Case, settings: &Settings) -> Result<Outcome> {
    std::fs::create_dir_all(&settings.work).with_context(|| settings.work.display().to_string())?;
    // Of two runs that share the folder the later one waits, and reads what the case came to. Held until the case has ended.
    let turn = File::create(settings.work.join(format!("{}.lock", case.name)))?;
    turn.lock()?;
    let folder = settings.work.join(case.name);
    let result = folder.join("result.json");
    let made_of = made_of(settings)?;
    let kept: Option<Kept> = std::fs::read(&result).ok().and_then(|bytes| serde_json::from_slice(&bytes).ok());
    match kept {
        Some(kept) if kept.made_of == made_of => return Ok(kept.outcome),
        // With whatever lies there: a fit goes on from a checkpoint that it finds.
        _ if folder.exists() => std::fs::remove_dir_all(&folder).with_context(|| folder.display().to_string())?,
        _ => {}
    }
    let (clip, avatar) = (folder.join("clip"), folder.join("avatar"));
    std::fs::create_dir_all(&clip).with_context(|| clip.display().to_string())?;
    let mut footage = Footage::read(&settings.clip)?;
    (case.spoil)(&mut footage, &mut Pcg64::seed_from_u64(settings.seed));
    footage.write(&clip)?;
    let started = Instant::now();
    let status = fit(settings, &footage, &clip, &avatar)?;
    let mut outcome = Outcome {
        case: case.name.to_owned(),
        status,
        views_db: None,
        aligned_views_db: None,
        poses_db: None,
        chamfer_cm: None,
        joints_cm: None,
        flags: Vec::new(),
        secs: started.elapsed().as_secs_f64(),
    };
    if outcome.status == Status::Fitted {
        outcome.flags = flags(&avatar.join("report.json"))?;
        measure(gpu, settings, &avatar, &folder, &footage, &mut outcome)?;
    }
    // Last, so that a case that was interrupted runs again.
    let kept = Kept { made_of, outcome };
    std::fs::write(&result, serde_json::to_vec_pretty(&kept)?)?;
    std::fs::remove_dir_all(&clip)?;
    Ok(kept.outcome)
}

/// All that a result hangs on but the case itself.
fn made_of(settings: &Settings) -> Result<String> {
    let Settings { preset, body, max_frames, seed, truths, .. } = settings;
    let made_of = Fingerprint::of_program()?
        .with_text(&format!("{preset} {body} {max_frames:?} {seed} {truths}"))
        .with_body(body)?
        .with_files_of(&settings.clip)
        .with_context(|| settings.clip.display().to_string())?;
    Ok(made_of.digits())
}

/// A process of its own: a fit that crashes takes nothing along.
fn fit(settings: &Settings, footage: &Footage, clip: &Path, avatar: &Path) -> Result<Status> {
    let mut command = Command::new(&settings.effigy);
    command.arg("fit").arg(clip).arg("--out").arg(avatar);
    command.args([
        "--preset",
        &settings.preset,
        "--body",
        &settings.body,
        "--seed",
        &settings.seed.to_string(),
        "--json",
    ]);
    if let Some(frames) = footage.max_frames.or(settings.max_frames) {
        command.args(["--max-frames", &frames.to_string()]);
    }
    let output = command.output().with_context(|| settings.effigy.display().to_string())?;
    let said = String::from_utf8_lossy(&output.stderr);
    let last =
        said.lines().rfind(|line| !line.trim().is_empty()).unwrap_or("").trim_start_matches("Error: ").to_owned();
    Ok(match output.status.code() {
        Some(0) => Status::Fitted,
        // What is no panic and no signal is an answer to the user.
        Some(1) => Status::Refused(last),
        _ => Status::Crashed(format!("{}: {last}", output.status)),
    })
}

fn flags(report: &Path) -> Result<Vec<String>> {
    let bytes = std::fs::read(report).with_context(|| report.display().to_string())?;
    let report: serde_json::Value = serde_json::from_slice(&bytes)?;
    let flags = report["quality"]["flags"].as_array().context("report.json has no flags")?;
    Ok(flags.iter().filter_map(|flag| flag["code"].as_str().map(str::to_owned)).collect())
}

/// Compares the avatar with the truth of the clean clip.
fn measure(
    gpu: &Arc<Gpu>,
    settings: &Settings,
    avatar: &Path,
    folder: &Path,
    footage: &Footage,
    outcome: &mut Outcome,
) -> Result<()> {
    // The masks of a cropped clip are not of its pictures' size.
    let mut truth = Subject::open(&settings.clip)?.without_masks();
    truth.surfaces.truncate(settings.truths);
    truth.views.truncate(settings.truths);
    truth.poses.truncate(settings.truths);
    let model = Arc::new(AvatarModel::load(&avatar.join("model.npz"))?);
    let pictures = folder.join("eval");
    std::fs::create_dir_all(&pictures)?;
    let options = EvalOptions { out: Some(&pictures), ..EvalOptions::default() };
    let report = evaluate(&Renderer::new(gpu, &model)?, &truth, &options, |_| {})?;
    let scaled = report.scale().is_some();
    let choose = |ours: &Option<ImageFigures>, plain: &Option<ImageFigures>| {
        if scaled { ours.as_ref().map(|m| m.psnr_db) } else { plain.as_ref().map(|m| m.psnr_db) }
    };
    let s = &report.summary;
    outcome.views_db = choose(&s.scaled_novel_views, &s.novel_views);
    outcome.poses_db = choose(&s.scaled_novel_poses, &s.novel_poses);
    outcome.aligned_views_db = s.aligned_novel_views.as_ref().map(|m| m.psnr_db);
    (outcome.chamfer_cm, outcome.joints_cm) = (s.chamfer_cm, s.joints_cm);
    let from = if scaled { pictures.join("scaled") } else { pictures.clone() };
    let mut piece = vec![shrunk(&first_frame(footage), PIECE_PX)];
    for name in truth.views.first().into_iter().chain(truth.poses.first()).map(|novel| &novel.name) {
        let picture = image::open(from.join(format!("{name}.png")))?.into_rgb8();
        // Truth, ours, difference.
        let third = picture.width() / 3;
        let ours = image::imageops::crop_imm(&picture, third, 0, third, picture.height()).to_image();
        piece.push(shrunk(&ours, PIECE_PX));
    }
    strip(&piece, 2, [255; 3]).save(folder.join("piece.png"))?;
    std::fs::remove_dir_all(&pictures)?;
    Ok(())
}

/// The first frame, dark where the mask has nothing.
fn first_frame(footage: &Footage) -> RgbImage {
    let mut picture = footage.frames[0].clone();
    for (pixel, _) in picture.pixels_mut().zip(footage.masks[0].pixels()).filter(|(_, m)| !is_foreground(m.0[0])) {
        pixel.0 = pixel.0.map(|c| c / 3);
    }
    picture
}
