//! `effigy render`: pictures of an avatar in given poses, and turntables.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use effigy::avatar::{AvatarModel, Place, Pose, RenderSpec, Renderer, holding};
use effigy::body::N_POSE;
use effigy::camera::Camera;
use effigy::capture::read_camera;
use effigy::gpu::{DeviceSelect, Gpu};
use effigy::npz::Npz;
use effigy::picture::{Background, Light};
use effigy::video_writer::{Quality, VideoError, VideoWriter};
use glam::{Quat, Vec3};
use image::{DynamicImage, RgbaImage};
use serde::Deserialize;
use serde::de::IntoDeserializer;

#[derive(clap::Args)]
pub struct Args {
    /// The avatar: `model.npz` of a job or of `effigy fit`.
    #[arg(long)]
    model: PathBuf,
    /// Poses to render: npz with `poses [N, 72]` and `trans [N, 3]` (SMPL's transl) or `pelvis [N, 3]`.
    #[arg(long, conflicts_with_all = ["frame", "turntable"])]
    poses: Option<PathBuf>,
    /// Read `trans` of the poses as the position of the pelvis joint.
    #[arg(long, requires = "poses")]
    trans_is_pelvis: bool,
    /// A frame of the captured video; the nearest kept one is rendered.
    #[arg(long, conflicts_with = "turntable")]
    frame: Option<u32>,
    /// Pictures of one whole turn of the first captured pose, and `turntable.mp4`.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=3600))]
    turntable: Option<u32>,
    /// Camera as JSON; by default the capture's, for a turntable with as much wider a view as the whole person needs.
    #[arg(long)]
    camera: Option<PathBuf>,
    /// Resize the camera so that its longer side has this many pixels.
    #[arg(long, value_parser = clap::value_parser!(u32).range(16..=8192))]
    size: Option<u32>,
    /// `transparent` or `#rrggbb`.
    #[arg(long, default_value = "transparent")]
    background: Background,
    /// `captured`: the light of the clip. `none`: the albedo, as the GLB's texture has it.
    #[arg(long, default_value = "captured", value_parser = light)]
    light: Light,
    /// Samples along a pixel's side.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=8))]
    samples: u32,
    /// Folder for the pictures.
    #[arg(long)]
    out: PathBuf,
}

fn light(text: &str) -> Result<Light, serde::de::value::Error> {
    Light::deserialize(text.into_deserializer())
}

