//! The evaluation itself.

use std::path::Path;

use glam::{DMat3, DVec3};

use super::geometry::{Similarity, align, distances, scale_about};
use super::image::mask_iou;
use super::lpips::{Lpips, LpipsError};
use super::page::{self, Cards, Set};
use super::refine::refined;
use super::report::{FrameIou, GeometryScore, ImageScore, JointScore, Report};
use super::shot::Shot;
use super::subject::{Novel, NovelPose, Subject, SubjectError};
use crate::avatar::{AvatarModel, Place, RenderError, RenderSpec, Renderer};
use crate::camera::Camera;
use crate::fit::FitError;

/// Samples along a pixel's side of the compared masks.
const SAMPLES: u32 = 4;

/// Focal lengths that differ by a smaller part than this are the same one.
const SAME_FOCAL: f64 = 1e-3;

/// What an evaluation does besides the figures.
#[derive(Clone, Copy, Default)]
pub struct EvalOptions<'a> {
    /// Folder for `eval.html` and for a picture of every novel one: truth, ours, absolute error.
    pub out: Option<&'a Path>,
    /// Compare novel poses also after refining them on their pictures.
    pub refine: bool,
    /// A network for LPIPS.
    pub lpips: Option<&'a Lpips>,
}

/// Why an evaluation stopped.
#[derive(Debug, thiserror::Error)]
pub enum EvalError {
    #[error(transparent)]
    Subject(#[from] SubjectError),
    #[error(transparent)]
    Render(#[from] RenderError),
    #[error(transparent)]
    Lpips(#[from] LpipsError),
    #[error("refining a pose: {0}")]
    Refine(#[from] FitError),
    #[error(transparent)]
    Io(#[from] std::io::Error),
    #[error("the folder has nothing to compare with: no masks.zip, truth/ or novel/")]
    NoTruth,
    #[error("{picture}: {reason}")]
    Picture { picture: String, reason: String },
}

impl EvalError {
    fn picture(novel: &Novel, reason: &dyn std::fmt::Display) -> Self {
        Self::Picture { picture: novel.name.clone(), reason: reason.to_string() }
    }
}

/// Compares the renderer's avatar with all the truth that `subject` has. `progress` hears what is done.
pub fn evaluate(
    renderer: &Renderer,
    subject: &Subject,
    options: &EvalOptions<'_>,
    mut progress: impl FnMut(&str),
) -> Result<Report, EvalError> {
    if subject.is_empty() {
        return Err(EvalError::NoTruth);
    }
    let mut report = Report::default();
    for i in 0..subject.surfaces.len() {
        progress(&format!("surface of frame {}", subject.surfaces[i].0));
        report.geometry.extend(geometry(renderer.model(), subject, i)?);
    }
    let mut comparison = Comparison { renderer, options, cards: Cards::default(), warnings: Vec::new() };
    let mut compare = |set: Set, novels: &[Novel]| comparison.compare(set, novels, &mut progress);
    report.novel_views = compare(Set::Plain, &subject.views)?;
    report.novel_poses = compare(Set::Plain, &subject.poses)?;
    let scale = report.scale();
    let centre = centre(renderer.model());
    let scaled = |novels: &[Novel], scale: Option<f64>| -> Vec<Novel> {
        novels.iter().map(|n| in_our_units(n, centre, scale.unwrap_or(1.0))).collect()
    };
    // Depth tells the size of no fit that found a focal length of its own.
    let filmed = subject.camera();
    let own_focal = matches!(&filmed, Ok(Some(filmed)) if differs(filmed, &renderer.model().camera));
    let poses = scaled(&subject.poses, if own_focal { report.size() } else { scale });
    if scale.is_some() {
        report.scaled_novel_views = compare(Set::Scaled, &scaled(&subject.views, scale))?;
        report.scaled_novel_poses = compare(Set::Scaled, &poses)?;
    }
    let aligned: Vec<Novel> = subject.views.iter().filter_map(|n| aligned(n, &report.geometry)).collect();
    report.aligned_novel_views = compare(Set::Aligned, &aligned)?;
    if options.refine {
        report.refined_novel_poses = compare(Set::Refined, &poses)?;
    }
    let Comparison { cards, mut warnings, .. } = comparison;
    warnings.extend(filmed.err().map(|error| format!("the camera's focal length is not compared: {error}")));
    // A picture that is compared in several ways warns once.
    warnings.sort();
    warnings.dedup();
    progress("training masks");
    match training_masks(renderer, subject) {
        Ok(scores) => report.mask_iou = scores,
        // All else has been compared by then.
        Err(EvalError::Subject(error)) => warnings.push(format!("the masks are not compared: {error}")),
        Err(error) => return Err(error),
    }
    report.warnings = warnings;
    report.joints = joints(renderer.model(), &subject.joints);
    report.summarise();
    if let Some(out) = options.out {
        std::fs::write(out.join("eval.html"), page::html(&report, &cards))?;
    }
    Ok(report)
}

/// Held-out pictures against the renderer's, and what is kept of that for the page.
struct Comparison<'a> {
    renderer: &'a Renderer,
    options: &'a EvalOptions<'a>,
    cards: Cards,
    warnings: Vec<String>,
}

impl Comparison<'_> {
    fn compare(
        &mut self,
        set: Set,
        novels: &[Novel],
        progress: &mut dyn FnMut(&str),
    ) -> Result<Vec<ImageScore>, EvalError> {
        let folder = self.options.out.map(|out| out.join(set.folder()));
        if let Some(folder) = &folder {
            std::fs::create_dir_all(folder)?;
        }
        let mut scores = Vec::new();
        for novel in novels {
            progress(&format!("{} {}", set.name(), novel.name));
            let mut spec = spec_of(self.renderer.model(), novel, &mut self.warnings);
            if set == Set::Refined {
                spec = refined(self.renderer, novel, spec)?;
            }
            let shot = Shot::draw(self.renderer, novel, spec)?;
            let score = shot.score(self.options.lpips)?;
            if let Some(folder) = &folder {
                let path = folder.join(format!("{}.png", novel.name));
                shot.side_by_side().save(&path).map_err(|error| EvalError::picture(novel, &error))?;
                self.cards.add(set, &score, &shot);
            }
            scores.push(score);
        }
        Ok(scores)
    }
}

/// Whether two cameras have other focal lengths, in pictures of the same size.
fn differs(one: &Camera, other: &Camera) -> bool {
    let one = one.scaled(other.width, other.height);
    (one.fx / other.fx - 1.0).abs() > SAME_FOCAL
}

/// Where the clip's camera stands in its world.
fn centre(model: &AvatarModel) -> DVec3 {
    DVec3::from(model.camera.centre())
}

/// The same picture of a world in which all is `1 / scale` as large and as far from the clip's camera at `centre`: `scale` is truth
/// over ours. With x_ours = c + (x − c) / scale, R x + t = scale (R x_ours + (R c (1 − scale) + t) / scale).
fn in_our_units(novel: &Novel, centre: DVec3, scale: f64) -> Novel {
    let mut novel = novel.clone();
    let seen = DVec3::from(novel.camera.view(centre.to_array()));
    let turned = seen - DVec3::from(novel.camera.translation);
    novel.camera.translation = (seen / scale - turned).to_array();
    if let NovelPose::Pose(_, pelvis) = &mut novel.pose {
        let place = DVec3::from(pelvis.map(f64::from));
        *pelvis = (centre + (place - centre) / scale).as_vec3().to_array();
    }
    novel
}

/// The same picture of a world in which our surface of the picture's frame has been laid onto the truth's: what remains is not
/// the place, the size or the facing. `None` where that frame has no surface.
fn aligned(novel: &Novel, surfaces: &[GeometryScore]) -> Option<Novel> {
    let NovelPose::Frame(frame) = novel.pose else { return None };
    let Similarity { scale, rotation, translation } = surfaces.iter().find(|s| s.frame == frame)?.alignment;
    // A picture does not tell whether all that it shows is smaller and nearer.
    let to_view = DMat3::from_cols_array(&novel.camera.rotation).transpose();
    let shift = (to_view * translation + DVec3::from(novel.camera.translation)) / scale;
    let mut novel = novel.clone();
    novel.camera.rotation = (to_view * rotation).transpose().to_cols_array();
    novel.camera.translation = shift.to_array();
    Some(novel)
}

/// The avatar in the picture's pose: as fitted where it is a frame's, in which case the nearest kept frame may stand for it.
fn spec_of(model: &AvatarModel, novel: &Novel, warnings: &mut Vec<String>) -> RenderSpec {
    match &novel.pose {
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
    }
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
        camera_scale: scale_about(centre(model), &ours, &truth),
        alignment,
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

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use glam::DVec2;

    use super::*;

    #[test]
    fn in_our_units_a_picture_shows_the_same_wherever_the_clips_camera_stands() {
        let rotation = DMat3::from_rotation_y(0.7) * DMat3::from_rotation_x(-0.2);
        let camera = Camera {
            rotation: rotation.transpose().to_cols_array(),
            translation: [0.3, -0.1, 2.0],
            ..Camera::pinhole(64, 64, [80.0, 80.0, 32.0, 32.0])
        };
        let (centre, scale, pelvis) = (DVec3::new(0.4, 1.2, -0.8), 1.25, [0.1f32, 0.9, 1.5]);
        let novel = Novel {
            name: "pose".to_owned(),
            camera: camera.clone(),
            pose: NovelPose::Pose(Box::new([0.0; 72]), pelvis),
            image: PathBuf::new(),
            mask: PathBuf::new(),
        };
        let ours = in_our_units(&novel, centre, scale);
        let NovelPose::Pose(_, place) = ours.pose else { panic!("it stays a pose") };
        let pixel = |camera: &Camera, place: [f64; 3]| DVec2::from(camera.project(camera.view(place)));
        for offset in [DVec3::ZERO, DVec3::new(0.2, -0.5, 0.1)] {
            let theirs = (DVec3::from(pelvis.map(f64::from)) + offset).to_array();
            let scaled = (DVec3::from(place.map(f64::from)) + offset / scale).to_array();
            let off = pixel(&camera, theirs).distance(pixel(&ours.camera, scaled));
            assert!(off < 1e-4, "{off} px");
        }
    }
}
