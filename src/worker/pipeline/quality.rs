//! The report's chapter on the clip.

use super::export::Fitted;
use super::score::FrameScore;
use crate::avatar::{AvatarModel, view_space};
use crate::fit::gains::FrameGains;
use crate::fit::stage0::{ADULT_STATURE, COARSE_POSES, FOCAL_OFF, FocalCheck, GivenPoses};
use crate::quality::{self, ContradictedFocal, ContradictedPoses, FitFindings, Flag, FrameMeasures, SurfaceCheck};

/// What was wrong with the clip and with what came of it.
#[derive(serde::Serialize)]
pub(super) struct Quality<'a> {
    pub flags: Vec<Flag>,
    pub frames: &'a [FrameMeasures],
    pub surface: SurfaceCheck,
}

impl<'a> Quality<'a> {
    /// `seen [F]`: the faces that a frame shows.
    pub fn of(fitted: &'a Fitted, model: &AvatarModel, scores: &[FrameScore], seen: &[bool]) -> Self {
        let undressed = model.body.shaped_vertices(&model.betas);
        let swapped: Vec<u32> = fitted.swapped_frames();
        let iou: Vec<f64> = scores.iter().map(|s| s.iou).collect();
        let distances = distances_in_heights(model, &undressed);
        let residuals = keypoint_residuals(&fitted.start.report.residual_px, &fitted.measures);
        let found = FitFindings {
            frames: &model.frames,
            iou: &iou,
            poses: &model.poses,
            swapped: &swapped,
            camera: &model.camera,
            camera_estimated: fitted.capture.camera_estimated,
            distances: &distances,
            contradicted_focal: fitted.focal.filter(FocalCheck::contradicts).map(contradicted),
            contradicted_poses: fitted.start.report.given_poses.and_then(contradicted_poses),
            keypoint_residuals: &residuals,
            guessed_height_m: fitted.start.report.guessed_height_m,
            usual_height_m: ADULT_STATURE,
            exposure_spread: fitted.gains.as_ref().map(FrameGains::spread),
            hem: fitted.skirt.map(|skirt| f64::from(skirt.hem)),
        };
        let surface = quality::check_surface(&model.rest_vertices(), &undressed, &model.body.faces, seen);
        let mut flags = quality::clip_flags(&fitted.measures);
        flags.extend(quality::fit_flags(&found));
        flags.extend(quality::surface_flags(&surface));
        flags.sort_by_key(|flag| quality::KINDS.iter().position(|kind| kind.code() == flag.code));
        Self { flags, frames: &fitted.measures, surface }
    }
}

fn contradicted(check: FocalCheck) -> ContradictedFocal {
    ContradictedFocal { given_px: check.given_px, ratio: check.ratio, limit: FOCAL_OFF }
}

fn contradicted_poses(given: GivenPoses) -> Option<ContradictedPoses> {
    let [off_degrees, limit_degrees] = [given.off.joints, COARSE_POSES].map(f64::to_degrees);
    let replaced = given.replaced;
    (off_degrees > limit_degrees).then_some(ContradictedPoses { off_degrees, limit_degrees, replaced })
}

/// `residual_px [N]` over the masks' heights, of the frames that have both.
fn keypoint_residuals(residual_px: &[f32], measures: &[FrameMeasures]) -> Vec<f64> {
    let of_frame = |(px, frame): (&f32, &FrameMeasures)| f64::from(*px) / frame.height_px as f64;
    residual_px.iter().zip(measures).map(of_frame).filter(|residual| residual.is_finite()).collect()
}

/// `[N]` from the camera to the pelvis, over the height of the `undressed` body, `[V, 3]`.
fn distances_in_heights(model: &AvatarModel, undressed: &[[f32; 3]]) -> Vec<f64> {
    let heights = || undressed.iter().map(|v| f64::from(v[1]));
    let height = heights().fold(f64::NEG_INFINITY, f64::max) - heights().fold(f64::INFINITY, f64::min);
    let pelvis = model.body.shaped_joints(&model.betas)[0];
    let places: Vec<[f32; 3]> = model.transl.iter().map(|t| std::array::from_fn(|k| pelvis[k] + t[k])).collect();
    let length = |p: &[f32; 3]| f64::from(glam::Vec3::from(*p).length());
    view_space(&places, &model.camera).iter().map(|p| length(p) / height).collect()
}
