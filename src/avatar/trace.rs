//! From a posed mesh to a picture: hard rasterisation on the device in tiles of several samples a pixel, colours for the
//! samples that hit, and their mean with smooth coverage.

use std::sync::Arc;

use glam::{DMat3, DVec3};
use image::{GrayImage, Luma, Rgba, RgbaImage};

use crate::camera::Camera;
use crate::gpu::{Gpu, GpuError};
use crate::ops::Corners;
use crate::ops::hard_rasterize::{HardRasterizeConfig, HardRasterizer};
use crate::ops::topology::Topology;

/// The longest side of a picture.
pub const MAX_SIDE_PX: u32 = 8192;

/// Samples along a side of a tile. A face's loop over a tile stays below the 65,535 rounds after which llvmpipe ends
/// any loop.
const TILE: u32 = 240;

/// Metres; what is nearer to the camera is not drawn.
const NEAR: f64 = 0.05;

/// A point of the mesh: barycentric coordinates in a face.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    pub face: u32,
    pub bary: [f32; 3],
}

/// A mesh's rasteriser on the device.
pub struct Tracer {
    gpu: Arc<Gpu>,
    rasterizer: HardRasterizer,
    view: crate::gpu::Buffer<f32>,
}

/// A picture in the making: sums over the samples that hit.
pub struct Picture {
    pub width: u32,
    pub height: u32,
    samples: u32,
    /// `[height, width]`: r, g, b sums and hits
    sums: Vec<[f32; 4]>,
}

impl Picture {
    fn new(camera: &Camera, samples: u32) -> Self {
        let (width, height) = (camera.width, camera.height);
        Self { width, height, samples, sums: vec![[0.0; 4]; width as usize * height as usize] }
    }

    fn pixel(&self, x: u32, y: u32) -> ([f32; 3], f32) {
        let [r, g, b, hits] = self.sums[(y * self.width + x) as usize];
        ([r, g, b].map(|c| 255.0 * c / hits.max(1.0)), hits / (self.samples * self.samples) as f32)
    }

    /// Over nothing: straight alpha.
    pub fn transparent(&self) -> RgbaImage {
        RgbaImage::from_fn(self.width, self.height, |x, y| {
            let (rgb, alpha) = self.pixel(x, y);
            let [r, g, b] = rgb.map(to_byte);
            Rgba([r, g, b, to_byte(255.0 * alpha)])
        })
    }

    /// Over a colour for each pixel.
    pub fn over(&self, background: impl Fn(u32, u32) -> [u8; 3]) -> RgbaImage {
        RgbaImage::from_fn(self.width, self.height, |x, y| {
            let ((rgb, alpha), behind) = (self.pixel(x, y), background(x, y));
            let [r, g, b] = std::array::from_fn(|k| to_byte(alpha * rgb[k] + (1.0 - alpha) * behind[k] as f32));
            Rgba([r, g, b, 255])
        })
    }

    /// Coverage, 255 where every sample hits.
    pub fn coverage(&self) -> GrayImage {
        GrayImage::from_fn(self.width, self.height, |x, y| Luma([to_byte(255.0 * self.pixel(x, y).1)]))
    }
}

fn to_byte(x: f32) -> u8 {
    x.round().clamp(0.0, 255.0) as u8
}

impl Tracer {
    pub fn new(gpu: &Arc<Gpu>, faces: &[[u32; 3]], n_vertices: usize) -> Self {
        let corners = Arc::new(Corners::new(gpu, faces, &Topology::new(n_vertices, faces)));
        let config = HardRasterizeConfig { near: NEAR, cull_back: false };
        Self {
            rasterizer: HardRasterizer::new(gpu, &corners, (TILE * TILE) as usize, config),
            view: gpu.zeros("trace/view", 3 * n_vertices),
            gpu: gpu.clone(),
        }
    }

