//! Pictures of the avatar in the making, seen by the first frame's camera.

use std::sync::Arc;
use std::time::{Duration, Instant};

use image::DynamicImage;
use image::codecs::jpeg::JpegEncoder;

use super::score::crop;
use crate::avatar::{AvatarModel, RenderSpec, Renderer};
use crate::body::Body;
use crate::camera::Camera;
use crate::capture::Capture;
use crate::fit::{FitConfig, FitState, Stage};
use crate::gpu::Gpu;
use crate::picture::Background;

/// The longer side of a picture.
const SIDE_PX: u32 = 320;
/// Samples along a pixel's side.
const SAMPLES: u32 = 2;
const QUALITY: u8 = 85;

/// A new picture comes after so long, or after so much of the whole job, whichever is first.
const EVERY: Duration = Duration::from_secs(20);
const EVERY_PART: f32 = 0.1;
/// But the fit takes at least so many times as long as the pictures.
const FIT_TO_PICTURES: u32 = 30;

/// Draws the pictures and says when one is due.
pub(super) struct Previews {
    /// The first frame; what is fitted is replaced before each picture.
    model: Arc<AvatarModel>,
    camera: Camera,
    last: Option<Last>,
}

struct Last {
    drawn: Instant,
    took: Duration,
    progress: f32,
}

impl Previews {
    pub fn new(body: &Body, capture: &Capture, camera: &Camera, config: &FitConfig, state: &FitState) -> Self {
        let frame = &capture.frames[0];
        let model = AvatarModel {
            body: body.clone(),
            betas: Vec::new(),
            offsets: Vec::new(),
            texcoords: Vec::new(),
            texture_config: config.field,
            texture: state.field.clone(),
            light: state.light,
            face_colours: Vec::new(),
            poses: Vec::new(),
            transl: Vec::new(),
            pelvis_moved: [0.0; 3],
            frames: vec![frame.index],
            fps: capture.fps,
            camera: camera.clone(),
        };
        let seen = crop(camera, frame);
        let scale = f64::from(SIDE_PX) / f64::from(seen.width.max(seen.height));
        let side = |px: u32| ((f64::from(px) * scale).round() as u32).max(1);
        let camera = seen.scaled(side(seen.width), side(seen.height));
        Self { model: Arc::new(model), camera, last: None }
    }

    /// Whether it is time for a picture, `progress` being that of the whole job.
    pub fn is_due(&self, progress: f32) -> bool {
        self.last.as_ref().is_none_or(|last| {
            let since = last.drawn.elapsed();
            since >= last.took * FIT_TO_PICTURES && (since >= EVERY || progress - last.progress >= EVERY_PART)
        })
    }

    /// The avatar as it is, as a JPEG on white. Waits.
    pub fn draw(&mut self, gpu: &Arc<Gpu>, state: &FitState, progress: f32) -> anyhow::Result<Vec<u8>> {
        let begun = Instant::now();
        let jpeg = self.picture(gpu, state);
        // One that failed is not tried again at once either.
        self.last = Some(Last { drawn: Instant::now(), took: begun.elapsed(), progress });
        jpeg
    }

    fn picture(&mut self, gpu: &Arc<Gpu>, state: &FitState) -> anyhow::Result<Vec<u8>> {
        let model = Arc::make_mut(&mut self.model);
        model.betas.clone_from(&state.betas);
        model.offsets = state.offsets.as_chunks().0.to_vec();
        model.texcoords = state.texcoords.as_chunks().0.to_vec();
        model.texture.clone_from(&state.field);
        model.light = state.light;
        model.face_colours = state.face_colours.as_chunks().0.to_vec();
        model.poses = state.poses.as_chunks().0[..1].to_vec();
        model.transl = state.transl.as_chunks().0[..1].to_vec();
        model.check()?;
        let renderer = Renderer::new(gpu, &self.model)?;
        let spec = RenderSpec {
            camera: self.camera.clone(),
            background: Background::Colour([255; 3]),
            samples: SAMPLES,
            ..RenderSpec::of_frame(&self.model, 0)
        };
        // Before its first step the texture is noise.
        let has_texture = state.stage > Stage::Geometry && (state.stage, state.step) != (Stage::Texture, 0);
        let picture = if has_texture { renderer.render(&spec)? } else { renderer.render_faces(&spec)? };
        let mut jpeg = Vec::new();
        DynamicImage::from(picture).to_rgb8().write_with_encoder(JpegEncoder::new_with_quality(&mut jpeg, QUALITY))?;
        Ok(jpeg)
    }
}
