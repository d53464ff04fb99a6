//! Detail: the last passes of the texture, at the resolution of the uploaded pictures.
//!
//! A fit looks at pictures that are scaled down: shape and poses gain little by more pixels and cost as many times more. A
//! face, a print or a seam shows what it is in the uploaded ones. So in the end the texture alone goes on with these, in some of
//! the frames. Half of them are close-ups of the head, since a whole picture gives a face few of the pixels that a step looks at;
//! a whole picture then teaches the rest. Each picture is first bent to lie where the texture shows what it shows; the clearer the
//! texture, the better it tells that, so there are [`ROUNDS`].
//!
//! Small pictures are enlarged first. Between the places that pixels of few frames hit a texture shows whatever it likes, as specks and
//! lines on a face; an enlarged picture says there what lies between its pixels.

mod pictures;
mod placing;
mod plan;
mod registration;
#[cfg(test)]
mod testing;
mod warp;

pub use self::pictures::square_around;
use self::pictures::{cut, enlarge, shrink, take_out};
pub use self::plan::{DetailPlan, ROUNDS, rounds};
use super::config::FitConfig;
use super::state::{FitState, Stage};
use crate::body::joints::HEAD;
use crate::body::{Body, N_POSE};
use crate::camera::Camera;
use crate::capture::{Capture, Frame};
use crate::ops::skinning::cpu::forward as pose_body;

/// Room around the head, over its size.
const MARGIN: f32 = 1.1;

/// Entries of a level of the texture, as a power of two: the more, the fewer places share one.
const LOG2_HASHMAP_SIZE: u32 = 17;

/// Colours run over a mask's border by compression, pixels.
const BLEEDING_PX: u32 = 2;

/// What a close-up and the rest of its picture have both, so that no place between them is told by none, pixels.
const SEAM_PX: u32 = 4;

/// The texture's way on: a fit of its own, in which all else stands.
pub struct Detail {
    /// Each frame's close-up of the head, where it shows one, and then the whole picture, whose mask lacks what the close-up shows.
    capture: Capture,
    pub camera: Camera,
    /// Of the last round.
    pub config: FitConfig,
    /// `[capture's frames]`: of the fit's.
    frames: Vec<usize>,
}

impl Detail {
    /// `fitted` is where a fit of `capture` with `config`, seen by `camera`, has ended; `large` has the frames of `plan`. A frame
    /// that is missing there is left out.
    pub fn new(
        body: &Body,
        capture: &Capture,
        camera: &Camera,
        config: &FitConfig,
        fitted: &FitState,
        plan: &DetailPlan,
        large: Capture,
    ) -> Self {
        // Whatever focal length came with the clip: the fit's own may have taken its place.
        let size = [large.camera.width, large.camera.height].map(|side| side * plan.enlarged);
        let camera = camera.scaled(size[0], size[1]);
        let mut frames = Vec::new();
        let mut pictures = Vec::new();
        for picture in &large.frames {
            let Some(&k) = plan.kept.iter().find(|&&k| capture.frames[k].index == picture.index) else { continue };
            let mut picture = enlarge(picture, plan.enlarged);
            shrink(&mut picture, BLEEDING_PX);
            if let Some(head) = head(body, fitted, k, &camera).and_then(|square| cut(&picture, square)) {
                take_out(&mut picture, &head, SEAM_PX);
                frames.push(k);
                pictures.push(head);
            }
            frames.push(k);
            pictures.push(picture);
        }
        let config = refined(config, body, fitted, &camera);
        Self {
            capture: Capture { frames: pictures, camera: camera.clone(), poses: None, ..large },
            camera,
            config,
            frames,
        }
    }

    /// The whole pictures, each with its frame of the fit.
    pub fn whole(&self) -> impl Iterator<Item = (usize, &Frame)> {
        let pictures = self.frames.iter().copied().zip(&self.capture.frames);
        // A frame's last one.
        let next = self.frames.iter().skip(1).map(Some).chain([None]);
        pictures.zip(next).filter(|((k, _), next)| *next != Some(k)).map(|(picture, _)| picture)
    }

    /// The close-ups among the pictures: each comes before its whole one.
    fn close_ups(&self) -> impl Iterator<Item = usize> {
        self.frames.windows(2).enumerate().filter(|(_, of)| of[0] == of[1]).map(|(at, _)| at)
    }

    /// What the detail starts from; `before` are the sizes of the texture of `fitted`.
    pub fn start(&self, fitted: &FitState, before: &FitConfig) -> FitState {
        let of = |values: &[f32], stride: usize| -> Vec<f32> {
            self.frames.iter().flat_map(|&k| values[k * stride..][..stride].iter().copied()).collect()
        };
        FitState {
            stage: Stage::Texture,
            step: 0,
            poses: of(&fitted.poses, N_POSE),
            stage_poses: of(&fitted.stage_poses, N_POSE),
            stage_transl: of(&fitted.stage_transl, 3),
            transl: of(&fitted.transl, 3),
            run_transl: Vec::new(),
            progress: None,
            field: fitted.field.refined(&before.field, &self.config.field, self.config.seed),
            ..fitted.clone()
        }
    }

