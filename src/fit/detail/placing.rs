//! Puts each close-up where the texture shows it: a head that is a few pixels off in each frame, now here and now there, would be
//! learned as a face without eyes.
//!
//! The texture's gradients do not tell that way. A hash grid's slopes are those of its finest cells, and a step along them goes
//! anywhere; so the texture is drawn, and its picture is moved over the frame's.

use std::sync::Arc;

use super::Detail;
use crate::body::Body;
use crate::fit::appearance::{Appearance as _, Texture, cosines, well_inside};
use crate::fit::config::FitConfig;
use crate::fit::poses::PoseGroups;
use crate::fit::scene::Scene;
use crate::fit::shape::Shape;
use crate::fit::state::FitState;
use crate::fit::{FitError, Inputs, frames};
use crate::gpu::Gpu;

/// How far a picture may be off, over its longer side.
const REACH: f64 = 0.06;
/// What of the error must go for a picture to be moved.
const GAIN: f64 = 0.02;
/// Of the pixels that are compared where the picture lies, so many must be there wherever it is moved to.
const KEPT: f64 = 0.7;

/// Where the search begins, all places within reach are tried: the longer side of a picture at most, pixels.
const COARSEST_PX: usize = 96;

/// Three channels a pixel, and what each pixel counts.
struct Picture {
    width: usize,
    height: usize,
    rgb: Vec<[f32; 3]>,
    weights: Vec<f32>,
}

impl Picture {
    /// Of `[width, height]`; what goes beyond is left out.
    fn new([width, height]: [usize; 2], mut rgb: Vec<[f32; 3]>, mut weights: Vec<f32>) -> Self {
        rgb.truncate(width * height);
        weights.truncate(width * height);
        Self { width, height, rgb, weights }
    }

    /// Half as large: the mean of four pixels, by what they count.
    fn halved(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let mut half = Self { width, height, rgb: Vec::new(), weights: Vec::new() };
        for y in 0..height {
            for x in 0..width {
                let four = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| (2 * y + dy) * self.width + 2 * x + dx);
                let weight: f32 = four.iter().map(|&i| self.weights[i]).sum();
                let sum = |k: usize| four.iter().map(|&i| self.weights[i] * self.rgb[i][k]).sum::<f32>();
                half.rgb.push([0, 1, 2].map(|k| if weight > 0.0 { sum(k) / weight } else { 0.0 }));
                half.weights.push(weight / 4.0);
            }
        }
        half
    }

    /// The mean squared difference from `other` moved by `[x, y]`, but for a channel's mean difference; `None` where too little of what
    /// is compared is in it.
    fn differs(&self, other: &Self, [dx, dy]: [i64; 2]) -> Option<f64> {
        let (mut all, mut sum, mut sums, mut squares) = (0.0, 0.0, [0.0; 3], [0.0; 3]);
        for y in 0..self.height {
            for x in 0..self.width {
                let i = y * self.width + x;
                let weight = f64::from(self.weights[i]);
                if weight == 0.0 {
                    continue;
                }
                all += weight;
                let (ox, oy) = (x as i64 + dx, y as i64 + dy);
                if ox < 0 || oy < 0 || ox >= other.width as i64 || oy >= other.height as i64 {
                    continue;
                }
                let j = oy as usize * other.width + ox as usize;
                let weight = weight * f64::from(other.weights[j]);
                sum += weight;
                for k in 0..3 {
                    let difference = f64::from(self.rgb[i][k] - other.rgb[j][k]);
                    sums[k] += weight * difference;
                    squares[k] += weight * difference * difference;
                }
            }
        }
        let variance = (0..3).map(|k| (squares[k] - sums[k] * sums[k] / sum) / sum).sum::<f64>();
        (sum > KEPT * all).then_some(variance)
    }
}

