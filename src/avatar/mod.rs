//! The result of a fit: a textured, rigged body that can be posed, rendered, baked and exported.
//!
//! [`AvatarModel`] holds everything; [`Renderer`] draws it in any pose from its hash texture; [`bake`] turns the texture
//! into an atlas; [`write_glb`], [`write_vrm`], [`write_motion`] and [`ply`] write what users take away.

mod atlas;
mod export;
mod framing;
mod gltf;
mod model;
mod motion;
pub mod ply;
mod pose;
mod render;
#[cfg(test)]
pub(crate) mod testing;
mod texture;
mod trace;
mod trim;
mod vrm;

/// What [`AvatarModel::posed`] gives.
pub use crate::ops::skinning::cpu::Posed;
pub use atlas::{BakeError, UvLayout, bake};
pub use export::ExportError;
pub use framing::holding;
pub use gltf::{Texture, write_glb};
pub use model::{AvatarModel, ModelError};
pub use motion::write_motion;
pub use pose::{Pose, vertex_normals};
pub use render::{Place, RenderError, RenderSpec, Renderer};
pub use texture::SurfaceTexture;
pub use trace::{MAX_SIDE_PX, Picture, Shading, SurfacePoint, Tracer, view_space};
pub use vrm::write_vrm;
