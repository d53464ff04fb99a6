//! Puts each picture where the texture shows what it shows: a head that is a few pixels off in each frame, now here and now there, would
//! be learned as a face without eyes. A close-up is moved as a whole. What is left, and all of a whole picture's, lies in another direction in each
//! place, as the surface is not quite where it should be, or cloth has moved; by that a picture is bent (see [`super::warp`]).
//!
//! The texture's gradients do not tell that way. A hash grid's slopes are those of its finest cells, and a step along them goes
//! anywhere; so the texture is drawn, and its picture is moved over the frame's.

use std::sync::Arc;

use rayon::prelude::*;

use super::Detail;
use super::registration::{Picture, shift};
use super::warp::{Warp, bend};
use crate::body::Body;
use crate::camera::Camera;
use crate::capture::{Capture, Frame};
use crate::fit::appearance::{Appearance as _, Texture, cosines, well_inside};
use crate::fit::config::FitConfig;
use crate::fit::frames::{DeviceFrame, FrameLevel};
use crate::fit::poses::PoseGroups;
use crate::fit::scene::Scene;
use crate::fit::shape::Shape;
use crate::fit::state::FitState;
use crate::fit::{FitError, Inputs, frames};
use crate::gpu::Gpu;

/// Pictures with a longer side than that are compared at half their size, which tells where their places lie as well.
const MOST_PX: u32 = 800;

/// Pictures that are compared at once, each on a core.
const SIDE_BY_SIDE: usize = 16;

/// The pictures with the person in them.
struct Seen {
    /// Each picture in the size in which it is compared.
    scene: Scene,
    texture: Texture,
    poses: PoseGroups,
}

impl Detail {
    /// The pictures, bent to lie where the texture of `start` shows the same. Before that its close-ups are moved to where they are shown,
    /// each across the camera's view. Asks `go_on` between pictures. Waits.
    ///
    /// # Errors
    /// [`FitError::Device`], [`FitError::Stopped`].
    pub fn place(
        &self,
        gpu: &Arc<Gpu>,
        body: &Body,
        start: &mut FitState,
        go_on: &mut dyn FnMut() -> bool,
    ) -> Result<Capture, FitError> {
        let mut placed = self.capture.clone();
        let seen = self.seen(gpu, body, start)?;
        let close_ups: Vec<usize> = self.close_ups().collect();
        let all: Vec<usize> = (0..self.frames.len()).collect();
        for some in all.chunks(SIDE_BY_SIDE) {
            if !go_on() {
                return Err(FitError::Stopped);
            }
            let pictures = some.iter().map(|&k| Ok((k, self.metre(start, k), seen.pictures(body, k)?)));
            let pictures = pictures.collect::<Result<Vec<_>, FitError>>()?;
            let lie = pictures.par_iter().map(|(k, metre, [drawn, filmed])| {
                let shift = if close_ups.contains(k) { shift(drawn, filmed) } else { None }.unwrap_or_default();
                let metre = metre * seen.level(*k).camera.fx / self.camera.fx;
                (*k, shift.map(|px| px / metre), Warp::between(drawn, filmed, shift, metre))
            });
            for (k, across, warp) in lie.collect::<Vec<_>>() {
                self.bend(&mut placed.frames[k], &seen.level(k).camera, &warp);
                for (c, place) in start.transl[3 * k..][..3].iter_mut().enumerate() {
                    // The rows of a camera's rotation are its axes.
                    *place += (across[0] * self.camera.rotation[c] + across[1] * self.camera.rotation[3 + c]) as f32;
                }
            }
        }
        Ok(placed)
    }

    /// Pixels of a metre at the person in picture `k`.
    fn metre(&self, start: &FitState, k: usize) -> f64 {
        let place = [0, 1, 2].map(|c| f64::from(start.transl[3 * k + c]));
        self.camera.fx / self.camera.view(place)[2].max(0.1)
    }

