//! Reference twin: every face against every pixel, without lists.

use super::SoftRasterizeParams;
use crate::camera::Camera;
use crate::ops::Real;
use crate::ops::corners::{add_corners, triangle};

/// The results of [`forward`], with what [`backward`] needs of them.
#[derive(Clone, Debug)]
pub struct Image<T> {
    pub rgb: Vec<T>,
    pub alpha: Vec<T>,
    /// The greatest score of each pixel, `W = Σ exp(score − greatest)`, and `ln Π(1 − D)`.
    state: Vec<[T; 3]>,
}

/// A face on the normalised plane.
struct Screen<T> {
    p: [[T; 2]; 3],
    inv_z: [T; 3],
    inv_area: T,
}

struct Fragment<T> {
    x: T,
    delta: [T; 2],
    foot: [T; 3],
    w: [T; 3],
    clamped: [T; 3],
    total: T,
    z: T,
}

fn sub<T: Real>(a: [T; 2], b: [T; 2]) -> [T; 2] {
    [a[0] - b[0], a[1] - b[1]]
}

fn dot<T: Real>(a: [T; 2], b: [T; 2]) -> T {
    a[0] * b[0] + a[1] * b[1]
}

fn cross<T: Real>(a: [T; 2], b: [T; 2]) -> T {
    a[0] * b[1] - a[1] * b[0]
}

/// The pixel centre in normalised units from the middle of the image.
fn centre<T: Real>(params: &SoftRasterizeParams, camera: &Camera, pixel: usize) -> [T; 2] {
    let at = |i: usize, size: u32| T::of((i as f64 + 0.5 - f64::from(size) / 2.0) / params.norm_px);
    let width = camera.width as usize;
    [at(pixel % width, camera.width), at(pixel / width, camera.height)]
}

/// Focal lengths and principal point in normalised units from the middle of the image.
fn pinhole<T: Real>(params: &SoftRasterizeParams, camera: &Camera) -> ([T; 2], [T; 2]) {
    let n = params.norm_px;
    let shift = [camera.cx - f64::from(camera.width) / 2.0, camera.cy - f64::from(camera.height) / 2.0];
    ([camera.fx, camera.fy].map(|f| T::of(f / n)), shift.map(|c| T::of(c / n)))
}

fn screen<T: Real>(params: &SoftRasterizeParams, camera: &Camera, corners: &[[T; 3]; 3]) -> Option<Screen<T>> {
    let (focal, shift) = pinhole::<T>(params, camera);
    let p = corners.map(|v| [focal[0] * v[0] / v[2] + shift[0], focal[1] * v[1] / v[2] + shift[1]]);
    let area = cross(sub(p[1], p[0]), sub(p[2], p[0]));
    let drawn = corners.iter().all(|v| v[2] > T::zero()) && area.abs() > T::of(1e-12);
    drawn.then(|| Screen { p, inv_z: corners.map(|v| T::one() / v[2]), inv_area: T::one() / area })
}

fn fragment<T: Real>(params: &SoftRasterizeParams, face: &Screen<T>, p: [T; 2]) -> Option<Fragment<T>> {
    let (zero, one) = (T::zero(), T::one());
    let q = face.p.map(|v| sub(v, p));
    let w = [0, 1, 2].map(|k| cross(q[(k + 1) % 3], q[(k + 2) % 3]) * face.inv_area);
    let (mut d2, mut delta, mut foot) = (T::infinity(), [zero; 2], [zero; 3]);
    for k in 0..3 {
        let e = sub(face.p[(k + 1) % 3], face.p[k]);
        let t = (-dot(q[k], e) / dot(e, e).max(T::of(1e-20))).max(zero).min(one);
        let to = [-(q[k][0] + t * e[0]), -(q[k][1] + t * e[1])];
        if dot(to, to) < d2 {
            (d2, delta, foot) = (dot(to, to), to, [zero; 3]);
            foot[k] = one - t;
            foot[(k + 1) % 3] = t;
        }
    }
    let inside = w.iter().all(|&w| w > zero);
    let x = if inside { d2 } else { -d2 } / T::of(params.sigma);
    let clamped = w.map(|w| w.max(zero).min(one));
    let total = clamped[0] + clamped[1] + clamped[2];
    let z = total / (0..3).map(|k| clamped[k] * face.inv_z[k]).sum();
    let counts = x > T::of(-params.cut) && z > T::of(params.near) && z < T::of(params.far);
    counts.then_some(Fragment { x, delta, foot, w, clamped, total, z })
}

/// `(ln D, ln(1 − D))` of `D = sigmoid(x)`.
fn log_sigmoids<T: Real>(x: T) -> (T, T) {
    let rest = (-x.abs()).exp().ln_1p();
    (-rest - (-x).max(T::zero()), -rest - x.max(T::zero()))
}

fn score<T: Real>(params: &SoftRasterizeParams, fragment: &Fragment<T>) -> T {
    let nearness = (T::of(params.far) - fragment.z) / T::of((params.far - params.near) * params.gamma);
    nearness + log_sigmoids(fragment.x).0
}

