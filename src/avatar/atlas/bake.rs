//! Baking: every texel of a face gets the colour of the surface point under its centre.

use std::collections::BTreeMap;

use glam::Vec2;
use image::{Rgb, RgbImage};

use super::UvLayout;
use super::fill::Canvas;
use crate::avatar::SurfacePoint;

/// Texels grown round each chart before the rest is filled smoothly.
const GUTTER: usize = 12;

/// Texels outside a chart that still continue its surface: all that bilinear filtering can reach.
const BORDER: f32 = 1.5;

/// Barycentric coordinates of a continued face stay above this; narrower faces are not continued so far.
const MIN_BARY: f32 = -0.5;

/// Texels evaluated at once.
const CHUNK: usize = 1 << 18;

/// Why a bake stopped.
#[derive(Debug, thiserror::Error)]
pub enum BakeError<E: std::error::Error> {
    #[error("a texture of {0} texels a side; 16 to 8192 are possible")]
    Size(u32),
    #[error(transparent)]
    Colour(E),
}

/// Bakes a `size`² texture: `colour` gives sRGB in [0, 1] for surface points, in chunks. Each texel is evaluated once
/// (where faces overlap in the layout, the first wins); gutters and free areas are filled from the charts.
pub fn bake<E: std::error::Error>(
    layout: &UvLayout,
    size: u32,
    mut colour: impl FnMut(&[SurfacePoint]) -> Result<Vec<[f32; 3]>, E>,
) -> Result<RgbImage, BakeError<E>> {
    if !(16..=8192).contains(&size) {
        return Err(BakeError::Size(size));
    }
    let mut canvas = Canvas::new(size as usize);
    let (mut places, mut points) = (Vec::new(), Vec::new());
    for face in 0..layout.uv_faces.len() {
        cover(layout, face, &mut canvas, &mut places, &mut points);
        if points.len() >= CHUNK || face + 1 == layout.uv_faces.len() {
            let colours = colour(&points).map_err(BakeError::Colour)?;
            for (place, rgb) in places.drain(..).zip(colours) {
                canvas.set(place, rgb);
            }
            points.clear();
        }
    }
    let border = border(layout, &canvas);
    let points: Vec<SurfacePoint> = border.values().map(|(_, point)| *point).collect();
    let colours = colour(&points).map_err(BakeError::Colour)?;
    for (&place, rgb) in border.keys().zip(colours) {
        canvas.set(place, rgb);
    }
    canvas.dilate(GUTTER);
    canvas.push_pull();
    let byte = |x: f32| x.round().clamp(0.0, 255.0) as u8;
    Ok(RgbImage::from_fn(size, size, |x, y| Rgb(canvas.rgb[(y * size + x) as usize].map(byte))))
}

/// Adds the texels whose centres lie in the face and are still free, and marks them.
fn cover(layout: &UvLayout, face: usize, canvas: &mut Canvas, places: &mut Vec<usize>, points: &mut Vec<SurfacePoint>) {
    let Some(face_on) = FaceOnTexture::new(layout, face, canvas.size) else { return };
    for (place, p) in face_on.texels(0.0) {
        let bary = face_on.bary(p);
        if bary.iter().all(|w| *w >= 0.0) && !canvas.known[place] {
            canvas.known[place] = true;
            places.push(place);
            points.push(SurfacePoint { face: face as u32, bary });
        }
    }
}

/// The free texels next to charts: for each the distance to the nearest face and that face's surface continued to it, so
/// that filtering at a seam mixes colours of one surface from both sides.
fn border(layout: &UvLayout, canvas: &Canvas) -> BTreeMap<usize, (f32, SurfacePoint)> {
    let mut border: BTreeMap<usize, (f32, SurfacePoint)> = BTreeMap::new();
    for face in 0..layout.uv_faces.len() {
        let Some(face_on) = FaceOnTexture::new(layout, face, canvas.size) else { continue };
        for (place, p) in face_on.texels(BORDER).filter(|(place, _)| !canvas.known[*place]) {
            let distance = face_on.distance(p);
            if distance > BORDER || border.get(&place).is_some_and(|(known, _)| *known <= distance) {
                continue;
            }
            let bary = face_on.bary(p).map(|w| w.max(MIN_BARY));
            let sum: f32 = bary.iter().sum();
            border.insert(place, (distance, SurfacePoint { face: face as u32, bary: bary.map(|w| w / sum) }));
        }
    }
    border
}

/// A face in texels.
struct FaceOnTexture {
    corners: [Vec2; 3],
    /// Twice the area, signed
    area: f32,
    size: usize,
}

impl FaceOnTexture {
    /// `None` for a face without area.
    fn new(layout: &UvLayout, face: usize, size: usize) -> Option<Self> {
        let corners = layout.uv_faces[face].map(|i| Vec2::from(layout.uvs[i as usize]) * size as f32);
        let [a, b, c] = corners;
        let area = (b - a).perp_dot(c - a);
        (area != 0.0).then_some(Self { corners, area, size })
    }