    /// Draws `vertices` (world space) with `samples`² samples a pixel; `colour` gives sRGB in [0, 1] for surface points.
    /// A distorted camera bends the vertices, so that straight edges of faces stay straight. Waits.
    pub fn trace(
        &self,
        vertices: &[[f32; 3]],
        camera: &Camera,
        samples: u32,
        mut colour: impl FnMut(&[SurfacePoint]) -> Result<Vec<[f32; 3]>, GpuError>,
    ) -> Result<Picture, GpuError> {
        let view = view_space(vertices, camera);
        self.gpu.write(&self.view, 0, view.as_flattened());
        let mut picture = Picture::new(camera, samples);
        // The vertices are in camera space and bent already; what is left is a pinhole.
        let [fx, fy, cx, cy] = [camera.fx, camera.fy, camera.cx, camera.cy];
        let pinhole = Camera::pinhole(camera.width, camera.height, [fx, fy, cx, cy]);
        let whole = pinhole.scaled(camera.width * samples, camera.height * samples);
        let Some([x0, y0, x1, y1]) = bounds(&view, &whole) else { return Ok(picture) };
        let (mut pixels, mut points) = (Vec::new(), Vec::new());
        for y in (y0..y1).step_by(TILE as usize) {
            for x in (x0..x1).step_by(TILE as usize) {
                let (width, height) = (TILE.min(x1 - x), TILE.min(y1 - y));
                self.hits(&whole.cropped(x as i32, y as i32, width, height), &mut |at, point| {
                    let (px, py) = (x + at % width, y + at / width);
                    pixels.push((py / samples * camera.width + px / samples) as usize);
                    points.push(point);
                })?;
                for (pixel, rgb) in pixels.drain(..).zip(colour(&points)?) {
                    let sum = &mut picture.sums[pixel];
                    (0..3).for_each(|k| sum[k] += rgb[k]);
                    sum[3] += 1.0;
                }
                points.clear();
            }
        }
        Ok(picture)
    }

    /// The samples of a tile that hit the mesh, in order: index in the tile and surface point.
    fn hits(&self, tile: &Camera, each: &mut dyn FnMut(u32, SurfacePoint)) -> Result<(), GpuError> {
        let mut recorder = self.gpu.recorder("trace/tile");
        self.rasterizer.forward(&mut recorder, tile, &self.view);
        recorder.submit()?;
        let faces = self.gpu.read(&self.rasterizer.pix_to_face)?;
        let bary = self.gpu.read(&self.rasterizer.bary_coords)?;
        for (at, (&face, &bary)) in faces.iter().zip(bary.as_chunks().0).enumerate().take(tile.n_pixels()) {
            if let Ok(face) = u32::try_from(face) {
                each(at as u32, SurfacePoint { face, bary });
            }
        }
        Ok(())
    }
}

/// World to camera space, then the lens: a distorted camera sees each point where the undistorted one sees the result.
/// Points outside the lens's field, where its polynomial turns back, end behind the camera and are not drawn.
fn view_space(vertices: &[[f32; 3]], camera: &Camera) -> Vec<[f32; 3]> {
    let rotation = DMat3::from_cols_array(&camera.rotation).transpose();
    let translation = DVec3::from(camera.translation);
    let [k1, k2, p1, p2, k3] = camera.distortion;
    let distorted = camera.distortion.iter().any(|k| *k != 0.0);
    let limit = if distorted { field_limit(k1, k2, k3) } else { f64::INFINITY };
    let view = |v: &[f32; 3]| {
        let p = rotation * DVec3::from(v.map(f64::from)) + translation;
        if !distorted || p.z <= NEAR {
            return p.as_vec3().to_array();
        }
        let (x, y) = (p.x / p.z, p.y / p.z);
        let r2 = x * x + y * y;
        if r2 > limit {
            return [0.0, 0.0, -1.0];
        }
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x);
        let yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y;
        [(xd * p.z) as f32, (yd * p.z) as f32, p.z as f32]
    };
    vertices.iter().map(view).collect()
}

/// The squared radius up to which `r (1 + k₁r² + k₂r⁴ + k₃r⁶)` grows.
fn field_limit(k1: f64, k2: f64, k3: f64) -> f64 {
    let slope = |r2: f64| 1.0 + r2 * (3.0 * k1 + r2 * (5.0 * k2 + r2 * 7.0 * k3));
    let steps = (1..=1000).map(|i| (i as f64 * 0.01).powi(2));
    steps.take_while(|&r2| slope(r2) > 0.0).last().unwrap_or(0.0)
}