/// Colours and coverage of all faces, of vertices `view` `[V, 3]` in camera space and colours `[F, 3]`, with what `backward` needs of
/// each pixel.
pub fn forward<T: Real>(
    params: &SoftRasterizeParams,
    camera: &Camera,
    view: &[T],
    faces: &[[u32; 3]],
    face_colours: &[T],
) -> Image<T> {
    let n = camera.n_pixels();
    let mut image = Image { rgb: vec![T::zero(); n * 3], alpha: vec![T::zero(); n], state: Vec::with_capacity(n) };
    let screens: Vec<_> = faces.iter().map(|face| screen(params, camera, &triangle(view, face))).collect();
    for pixel in 0..n {
        let p = centre(params, camera, pixel);
        let (mut most, mut weight, mut log_t) = (T::of(params.eps / params.gamma), T::one(), T::zero());
        let mut rgb = params.background.map(T::of);
        for (f, face) in screens.iter().enumerate() {
            let Some(r) = face.as_ref().and_then(|face| fragment(params, face, p)) else { continue };
            log_t += log_sigmoids(r.x).1;
            let score = score(params, &r);
            let (old, new) = ((most - score.max(most)).exp(), (score - score.max(most)).exp());
            most = most.max(score);
            weight = weight * old + new;
            for (rgb, own) in rgb.iter_mut().zip(&face_colours[f * 3..][..3]) {
                *rgb = *rgb * old + *own * new;
            }
        }
        image.rgb[pixel * 3..][..3].copy_from_slice(&rgb.map(|x| x / weight));
        image.alpha[pixel] = -log_t.exp_m1();
        image.state.push([most, weight, log_t]);
    }
    image
}

/// Adds to `grad_view` and `grad_face_colours`.
#[expect(clippy::too_many_arguments, reason = "the contract's buffers, in its order")]
pub fn backward<T: Real>(
    params: &SoftRasterizeParams,
    camera: &Camera,
    view: &[T],
    faces: &[[u32; 3]],
    face_colours: &[T],
    image: &Image<T>,
    grad_rgb: &[T],
    grad_alpha: &[T],
    grad_view: &mut [T],
    grad_face_colours: &mut [T],
) {
    for (f, face) in faces.iter().enumerate() {
        let corners = triangle(view, face);
        let Some(on_screen) = screen(params, camera, &corners) else { continue };
        let (mut gp, mut g_inv_z) = ([[T::zero(); 2]; 3], [T::zero(); 3]);
        for pixel in 0..camera.n_pixels() {
            let p = centre(params, camera, pixel);
            let Some(r) = fragment(params, &on_screen, p) else { continue };
            let [most, total_weight, log_t] = image.state[pixel];
            let weight = (score(params, &r) - most).exp() / total_weight;
            let mut gs = T::zero();
            for c in 0..3 {
                let g = grad_rgb[pixel * 3 + c];
                gs += weight * g * (face_colours[f * 3 + c] - image.rgb[pixel * 3 + c]);
                grad_face_colours[f * 3 + c] += weight * g;
            }
            let (log_d, log_rest) = log_sigmoids(r.x);
            let gx = gs * log_rest.exp() + (log_t + log_d).exp() * grad_alpha[pixel];
            fragment_backward(params, &on_screen, p, &r, gx, gs, &mut gp, &mut g_inv_z);
        }
        let (focal, shift) = pinhole::<T>(params, camera);
        let grad = std::array::from_fn(|k| {
            let inv_z = on_screen.inv_z[k];
            let g_z = dot(gp[k], sub(on_screen.p[k], shift)) * inv_z + g_inv_z[k] * inv_z * inv_z;
            [gp[k][0] * focal[0] * inv_z, gp[k][1] * focal[1] * inv_z, -g_z]
        });
        add_corners(grad_view, face, &grad);
    }
}

/// The gradient `gx` of `x` and `gs` of the score, to the corners on the plane and their `1/z`.
#[expect(clippy::too_many_arguments, reason = "one step of a chain rule")]
fn fragment_backward<T: Real>(
    params: &SoftRasterizeParams,
    face: &Screen<T>,
    p: [T; 2],
    r: &Fragment<T>,
    gx: T,
    gs: T,
    gp: &mut [[T; 2]; 3],
    g_inv_z: &mut [T; 3],
) {
    let (zero, one) = (T::zero(), T::one());
    let g_delta = T::of(-2.0) * r.x.signum() * gx / T::of(params.sigma);
    let g_s = r.z * r.z * gs / (T::of((params.far - params.near) * params.gamma) * r.total);
    let gw: [T; 3] = std::array::from_fn(|k| {
        let passes = r.w[k] > zero && r.w[k] < one;
        if passes { g_s * (face.inv_z[k] - one / r.z) } else { zero }
    });
    let mean = gw[0] * r.w[0] + gw[1] * r.w[1] + gw[2] * r.w[2];
    let q = face.p.map(|v| sub(v, p));
    for k in 0..3 {
        g_inv_z[k] += g_s * r.clamped[k];
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        let gd = (gw[k] - mean) * face.inv_area;
        gp[k][0] += g_delta * r.foot[k] * r.delta[0];
        gp[k][1] += g_delta * r.foot[k] * r.delta[1];
        gp[i][0] += gd * q[j][1];
        gp[i][1] -= gd * q[j][0];
        gp[j][0] -= gd * q[i][1];
        gp[j][1] += gd * q[i][0];
    }
}
