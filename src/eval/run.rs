//! The evaluation itself.

use std::path::Path;

use glam::DVec3;
use image::{Rgb, RgbImage};

use super::geometry::{Similarity, align, distances};
use super::image::{mask_iou, psnr, ssim};
use super::report::{FrameIou, GeometryScore, ImageScore, JointScore, Report};
use super::subject::{Novel, NovelPose, Subject, SubjectError};
use crate::avatar::{AvatarModel, Background, Place, RenderError, RenderSpec, Renderer};

/// Samples along a pixel's side of the compared pictures: the truth's are well antialiased.
const SAMPLES: u32 = 4;

/// Why an evaluation stopped.
#[derive(Debug, thiserror::Error)]
pub enum EvalError {
    #[error(transparent)]
    Subject(#[from] SubjectError),
    #[error(transparent)]
    Render(#[from] RenderError),
    #[error(transparent)]
    Io(#[from] std::io::Error),
    #[error("{picture}: {reason}")]
    Picture { picture: String, reason: String },
}

/// Compares the renderer's avatar with all the truth that `subject` has. With `out`, writes a picture for every novel one:
/// truth, ours, absolute error. `progress` hears what is done.
pub fn evaluate(
    renderer: &Renderer,
    subject: &Subject,
    out: Option<&Path>,
    mut progress: impl FnMut(&str),
) -> Result<Report, EvalError> {
    let mut report = Report::default();
    for i in 0..subject.surfaces.len() {
        progress(&format!("surface of frame {}", subject.surfaces[i].0));
        report.geometry.extend(geometry(renderer.model(), subject, i)?);
    }
    for novel in &subject.views {
        progress(&novel.name);
        report.novel_views.push(image_score(renderer, novel, out, &mut report.warnings)?);
    }
    for novel in &subject.poses {
        progress(&novel.name);
        report.novel_poses.push(image_score(renderer, novel, out, &mut report.warnings)?);
    }
    if let Some(scale) = report.scale() {
        let folder = out.map(|out| out.join("scaled"));
        if let Some(folder) = &folder {
            std::fs::create_dir_all(folder)?;
        }
        let mut ignored = Vec::new();
        for (novels, scores) in
            [(&subject.views, &mut report.scaled_novel_views), (&subject.poses, &mut report.scaled_novel_poses)]
        {
            for novel in novels {
                progress(&format!("{}, scaled", novel.name));
                scores.push(image_score(renderer, &in_our_units(novel, scale), folder.as_deref(), &mut ignored)?);
            }
        }
    }
    progress("training masks");
    report.mask_iou = training_masks(renderer, subject)?;
    report.joints = joints(renderer.model(), &subject.joints);
    report.summarise();
    Ok(report)
}

/// The same picture of a world in which everything is `1 / scale` as large: `scale` is truth over ours.
fn in_our_units(novel: &Novel, scale: f64) -> Novel {
    let mut novel = novel.clone();
    novel.camera.translation = novel.camera.translation.map(|t| t / scale);
    if let NovelPose::Pose(_, pelvis) = &mut novel.pose {
        *pelvis = pelvis.map(|x| (x as f64 / scale) as f32);
    }
    novel
}

fn image_score(
    renderer: &Renderer,
    novel: &Novel,
    out: Option<&Path>,
    warnings: &mut Vec<String>,
) -> Result<ImageScore, EvalError> {
    let model = renderer.model();
    let mut spec = match &novel.pose {
        NovelPose::Frame(frame) => {
            let k = model.nearest_frame(*frame);
            if model.frames[k] != *frame {
                warnings.push(format!("{}: frame {} stands for frame {frame}", novel.name, model.frames[k]));
            }
            RenderSpec::of_frame(model, k)
        }
        NovelPose::Pose(pose, pelvis) => {
            RenderSpec { pose: **pose, place: Place::Pelvis(*pelvis), ..RenderSpec::of_frame(model, 0) }
        }
    };
    spec.camera = novel.camera.clone();
    spec.background = Background::Colour([255; 3]);
    spec.samples = SAMPLES;
    let picture_error = |reason: String| EvalError::Picture { picture: novel.name.clone(), reason };
    let ours = image::DynamicImage::ImageRgba8(renderer.render(&spec)?).into_rgb8();
    let truth = novel.on_white()?;
    if truth.dimensions() != ours.dimensions() || truth.width().min(truth.height()) < 11 {
        let ((w, h), (want_w, want_h)) = (truth.dimensions(), ours.dimensions());
        return Err(picture_error(format!("the picture is {w}×{h}, its camera {want_w}×{want_h}, at least 11 a side")));
    }
    if let Some(out) = out {
        let path = out.join(format!("{}.png", novel.name));
        side_by_side(&truth, &ours).save(&path).map_err(|e| picture_error(e.to_string()))?;
    }
    Ok(ImageScore { name: novel.name.clone(), psnr_db: psnr(&truth, &ours), ssim: ssim(&truth, &ours) })
}

/// Truth, ours, and their absolute difference.
fn side_by_side(truth: &RgbImage, ours: &RgbImage) -> RgbImage {
    let (width, height) = truth.dimensions();
    RgbImage::from_fn(3 * width, height, |x, y| {
        let (a, b) = (truth.get_pixel(x % width, y), ours.get_pixel(x % width, y));
        match x / width {
            0 => *a,
            1 => *b,
            _ => Rgb(std::array::from_fn(|k| a.0[k].abs_diff(b.0[k]))),
        }
    })
}

fn training_masks(renderer: &Renderer, subject: &Subject) -> Result<Vec<FrameIou>, EvalError> {
    let model = renderer.model();
    let mut scores = Vec::new();
    for (k, mask) in subject.masks(&model.frames)?.into_iter().enumerate() {
        let Some(mask) = mask else { continue };
        let mut spec = RenderSpec::of_frame(model, k);
        spec.camera = model.camera.scaled(mask.width(), mask.height());
        spec.samples = SAMPLES;
        scores.push(FrameIou { frame: model.frames[k], iou: mask_iou(&renderer.mask(&spec)?, &mask) });
    }
    Ok(scores)
}

/// `None` where the frame was not kept.
fn geometry(model: &AvatarModel, subject: &Subject, i: usize) -> Result<Option<GeometryScore>, EvalError> {
    let frame = subject.surfaces[i].0;
    let Some(ours) = model.frames.iter().position(|&f| f == frame).and_then(|k| model.mesh(Some(k))) else {
        return Ok(None);
    };
    let truth = subject.surface(i)?;
    let alignment = align(&ours, &truth);
    Ok(Some(GeometryScore {
        frame,
        aligned: distances(&ours, &truth, &alignment),
        unaligned: distances(&ours, &truth, &Similarity::IDENTITY),
        scale: alignment.scale,
    }))
}

fn joints(model: &AvatarModel, truth: &[Vec<[f64; 3]>]) -> Option<JointScore> {
    let (mut sum, mut root_sum, mut n) = (0.0, 0.0, 0);
    for (k, &frame) in model.frames.iter().enumerate() {
        let Some(truth) = truth.get(frame as usize) else { continue };
        let ours = model.posed(&model.poses[k], model.transl[k]).joints;
        let point = |p: [f32; 3]| DVec3::from(p.map(f64::from));
        let root = point(ours[0]) - DVec3::from(*truth.first()?);
        for (&a, &b) in ours.iter().zip(truth) {
            let difference = point(a) - DVec3::from(b);
            sum += difference.length();
            root_sum += (difference - root).length();
            n += 1;
        }
    }
    let cm = |sum: f64| 100.0 * sum / n as f64;
    (n > 0).then(|| JointScore { mean_cm: cm(sum), root_aligned_cm: cm(root_sum) })
}
