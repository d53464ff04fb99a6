//! Pictures of the avatar in any pose, from any camera, at any size; shaded from the hash texture: at each sample where that is much
//! finer than the picture, else once for each surface that a pixel shows.

mod lit;
mod spec;

use std::sync::{Arc, OnceLock};

use image::{GrayImage, RgbaImage};

use self::lit::LitBody;
pub use self::spec::{Place, RenderSpec};
use super::AvatarModel;
use super::texture::SurfaceTexture;
use super::trace::{Picture, Shading, SurfacePoint, Tracer};
use super::trim::trims;
use crate::camera::Camera;
use crate::gpu::{Gpu, GpuError};
use crate::ops::skinning::cpu::{Posed, forward};
use crate::ops::texture_field::TextureFieldError;
use crate::picture::{Background, Light};

/// Why a picture could not be made.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// The request cannot be met; says which part and what was expected.
    #[error("{0}")]
    Invalid(String),
    #[error(transparent)]
    Texture(#[from] TextureFieldError),
    #[error(transparent)]
    Gpu(#[from] GpuError),
}

/// The texture's cells along a pixel from which on a sample in its middle no longer stands for it.
const CELLS_A_PIXEL: f64 = 3.0;

/// An avatar on the device, ready to be drawn.
pub struct Renderer {
    gpu: Arc<Gpu>,
    model: Arc<AvatarModel>,
    tracer: Tracer,
    texture: SurfaceTexture,
    /// The side of the texture's finest cell on the surface, metres.
    cell_m: f64,
    /// `[V]`, see [`trim`](super::trim); found when it is first asked for
    trims: OnceLock<Vec<f32>>,
}

impl Renderer {
    pub fn new(gpu: &Arc<Gpu>, model: &Arc<AvatarModel>) -> Result<Self, RenderError> {
        Ok(Self {
            tracer: Tracer::new(gpu, &model.body.faces, &model.body.v_template),
            texture: SurfaceTexture::new(gpu, model)?,
            cell_m: finest_cell(model),
            trims: OnceLock::new(),
            gpu: gpu.clone(),
            model: model.clone(),
        })
    }

    pub fn model(&self) -> &Arc<AvatarModel> {
        &self.model
    }

    pub fn texture(&self) -> &SurfaceTexture {
        &self.texture
    }

    pub fn gpu(&self) -> &Arc<Gpu> {
        &self.gpu
    }

    /// `[V]`: what of the texture's colour an albedo keeps that is shown without the clip's light. Waits.
    pub(super) fn trims(&self) -> Result<&[f32], GpuError> {
        if self.trims.get().is_none() {
            let albedo = self.texture.vertex_colours(&self.gpu)?;
            self.trims.get_or_init(|| trims(&self.model, &albedo));
        }
        Ok(self.trims.get().expect("it has just been found"))
    }

    /// The albedo at points of the surface, as it is shown without the clip's light. Waits.
    pub(super) fn albedo(&self, points: &[SurfacePoint]) -> Result<Vec<[f32; 3]>, GpuError> {
        let trims = self.trims()?;
        let mut colours = self.texture.colours(&self.gpu, points)?;
        for (point, rgb) in points.iter().zip(&mut colours) {
            let corners = self.model.body.faces[point.face as usize];
            let trim: f32 = corners.iter().zip(point.bary).map(|(&v, weight)| weight * trims[v as usize]).sum();
            *rgb = rgb.map(|x| trim * x);
        }
        Ok(colours)
    }

    /// The picture at the camera's size: straight alpha where the background is transparent. Waits.
    pub fn render(&self, spec: &RenderSpec) -> Result<RgbaImage, RenderError> {
        self.render_with(spec, |points| match spec.light {
            Light::Captured => self.texture.colours(&self.gpu, points),
            Light::None => self.albedo(points),
        })
    }

    /// As [`Renderer::render`]; sets `seen [F]` for the faces that the picture shows: of faces that touch in a pixel, the one
    /// with most of it.
    ///
    /// # Panics
    /// When `seen` is shorter than the faces.
    pub fn render_marking(&self, spec: &RenderSpec, seen: &mut [bool]) -> Result<RgbaImage, RenderError> {
        let spec = &RenderSpec { shading: Some(Shading::Surfaces), ..spec.clone() };
        self.render_with(spec, |points| {
            points.iter().for_each(|point| seen[point.face as usize] = true);
            self.texture.colours(&self.gpu, points)
        })
    }

    /// As [`Renderer::render`], in stage 1's colours: one a face.
    pub fn render_faces(&self, spec: &RenderSpec) -> Result<RgbaImage, RenderError> {
        let colours = &self.model.face_colours;
        self.render_with(spec, |points| Ok(points.iter().map(|point| colours[point.face as usize]).collect()))
    }

    fn render_with(
        &self,
        spec: &RenderSpec,
        mut albedo: impl FnMut(&[SurfacePoint]) -> Result<Vec<[f32; 3]>, GpuError>,
    ) -> Result<RgbaImage, RenderError> {
        let posed = self.posed(spec)?;
        let picture = if spec.light == Light::Captured {
            let lit = OnceLock::new();
            let light = || lit.get_or_init(|| LitBody::new(&self.model, &posed.vertices));
            // The light is the host's work: it is done while the device looks for what the pixels show.
            std::thread::scope(|scope| {
                scope.spawn(light);
                self.trace(spec, &posed, |points| {
                    let mut colours = albedo(points)?;
                    light().shade(points, &mut colours);
                    Ok(colours)
                })
            })?
        } else {
            self.trace(spec, &posed, albedo)?
        };
        Ok(match spec.background {
            Background::Transparent => picture.transparent(),
            Background::Colour(rgb) => picture.over(|_, _| rgb),
        })
    }

    /// The person's coverage of each pixel, 0 to 255, without shading. Waits.
    pub fn mask(&self, spec: &RenderSpec) -> Result<GrayImage, RenderError> {
        let posed = self.posed(spec)?;
        let spec = &RenderSpec { shading: Some(Shading::Surfaces), ..spec.clone() };
        Ok(self.trace(spec, &posed, |points| Ok(vec![[0.0; 3]; points.len()]))?.coverage())
    }

    /// The body as a picture shows it; [`RenderError::Invalid`] for a picture that cannot be.
    fn posed(&self, spec: &RenderSpec) -> Result<Posed<f32>, RenderError> {
        spec.check(&self.model)?;
        let model = &self.model;
        let betas = spec.betas.as_deref().unwrap_or(&model.betas);
        let transl = spec.place.transl(&model.body, betas);
        Ok(forward(&model.body, betas, Some(&model.offsets), &spec.pose, transl))
    }

    fn trace(
        &self,
        spec: &RenderSpec,
        posed: &Posed<f32>,
        colour: impl FnMut(&[SurfacePoint]) -> Result<Vec<[f32; 3]>, GpuError>,
    ) -> Result<Picture, GpuError> {
        let shading = spec.shading.unwrap_or_else(|| self.shading(&spec.camera, posed));
        self.tracer.trace(&posed.vertices, &spec.camera, spec.samples, shading, colour)
    }

    /// How often the texture must be asked for a picture of the person at the pelvis's distance.
    fn shading(&self, camera: &Camera, posed: &Posed<f32>) -> Shading {
        let [_, _, distance] = camera.view(posed.joints[0].map(f64::from));
        let pixel_m = distance / camera.fx.max(camera.fy);
        if pixel_m > CELLS_A_PIXEL * self.cell_m { Shading::Samples } else { Shading::Surfaces }
    }
}

/// Metres: coordinates lie on the surface as the mean edge has them.
fn finest_cell(model: &AvatarModel) -> f64 {
    let vertices = model.rest_vertices();
    let length = |of: &[[f32; 3]], [a, b]: [u32; 2]| {
        f64::from(glam::Vec3::from(of[a as usize]).distance(glam::Vec3::from(of[b as usize])))
    };
    let sum = |of: &[[f32; 3]]| model.body.faces.iter().map(|&[a, b, _]| length(of, [a, b])).sum::<f64>();
    let metres = sum(&vertices) / sum(&model.texcoords).max(f64::MIN_POSITIVE);
    metres / model.texture_config.levels().last().map_or(1.0, |finest| finest.scale.max(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::avatar::testing::{camera, turning_avatar};
    use crate::ops::testing::gpu;
    use crate::ops::texture_field;

    fn renderer(test: &str) -> Option<Renderer> {
        Some(Renderer::new(&gpu(test)?, &Arc::new(turning_avatar())).unwrap())
    }

    #[test]
    fn the_texture_is_asked_as_often_as_a_picture_is_coarse() {
        let Some(renderer) = renderer("render::the_texture_is_asked_as_often_as_a_picture_is_coarse") else { return };
        let spec = RenderSpec::of_frame(renderer.model(), 0);
        let picture = |scale: f64, shading: Option<Shading>| {
            let side = |n: u32| (f64::from(n) * scale).round() as u32;
            let camera = spec.camera.scaled(side(spec.camera.width), side(spec.camera.height));
            renderer.render(&RenderSpec { camera, shading, ..spec.clone() }).unwrap()
        };
        let cells = {
            let posed = renderer.posed(&spec).unwrap();
            f64::from(posed.joints[0][2]) / spec.camera.fx / renderer.cell_m
        };
        for scale in [0.9 * cells / CELLS_A_PIXEL, 1.1 * cells / CELLS_A_PIXEL] {
            let want = if scale < cells / CELLS_A_PIXEL { Shading::Samples } else { Shading::Surfaces };
            let other = if want == Shading::Samples { Shading::Surfaces } else { Shading::Samples };
            let ours = picture(scale, None);
            assert_eq!(ours, picture(scale, Some(want)), "{scale}");
            assert_ne!(ours, picture(scale, Some(other)), "{scale}");
        }
    }

    #[test]
    fn the_pelvis_and_the_translation_name_the_same_place() {
        let Some(renderer) = renderer("render::the_pelvis_and_the_translation_name_the_same_place") else { return };
        let model = renderer.model().clone();
        let by_transl = RenderSpec { samples: 1, ..RenderSpec::of_frame(&model, 1) };
        let pelvis = model.posed(&model.poses[1], model.transl[1]).joints[0];
        let by_pelvis = RenderSpec { place: Place::Pelvis(pelvis), ..by_transl.clone() };
        let (a, b) = (renderer.render(&by_transl).unwrap(), renderer.render(&by_pelvis).unwrap());
        let covered = a.pixels().filter(|p| p.0[3] == 255).count();
        assert!(covered > 500, "{covered} pixels show the person");
        let differing = a.pixels().zip(b.pixels()).filter(|(a, b)| a != b).count();
        assert!(differing <= covered / 100, "{differing} pixels differ");
    }

    #[test]
    fn each_sample_has_the_colour_of_the_reference_field() {
        let Some(renderer) = renderer("render::each_sample_has_the_colour_of_the_reference_field") else { return };
        let model = renderer.model();
        let points: Vec<_> =
            (0..200).map(|i| crate::avatar::SurfacePoint { face: i * 5, bary: [0.2, 0.5, 0.3] }).collect();
        let ours = renderer.texture().colours(renderer.gpu(), &points).unwrap();
        for (point, rgb) in points.iter().zip(ours) {
            let corners = model.body.faces[point.face as usize].map(|v| model.texcoords[v as usize]);
            let coord: [f32; 3] = std::array::from_fn(|k| (0..3).map(|c| point.bary[c] * corners[c][k]).sum());
            let want = texture_field::cpu::forward(&model.texture_config, &model.texture, &coord);
            for k in 0..3 {
                assert!((rgb[k] - want[k]).abs() < 1e-4, "{point:?}: {rgb:?}, expected {want:?}");
            }
        }
    }

    #[test]
    fn a_marking_render_tells_the_faces_that_look_at_the_camera() {
        let Some(renderer) = renderer("render::a_marking_render_tells_the_faces_that_look_at_the_camera") else {
            return;
        };
        let model = renderer.model().clone();
        let spec = RenderSpec { samples: 2, ..RenderSpec::of_frame(&model, 0) };
        let mut seen = vec![false; model.body.n_faces()];
        assert_eq!(renderer.render_marking(&spec, &mut seen).unwrap(), renderer.render(&spec).unwrap());
        let share = seen.iter().filter(|&&s| s).count() as f64 / seen.len() as f64;
        assert!((0.2..0.8).contains(&share), "one picture shows {share} of the faces");
        let vertices = model.posed(&model.poses[0], model.transl[0]).vertices;
        for (face, _) in model.body.faces.iter().zip(&seen).filter(|(_, seen)| **seen) {
            let [a, b, c] = face.map(|v| glam::Vec3::from(vertices[v as usize]));
            assert!((b - a).cross(c - a).dot(a) < 1e-6, "a face that looks away was seen: {face:?}");
        }
    }

    #[test]
    fn betas_of_a_request_change_the_size_of_the_person() {
        let Some(renderer) = renderer("render::betas_of_a_request_change_the_size_of_the_person") else { return };
        let spec = RenderSpec { samples: 1, ..RenderSpec::of_frame(renderer.model(), 0) };
        let covered = |betas: Vec<f32>| {
            let mask = renderer.mask(&RenderSpec { betas: Some(betas), ..spec.clone() }).unwrap();
            mask.pixels().filter(|p| p.0[0] > 0).count()
        };
        assert!(covered(vec![2.0]) as f64 > 1.1 * covered(vec![-2.0]) as f64);
    }

    #[test]
    fn what_cannot_be_rendered_is_refused_by_name() {
        let Some(renderer) = renderer("render::what_cannot_be_rendered_is_refused_by_name") else { return };
        let good = RenderSpec::of_frame(renderer.model(), 0);
        let with = |camera: Camera| RenderSpec { camera, ..good.clone() };
        let mut nan = good.clone();
        nan.pose[3] = f32::NAN;
        let cases = [
            (with(Camera { width: 0, ..camera(8) }), "0×8 px"),
            (with(Camera { height: 100_000, ..camera(8) }), "100000 px"),
            (with(Camera { fx: 0.0, ..camera(8) }), "fx 0"),
            (with(Camera { cx: f64::NAN, ..camera(8) }), "camera"),
            (nan, "pose"),
            (RenderSpec { betas: Some(vec![0.0; 9]), ..good.clone() }, "betas: 9 values, expected at most 3"),
            (RenderSpec { samples: 0, ..good.clone() }, "samples"),
        ];
        for (spec, want) in cases {
            let error = renderer.render(&spec).unwrap_err().to_string();
            assert!(error.contains(want), "`{error}` does not say `{want}`");
        }
    }
}
