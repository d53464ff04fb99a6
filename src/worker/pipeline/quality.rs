//! The report's chapter on the clip.

use super::export::Fitted;
use super::score::FrameScore;
use crate::avatar::AvatarModel;
use crate::fit::stage0::ADULT_STATURE;
use crate::quality::{self, FitFindings, Flag, FrameMeasures, SurfaceCheck};

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
        let swapped: Vec<u32> = fitted.start.report.swapped.iter().map(|&t| model.frames[t]).collect();
        let iou: Vec<f64> = scores.iter().map(|s| s.iou).collect();
        let found = FitFindings {
            frames: &model.frames,
            iou: &iou,
            poses: &model.poses,
            swapped: &swapped,
            camera: &model.camera,
            camera_estimated: fitted.capture.camera_estimated,
            focal_ratio: fitted.focal_ratio,
            guessed_height_m: fitted.start.report.guessed_height_m,
            usual_height_m: ADULT_STATURE,
            hem: fitted.skirt.map(|skirt| f64::from(skirt.hem)),
        };
        let undressed = model.body.shaped_vertices(&model.betas);
        let surface = quality::check_surface(&model.rest_vertices(), &undressed, &model.body.faces, seen);
        let mut flags = quality::clip_flags(&fitted.measures);
        flags.extend(quality::fit_flags(&found));
        flags.extend(quality::surface_flags(&surface));
        flags.sort_by_key(|flag| quality::KINDS.iter().position(|kind| kind.code() == flag.code));
        Self { flags, frames: &fitted.measures, surface }
    }
}
