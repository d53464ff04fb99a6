//! From a posed mesh to a picture: hard rasterisation on the device in tiles of several samples a pixel, colours for the
//! samples that hit, and their mean with smooth coverage.

use std::sync::Arc;

use image::{GrayImage, Luma, Rgba, RgbaImage};

use crate::camera::Camera;
use crate::gpu::{Gpu, GpuError};
use crate::ops::Corners;
use crate::ops::hard_rasterize::cpu::bary_at;
use crate::ops::hard_rasterize::{HardRasterizeConfig, HardRasterizer};
use crate::ops::topology::Topology;

/// The longest side of a picture.
pub const MAX_SIDE_PX: u32 = 8192;

/// Samples of a tile, at most.
const TILE: u32 = 1 << 20;

/// The samples that one face's box may have in a tile: llvmpipe ends any loop after 65,535 rounds, and a face's is one.
const MAX_BOX: u32 = 57_600;

/// Metres; what is nearer to the camera is not drawn.
const NEAR: f64 = 0.05;

/// A point of the mesh: barycentric coordinates in a face.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    pub face: u32,
    pub bary: [f32; 3],
}

/// How often the colour is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shading {
    /// At each sample: for colours that change within a pixel.
    Samples,
    /// Once for each surface that a pixel shows: for textures no finer than the picture. Faces that touch are one surface,
    /// which is asked in the middle of the samples of the face that has the most of them.
    Surfaces,
}

/// A mesh's rasteriser on the device.
pub struct Tracer {
    gpu: Arc<Gpu>,
    rasterizer: HardRasterizer,
    faces: Vec<[u32; 3]>,
    view: crate::gpu::Buffer<f32>,
}

/// What a picture is asked a colour for: the pixel that shows a point, and the samples that the point stands for.
struct Seen {
    pixel: usize,
    samples: f32,
}