/// By how many pixels `drawn` must be moved to lie on `filmed`; `None` where that gains little, or leads out of reach.
fn shift(drawn: &Picture, filmed: &Picture) -> Option<[f64; 2]> {
    let longer = |picture: &Picture| picture.width.max(picture.height);
    let reach = |picture: &Picture| (REACH * longer(picture) as f64).ceil() as i64;
    let mut halves: Vec<[Picture; 2]> = Vec::new();
    loop {
        let [drawn, filmed] = halves.last().map_or([drawn, filmed], |[drawn, filmed]| [drawn, filmed]);
        if longer(drawn) <= COARSEST_PX {
            break;
        }
        halves.push([drawn.halved(), filmed.halved()]);
    }
    let levels = halves.iter().rev().map(|[drawn, filmed]| [drawn, filmed]).chain([[drawn, filmed]]);
    let mut at = [0; 2];
    for (nth, [drawn, filmed]) in levels.enumerate() {
        let around = if nth == 0 { reach(drawn) } else { 1 };
        at = at.map(|d| 2 * d);
        let tried = (-around..=around).flat_map(|dy| (-around..=around).map(move |dx| [at[0] + dx, at[1] + dy]));
        let differences = tried.filter_map(|to| Some((drawn.differs(filmed, to)?, to)));
        at = differences.min_by(|a, b| a.0.total_cmp(&b.0))?.1;
    }
    let (least, stands) = (drawn.differs(filmed, at)?, drawn.differs(filmed, [0; 2])?);
    if least > (1.0 - GAIN) * stands || at.iter().any(|d| d.abs() >= reach(drawn)) {
        return None;
    }
    // Between the pixels: the lowest point of a parabola through three.
    let between = |axis: usize| {
        let mut beside = [at; 2];
        beside[0][axis] -= 1;
        beside[1][axis] += 1;
        let [low, high] = [drawn.differs(filmed, beside[0]), drawn.differs(filmed, beside[1])];
        let (Some(low), Some(high)) = (low, high) else { return 0.0 };
        let bend = low + high - 2.0 * least;
        if bend > 0.0 { (0.5 * (low - high) / bend).clamp(-0.5, 0.5) } else { 0.0 }
    };
    Some([0, 1].map(|axis| at[axis] as f64 + between(axis)))
}

impl Detail {
    /// Moves the close-ups of `start` to where its texture shows them, each across the camera's view. Waits.
    ///
    /// # Errors
    /// [`FitError::Device`].
    pub fn place(&self, gpu: &Arc<Gpu>, body: &Body, start: &mut FitState) -> Result<(), FitError> {
        let (scene, texture, poses) = self.seen(gpu, body, start)?;
        for k in self.close_ups() {
            let drawn = texture.draw(&scene, &poses, k)?;
            let level = &scene.frames[k].levels[0];
            let cosines = cosines(&scene, &body.faces)?;
            let facing = gpu.read(&scene.hard.pix_to_face)?.into_iter().map(|face| cosines.get(face as usize));
            let size = [level.width as usize, level.height as usize];
            let drawn =
                Picture::new(size, drawn, facing.map(|cosine| cosine.map_or(0.0, |c| (c * c) as f32)).collect());
            let filmed: Vec<[u8; 4]> = gpu.read(&level.target)?.into_iter().map(u32::to_le_bytes).collect();
            let inside = well_inside(&filmed, size[0]).map(|inside| if inside { 1.0 } else { 0.0 }).collect();
            let colours = filmed.iter().map(|pixel| [0, 1, 2].map(|c| f32::from(pixel[c]) / 255.0)).collect();
            let Some(shift) = shift(&drawn, &Picture::new(size, colours, inside)) else { continue };
            let place = &mut start.transl[3 * k..][..3];
            let distance = self.camera.view([0, 1, 2].map(|c| f64::from(place[c])))[2];
            let across = [shift[0] * distance / level.camera.fx, shift[1] * distance / level.camera.fy];
            for (c, place) in place.iter_mut().enumerate() {
                // The rows of a camera's rotation are its axes.
                *place += (across[0] * self.camera.rotation[c] + across[1] * self.camera.rotation[3 + c]) as f32;
            }
        }
        Ok(())
    }

    /// The pictures with the person in them; close-ups can be drawn whole.
    fn seen(&self, gpu: &Arc<Gpu>, body: &Body, start: &FitState) -> Result<(Scene, Texture, PoseGroups), FitError> {
        let sizes = self.close_ups().map(|k| &self.capture.frames[k]).map(|frame| frame.width * frame.height);
        let most_pixels = Some(sizes.max().unwrap_or(1) as usize);
        let config = &FitConfig { most_pixels, ..self.config.clone() };
        let inputs = Inputs { body, capture: &self.capture, camera: &self.camera, config };
        let levels = frames::upload(gpu, &self.capture, &self.camera, 1, config.white());
        let scene = Scene::new(gpu, &inputs, levels, &start.transl);
        Shape::stand(&scene, start)?;
        let poses = PoseGroups::new(gpu, config, start);
        let mut texture = Texture::new(&scene, &inputs, start)?;
        texture.cast_shadows(&scene, &poses)?;
        Ok((scene, texture, poses))
    }
}

#[cfg(test)]
mod tests {
    use super::super::{DetailPlan, testing};
    use super::*;
    use crate::body::N_POSE;
    use crate::ops::testing::gpu;
    use crate::ops::texture_field::TextureFieldConfig;

