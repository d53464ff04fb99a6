//! Exposure and white balance that a camera changes while it films, as phones do unless they are told not to: found after stage 0, from
//! the colours of the posed body, and taken out of the pictures before anything is learned from them.

mod cut_off;

use std::sync::Arc;

use self::cut_off::CutOff;
use super::appearance::solve_gains;
use super::frames::{self, DeviceFrame};
use super::poses::PoseGroups;
use super::scene::Scene;
use super::shape::Shape;
use super::state::FitState;
use super::{FitError, Inputs};
use crate::capture::Capture;
use crate::gpu::Gpu;

/// Halved once: faces are seen as well, and it takes a quarter of the time.
const LEVEL: usize = 1;

/// What the camera has changed.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameGains {
    /// The video's numbers of the frames.
    frames: Vec<u32>,
    /// `[N]`: by what factor each channel of a frame is brighter than in the mean
    gains: Vec<[f32; 3]>,
    /// For how bright what was cut off is taken.
    cut_off: CutOff,
}

impl FrameGains {
    /// `None` where the clip tells of no change. Of `start` shape, poses and places. Waits.
    ///
    /// # Errors
    /// [`FitError::Device`].
    pub fn find(gpu: &Arc<Gpu>, inputs: &Inputs<'_>, start: &FitState) -> Result<Option<Self>, FitError> {
        let white = inputs.config.white();
        let frames = frames::upload(gpu, inputs.capture, inputs.camera, LEVEL + 1, white);
        let halved = |mut frame: DeviceFrame| DeviceFrame { levels: vec![frame.levels.swap_remove(LEVEL)] };
        let scene = Scene::new(gpu, inputs, frames.into_iter().map(halved).collect(), &start.transl);
        Shape::stand(&scene, start)?;
        let poses = PoseGroups::new(gpu, inputs.config, start);
        let gains = solve_gains(&scene, &inputs.body.faces, &poses, 0)?;
        Ok(gains.map(|gains| Self::new(inputs.capture, gains, white)))
    }

    /// Of the clip's frames; channels from `white` on are cut off.
    fn new(capture: &Capture, gains: Vec<[f32; 3]>, white: u8) -> Self {
        let frames = capture.frames.iter().map(|frame| frame.index).collect();
        Self { frames, cut_off: CutOff::of(&capture.frames, &gains, white), gains }
    }

    /// `[N]`, in the order of the clip's frames.
    pub fn gains(&self) -> &[[f32; 3]] {
        &self.gains
    }

    /// The brightest frame over the darkest one, in the channel in which they differ most.
    pub fn spread(&self) -> f64 {
        let of = |k: usize| {
            let channel = self.gains.iter().map(|gain| f64::from(gain[k]));
            channel.clone().fold(0.0, f64::max) / channel.fold(f64::INFINITY, f64::min)
        };
        if self.gains.is_empty() { 1.0 } else { of(0).max(of(1)).max(of(2)) }
    }