/// The samples of a face in a pixel: how many, and the sum of their places in the tile.
#[derive(Clone, Copy)]
struct Part {
    face: u32,
    samples: f32,
    place: [f32; 2],
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
    /// For meshes of these faces; `vertices` are one of them. Of a closed surface only the faces that look at the camera are drawn, as
    /// viewers of the exported avatar draw it: the coverage is the same, where all of it lies before the camera. Of any other, both
    /// sides.
    pub fn new(gpu: &Arc<Gpu>, faces: &[[u32; 3]], vertices: &[[f32; 3]]) -> Self {
        let n_vertices = vertices.len();
        let corners = Arc::new(Corners::new(gpu, faces, &Topology::new(n_vertices, faces)));
        let config = HardRasterizeConfig { near: NEAR, cull_back: Topology::looks_out(vertices, faces) };
        Self {
            rasterizer: HardRasterizer::new(gpu, &corners, TILE as usize, config),
            faces: faces.to_vec(),
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
        shading: Shading,
        mut colour: impl FnMut(&[SurfacePoint]) -> Result<Vec<[f32; 3]>, GpuError>,
    ) -> Result<Picture, GpuError> {
        let view = view_space(vertices, camera);
        self.gpu.write(&self.view, 0, view.as_flattened());
        let mut picture = Picture::new(camera, samples);
        // The vertices are in camera space and bent already; what is left is a pinhole.
        let [fx, fy, cx, cy] = [camera.fx, camera.fy, camera.cx, camera.cy];
        let pinhole = Camera::pinhole(camera.width, camera.height, [fx, fy, cx, cy]);
        let whole = pinhole.scaled(camera.width * samples, camera.height * samples);
        let points = screen(&view, &whole);
        let Some([x0, y0, x1, y1]) = bounds(&points, &whole) else { return Ok(picture) };
        // Tiles are whole pixels.
        let [x0, y0] = [x0, y0].map(|from| from / samples * samples);
        let [x1, y1] = [x1, y1].map(|to| to.next_multiple_of(samples));
        let [width, height] = self.tile([x1 - x0, y1 - y0], largest_box(&points, &self.faces, &whole), samples);
        let (mut seen, mut points) = (Vec::new(), Vec::new());
        for y in (y0..y1).step_by(height as usize) {
            for x in (x0..x1).step_by(width as usize) {
                let tile = whole.cropped(x as i32, y as i32, width.min(x1 - x), height.min(y1 - y));
                let first = (y / samples * camera.width + x / samples) as usize;
                self.points(&tile, &view, samples, shading, |at, n, point| {
                    let (column, row) = (at % tile.width as usize, at / tile.width as usize);
                    seen.push(Seen { pixel: first + row * camera.width as usize + column, samples: n });
                    points.push(point);
                })?;
                for (Seen { pixel, samples }, rgb) in seen.drain(..).zip(colour(&points)?) {
                    let sum = &mut picture.sums[pixel];
                    (0..3).for_each(|k| sum[k] += samples * rgb[k]);
                    sum[3] += samples;
                }
                points.clear();
            }
        }
        Ok(picture)
    }

    /// Width and height of the tiles of a region, in samples: as few as the buffers hold, or, where a face is large, so
    /// small that its box fits.
    fn tile(&self, [width, height]: [u32; 2], largest_box: f64, samples: u32) -> [u32; 2] {
        let capacity = if largest_box > f64::from(MAX_BOX) { MAX_BOX } else { TILE };
        if width.saturating_mul(height) <= capacity {
            return [width, height];
        }
        let side = |length: u32| (length / samples).max(1) * samples;
        let width = side(width.min(capacity.isqrt() * 2));
        [width, side((capacity / width).min(height))]
    }

    /// The points that a tile shows, pixel by pixel: `each` gets the place `row · tile width + column` of the pixel in the tile,
    /// how many samples the point stands for, and the point.
    fn points(
        &self,
        tile: &Camera,
        view: &[[f32; 3]],
        samples: u32,
        shading: Shading,
        mut each: impl FnMut(usize, f32, SurfacePoint),
    ) -> Result<(), GpuError> {
        let mut recorder = self.gpu.recorder("trace/tile");
        self.rasterizer.forward_faces(&mut recorder, tile, &self.view);
        recorder.submit()?;
        let pix_to_face = self.gpu.read_front(&self.rasterizer.pix_to_face, tile.n_pixels())?;
        let (width, samples) = (tile.width as usize, samples as usize);
        let mut parts: Vec<Part> = Vec::with_capacity(samples * samples);
        for y in (0..tile.height as usize).step_by(samples) {
            for x in (0..width).step_by(samples) {
                gather(&pix_to_face, width, [x, y], samples, shading, &mut parts);
                if shading == Shading::Surfaces && parts.len() > 1 {
                    parts.sort_by(|a, b| b.samples.total_cmp(&a.samples));
                }
                let mut left = &mut parts[..];
                while let Some((part, rest)) = left.split_first_mut() {
                    let corners = self.faces[part.face as usize];
                    let triangle = corners.map(|v| view[v as usize]);
                    let middle = part.place.map(|x| f64::from(x / part.samples));
                    let point = SurfacePoint { face: part.face, bary: bary_at(tile, &triangle, middle) };
                    let touches = |face: u32| self.faces[face as usize].iter().any(|v| corners.contains(v));
                    let merges = |other: &Part| shading == Shading::Surfaces && touches(other.face);
                    let (stands_for, n_left) = merge(part.samples, rest, merges);
                    each(y / samples * width + x / samples, stands_for, point);
                    left = &mut rest[..n_left];
                }
                parts.clear();
            }
        }
        Ok(())
    }
}

/// Adds the faces of the pixel whose first sample is at x and y to `parts`: one for each sample, or for each face where surfaces
/// are shaded.
fn gather(
    pix_to_face: &[i32],
    width: usize,
    [x, y]: [usize; 2],
    samples: usize,
    shading: Shading,
    parts: &mut Vec<Part>,
) {
    for (row, column) in (y..y + samples).flat_map(|row| (x..x + samples).map(move |column| (row, column))) {
        let Ok(face) = u32::try_from(pix_to_face[row * width + column]) else { continue };
        let place = [column as f32 + 0.5, row as f32 + 0.5];
        match parts.iter_mut().find(|p| shading == Shading::Surfaces && p.face == face) {
            Some(part) => {
                part.samples += 1.0;
                (0..2).for_each(|k| part.place[k] += place[k]);
            }
            None => parts.push(Part { face, samples: 1.0, place }),
        }
    }
}

/// Takes the samples of those that merge out of `rest`; the samples with theirs, and how many stay, which come first and in
/// their order.
fn merge(mut samples: f32, rest: &mut [Part], merges: impl Fn(&Part) -> bool) -> (f32, usize) {
    let mut n_left = 0;
    for k in 0..rest.len() {
        if merges(&rest[k]) {
            samples += rest[k].samples;
        } else {
            rest[n_left] = rest[k];
            n_left += 1;
        }
    }
    (samples, n_left)
}

/// World to camera space, then the lens: a distorted camera sees each point where the undistorted one sees the result.
/// Points outside the lens's field, where its polynomial turns back, end behind the camera and are not drawn.
pub fn view_space(vertices: &[[f32; 3]], camera: &Camera) -> Vec<[f32; 3]> {
    let limit = if camera.has_lens() { field_limit(camera) } else { f64::INFINITY };
    let view = |v: &[f32; 3]| {
        let [x, y, z] = camera.view(v.map(f64::from));
        if !camera.has_lens() || z <= NEAR {
            return [x, y, z].map(|c| c as f32);
        }
        let [x, y] = [x / z, y / z];
        if x * x + y * y > limit {
            return [0.0, 0.0, -1.0];
        }
        let [x, y] = camera.distorted([x, y]);
        [x * z, y * z, z].map(|c| c as f32)
    };
    vertices.iter().map(view).collect()
}

/// The squared radius up to which the lens keeps the order of points.
fn field_limit(camera: &Camera) -> f64 {
    let steps = (1..=1000).map(|i| (i as f64 * 0.01).powi(2));
    steps.take_while(|&r2| camera.radial_growth(r2) > 0.0).last().unwrap_or(0.0)
}

/// Where the vertices are on the image; `None` behind the near plane.
fn screen(view: &[[f32; 3]], camera: &Camera) -> Vec<Option<[f64; 2]>> {
    let point = |v: &[f32; 3]| {
        let place = v.map(f64::from);
        (place[2] > NEAR).then(|| camera.project(place))
    };
    view.iter().map(point).collect()
}

/// Low and high corner of some points, within the image.
fn extent(points: impl Iterator<Item = [f64; 2]>, camera: &Camera) -> [[f64; 2]; 2] {
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for p in points {
        (0..2).for_each(|k| (low[k], high[k]) = (low[k].min(p[k]), high[k].max(p[k])));
    }
    let size = [camera.width, camera.height].map(f64::from);
    let inside = |p: [f64; 2]| [0, 1].map(|k| p[k].clamp(0.0, size[k]));
    [inside(low.map(f64::floor)), inside(high.map(f64::ceil))]
}

/// The samples that the mesh can reach: x0 y0 x1 y1, or `None`.
fn bounds(points: &[Option<[f64; 2]>], camera: &Camera) -> Option<[u32; 4]> {
    let [[x0, y0], [x1, y1]] = extent(points.iter().copied().flatten(), camera);
    (x0 < x1 && y0 < y1).then_some([x0, y0, x1, y1].map(|x| x as u32))
}

/// The samples of the largest box round a face; that of a face that reaches behind the near plane may be the whole image.
fn largest_box(points: &[Option<[f64; 2]>], faces: &[[u32; 3]], camera: &Camera) -> f64 {
    let area = |face: &[u32; 3]| {
        let [a, b, c] = face.map(|v| points[v as usize]);
        let (Some(a), Some(b), Some(c)) = (a, b, c) else {
            let seen = a.or(b).or(c).is_some();
            return if seen { camera.n_pixels() as f64 } else { 0.0 };
        };
        let [[x0, y0], [x1, y1]] = extent([a, b, c].into_iter(), camera);
        (x1 - x0 + 1.0) * (y1 - y0 + 1.0)
    };
    faces.iter().map(area).fold(0.0, f64::max)
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
        let tracer = Tracer::new(&gpu, &faces, &vertices);
        // 64 px, focal length 89.6: the edges lie at 32 ± 22.4 px.
        let picture =
            tracer.trace(&vertices, &camera(64), 5, Shading::Samples, |p| Ok(vec![[1.0, 0.5, 0.0]; p.len()])).unwrap();
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
        let tracer = Tracer::new(&gpu, &faces, &vertices);
        // The square's faces are larger than the picture and than what a loop may do: tiles of up to 480 × 120 samples.
        let whole = camera(280);
        let (mut seen, mut calls) = (0, 0);
        let picture = tracer
            .trace(&vertices, &whole, 2, Shading::Samples, |points| {
                (seen, calls) = (seen + points.len(), calls + 1);
                Ok(vec![[1.0; 3]; points.len()])
            })
            .unwrap();
        assert_eq!((calls, seen), (2 * 5, 4 * (whole.width * whole.height) as usize));
        assert!(picture.coverage().pixels().all(|p| p.0[0] == 255));
    }

