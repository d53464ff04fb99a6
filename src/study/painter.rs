//! Pictures of meshes for figures and made targets.

use std::sync::Arc;

use anyhow::Result;
use glam::Vec3;
use image::RgbImage;

use crate::avatar::{Picture, Shading, SurfacePoint, Tracer};
use crate::camera::Camera;
use crate::gpu::Gpu;

/// Samples along a pixel's side.
const SAMPLES: u32 = 4;

/// Draws meshes that share faces and one colour a face.
pub struct Painter<'a> {
    tracer: Tracer,
    faces: &'a [[u32; 3]],
    /// `[F, 3]`
    colours: &'a [[f32; 3]],
}

impl<'a> Painter<'a> {
    /// `vertices` are those of one of the meshes.
    pub fn new(gpu: &Arc<Gpu>, faces: &'a [[u32; 3]], vertices: &[[f32; 3]], colours: &'a [[f32; 3]]) -> Self {
        Self { tracer: Tracer::new(gpu, faces, vertices), faces, colours }
    }

    pub fn textured(&self, vertices: &[[f32; 3]], camera: &Camera) -> Result<Picture> {
        self.draw(vertices, camera, |p| self.colours[p.face as usize])
    }

    /// Grey, lit from a direction in the world.
    pub fn lit(&self, vertices: &[[f32; 3]], camera: &Camera, light: Vec3) -> Result<Picture> {
        self.draw(vertices, camera, |p| {
            let [a, b, c] = self.faces[p.face as usize].map(|v| Vec3::from(vertices[v as usize]));
            [0.45 + 0.45 * (b - a).cross(c - a).normalize_or_zero().dot(light); 3]
        })
    }

    fn draw(
        &self,
        vertices: &[[f32; 3]],
        camera: &Camera,
        colour: impl Fn(&SurfacePoint) -> [f32; 3],
    ) -> Result<Picture> {
        Ok(self
            .tracer
            .trace(vertices, camera, SAMPLES, Shading::Samples, |points| Ok(points.iter().map(&colour).collect()))?)
    }
}

pub fn on_white(picture: &Picture) -> RgbImage {
    image::DynamicImage::ImageRgba8(picture.over(|_, _| [255; 3])).into_rgb8()
}

/// Pictures of one size in rows.
///
/// # Panics
/// When there is none.
pub fn sheet(rows: &[Vec<RgbImage>]) -> RgbImage {
    let (width, height) = rows[0][0].dimensions();
    let columns = rows.iter().map(Vec::len).max().unwrap_or(1) as u32;
    let mut sheet = RgbImage::from_pixel(columns * width, rows.len() as u32 * height, image::Rgb([255; 3]));
    for (y, row) in rows.iter().enumerate() {
        for (x, picture) in row.iter().enumerate() {
            image::imageops::replace(&mut sheet, picture, x as i64 * width as i64, y as i64 * height as i64);
        }
    }
    sheet
}
