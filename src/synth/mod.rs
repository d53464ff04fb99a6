//! Made clips with truth: a body of random shape in made clothes turns once before a camera. The folder is laid out for
//! `effigy eval` and as an upload.

mod build;
mod clothes;
mod filming;
mod kept;
mod keypoints;
mod motion;
mod paint;
mod skirt;
mod write;

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{DMat3, DVec3};
use image::RgbImage;
use rand::SeedableRng;
use rand_pcg::Pcg64;

pub use self::build::Build;
pub use self::clothes::Outfit;
use self::clothes::{Dress, dress};
pub use self::filming::Filming;
pub use self::kept::KeptClips;
use self::keypoints::detect;
use self::motion::{novel_poses, turn};
use self::paint::Paint;
use self::skirt::{Skirt, sew};
use self::write::FolderWriter;
use crate::avatar::{Picture, Pose, Shading, Tracer, vertex_normals};
use crate::body::{Body, BodyError};
use crate::camera::Camera;
use crate::gpu::{Gpu, GpuError};
use crate::novel::NovelEntry;
use crate::npz::NpzError;
use crate::ops::skinning::cpu::{Posed, forward};
use crate::video_writer::VideoError;

/// A clip to make.
#[derive(Clone, Debug, serde::Serialize)]
pub struct SynthOptions {
    pub frames: usize,
    /// The picture's longer side, even
    pub size_px: u32,
    pub seed: u64,
    pub build: Build,
    pub outfit: Outfit,
    /// Whether the cloth is checked, so that there is something to see everywhere.
    pub checked: bool,
    /// Share of the light that comes from one side; zero lights everything evenly.
    pub side_light: f32,
    pub fps: f64,
    /// σ of the keypoints at 540 px; scaled with the size
    pub keypoint_noise_px: f64,
    pub filming: Filming,
    /// Frames with a truth surface, novel views and novel poses, each at most
    pub truths: usize,
}

impl Default for SynthOptions {
    fn default() -> Self {
        Self {
            frames: 60,
            size_px: 360,
            seed: 1,
            build: Build::Any,
            outfit: Outfit::Any,
            checked: false,
            side_light: 0.28,
            fps: 30.0,
            keypoint_noise_px: 2.0,
            filming: Filming::default(),
            truths: 8,
        }
    }
}

