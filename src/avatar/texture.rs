//! The avatar's colours at points of its surface, from the texture field on the device.

use super::AvatarModel;
use super::trace::SurfacePoint;
use crate::gpu::{Gpu, GpuError};
use crate::ops::texture_field::{TextureField, TextureFieldError};

/// Points of one pass: bounds the activations to some 25 MB.
const CAPACITY: usize = 1 << 16;

/// The texture field of an avatar with the coordinates of its vertices.
pub struct SurfaceTexture {
    field: TextureField,
    faces: Vec<[u32; 3]>,
    texcoords: Vec<[f32; 3]>,
}

impl SurfaceTexture {
    pub fn new(gpu: &Gpu, model: &AvatarModel) -> Result<Self, TextureFieldError> {
        Ok(Self {
            field: TextureField::to_show(gpu, model.texture_config, &model.texture, CAPACITY)?,
            faces: model.body.faces.clone(),
            texcoords: model.texcoords.clone(),
        })
    }

    /// sRGB in [0, 1] of surface points: texture coordinates interpolated over the face, then the field. Waits.
    pub fn colours(&self, gpu: &Gpu, points: &[SurfacePoint]) -> Result<Vec<[f32; 3]>, GpuError> {
        let coord = |p: &SurfacePoint| -> [f32; 3] {
            let corners = self.faces[p.face as usize].map(|v| self.texcoords[v as usize]);
            std::array::from_fn(|k| (0..3).map(|c| p.bary[c] * corners[c][k]).sum())
        };
        let coords: Vec<[f32; 3]> = points.iter().map(coord).collect();
        self.at_coords(gpu, &coords)
    }

    /// sRGB of every vertex. Waits.
    pub fn vertex_colours(&self, gpu: &Gpu) -> Result<Vec<[f32; 3]>, GpuError> {
        self.at_coords(gpu, &self.texcoords)
    }

    fn at_coords(&self, gpu: &Gpu, coords: &[[f32; 3]]) -> Result<Vec<[f32; 3]>, GpuError> {
        Ok(self.field.eval_points(gpu, coords.as_flattened())?.as_chunks().0.to_vec())
    }
}
