//! Puts each close-up where the texture shows it: a head that is a few pixels off in each frame, now here and now there, would be
//! learned as a face without eyes. A face whose surface lies at another depth is off by another way in each of its places: what is left
//! of it after the whole has been moved, the picture is bent by (see [`super::warp`]).
//!
//! The texture's gradients do not tell that way. A hash grid's slopes are those of its finest cells, and a step along them goes
//! anywhere; so the texture is drawn, and its picture is moved over the frame's.

use std::sync::Arc;

use super::Detail;
use super::registration::{Picture, shift};
use super::warp::{Warp, bend};
use crate::body::Body;
use crate::fit::appearance::{Appearance as _, Texture, cosines, well_inside};
use crate::fit::config::FitConfig;
use crate::fit::poses::PoseGroups;
use crate::fit::scene::Scene;
use crate::fit::shape::Shape;
use crate::fit::state::FitState;
use crate::fit::{FitError, Inputs, frames};
use crate::gpu::Gpu;

impl Detail {
    /// Moves the close-ups of `start` to where its texture shows them, each across the camera's view, and bends their pictures. Waits.
    ///
    /// # Errors
    /// [`FitError::Device`].
    pub fn place(&mut self, gpu: &Arc<Gpu>, body: &Body, start: &mut FitState) -> Result<(), FitError> {
        let (scene, texture, poses) = self.seen(gpu, body, start)?;
        for k in self.close_ups().collect::<Vec<_>>() {
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
            let filmed = Picture::new(size, colours, inside);
            let shift = shift(&drawn, &filmed).unwrap_or_default();
            let picture = &mut self.capture.frames[k];
            // The device's picture has some room around it.
            let room = [level.camera.cx - self.camera.cx, level.camera.cy - self.camera.cy];
            let corner = [room[0] + f64::from(picture.x0), room[1] + f64::from(picture.y0)];
            bend(picture, &Warp::between(&drawn, &filmed, shift), corner);
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