/// Why no clip was made.
#[derive(Debug, thiserror::Error)]
pub enum SynthError {
    #[error("{0}")]
    Options(String),
    #[error("{} has files that `effigy synth` did not make: give another folder", folder.display())]
    Occupied { folder: PathBuf },
    #[error("{}: {source}; import a body first (`make body`)", path.display())]
    Body { path: PathBuf, source: BodyError },
    #[error(transparent)]
    Gpu(#[from] GpuError),
    #[error(transparent)]
    Video(#[from] VideoError),
    #[error(transparent)]
    Npz(#[from] NpzError),
    #[error(transparent)]
    Image(#[from] image::ImageError),
    #[error(transparent)]
    Json(#[from] serde_json::Error),
    #[error(transparent)]
    Zip(#[from] zip::result::ZipError),
    #[error(transparent)]
    Io(#[from] std::io::Error),
}

/// Samples along a pixel's side.
const SAMPLES: u32 = 4;

/// One made person before one camera.
struct Scene<'a> {
    body: &'a Body,
    betas: &'a [f32],
    dress: &'a Dress,
    paint: Paint<'a>,
    tracer: Tracer,
    camera: Camera,
    /// Position of the pelvis joint around which the clip is centred
    centre: [f32; 3],
}

impl Scene<'_> {
    /// The body with its pelvis at `pelvis`.
    fn posed(&self, pose: &Pose, pelvis: [f32; 3]) -> Posed<f32> {
        let at = self.body.shaped_joints(self.betas)[0];
        let transl = std::array::from_fn(|k| pelvis[k] - at[k]);
        forward(self.body, self.betas, Some(&self.dress.offsets), pose, transl)
    }

    fn picture(&self, posed: &Posed<f32>, camera: &Camera) -> Result<Picture, GpuError> {
        let normals = vertex_normals(&posed.vertices, &self.body.faces);
        let exposures = self.paint.exposures(&posed.vertices);
        self.tracer.trace(&posed.vertices, camera, SAMPLES, Shading::Samples, |points| {
            Ok(points.iter().map(|p| self.paint.colour(p, &normals, &exposures)).collect())
        })
    }
}

/// A still wall and floor behind the person.
fn backdrop(x: u32, y: u32, width: u32, height: u32) -> [u8; 3] {
    let (u, v) = (x as f32 / width as f32, y as f32 / height as f32);
    let grey = if v < 0.82 { 150.0 + 30.0 * (1.0 - v) - 25.0 * (u - 0.5).abs() } else { 115.0 + 120.0 * (v - 0.82) };
    [grey, grey * 0.985, grey * 0.96].map(|c| c as u8)
}

fn over_backdrop(picture: &Picture, camera: &Camera) -> RgbImage {
    image::DynamicImage::ImageRgba8(picture.over(|x, y| backdrop(x, y, camera.width, camera.height))).into_rgb8()
}

/// Makes a clip of `body` in `folder`: `video.mp4`, `masks.zip`, `keypoints.json`, `camera.json`, `truth/` and `novel/`.
/// The same options give the same clip on the same device. `progress` hears the frames done and of how many.
pub fn synthesise(
    gpu: &Arc<Gpu>,
    body: &Body,
    options: &SynthOptions,
    folder: &Path,
    mut progress: impl FnMut(usize, usize),
) -> Result<(), SynthError> {
    check(options)?;
    let mut rng = Pcg64::seed_from_u64(options.seed);
    let betas = options.build.betas(body, &mut rng);
    let dress = dress(body, &betas, options.outfit, &mut rng);
    let (body, dress) = match Skirt::of(options.outfit) {
        Some(skirt) => {
            let (sewn, dress) = sew(body, &betas, dress, &skirt);
            (Cow::Owned(sewn), dress)
        }
        None => (Cow::Borrowed(body), dress),
    };
    let body = body.as_ref();
    let paint = Paint::random(body, &betas, &dress, options, &mut rng);
    let filming = &options.filming;
    let ys = dress.rest.iter().map(|v| f64::from(v[1]));
    let (low, high) = ys.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), y| (l.min(y), h.max(y)));
    let (camera, centre) = filming.camera(options.size_px, low, high, f64::from(body.shaped_joints(&betas)[0][1]));
    let centre = centre.as_vec3().to_array();
    let tracer = Tracer::new(gpu, &body.faces, &body.v_template);
    let scene = Scene { body, betas: &betas, dress: &dress, paint, tracer, camera, centre };
    let mut out = FolderWriter::create(folder, body, options)?;
    out.canonical(body, &dress.rest)?;

    let (poses, sways) = turn(options.frames, filming, &mut rng);
    let truth_step = options.frames.div_ceil(options.truths.max(1));
    for (i, (pose, sway)) in poses.iter().zip(&sways).enumerate() {
        let pelvis: [f32; 3] = std::array::from_fn(|k| scene.centre[k] + sway[k]);
        let posed = scene.posed(pose, pelvis);
        let picture = scene.picture(&posed, &scene.camera)?;
        let noise_px = options.keypoint_noise_px * options.size_px as f64 / 540.0;
        let keypoints = detect(body, &posed.vertices, &posed.joints, &scene.camera, noise_px, &mut rng);
        out.frame(&over_backdrop(&picture, &scene.camera), &picture.coverage(), pose, &posed.joints, keypoints)?;
        if options.truths > 0 && i % truth_step == 0 {
            out.surface(i, body, &posed.vertices)?;
        }
        if i == 0 {
            for k in 0..options.truths {
                novel_view(&scene, &posed, k, options.truths, &mut out)?;
            }
        }
        progress(i + 1, options.frames);
    }
    for (name, pose) in novel_poses(filming).into_iter().take(options.truths) {
        let picture = scene.picture(&scene.posed(&pose, scene.centre), &scene.camera)?;
        let entry = NovelEntry::of_pose(name, &pose, scene.centre, &scene.camera);
        out.novel_pose(entry, &over_backdrop(&picture, &scene.camera), &picture.coverage())?;
    }
    out.finish(body, &betas, &scene.camera)
}

fn check(options: &SynthOptions) -> Result<(), SynthError> {
    if !(1..=10_000).contains(&options.frames) {
        return Err(SynthError::Options(format!("{} frames, expected 1 to 10000", options.frames)));
    }
    if !(32..=4096).contains(&options.size_px) || !options.size_px.is_multiple_of(2) {
        return Err(SynthError::Options(format!("a size of {} px, expected 32 to 4096 and even", options.size_px)));
    }
    let ranges = [
        ("frames a second", options.fps, 1.0..=240.0),
        ("a side light", f64::from(options.side_light), 0.0..=1.0),
        ("a keypoint noise", options.keypoint_noise_px, 0.0..=100.0),
    ];
    filming::check_ranges(&ranges)?;
    options.filming.check()
}

/// Frame 0 from a camera that has walked round the person and looks a little down.
fn novel_view(
    scene: &Scene<'_>,
    posed: &Posed<f32>,
    k: usize,
    n: usize,
    out: &mut FolderWriter,
) -> Result<(), SynthError> {
    let azimuth = std::f64::consts::TAU * (k as f64 + 0.5) / n as f64;
    let elevation: f64 = if k.is_multiple_of(2) { 0.09 } else { 0.2 };
    let rotation = DMat3::from_rotation_x(elevation) * DMat3::from_rotation_y(azimuth);
    let centre = DVec3::new(0.0, 0.0, scene.centre[2] as f64);
    let camera = Camera {
        rotation: rotation.transpose().to_cols_array(),
        translation: (centre - rotation * centre).to_array(),
        ..scene.camera.clone()
    };
    let picture = scene.picture(posed, &camera)?;
    out.novel_view(k, &camera, &over_backdrop(&picture, &camera), &picture.coverage())
}