    /// Bends a picture that was compared as `camera` sees it.
    fn bend(&self, picture: &mut Frame, camera: &Camera, warp: &Warp) {
        let scale = self.camera.fx / camera.fx;
        // The device's picture has some room around it.
        let room = [camera.cx - self.camera.cx / scale, camera.cy - self.camera.cy / scale];
        let corner = [room[0] + f64::from(picture.x0) / scale, room[1] + f64::from(picture.y0) / scale];
        bend(picture, warp, corner, scale);
    }

    /// Each of the pictures can be drawn.
    fn seen(&self, gpu: &Arc<Gpu>, body: &Body, start: &FitState) -> Result<Seen, FitError> {
        let config = &self.config;
        let inputs = Inputs { body, capture: &self.capture, camera: &self.camera, config };
        let pictures = frames::upload(gpu, &self.capture, &self.camera, 2, config.white());
        let compared = |mut frame: DeviceFrame| {
            let large = frame.levels[0].width.max(frame.levels[0].height) > MOST_PX;
            DeviceFrame { levels: vec![frame.levels.swap_remove(usize::from(large))] }
        };
        let scene = Scene::new(gpu, &inputs, pictures.into_iter().map(compared).collect(), &start.transl);
        Shape::stand(&scene, start)?;
        let poses = PoseGroups::new(gpu, config, start);
        let mut most_pixels = 1;
        for k in 0..scene.frames.len() {
            most_pixels = most_pixels.max(covered(&scene, &poses, k)?);
        }
        let config = &FitConfig { most_pixels: Some(most_pixels), ..config.clone() };
        let mut texture = Texture::new(&scene, &Inputs { config, ..inputs }, start)?;
        texture.cast_shadows(&scene, &poses)?;
        Ok(Seen { scene, texture, poses })
    }
}

impl Seen {
    fn level(&self, k: usize) -> &FrameLevel {
        &self.scene.frames[k].levels[0]
    }

    /// Picture `k` as the texture shows it, and as it was filmed. Waits.
    fn pictures(&self, body: &Body, k: usize) -> Result<[Picture; 2], FitError> {
        let Self { scene, texture, poses } = self;
        let drawn = texture.draw(scene, poses, k)?;
        let cosines = cosines(scene, &body.faces)?;
        let facing = scene.gpu.read(&scene.hard.pix_to_face)?.into_iter().map(|face| cosines.get(face as usize));
        let facing = facing.map(|cosine| cosine.map_or(0.0, |c| (c * c) as f32)).collect();
        let level = self.level(k);
        let size = [level.width as usize, level.height as usize];
        let filmed: Vec<[u8; 4]> = scene.gpu.read(&level.target)?.into_iter().map(u32::to_le_bytes).collect();
        let inside = well_inside(&filmed, size[0]).map(|inside| if inside { 1.0 } else { 0.0 }).collect();
        let colours = filmed.iter().map(|pixel| [0, 1, 2].map(|c| f32::from(pixel[c]) / 255.0)).collect();
        Ok([Picture::new(size, drawn, facing), Picture::new(size, colours, inside)])
    }
}

/// Pixels of picture `k` that show the body. Waits.
fn covered(scene: &Scene, poses: &PoseGroups, k: usize) -> Result<usize, FitError> {
    let level = &scene.frames[k].levels[0];
    let mut recorder = scene.gpu.recorder("fit/covered_pixels");
    scene.forward(&mut recorder, level, poses.at(k));
    recorder.submit()?;
    let faces = scene.gpu.read(&scene.hard.pix_to_face)?.into_iter().take(level.camera.n_pixels());
    Ok(faces.filter(|&face| face >= 0).count())
}

#[cfg(test)]
mod tests {
    use super::super::{DetailPlan, testing};
    use super::*;
    use crate::body::N_POSE;
    use crate::ops::testing::gpu;
    use crate::ops::texture_field::TextureFieldConfig;

