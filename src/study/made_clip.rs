//! A made clip as a job would read it, and what it was made of.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use anyhow::{Context as _, Result, ensure};

use crate::avatar::{Pose, ply};
use crate::body::Body;
use crate::capture::{Capture, CaptureInputs, CaptureOptions};
use crate::npz::Npz;

/// All frames of the clip of a folder, as large as they are. Poses are not given.
pub(super) fn load(clip: &Path) -> Result<Capture> {
    let inputs = CaptureInputs {
        video: clip.join("video.mp4"),
        masks: clip.join("masks.zip"),
        keypoints: clip.join("keypoints.json"),
        camera: Some(clip.join("camera.json")),
        poses: None,
    };
    Ok(Capture::load(&inputs, &CaptureOptions { max_frames: u32::MAX, max_side_px: u32::MAX }, &mut |_| true)?)
}

/// The person of a made clip.
pub(super) struct MadeOf {
    pub betas: Vec<f32>,
    /// D, of each vertex
    pub offsets: Vec<[f32; 3]>,
    /// Of each frame
    pub poses: Vec<Pose>,
    /// SMPL's, of each frame
    pub transl: Vec<[f32; 3]>,
}

impl MadeOf {
    /// The truth beside the clip of a folder, whose person has this body.
    pub fn read(clip: &Path, body: &Body) -> Result<Self> {
        let path = clip.join("truth/poses.npz");
        let npz = Npz::open(&path).with_context(|| path.display().to_string())?;
        let betas = npz.get("betas")?.f32();
        let poses: Vec<Pose> = npz.get("poses")?.f32().as_chunks().0.to_vec();
        let pelvis = npz.get("trans")?.f32();
        ensure!(
            pelvis.len() == 3 * poses.len(),
            "{}: {} poses, {} places",
            path.display(),
            poses.len(),
            pelvis.len() / 3
        );
        let at = body.shaped_joints(&betas)[0];
        let transl = pelvis.as_chunks::<3>().0.iter().map(|p| std::array::from_fn(|k| p[k] - at[k])).collect();
        let rest = ply::read(BufReader::new(File::open(clip.join("truth/canonical.ply"))?))?.vertices;
        let naked = body.shaped_vertices(&betas);
        let offsets = rest.iter().zip(&naked).map(|(r, n)| std::array::from_fn(|k| r[k] - n[k])).collect();
        Ok(Self { betas, offsets, poses, transl })
    }
}