pub fn run(args: Args) -> Result<()> {
    let model = AvatarModel::load(&args.model).with_context(|| args.model.display().to_string())?;
    let shots = shots(&args, &model)?;
    let camera = camera(&args, &model, &shots)?;
    std::fs::create_dir_all(&args.out).with_context(|| args.out.display().to_string())?;
    let renderer = Renderer::new(&Gpu::open(&DeviceSelect::Auto)?, &Arc::new(model))?;
    let bar = super::progress(shots.len() as u64, "pictures");
    let mut film = args.turntable.map(|n| Film::start(&args.out, &camera, n)).transpose()?;
    for (name, pose, place) in shots {
        let image = renderer.render(&RenderSpec {
            pose,
            place,
            betas: None,
            camera: camera.clone(),
            background: args.background,
            light: args.light,
            samples: args.samples,
            shading: None,
        })?;
        let path = args.out.join(format!("{name}.png"));
        image.save(&path).with_context(|| path.display().to_string())?;
        if let Some(film) = &mut film {
            film.push(&image)?;
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    film.map(Film::finish).transpose()?;
    println!("wrote {}", args.out.display());
    Ok(())
}

fn camera(args: &Args, model: &AvatarModel, shots: &[Shot]) -> Result<Camera> {
    let camera = match &args.camera {
        None if args.turntable.is_some() => {
            let persons = shots.iter().map(|(_, pose, place)| (pose, *place));
            holding(&model.camera, model, persons)
        }
        None => model.camera.clone(),
        Some(path) => read_camera(path).with_context(|| path.display().to_string())?,
    };
    let Some(size) = args.size else { return Ok(camera) };
    let scale = f64::from(size) / f64::from(camera.width.max(camera.height));
    let side = |s: u32| ((f64::from(s) * scale).round() as u32).max(1);
    Ok(camera.scaled(side(camera.width), side(camera.height)))
}

type Shot = (String, Pose, Place);

fn shots(args: &Args, model: &AvatarModel) -> Result<Vec<Shot>> {
    if let Some(path) = &args.poses {
        return poses(model, path, args.trans_is_pelvis).with_context(|| path.display().to_string());
    }
    if let Some(n) = args.turntable {
        return Ok(turntable(model, n));
    }
    let Some(frame) = args.frame else { bail!("say what to render: --poses, --frame or --turntable") };
    let k = model.nearest_frame(frame);
    if model.frames[k] != frame {
        eprintln!("frame {frame} is none of those that were fitted; the nearest is {}", model.frames[k]);
    }
    Ok(vec![(format!("frame_{:04}", model.frames[k]), model.poses[k], Place::Transl(model.transl[k]))])
}

fn poses(model: &AvatarModel, path: &Path, trans_is_pelvis: bool) -> Result<Vec<Shot>> {
    let npz = Npz::open(path)?;
    let poses = npz.shaped("poses", &[usize::MAX, N_POSE])?;
    let n = poses.shape[0];
    let is_pelvis = npz.arrays.contains_key("pelvis");
    let places = npz.shaped(if is_pelvis { "pelvis" } else { "trans" }, &[n, 3])?.f32();
    let place = |pose: &Pose, at: [f32; 3]| match is_pelvis || trans_is_pelvis {
        true => Place::Pelvis(at),
        false => Place::Transl((Vec3::from(at) + model.pelvis_shift(pose)).to_array()),
    };
    let rows = poses.f32().as_chunks::<N_POSE>().0.to_vec().into_iter().zip(places.as_chunks().0.to_vec());
    Ok(rows.enumerate().map(|(i, (pose, at))| (format!("pose_{i:04}"), pose, place(&pose, at))).collect())
}

/// The first captured pose, turned about the body's own axis; the pelvis stays where it was.
fn turntable(model: &AvatarModel, n: u32) -> Vec<Shot> {
    let pelvis = model.posed(&model.poses[0], model.transl[0]).joints[0];
    let root = Quat::from_scaled_axis(Vec3::from_slice(&model.poses[0][..3]));
    let shot = |i| {
        let turned = root * Quat::from_rotation_y(std::f32::consts::TAU * i as f32 / n as f32);
        let mut pose = model.poses[0];
        pose[..3].copy_from_slice(&turned.to_scaled_axis().to_array());
        (format!("turn_{i:04}"), pose, Place::Pelvis(pelvis))
    };
    (0..n).map(shot).collect()
}

/// `turntable.mp4`: one turn in four seconds, on white where the pictures are transparent.
struct Film {
    writer: VideoWriter,
    even: (u32, u32),
}

impl Film {
    fn start(out: &Path, camera: &Camera, n: u32) -> Result<Self, VideoError> {
        let even = ((camera.width & !1).max(2), (camera.height & !1).max(2));
        let writer = VideoWriter::create(&out.join("turntable.mp4"), even, n as f64 / 4.0, Quality::Playable)?;
        Ok(Self { writer, even })
    }

    fn push(&mut self, image: &RgbaImage) -> Result<(), VideoError> {
        let mut opaque = image::RgbaImage::from_pixel(self.even.0, self.even.1, image::Rgba([255; 4]));
        image::imageops::overlay(&mut opaque, image, 0, 0);
        self.writer.push(&DynamicImage::ImageRgba8(opaque).into_rgb8())
    }

    fn finish(self) -> Result<(), VideoError> {
        self.writer.finish()
    }
}