    #[test]
    fn a_pixel_asks_each_surface_once_and_weighs_it_by_its_samples() {
        let Some(gpu) = gpu("trace::a_pixel_asks_each_surface_once_and_weighs_it_by_its_samples") else { return };
        // A square of two faces, and behind it, a little aside, another one, which touches nothing of the first.
        let (mut vertices, mut faces) = square(2.0);
        let (behind, more) = square(3.0);
        vertices.extend(behind.iter().map(|[x, y, z]| [x + 0.53, *y, *z]));
        faces.extend(more.iter().map(|f| f.map(|v| v + 4)));
        let tracer = Tracer::new(&gpu, &faces, &vertices);
        let by_square = |points: &[SurfacePoint]| Ok(points.iter().map(|p| [(p.face / 2) as f32, 0.5, 0.0]).collect());
        let mut asked = [0; 2];
        let [samples, once] = [Shading::Samples, Shading::Surfaces].map(|shading| {
            let picture = tracer.trace(&vertices, &camera(64), 4, shading, |points| {
                asked[usize::from(shading == Shading::Surfaces)] += points.len();
                by_square(points)
            });
            picture.unwrap().transparent()
        });
        assert_eq!(samples, once, "colours that are even on a surface");
        let covered = samples.pixels().filter(|p| p.0[3] > 0).count();
        let shared = samples.pixels().filter(|p| ![0, 255].contains(&p.0[0])).count();
        assert!(shared > 20, "{shared} pixels show both squares");
        assert_eq!(asked[1], covered + shared);
        assert!(asked[0] > 10 * covered, "{asked:?} of {covered}");
        // In a pixel within one face the middle of the samples is the pixel's own middle.
        let mut middle = None;
        let spot = camera(64).cropped(20, 40, 1, 1);
        let note = |points: &[SurfacePoint]| {
            middle = Some(points[0]);
            by_square(points)
        };
        tracer.trace(&vertices, &spot, 4, Shading::Surfaces, note).unwrap();
        let SurfacePoint { face, bary } = middle.unwrap();
        let x: f32 = (0..3).map(|k| bary[k] * vertices[faces[face as usize][k] as usize][0]).sum();
        assert!((x - 2.0 * (20.5 - 32.0) / 89.6).abs() < 1e-4, "{x}");
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
        let tracer = Tracer::new(&gpu, &model.body.faces, &model.body.v_template);
        for transl in [[0.0, 0.0, -3.0], [50.0, 0.0, 3.0]] {
            let vertices = model.posed(&model.poses[0], transl).vertices;
            let picture =
                tracer.trace(&vertices, &camera(32), 1, Shading::Surfaces, |p| Ok(vec![[1.0; 3]; p.len()])).unwrap();
            assert!(picture.coverage().pixels().all(|p| p.0[0] == 0), "at {transl:?}");
        }
    }
}