    /// Makes the pictures what a camera would have taken that stays as this one was in the mean. A frame that is not of the clip stays.
    pub fn even_out(&self, capture: &mut Capture) {
        for frame in &mut capture.frames {
            let Some(k) = self.frames.iter().position(|&of| of == frame.index) else { continue };
            let evened: [[u8; 256]; 3] =
                std::array::from_fn(|channel| self.cut_off.evened(channel, self.gains[k][channel]));
            for (i, value) in frame.rgb.iter_mut().enumerate() {
                *value = evened[i % 3][usize::from(*value)];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f32::consts::{PI, TAU};

    use super::*;
    use crate::body::{Body, N_POSE};
    use crate::camera::Camera;
    use crate::capture::Frame;
    use crate::fit::FitConfig;
    use crate::ops::hard_rasterize::{HardRasterizeConfig, cpu};
    use crate::ops::light::{Exposure, Light};
    use crate::ops::skinning::cpu::forward as pose_body;
    use crate::ops::testing::gpu;

    const SIDE: u32 = 160;
    const PLACE: [f32; 3] = [0.0, 0.0, 3.0];

    /// A turn in `n` frames, upright before a camera whose y runs down.
    fn turn(n: usize) -> Vec<[f32; N_POSE]> {
        let pose = |k: usize| {
            let turn = glam::Quat::from_rotation_x(PI) * glam::Quat::from_rotation_y(TAU * k as f32 / n as f32);
            let mut pose = [0.0; N_POSE];
            pose[..3].copy_from_slice(&turn.to_scaled_axis().to_array());
            pose
        };
        (0..n).map(pose).collect()
    }

    /// The body under a lamp from the side, as a camera sees it that stays as it is.
    fn filmed(body: &Body, camera: &Camera, poses: &[[f32; N_POSE]]) -> Capture {
        let light = Light {
            ambient: [0.6; 3],
            strength: [0.6; 3],
            direction: glam::Vec3::new(0.6, -0.5, -0.6).normalize().to_array(),
            ..Light::EVEN
        };
        let picture = |(k, pose): (usize, &[f32; N_POSE])| {
            let vertices = pose_body(body, &[], None, pose, PLACE).vertices;
            let view: Vec<f32> = vertices.iter().flatten().copied().collect();
            let seen = cpu::forward(&HardRasterizeConfig::default(), camera, &view, &body.faces).pix_to_face;
            let colour = |face: &i32| {
                let Ok(f) = usize::try_from(*face) else { return [0; 3] };
                let [a, b, c] = body.faces[f].map(|v| glam::Vec3::from(vertices[v as usize]));
                let shade = light.shade((b - a).cross(c - a).normalize().to_array(), Exposure::FULL);
                std::array::from_fn(|k| (255.0 * (0.25 + 0.06 * ((f + 2 * k) % 7) as f32) * shade[k]) as u8)
            };
            Frame {
                index: 2 * k as u32,
                x0: 0,
                y0: 0,
                width: SIDE,
                height: SIDE,
                rgb: seen.iter().flat_map(colour).collect(),
                mask: seen.iter().map(|&face| if face < 0 { 0 } else { 255 }).collect(),
                keypoints: Vec::new(),
            }
        };
        Capture {
            camera: camera.clone(),
            uploaded_side_px: SIDE,
            camera_estimated: false,
            fps: 30.0,
            frames: poses.iter().enumerate().map(picture).collect(),
            keypoint_format: "coco17".into(),
            given_keypoint_format: "coco17".into(),
            poses: None,
            warnings: Vec::new(),
        }
    }

    #[test]
    fn pictures_of_a_camera_that_follows_the_scene_are_evened_out() {
        let Some(gpu) = gpu("pictures_of_a_camera_that_follows_the_scene_are_evened_out") else { return };
        let (body, config, side) = (Body::test_body(), FitConfig::draft(1), f64::from(SIDE));
        let camera = Camera::pinhole(SIDE, SIDE, [1.3 * side, 1.3 * side, 0.5 * side, 0.5 * side]);
        let poses = turn(16);
        let still = filmed(&body, &camera, &poses);
        let start = FitState::new(&body, vec![0.0; body.n_betas], &poses, &[PLACE; 16], config.field, 1);
        let find = |capture: &Capture| {
            FrameGains::find(&gpu, &Inputs { body: &body, capture, camera: &camera, config: &config }, &start).unwrap()
        };
        assert_eq!(find(&still), None);
        let gain = |k: usize| [1.05, 1.0, 0.95].map(|of: f32| of.powi(k as i32 % 3) * (1.0 + 0.2 * (k as f32).sin()));
        let mut drifting = still.clone();
        for (k, frame) in drifting.frames.iter_mut().enumerate() {
            let by = |(i, value): (usize, &mut u8)| *value = (gain(k)[i % 3] * f32::from(*value)).round() as u8;
            frame.rgb.iter_mut().enumerate().for_each(by);
        }
        let found = find(&drifting).unwrap();
        let mean = |c: usize| ((0..16).map(|k| gain(k)[c].ln()).sum::<f32>() / 16.0).exp();
        for (k, gains) in found.gains().iter().enumerate() {
            for c in 0..3 {
                let want = gain(k)[c] / mean(c);
                assert!((gains[c] / want - 1.0).abs() < 0.04, "frame {k}: {gains:?}, channel {c} was {want}");
            }
        }
        assert!((1.4..1.7).contains(&found.spread()), "{}", found.spread());
        found.even_out(&mut drifting);
        for (frame, truth) in drifting.frames.iter().zip(&still.frames) {
            let off = |c: usize| {
                let pairs = frame.rgb.iter().zip(&truth.rgb).skip(c).step_by(3);
                let both: (f64, f64) = pairs.fold((0.0, 0.0), |(a, b), (x, y)| (a + f64::from(*x), b + f64::from(*y)));
                both.0 / both.1 * f64::from(mean(c)).recip()
            };
            assert!(
                (0..3).all(|c| (off(c) - 1.0).abs() < 0.04),
                "frame {}: {:?}",
                frame.index,
                [off(0), off(1), off(2)]
            );
        }
        // A frame that the clip does not have stays.
        let mut other = Capture { frames: vec![still.frames[3].clone()], ..still };
        other.frames[0].index = 7;
        let before = other.frames[0].rgb.clone();
        found.even_out(&mut other);
        assert_eq!(other.frames[0].rgb, before);
    }
}
