//! A picture of an avatar in a pose, as the service draws it.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::frame::{FrameError, unit_box};
use super::person::Person;
use super::timing::{Times, profiled, timed};
use crate::avatar::{AvatarModel, RenderError, RenderSpec, Renderer};
use crate::body::Body;
use crate::fit::FitConfig;
use crate::gpu::{Gpu, KernelTime};
use crate::ops::light::Light;
use crate::ops::texture_field::TextureFieldParams;

/// What a picture took.
#[derive(Clone, Debug, serde::Serialize)]
pub struct PictureTimes {
    /// From the request to the pixels on the host: much of it is the host's, so the wall times count.
    pub times: Times,
    /// Kernels, each dispatch timed by itself: sums over a picture.
    pub kernels: BTreeMap<String, KernelTime>,
}

/// A body in the texture of `standard`, and a camera of `size` × `size` pixels before it.
pub struct PictureBench {
    renderer: Renderer,
    spec: RenderSpec,
}

impl PictureBench {
    pub fn new(gpu: &Arc<Gpu>, body: &Body, size: u32) -> Result<Self, FrameError> {
        let Person { camera, pose, transl } = Person::new(body, size);
        let texture_config = FitConfig::standard(1).field;
        let model = Arc::new(AvatarModel {
            betas: vec![0.0; body.n_betas],
            offsets: vec![[0.0; 3]; body.n_vertices()],
            texcoords: unit_box(body).as_chunks().0.to_vec(),
            texture: TextureFieldParams::random(&texture_config, 1),
            texture_config,
            light: Light {
                ambient: [0.6; 3],
                strength: [0.5; 3],
                direction: [0.0, -0.6, -0.8],
                occlusion: 0.35,
                slope: [0.0, 0.0, -0.1],
            },
            face_colours: vec![[0.5; 3]; body.n_faces()],
            poses: vec![pose],
            transl: vec![transl],
            pelvis_moved: [0.0; 3],
            frames: vec![0],
            fps: 30.0,
            camera,
            body: body.clone(),
        });
        let renderer = Renderer::new(gpu, &model)?;
        Ok(Self { spec: RenderSpec::of_frame(&model, 0), renderer })
    }

    /// `repeats` pictures after one that compiles, then a few that are profiled.
    pub fn run(&self, repeats: u32) -> Result<PictureTimes, RenderError> {
        let draw = || self.renderer.render(&self.spec).map(drop);
        draw()?;
        let pairs = (0..repeats).map(|_| timed(draw)).collect::<Result<Vec<_>, _>>()?;
        let kernels = profiled(self.renderer.gpu(), repeats.div_ceil(4), draw)?;
        Ok(PictureTimes { times: Times::of(&pairs), kernels })
    }
}