    /// What the texture of `state` shows in the place of each picture: colours and mask.
    fn shown(gpu: &Arc<Gpu>, detail: &Detail, body: &Body, state: &FitState) -> Vec<(Vec<u8>, Vec<u8>)> {
        let seen = detail.seen(gpu, body, state).unwrap();
        let Seen { scene, texture, poses } = &seen;
        let shown = detail.capture.frames.iter().enumerate().map(|(k, picture)| {
            let drawn = texture.draw(scene, poses, k).unwrap();
            let covered = gpu.read(&scene.hard.pix_to_face).unwrap();
            let level = seen.level(k);
            let scale = detail.camera.fx / level.camera.fx;
            let pixels: Vec<usize> = (0..picture.mask.len() as u32)
                .map(|i| [i % picture.width + picture.x0, i / picture.width + picture.y0].map(|px| f64::from(px) + 0.5))
                .map(|[x, y]| {
                    [(x - detail.camera.cx) / scale + level.camera.cx, (y - detail.camera.cy) / scale + level.camera.cy]
                })
                .map(|[x, y]| y as usize * level.width as usize + x as usize)
                .collect();
            let rgb = pixels.iter().flat_map(|&i| drawn[i].map(|c| (255.0 * c).round() as u8)).collect();
            (rgb, pixels.iter().map(|&i| if covered[i] < 0 { 0 } else { 255 }).collect())
        });
        shown.collect()
    }

    /// The mean difference of the colours where both masks are.
    fn difference(picture: &Frame, (rgb, mask): &(Vec<u8>, Vec<u8>)) -> f64 {
        let both = |i: &usize| mask[*i] == 255 && picture.mask[*i] == 255;
        let (n, sum) = (0..mask.len()).filter(both).fold((0.0, 0.0), |(n, sum), i| {
            let of = |c: usize| f64::from(picture.rgb[3 * i + c].abs_diff(rgb[3 * i + c]));
            (n + 3.0, sum + of(0) + of(1) + of(2))
        });
        assert!(n > 0.0);
        sum / n
    }

    #[test]
    fn close_ups_go_to_where_the_texture_shows_them_and_whole_pictures_are_bent_to_lie_there() {
        let name = "close_ups_go_to_where_the_texture_shows_them_and_whole_pictures_are_bent_to_lie_there";
        let Some(gpu) = gpu(name) else { return };
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
        let camera = Camera { rotation: turned, ..capture.camera.clone() };
        let mut detail = Detail::new(&body, &capture, &camera, &config, &fitted, &plan, large);
        let truth = detail.start(&fitted, &config);
        assert_eq!(detail.close_ups().collect::<Vec<_>>(), [0, 2]);
        assert!(detail.capture.frames[1].height > MOST_PX, "compared at half its size");
        for (picture, (rgb, mask)) in shown(&gpu, &detail, &body, &truth).into_iter().enumerate() {
            (detail.capture.frames[picture].rgb, detail.capture.frames[picture].mask) = (rgb, mask);
        }
        let mut start = truth.clone();
        start.transl[0] += 0.008;
        start.transl[3 * 2 + 1] -= 0.008;
        start.transl[3] += 0.006;
        let before = difference(&detail.capture.frames[1], &shown(&gpu, &detail, &body, &start)[1]);
        let placed = detail.place(&gpu, &body, &mut start, &mut || true).unwrap();
        for k in [0, 2] {
            for c in 3 * k..3 * k + 3 {
                assert!((start.transl[c] - truth.transl[c]).abs() < 0.0005, "{:?}", start.transl);
            }
        }
        assert_eq!(start.transl[3..6], [0.006, 0.0, 2.0], "whole pictures stay");
        let after = difference(&placed.frames[1], &shown(&gpu, &detail, &body, &start)[1]);
        assert!(after < 0.5 * before, "{before} and then {after} of 255");
        let stopped = detail.place(&gpu, &body, &mut start, &mut || false);
        assert!(matches!(stopped, Err(FitError::Stopped)));
    }
}
