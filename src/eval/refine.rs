//! Poses of held-out pictures, refined against the frozen avatar.

use std::sync::Arc;

use image::{GrayImage, RgbImage};

use super::run::EvalError;
use super::subject::Novel;
use crate::avatar::{AvatarModel, Place, RenderSpec, Renderer};
use crate::capture::Frame;
use crate::fit::{FitConfig, FitState, Stage, refine_pose};
use crate::mask::{self, is_foreground};

/// Room around the mask in which the body may stand before it is refined, over the mask's longer side.
const MARGIN: f64 = 0.12;

/// `spec` with the pose and the place that explain the picture best; both start from `spec`'s. Waits.
pub(super) fn refined(renderer: &Renderer, novel: &Novel, spec: RenderSpec) -> Result<RenderSpec, EvalError> {
    let model = renderer.model();
    let (picture, mask) = novel.open()?;
    let Some(frame) = frame(&picture, &mask) else { return Ok(spec) };
    let transl = spec.place.transl(&model.body, &model.betas);
    let config = FitConfig { field: model.texture_config, ..FitConfig::standard(0) };
    let state = state_of(model, &spec, transl);
    let state = refine_pose(renderer.gpu(), &model.body, &novel.camera, frame, state, &config)?;
    let (poses, places) = (state.poses.as_chunks().0, state.transl.as_chunks().0);
    Ok(RenderSpec { pose: poses[0], place: Place::Transl(places[0]), ..spec })
}

fn state_of(model: &Arc<AvatarModel>, spec: &RenderSpec, transl: [f32; 3]) -> FitState {
    FitState {
        stage: Stage::Texture,
        step: 0,
        betas: model.betas.clone(),
        offsets: model.offsets.as_flattened().to_vec(),
        poses: spec.pose.to_vec(),
        stage_poses: spec.pose.to_vec(),
        transl: transl.to_vec(),
        stage_transl: transl.to_vec(),
        run_transl: Vec::new(),
        face_colours: model.face_colours.as_flattened().to_vec(),
        light: model.light,
        texcoords: model.texcoords.as_flattened().to_vec(),
        field: model.texture.clone(),
        texels: None,
        progress: None,
    }
}

/// The picture round its mask; `None` where that is empty.
fn frame(picture: &RgbImage, mask: &GrayImage) -> Option<Frame> {
    let inside = mask.enumerate_pixels().filter(|(_, _, m)| is_foreground(m.0[0]));
    let (mut low, mut high) = ([u32::MAX; 2], [0; 2]);
    for (x, y, _) in inside {
        (low, high) = ([low[0].min(x), low[1].min(y)], [high[0].max(x + 1), high[1].max(y + 1)]);
    }
    if high[0] == 0 {
        return None;
    }
    let margin = (MARGIN * f64::from((high[0] - low[0]).max(high[1] - low[1]))).ceil() as u32;
    let [x0, y0] = low.map(|v| v.saturating_sub(margin));
    let (x1, y1) = ((high[0] + margin).min(picture.width()), (high[1] + margin).min(picture.height()));
    let (width, height) = (x1 - x0, y1 - y0);
    let cut = image::imageops::crop_imm(mask, x0, y0, width, height).to_image();
    Some(Frame {
        index: 0,
        x0,
        y0,
        width,
        height,
        rgb: image::imageops::crop_imm(picture, x0, y0, width, height).to_image().into_raw(),
        mask: cut.into_raw().into_iter().map(mask::binary).collect(),
        keypoints: Vec::new(),
    })
}