/// The samples that the mesh can reach: x0 y0 x1 y1, or `None`.
fn bounds(view: &[[f32; 3]], camera: &Camera) -> Option<[u32; 4]> {
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for v in view.iter().filter(|v| v[2] as f64 > NEAR) {
        let z = v[2] as f64;
        let p = [camera.fx * v[0] as f64 / z + camera.cx, camera.fy * v[1] as f64 / z + camera.cy];
        (0..2).for_each(|k| (low[k], high[k]) = (low[k].min(p[k]), high[k].max(p[k])));
    }
    let clamp = |x: f64, size: u32| x.clamp(0.0, size as f64) as u32;
    let [x0, y0] = [clamp(low[0].floor(), camera.width), clamp(low[1].floor(), camera.height)];
    let [x1, y1] = [clamp(high[0].ceil(), camera.width), clamp(high[1].ceil(), camera.height)];
    (x0 < x1 && y0 < y1).then_some([x0, y0, x1, y1])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::avatar::testing::{camera, turning_avatar};
    use crate::ops::testing::gpu;

    fn square(z: f32) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
        (vec![[-0.5, -0.5, z], [0.5, -0.5, z], [0.5, 0.5, z], [-0.5, 0.5, z]], vec![[0, 1, 2], [0, 2, 3]])
    }

    #[test]
    fn coverage_at_an_edge_is_the_covered_part_of_the_pixel() {
        let Some(gpu) = gpu("trace::coverage_at_an_edge_is_the_covered_part_of_the_pixel") else { return };
        let (vertices, faces) = square(2.0);
        let tracer = Tracer::new(&gpu, &faces, 4);
        // 64 px, focal length 89.6: the edges lie at 32 ± 22.4 px.
        let picture = tracer.trace(&vertices, &camera(64), 5, |p| Ok(vec![[1.0, 0.5, 0.0]; p.len()])).unwrap();
        let coverage = picture.coverage();
        assert_eq!((coverage.get_pixel(32, 32).0[0], coverage.get_pixel(2, 32).0[0]), (255, 0));
        assert_eq!(coverage.get_pixel(9, 32).0[0], 102, "2 of 5 columns");
        assert_eq!(coverage.get_pixel(54, 54).0[0], 41, "2 of 5 columns in 2 of 5 rows");
        // The colour of an edge pixel is the surface's, not mixed with nothing.
        assert_eq!(picture.transparent().get_pixel(9, 32).0, [255, 128, 0, 102]);
        assert_eq!(picture.over(|_, _| [255; 3]).get_pixel(9, 32).0, [255, 204, 153, 255]);
    }

    #[test]
    fn tiles_meet_without_a_seam() {
        let Some(gpu) = gpu("trace::tiles_meet_without_a_seam") else { return };
        let (vertices, faces) = square(1.0);
        let tracer = Tracer::new(&gpu, &faces, 4);
        // The square is larger than the picture, which takes 2×2 tiles.
        let whole = camera(TILE / 2 + 40);
        let (mut seen, mut calls) = (0, 0);
        let picture = tracer
            .trace(&vertices, &whole, 2, |points| {
                (seen, calls) = (seen + points.len(), calls + 1);
                Ok(vec![[1.0; 3]; points.len()])
            })
            .unwrap();
        assert_eq!((calls, seen), (4, 4 * (whole.width * whole.height) as usize));
        assert!(picture.coverage().pixels().all(|p| p.0[0] == 255));
    }

    #[test]
    fn a_lens_moves_points_by_its_polynomial() {
        let (k1, p1) = (-0.2, 0.01);
        let lens = Camera { distortion: [k1, 0.0, p1, 0.0, 0.0], ..camera(64) };
        let [seen] = view_space(&[[0.6, 0.8, 2.0]], &lens)[..] else { panic!("one point") };
        // x = 0.3, y = 0.4, r² = 0.25
        let radial = 1.0 + 0.25 * k1;
        let want = [0.3 * radial + 2.0 * p1 * 0.12, 0.4 * radial + p1 * (0.25 + 2.0 * 0.16)];
        assert!((seen[0] as f64 - 2.0 * want[0]).abs() < 1e-6 && (seen[1] as f64 - 2.0 * want[1]).abs() < 1e-6);
        // Where the polynomial turns back (3 k₁ r² = −1), nothing is drawn.
        assert!(view_space(&[[3.0, 0.0, 2.0]], &lens)[0][2] < 0.0);
    }

    #[test]
    fn nothing_in_view_gives_an_empty_picture() {
        let Some(gpu) = gpu("trace::nothing_in_view_gives_an_empty_picture") else { return };
        let model = turning_avatar();
        let tracer = Tracer::new(&gpu, &model.body.faces, model.body.n_vertices());
        for transl in [[0.0, 0.0, -3.0], [50.0, 0.0, 3.0]] {
            let vertices = model.posed(&model.poses[0], transl).vertices;
            let picture = tracer.trace(&vertices, &camera(32), 1, |p| Ok(vec![[1.0; 3]; p.len()])).unwrap();
            assert!(picture.coverage().pixels().all(|p| p.0[0] == 0), "at {transl:?}");
        }
    }
}
