//! Drawing avatars on the device.

use std::io::{Cursor, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use glam::Vec3;

use crate::atomic_file;
use crate::avatar::{self, AvatarModel, Place, Pose, RenderSpec, Renderer, ply};
use crate::gpu::Gpu;
use crate::jobs::render::{self, ImageRequest, PoseSource, RenderError, RenderRequest, What};

/// Models that stay on the device: clients tend to ask for many pictures of one avatar.
const KEPT: usize = 2;
/// Samples along a pixel's side.
const SAMPLES: u32 = 3;

/// Draws on a device, and keeps the last avatars there.
#[derive(Default)]
pub(super) struct CachedRenderers {
    /// The last used at the end.
    kept: Vec<Loaded>,
}

struct Loaded {
    path: PathBuf,
    /// A retry may publish another model under the same path.
    written: SystemTime,
    renderer: Renderer,
    /// `[V]`, computed for the first mesh.
    colours: Option<Vec<[u8; 3]>>,
}

impl CachedRenderers {
    /// Frees what is on the device.
    pub fn forget(&mut self) {
        self.kept.clear();
    }

    /// Writes the picture or mesh to `to`, whole or not at all. A fit that has the device does not end with a picture for which there
    /// is no memory.
    pub fn draw(&mut self, gpu: &Arc<Gpu>, request: &RenderRequest, to: &Path) -> Result<(), RenderError> {
        let drawn = gpu.apart(|| self.content(gpu, request));
        let content = drawn.inspect_err(|_| self.forget()).map_err(failed)??;
        atomic_file::write(to, &content).map_err(failed)
    }

    fn content(&mut self, gpu: &Arc<Gpu>, request: &RenderRequest) -> Result<Vec<u8>, RenderError> {
        let kept = self.model(gpu, &request.model)?;
        match &request.what {
            What::Image(image) => kept.image(image),
            What::Mesh { frame } => kept.mesh(*frame),
        }
    }

    fn model(&mut self, gpu: &Arc<Gpu>, path: &Path) -> Result<&mut Loaded, RenderError> {
        let written = path.metadata().and_then(|meta| meta.modified()).map_err(failed)?;
        let found = self.kept.iter().position(|kept| kept.path == path && kept.written == written);
        let kept = match found {
            Some(at) => self.kept.remove(at),
            None => {
                let model = Arc::new(AvatarModel::load(path).map_err(failed)?);
                let renderer = Renderer::new(gpu, &model).map_err(failed)?;
                Loaded { path: path.into(), written, renderer, colours: None }
            }
        };
        if self.kept.len() >= KEPT {
            self.kept.remove(0);
        }
        self.kept.push(kept);
        let last = self.kept.len() - 1;
        Ok(&mut self.kept[last])
    }
}

impl Loaded {
    fn image(&self, request: &ImageRequest) -> Result<Vec<u8>, RenderError> {
        let spec = self.spec(request)?;
        let picture = self.renderer.render(&spec).map_err(|error| match error {
            avatar::RenderError::Invalid(reason) => RenderError::Refused(reason),
            error => failed(error),
        })?;
        let mut png = Cursor::new(Vec::new());
        picture.write_to(&mut png, image::ImageFormat::Png).map_err(failed)?;
        Ok(png.into_inner())
    }

    fn spec(&self, request: &ImageRequest) -> Result<RenderSpec, RenderError> {
        let model = self.renderer.model();
        let (pose, place) = match &request.pose {
            PoseSource::Frame(frame) => {
                let spec = RenderSpec::of_frame(model, model.nearest_frame(*frame));
                (spec.pose, spec.place)
            }
            PoseSource::Given { pose, place } => {
                let numbers = pose.len();
                let pose: Result<&Pose, _> = pose.as_slice().try_into();
                let pose = *pose.map_err(|_| RenderError::Refused(format!("the pose has {numbers} numbers")))?;
                (pose, place.map_or_else(|| self.first_pelvis(), |place| place_of(model, &pose, place)))
            }
        };
        Ok(RenderSpec {
            pose,
            place,
            betas: request.betas.clone(),
            camera: request.camera.clone(),
            background: request.background,
            light: request.light,
            samples: SAMPLES,
            shading: None,
        })
    }

    /// Where the pelvis was in the first fitted frame.
    fn first_pelvis(&self) -> Place {
        let model = self.renderer.model();
        let first = model.transl.first().copied().unwrap_or_default();
        let joint = model.body.shaped_joints(&model.betas)[0];
        Place::Pelvis(std::array::from_fn(|k| joint[k] + first[k]))
    }

    fn mesh(&mut self, frame: u32) -> Result<Vec<u8>, RenderError> {
        let model = self.renderer.model();
        let mesh = model.mesh(Some(model.nearest_frame(frame)));
        let mut mesh = mesh.ok_or_else(|| RenderError::Failed("the model has no frames".into()))?;
        if self.colours.is_none() {
            self.colours = Some(self.renderer.vertex_colours().map_err(failed)?);
        }
        mesh.colours = self.colours.clone().unwrap_or_default();
        let mesh = mesh.without_loose_vertices();
        let mut out = Vec::new();
        ply::write(&mesh, &mut out).and_then(|()| out.flush()).map_err(failed)?;
        Ok(out)
    }
}

fn place_of(model: &AvatarModel, pose: &Pose, place: render::Place) -> Place {
    match place {
        render::Place::Translation(t) => Place::Transl((Vec3::from(t) + model.pelvis_shift(pose)).to_array()),
        render::Place::Pelvis(p) => Place::Pelvis(p),
    }
}

fn failed(error: impl std::fmt::Display) -> RenderError {
    RenderError::Failed(error.to_string())
}
