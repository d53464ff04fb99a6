//! Everything a user takes away, into a folder.

use std::io::{BufWriter, Cursor};
use std::path::Path;

use image::{DynamicImage, ImageFormat, RgbImage};

use super::ply::Mesh;
use super::render::{RenderError, Renderer};
use super::vrm::{portrait, write_vrm};
use super::{BakeError, ModelError, Texture, UvLayout, bake, ply, write_glb, write_motion};
use crate::gpu::GpuError;
use crate::npz::NpzError;

/// Why the files could not be made.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    #[error(transparent)]
    Bake(#[from] BakeError<GpuError>),
    #[error(transparent)]
    Gpu(#[from] GpuError),
    #[error(transparent)]
    Render(#[from] RenderError),
    #[error(transparent)]
    Model(#[from] ModelError),
    #[error(transparent)]
    Motion(#[from] NpzError),
    #[error(transparent)]
    Image(#[from] image::ImageError),
    #[error(transparent)]
    Io(#[from] std::io::Error),
}

impl Renderer {
    /// The mesh of captured frame `k` (an index into `frames`) in world space, or the T-pose, with vertex colours from
    /// the texture, and without vertices that no face has. `None` where there is no such frame. Waits.
    pub fn mesh(&self, k: Option<usize>) -> Result<Option<Mesh>, GpuError> {
        let Some(mesh) = self.model().mesh(k) else { return Ok(None) };
        let colours = self.vertex_colours()?;
        Ok(Some(Mesh { colours, ..mesh }.without_loose_vertices()))
    }

    /// sRGB bytes of every vertex's albedo, for files with vertex colours. Waits.
    pub fn vertex_colours(&self) -> Result<Vec<[u8; 3]>, GpuError> {
        let byte = |x: f32| (255.0 * x).round().clamp(0.0, 255.0) as u8;
        let albedo = self.texture().vertex_colours(self.gpu())?;
        Ok(albedo.into_iter().zip(self.trims()?).map(|(rgb, trim)| rgb.map(|x| byte(trim * x))).collect())
    }

    /// The texture field baked to a square of `size_px`. Waits.
    pub fn bake(&self, layout: &UvLayout, size_px: u32) -> Result<RgbImage, BakeError<GpuError>> {
        bake(layout, size_px, |points| self.albedo(points))
    }

    /// Writes `avatar.glb`, `avatar.vrm`, `texture.png` (`size_px` a side), `mesh.ply` (T-pose), `motion.npz` and `model.npz`
    /// into an existing folder. Waits.
    pub fn export(&self, folder: &Path, size_px: u32) -> Result<(), ExportError> {
        let model = self.model();
        let layout = UvLayout::of_body(&model.body);
        let texture = png(&self.bake(&layout, size_px)?)?;
        let portrait = png(&DynamicImage::from(self.render(&portrait(model))?).into_rgb8())?;
        std::fs::write(folder.join("texture.png"), &texture)?;
        let [texture, portrait] = [&texture, &portrait].map(|bytes| Texture { bytes, mime: "image/png" });
        std::fs::write(folder.join("avatar.glb"), write_glb(model, &layout, &texture))?;
        std::fs::write(folder.join("avatar.vrm"), write_vrm(model, &layout, &texture, Some(&portrait)))?;
        if let Some(mesh) = self.mesh(None)? {
            ply::write(&mesh, std::fs::File::create(folder.join("mesh.ply"))?)?;
        }
        write_motion(model, BufWriter::new(std::fs::File::create(folder.join("motion.npz"))?))?;
        model.save(&folder.join("model.npz"))?;
        Ok(())
    }
}

fn png(image: &RgbImage) -> Result<Vec<u8>, image::ImageError> {
    let mut out = Cursor::new(Vec::new());
    image.write_to(&mut out, ImageFormat::Png)?;
    Ok(out.into_inner())
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::avatar::AvatarModel;
    use crate::avatar::testing::turning_avatar;
    use crate::ops::testing::gpu;

    #[test]
    fn an_export_holds_every_file_and_they_agree() {
        let Some(gpu) = gpu("export::an_export_holds_every_file_and_they_agree") else { return };
        let renderer = Renderer::new(&gpu, &Arc::new(turning_avatar())).unwrap();
        let folder = tempfile::tempdir().unwrap();
        renderer.export(folder.path(), 128).unwrap();
        let read = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
        let texture = image::load_from_memory(&read("texture.png")).unwrap();
        assert_eq!((texture.width(), texture.height()), (128, 128));
        let glb = read("avatar.glb");
        let png = read("texture.png");
        assert!(glb.windows(png.len()).any(|w| w == png), "the texture is inside the GLB");
        let vrm = read("avatar.vrm");
        assert!(vrm.windows(png.len()).any(|w| w == png), "the texture is inside the VRM");
        let mesh = ply::read(read("mesh.ply").as_slice()).unwrap();
        assert_eq!((mesh.vertices.len(), mesh.colours.len()), (634, 634));
        assert_eq!(AvatarModel::load(&folder.path().join("model.npz")).unwrap(), **renderer.model());
        assert!(read("motion.npz").len() > 1000);
    }

    #[test]
    fn a_posed_mesh_stands_where_the_frame_was() {
        let Some(gpu) = gpu("export::a_posed_mesh_stands_where_the_frame_was") else { return };
        let renderer = Renderer::new(&gpu, &Arc::new(turning_avatar())).unwrap();
        let mesh = renderer.mesh(Some(2)).unwrap().unwrap();
        let mean_z = mesh.vertices.iter().map(|v| v[2]).sum::<f32>() / mesh.vertices.len() as f32;
        assert!((mean_z - 3.0).abs() < 0.2, "{mean_z}");
        assert!(renderer.mesh(Some(5)).unwrap().is_none());
    }
}
