//! The captured light on a posed body.

use crate::avatar::AvatarModel;
use crate::avatar::pose::vertex_normals;
use crate::avatar::trace::SurfacePoint;
use crate::ops::light::Exposure;

/// A posed body under the captured light.
pub(super) struct LitBody<'a> {
    model: &'a AvatarModel,
    /// `[V]`, unit
    normals: Vec<[f32; 3]>,
    /// `[V]`: what of the light reaches each vertex
    exposures: Vec<Exposure>,
}

impl<'a> LitBody<'a> {
    pub fn new(model: &'a AvatarModel, vertices: &[[f32; 3]]) -> Self {
        let faces = &model.body.faces;
        let normals = vertex_normals(vertices, faces);
        Self { model, normals, exposures: model.light.exposures(vertices, faces) }
    }

    /// Puts the light on albedos.
    pub fn shade(&self, points: &[SurfacePoint], colours: &mut [[f32; 3]]) {
        for (point, rgb) in points.iter().zip(colours) {
            let corners = self.model.body.faces[point.face as usize].map(|v| v as usize);
            let weighted = |of: &dyn Fn(usize) -> f32| (0..3).map(|c| point.bary[c] * of(corners[c])).sum();
            let normal = std::array::from_fn(|k| weighted(&|v| self.normals[v][k]));
            let reaching = Exposure::weighted((0..3).map(|c| (point.bary[c], self.exposures[corners[c]])));
            let shade = self.model.light.shade(normal, reaching);
            *rgb = std::array::from_fn(|k| (rgb[k] * shade[k]).min(1.0));
        }
    }
}