    /// `fitted` with the look of `detailed`.
    pub fn end(fitted: FitState, detailed: FitState) -> FitState {
        let FitState { poses, stage_poses, transl, stage_transl, .. } = fitted;
        FitState { poses, stage_poses, transl, stage_transl, ..detailed }
    }
}

/// As the last round goes on with pictures that `camera` took, from where a fit with `config` has ended.
pub fn refined(config: &FitConfig, body: &Body, fitted: &FitState, camera: &Camera) -> FitConfig {
    let config = config.clone().detailed(ROUNDS[ROUNDS.len() - 1]);
    FitConfig { field: config.field.refined(cell(body, fitted, camera), LOG2_HASHMAP_SIZE), ..config }
}

/// A pixel at the person, in the units of the texture's coordinates.
fn cell(body: &Body, fitted: &FitState, camera: &Camera) -> f64 {
    let distances = fitted.transl.as_chunks::<3>().0.iter().map(|t| camera.view(t.map(f64::from))[2]);
    let nearest = distances.fold(f64::INFINITY, f64::min);
    nearest.max(0.1) / camera.fx / super::state::cube_side(body)
}

/// The square round the head in frame `k`: left, top, side, pixels of the whole picture.
fn head(body: &Body, fitted: &FitState, k: usize, camera: &Camera) -> Option<[f32; 3]> {
    let (pose, offsets) = (&fitted.poses[k * N_POSE..][..N_POSE], fitted.offsets.as_chunks().0);
    let posed = pose_body(body, &fitted.betas, Some(offsets), pose, fitted.transl.as_chunks().0[k]);
    square_around(camera, &posed.vertices, |v| body.weight_of(v, |j| j as usize == HEAD) > 0.5, MARGIN)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ops::texture_field::TextureFieldConfig;

    #[test]
    fn the_texture_goes_on_with_the_heads_of_the_frames_and_all_else_stands() {
        let body = Body::test_body();
        let capture = testing::capture(3, 120, 240, 90);
        let config =
            FitConfig { field: TextureFieldConfig { n_levels: 3, ..Default::default() }, ..FitConfig::draft(1) };
        let poses: Vec<[f32; N_POSE]> =
            (0..3).map(|k| std::array::from_fn(|i| if i == 1 { 0.1 * k as f32 } else { 0.0 })).collect();
        // The camera's y points down: upside down, and in the middle of the picture.
        let transl = [[0.0, 0.0, 2.0]; 3];
        let mut fitted = FitState::new(&body, vec![0.0; body.n_betas], &poses, &transl, config.field, 1);
        fitted.run_transl = fitted.transl.clone();
        let plan = DetailPlan::to(&capture).unwrap();
        let mut large = testing::capture(3, 240, 240, 200);
        large.frames.remove(1);
        large.frames.iter_mut().for_each(|frame| *frame = testing::picture(frame.index, [0, 0, 240, 240]));
        // The clip came with another focal length than the one that was found.
        large.camera = Camera { fx: 0.7 * large.camera.fx, fy: 0.7 * large.camera.fy, ..large.camera };
        let found = Camera { cx: 61.0, translation: [0.1, 0.0, 0.0], ..capture.camera.clone() };
        let detail = Detail::new(&body, &capture, &found, &config, &fitted, &plan, large);
        assert_eq!(detail.camera, found.scaled(480, 480));
        assert_eq!(detail.frames, [0, 0, 2, 2], "the second frame could not be read again");
        let whole: Vec<(usize, u32)> = detail.whole().map(|(k, frame)| (k, frame.width)).collect();
        assert_eq!(whole, [(0, 480), (2, 480)], "enlarged");
        let sizes: Vec<u32> = detail.capture.frames.iter().map(|frame| frame.width).collect();
        assert!(sizes[0] < 240 && sizes[1] == 480, "a head before each whole picture: {sizes:?}");
        let [head, whole] = [0, 1].map(|k| &detail.capture.frames[k]);
        let (x, y) = (head.x0 + head.width / 2, head.y0 + head.height / 2);
        let [close, far] = [head, whole].map(|f| f.mask[((y - f.y0) * f.width + x - f.x0) as usize]);
        assert_eq!((close, far), (255, 0), "the close-up alone tells the head");
        assert!(detail.config.field.n_levels > 3 && detail.config.field.log2_hashmap_size == LOG2_HASHMAP_SIZE);
        let start = detail.start(&fitted, &config);
        assert_eq!((start.n_frames(), start.stage), (4, Stage::Texture));
        assert!(start.run_transl.is_empty(), "a run of its own");
        assert_eq!((start.poses[1], start.poses[2 * N_POSE + 1]), (0.0, 0.2));
        start.field.validate(&detail.config.field).unwrap();
        let end =
            Detail::end(fitted.clone(), FitState { face_colours: vec![0.25; fitted.face_colours.len()], ..start });
        assert_eq!((end.poses, end.transl), (fitted.poses, fitted.transl));
        assert_eq!(end.face_colours[0], 0.25);
    }
}