    /// Index and centre of the texels in the face's box, grown by `margin`.
    fn texels(&self, margin: f32) -> impl Iterator<Item = (usize, Vec2)> + use<> {
        let ([a, b, c], size) = (self.corners, self.size);
        let low = (a.min(b).min(c) - 0.5 - margin).ceil().max(Vec2::ZERO);
        let high = (a.max(b).max(c) - 0.5 + margin).floor().min(Vec2::splat(size as f32 - 1.0));
        let range = |low: f32, high: f32| low as usize..(high + 1.0).max(0.0) as usize;
        range(low.y, high.y).flat_map(move |y| {
            range(low.x, high.x).map(move |x| (y * size + x, Vec2::new(x as f32 + 0.5, y as f32 + 0.5)))
        })
    }

    fn bary(&self, p: Vec2) -> [f32; 3] {
        let [a, b, c] = self.corners.map(|corner| corner - p);
        [b.perp_dot(c), c.perp_dot(a), a.perp_dot(b)].map(|w| w / self.area)
    }

    /// From `p` outside the face to its nearest edge.
    fn distance(&self, p: Vec2) -> f32 {
        let edge = |k: usize| {
            let (a, b) = (self.corners[k], self.corners[(k + 1) % 3]);
            let t = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
            p.distance(a + t * (b - a))
        };
        edge(0).min(edge(1)).min(edge(2))
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;
    use crate::body::Body;

    /// Colours by the position on the T-pose, which is smooth across every seam.
    fn by_position(body: &Body) -> impl FnMut(&[SurfacePoint]) -> Result<Vec<[f32; 3]>, Infallible> + use<'_> {
        |texels| {
            let point = |t: &SurfacePoint| {
                let face = body.faces[t.face as usize];
                let p: [f32; 3] = std::array::from_fn(|k| {
                    (0..3).map(|c| t.bary[c] * body.v_template[face[c] as usize][k]).sum::<f32>()
                });
                p.map(|x| 0.5 + 0.4 * x)
            };
            Ok(texels.iter().map(point).collect())
        }
    }

    /// The texture as a renderer reads it, bilinear.
    fn sample(image: &RgbImage, uv: Vec2) -> [f32; 3] {
        let p = uv * image.width() as f32 - 0.5;
        let (low, part) = (p.floor(), p - p.floor());
        let at = |dx: f32, dy: f32, k: usize| {
            let clamp = |v: f32| v.clamp(0.0, image.width() as f32 - 1.0) as u32;
            image.get_pixel(clamp(low.x + dx), clamp(low.y + dy)).0[k] as f32
        };
        std::array::from_fn(|k| {
            let top = at(0.0, 0.0, k) * (1.0 - part.x) + at(1.0, 0.0, k) * part.x;
            let bottom = at(0.0, 1.0, k) * (1.0 - part.x) + at(1.0, 1.0, k) * part.x;
            top * (1.0 - part.y) + bottom * part.y
        })
    }

    #[test]
    fn both_sides_of_every_seam_read_the_same_colour() {
        let own = Body::test_body();
        let bare = Body { uvs: Vec::new(), uv_faces: Vec::new(), ..Body::test_body() };
        for body in [own, bare] {
            let layout = UvLayout::of_body(&body);
            let image = bake(&layout, 512, by_position(&body)).unwrap();
            for (face, uv_face) in body.faces.iter().zip(&layout.uv_faces) {
                for k in 0..3 {
                    // The middle of an edge lies on a seam or inside a chart: in both cases the colour is known.
                    let (i, j) = (k, (k + 1) % 3);
                    let uv = 0.5
                        * (Vec2::from(layout.uvs[uv_face[i] as usize]) + Vec2::from(layout.uvs[uv_face[j] as usize]));
                    let rgb = sample(&image, uv);
                    for (axis, x) in rgb.into_iter().enumerate() {
                        let p =
                            0.5 * (body.v_template[face[i] as usize][axis] + body.v_template[face[j] as usize][axis]);
                        let want = 255.0 * (0.5 + 0.4 * p);
                        assert!((x - want).abs() < 1.5, "edge of {face:?}: {x}, expected {want}");
                    }
                }
            }
        }
    }

    #[test]
    fn free_areas_hold_no_foreign_colour() {
        let body = Body::test_body();
        let image = bake(&UvLayout::of_body(&body), 256, by_position(&body)).unwrap();
        // All surface colours lie well inside (0, 255).
        assert!(image.pixels().all(|p| p.0.iter().all(|&x| (20..=235).contains(&x))));
    }

    #[test]
    fn absurd_sizes_are_refused() {
        let body = Body::test_body();
        assert!(bake(&UvLayout::of_body(&body), 0, by_position(&body)).is_err());
        assert!(bake(&UvLayout::of_body(&body), 100_000, by_position(&body)).is_err());
    }
}
