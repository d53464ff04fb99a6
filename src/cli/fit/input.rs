//! The clip and the options of a command.

use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow, bail};
use effigy::capture::CaptureInputs;
use effigy::jobs::JobOptions;
use effigy::worker::pipeline::PipelineInput;

use super::Args;

pub(super) fn input_of(args: &Args) -> anyhow::Result<PipelineInput> {
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
    if let Some(video) = args.clip.as_deref().filter(|clip| clip.is_file()) {
        bail!(
            "{} is a file: give a folder with video.*, masks.* and keypoints.* (tools/detect/detect.py makes one of a video), or \
             --video, --masks and --keypoints",
            video.display()
        );
    }
    let part = |given: &Option<PathBuf>, name: &str| -> anyhow::Result<Option<PathBuf>> {
        match (given, &args.clip) {
            (Some(path), _) => given_file(path, name).map(Some),
            (None, Some(folder)) => find(folder, name),
            (None, None) => Ok(None),
        }
    };
    let needed = |given: &Option<PathBuf>, name: &str| -> anyhow::Result<PathBuf> {
        part(given, name)?.ok_or_else(|| match &args.clip {
            Some(folder) => anyhow!("there is no {name}.* in {}: {}", folder.display(), names(folder)),
            None => anyhow!("{name}: give a clip's folder, or --{name} FILE"),
        })
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

/// The one file `name.*` of a folder.
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
    if found.len() > 1 {
        bail!("{} and {} are both there: say which with --{name}", found[0].display(), found[1].display());
    }
    Ok(found.pop())
}

/// What a folder has instead of what was looked for.
fn names(folder: &Path) -> String {
    const MOST: usize = 8;
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut names: Vec<String> = entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    match names.len() {
        0 => "it is empty".into(),
        n if n > MOST => format!("it has {}, and {} more", names[..MOST].join(", "), n - MOST),
        _ => format!("it has {}", names.join(", ")),
    }
}
