//! A folder of truth: `masks.zip`, `novel/novel.json` with its pictures, `truth/frame_*.ply` and
//! `truth/joints3d.json`. What is absent is not evaluated.

use std::io::BufReader;
use std::path::{Path, PathBuf};

use image::{GrayImage, RgbImage};

use super::shot::composited;
use crate::avatar::Pose;
use crate::avatar::ply::{self, Mesh, PlyError};
use crate::camera::Camera;
use crate::capture;
use crate::novel::{NovelEntry, NovelFile};

/// Why the folder could not be read.
#[derive(Debug, thiserror::Error)]
pub enum SubjectError {
    #[error("{path}: {reason}")]
    File { path: PathBuf, reason: String },
    #[error("{path}: {source}")]
    Ply { path: PathBuf, source: PlyError },
}

fn file_error(path: &Path) -> impl Fn(&dyn std::fmt::Display) -> SubjectError + use<'_> {
    move |reason| SubjectError::File { path: path.to_owned(), reason: reason.to_string() }
}

/// Which pose a held-out picture shows.
#[derive(Clone, Debug, PartialEq)]
pub enum NovelPose {
    /// The captured pose of this frame of the video.
    Frame(u32),
    /// A pose that the video does not show, and the pelvis joint's position.
    Pose(Box<Pose>, [f32; 3]),
}

/// A held-out picture.
#[derive(Clone, Debug)]
pub struct Novel {
    pub name: String,
    pub image: PathBuf,
    pub mask: PathBuf,
    pub camera: Camera,
    pub pose: NovelPose,
}

impl Novel {
    /// The picture as it is, and its mask.
    pub fn open(&self) -> Result<(RgbImage, GrayImage), SubjectError> {
        let open = |path: &Path| ::image::open(path).map_err(|e| file_error(path)(&e));
        let (image, mask) = (open(&self.image)?.into_rgb8(), open(&self.mask)?.into_luma8());
        if image.dimensions() != mask.dimensions() {
            return Err(file_error(&self.mask)(&"not the size of its picture"));
        }
        Ok((image, mask))
    }

    /// The truth on white: the picture where its mask covers.
    pub fn on_white(&self) -> Result<RgbImage, SubjectError> {
        let (image, mask) = self.open()?;
        Ok(composited(&image, &mask, [255; 3]))
    }
}

/// An opened folder.
#[derive(Debug, Default)]
pub struct Subject {
    pub views: Vec<Novel>,
    pub poses: Vec<Novel>,
    /// Frame of the video and its surface
    pub surfaces: Vec<(u32, PathBuf)>,
    /// `[T][24]`, the clip's world, metres
    pub joints: Vec<Vec<[f64; 3]>>,
    /// The clip's masks and its camera
    masks: Option<PathBuf>,
    camera: Option<PathBuf>,
}

fn novel(entry: NovelEntry, folder: &Path) -> Result<Novel, String> {
    let camera = entry.camera();
    let pose = match (entry.pose, entry.trans) {
        (Some(pose), Some(trans)) => {
            let n = pose.len();
            let pose = pose.try_into().map_err(|_| format!("{}: a pose of {n} numbers, expected 72", entry.image))?;
            NovelPose::Pose(Box::new(pose), trans)
        }
        _ => NovelPose::Frame(entry.frame.unwrap_or(0)),
    };
    Ok(Novel {
        name: Path::new(&entry.image).file_stem().unwrap_or_default().to_string_lossy().into_owned(),
        image: folder.join(&entry.image),
        mask: folder.join(&entry.mask),
        camera,
        pose,
    })
}

#[derive(serde::Deserialize)]
struct JointsFile {
    frames: Vec<Vec<[f64; 3]>>,
}

fn json<T: serde::de::DeserializeOwned>(path: &Path) -> Result<Option<T>, SubjectError> {
    if !path.exists() {
        return Ok(None);
    }
    let bytes = std::fs::read(path).map_err(|e| file_error(path)(&e))?;
    serde_json::from_slice(&bytes).map(Some).map_err(|e| file_error(path)(&e))
}

impl Subject {
    pub fn open(folder: &Path) -> Result<Self, SubjectError> {
        if !folder.is_dir() {
            return Err(file_error(folder)(&"not a folder"));
        }
        let mut subject = Self::default();
        let list = folder.join("novel/novel.json");
        if let Some(file) = json::<NovelFile>(&list)? {
            let novels = |entries: Vec<NovelEntry>| {
                let novels = entries.into_iter().map(|e| novel(e, &folder.join("novel")));
                novels.collect::<Result<Vec<_>, _>>().map_err(|e| file_error(&list)(&e))
            };
            subject.views = novels(file.views)?;
            subject.poses = novels(file.poses)?;
        }
        if let Some(file) = json::<JointsFile>(&folder.join("truth/joints3d.json"))? {
            subject.joints = file.frames;
        }
        let truth = folder.join("truth");
        for entry in std::fs::read_dir(&truth).into_iter().flatten().flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            let number = name.strip_prefix("frame_").and_then(|n| n.strip_suffix(".ply")).and_then(|n| n.parse().ok());
            subject.surfaces.extend(number.map(|n| (n, entry.path())));
        }
        subject.surfaces.sort();
        let part = |name: &str| Some(folder.join(name)).filter(|path| path.exists());
        (subject.masks, subject.camera) = (part("masks.zip"), part("camera.json"));
        Ok(subject)
    }

    /// All but the masks.
    #[must_use]
    pub fn without_masks(self) -> Self {
        Self { masks: None, ..self }
    }

    /// Whether it has nothing that an avatar could be compared with.
    pub fn is_empty(&self) -> bool {
        let Self { views, poses, joints, surfaces, masks, camera: _ } = self;
        views.is_empty() && poses.is_empty() && joints.is_empty() && surfaces.is_empty() && masks.is_none()
    }

    /// The truth's surface of `surfaces[i]`.
    pub fn surface(&self, i: usize) -> Result<Mesh, SubjectError> {
        let path = &self.surfaces[i].1;
        let file = std::fs::File::open(path).map_err(|e| file_error(path)(&e))?;
        ply::read(BufReader::new(file)).map_err(|source| SubjectError::Ply { path: path.clone(), source })
    }

    /// The camera that the clip was filmed with; `None` without `camera.json`.
    pub fn camera(&self) -> Result<Option<Camera>, SubjectError> {
        let read = |path: &Path| capture::read_camera(path).map_err(|e| file_error(path)(&e));
        self.camera.as_deref().map(read).transpose()
    }

    /// The masks of these frames of the video, without the lens's distortion; `None` for a frame without one. Empty without masks.
    pub fn masks(&self, frames: &[u32]) -> Result<Vec<Option<GrayImage>>, SubjectError> {
        let Some(path) = &self.masks else { return Ok(Vec::new()) };
        capture::masks(path, self.camera.as_deref(), frames).map_err(|e| file_error(path)(&e))
    }
}
