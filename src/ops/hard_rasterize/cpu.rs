//! Reference twin.

use super::HardRasterizeConfig;
use crate::camera::Camera;
use crate::ops::Real;
use crate::ops::corners::{add_corners, triangle};

/// The results of [`forward`].
#[derive(Clone, Debug)]
pub struct Image<T> {
    pub pix_to_face: Vec<i32>,
    pub bary_coords: Vec<T>,
    pub zbuf: Vec<T>,
    pub alpha: Vec<T>,
}

struct Meeting<T> {
    q: [[T; 2]; 3],
    bary: [T; 3],
    total: T,
    z: T,
}

fn ray_at<T: Real>(camera: &Camera, [x, y]: [f64; 2]) -> [T; 2] {
    [T::of((x - camera.cx) / camera.fx), T::of((y - camera.cy) / camera.fy)]
}

fn ray<T: Real>(camera: &Camera, pixel: usize) -> [T; 2] {
    let width = camera.width as usize;
    ray_at(camera, [(pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5])
}

/// Barycentric coordinates of where the ray through a point of the image, in pixels, meets the plane of a triangle in camera
/// space.
pub fn bary_at<T: Real>(camera: &Camera, triangle: &[[T; 3]; 3], point: [f64; 2]) -> [T; 3] {
    meet(triangle, ray_at(camera, point)).1.bary
}

fn meet<T: Real>(t: &[[T; 3]; 3], ray: [T; 2]) -> ([T; 3], Meeting<T>) {
    let q = t.map(|v| [v[0] - ray[0] * v[2], v[1] - ray[1] * v[2]]);
    let d: [T; 3] = std::array::from_fn(|k| {
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        q[i][0] * q[j][1] - q[i][1] * q[j][0]
    });
    let total = d[0] + d[1] + d[2];
    let bary = d.map(|d| d / total);
    (d, Meeting { q, bary, total, z: bary[0] * t[0][2] + bary[1] * t[1][2] + bary[2] * t[2][2] })
}

/// The pixels that the triangle may cover, by columns and rows.
fn pixel_box<T: Real>(camera: &Camera, near: f64, t: &[[T; 3]; 3]) -> [std::ops::Range<usize>; 2] {
    if t.iter().any(|v| v[2].f64() <= near || v[2].is_nan()) {
        return [0..0, 0..0];
    }
    let range = |f: f64, c: f64, axis: usize, size: u32| {
        let p = t.map(|v| f * v[axis].f64() / v[2].f64() + c);
        let (low, high) = (p[0].min(p[1]).min(p[2]), p[0].max(p[1]).max(p[2]));
        (low - 0.51).ceil().clamp(0.0, f64::from(size)) as usize
            ..(high + 0.51).floor().clamp(0.0, f64::from(size)) as usize
    };
    [range(camera.fx, camera.cx, 0, camera.width), range(camera.fy, camera.cy, 1, camera.height)]
}

/// What each pixel shows of the vertices `view`, `[V, 3]` in camera space, metres: the nearest face and where the ray meets it.
pub fn forward<T: Real>(config: &HardRasterizeConfig, camera: &Camera, view: &[T], faces: &[[u32; 3]]) -> Image<T> {
    let n = camera.n_pixels();
    let mut image = Image {
        pix_to_face: vec![-1; n],
        bary_coords: vec![T::zero(); n * 3],
        zbuf: vec![-T::one(); n],
        alpha: vec![T::zero(); n],
    };
    for (f, face) in faces.iter().enumerate() {
        let t = triangle(view, face);
        let [columns, rows] = pixel_box(camera, config.near, &t);
        for pixel in rows.flat_map(|y| columns.clone().map(move |x| y * camera.width as usize + x)) {
            let (d, m) = meet(&t, ray(camera, pixel));
            let front = d.iter().all(|&d| d <= T::zero()) && m.total < T::zero();
            let back = d.iter().all(|&d| d >= T::zero()) && m.total > T::zero();
            if (front || back && !config.cull_back) && (image.pix_to_face[pixel] < 0 || m.z < image.zbuf[pixel]) {
                image.pix_to_face[pixel] = f as i32;
                image.bary_coords[pixel * 3..][..3].copy_from_slice(&m.bary);
                image.zbuf[pixel] = m.z;
                image.alpha[pixel] = T::one();
            }
        }
    }
    image
}

/// Adds to `grad_view`.
pub fn backward<T: Real>(
    camera: &Camera,
    view: &[T],
    faces: &[[u32; 3]],
    pix_to_face: &[i32],
    grad_bary: &[T],
    grad_zbuf: Option<&[T]>,
    grad_view: &mut [T],
) {
    for (pixel, &f) in pix_to_face.iter().enumerate().filter(|(_, f)| **f >= 0) {
        let face = &faces[f as usize];
        let t = triangle(view, face);
        let ray = ray(camera, pixel);
        let (_, m) = meet(&t, ray);
        let gz = grad_zbuf.map_or(T::zero(), |g| g[pixel]);
        let g: [T; 3] = std::array::from_fn(|k| grad_bary[pixel * 3 + k] + gz * t[k][2]);
        let mean = g[0] * m.bary[0] + g[1] * m.bary[1] + g[2] * m.bary[2];
        let gd = g.map(|g| (g - mean) / m.total);
        let mut grad = m.bary.map(|b| [T::zero(), T::zero(), gz * b]);
        for (k, &gd) in gd.iter().enumerate() {
            let (i, j) = ((k + 1) % 3, (k + 2) % 3);
            let add = |grad: &mut [T; 3], gq: [T; 2]| {
                grad[0] += gq[0];
                grad[1] += gq[1];
                grad[2] -= gq[0] * ray[0] + gq[1] * ray[1];
            };
            add(&mut grad[i], [gd * m.q[j][1], -gd * m.q[j][0]]);
            add(&mut grad[j], [-gd * m.q[i][1], gd * m.q[i][0]]);
        }
        add_corners(grad_view, face, &grad);
    }
}

/// Adds to `grad_view` the gradient through the places in the image of the points that pixels show, `[H, W, 2]`.
pub fn screen_backward<T: Real>(
    camera: &Camera,
    view: &[T],
    faces: &[[u32; 3]],
    pix_to_face: &[i32],
    grad_screen: &[T],
    grad_view: &mut [T],
) {
    for (pixel, &f) in pix_to_face.iter().enumerate().filter(|(_, f)| **f >= 0) {
        let face = &faces[f as usize];
        let ray = ray(camera, pixel);
        let (_, m) = meet(&triangle(view, face), ray);
        let g = [grad_screen[pixel * 2] * T::of(camera.fx) / m.z, grad_screen[pixel * 2 + 1] * T::of(camera.fy) / m.z];
        let point = [g[0], g[1], -(g[0] * ray[0] + g[1] * ray[1])];
        add_corners(grad_view, face, &m.bary.map(|b| point.map(|g| b * g)));
    }
}

/// `[H, W, 3]`: each pixel's face colour (`[F, 3]`), and `background` where there is no face.
pub fn shade<T: Real>(pix_to_face: &[i32], face_colours: &[T], background: [T; 3]) -> Vec<T> {
    let colour = |&f: &i32| match usize::try_from(f) {
        Ok(f) => [face_colours[f * 3], face_colours[f * 3 + 1], face_colours[f * 3 + 2]],
        Err(_) => background,
    };
    pix_to_face.iter().flat_map(colour).collect()
}

/// Adds to `grad_face_colours`.
pub fn shade_backward<T: Real>(pix_to_face: &[i32], grad_image: &[T], grad_face_colours: &mut [T]) {
    for (pixel, &f) in pix_to_face.iter().enumerate() {
        if let Ok(f) = usize::try_from(f) {
            for c in 0..3 {
                grad_face_colours[f * 3 + c] += grad_image[pixel * 3 + c];
            }
        }
    }
}