    /// Blobs some ten pixels wide, in a light of their own.
    fn blobs([x, y]: [f64; 2], light: f32) -> Picture {
        let size = [120, 150];
        let at = |i: usize| [(i % size[0]) as f64 - x, (i / size[0]) as f64 - y];
        let colour =
            |[x, y]: [f64; 2]| [0.3 * x, 0.35 * y, 0.25 * (x + y)].map(|phase| light + 0.2 * phase.sin() as f32);
        Picture::new(size, (0..size[0] * size[1]).map(|i| colour(at(i))).collect(), vec![1.0; size[0] * size[1]])
    }

    #[test]
    fn a_picture_is_moved_by_fractions_of_a_pixel_and_no_further_than_it_may_be_off() {
        let here = blobs([0.0; 2], 0.5);
        let [x, y] = shift(&here, &blobs([4.6, -3.0], 0.4)).unwrap();
        assert!((x - 4.6).abs() < 0.3 && (y + 3.0).abs() < 0.3, "{x} {y}");
        let lies = shift(&here, &blobs([0.0; 2], 0.6)).unwrap_or_default();
        assert!(lies.iter().all(|d| d.abs() < 0.01), "{lies:?}");
        let mut grey = blobs([0.0; 2], 0.5);
        grey.rgb.fill([0.5; 3]);
        assert_eq!(shift(&grey, &here), None, "nothing tells where it lies");
        // A slope has its least difference ever further.
        let slope = |x: f32| {
            let mut slope = blobs([0.0; 2], 0.5);
            slope.rgb.iter_mut().enumerate().for_each(|(i, rgb)| *rgb = [1e-5 * ((i % 120) as f32 + x).powi(2); 3]);
            slope
        };
        assert_eq!(shift(&slope(0.0), &slope(40.0)), None);
    }

    #[test]
    fn a_close_up_goes_to_where_the_texture_shows_it() {
        let Some(gpu) = gpu("a_close_up_goes_to_where_the_texture_shows_it") else { return };
        let body = Body::test_body();
        let capture = testing::capture(2, 240, 480, 180);
        let field = TextureFieldConfig { n_levels: 1, ..Default::default() };
        let config = FitConfig { light: false, field, ..FitConfig::draft(1) };
        let mut fitted =
            FitState::new(&body, vec![0.0; body.n_betas], &[[0.0; N_POSE]; 2], &[[0.0, 0.0, 2.0]; 2], field, 1);
        // Strong colours.
        fitted.field.table.iter_mut().for_each(|value| *value *= 2e4);
        let plan = DetailPlan::to(&capture).unwrap();
        let mut large = testing::capture(2, 480, 480, 400);
        large.frames.iter_mut().for_each(|frame| *frame = testing::picture(frame.index, [0, 0, 480, 480]));
        // A camera that looks up along the world's x axis.
        let turned = [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        let camera = crate::camera::Camera { rotation: turned, ..capture.camera.clone() };
        let mut detail = Detail::new(&body, &capture, &camera, &config, &fitted, &plan, large);
        let truth = detail.start(&fitted, &config);
        assert_eq!(detail.close_ups().collect::<Vec<_>>(), [0, 2]);
        let (scene, texture, poses) = detail.seen(&gpu, &body, &truth).unwrap();
        for k in [0, 2] {
            let drawn = texture.draw(&scene, &poses, k).unwrap();
            let covered = gpu.read(&scene.hard.pix_to_face).unwrap();
            let picture = &mut detail.capture.frames[k];
            // The device's picture has some room around it.
            let level = &scene.frames[k].levels[0];
            let left = (level.camera.cx - detail.camera.cx).round() as i64 + i64::from(picture.x0);
            let above = (level.camera.cy - detail.camera.cy).round() as i64 + i64::from(picture.y0);
            let [left, above, width] = [left as usize, above as usize, picture.width as usize];
            let pixels = (0..picture.mask.len()).map(|i| (i / width + above) * level.width as usize + i % width + left);
            picture.rgb = pixels.clone().flat_map(|i| drawn[i].map(|c| (255.0 * c).round() as u8)).collect();
            picture.mask = pixels.map(|i| if covered[i] < 0 { 0 } else { 255 }).collect();
        }
        let mut start = truth.clone();
        start.transl[0] += 0.008;
        start.transl[3 * 2 + 1] -= 0.008;
        detail.place(&gpu, &body, &mut start).unwrap();
        for (placed, truth) in start.transl.iter().zip(&truth.transl) {
            assert!((placed - truth).abs() < 0.0005, "{:?}", start.transl);
        }
        assert_eq!(start.transl[3..6], truth.transl[3..6], "whole pictures stay");
    }
}
