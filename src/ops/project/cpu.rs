//! Reference twin.

use super::Z_MIN;
use crate::camera::Camera;
use crate::ops::Real;
use crate::ops::linear::{Matrix, Vector, accumulate, add, mul, mul_transposed};

/// A camera's numbers in the twin's precision.
struct Pinhole<T> {
    rotation: Matrix<T>,
    translation: Vector<T>,
    fx: T,
    fy: T,
    cx: T,
    cy: T,
}

impl<T: Real> From<&Camera> for Pinhole<T> {
    fn from(camera: &Camera) -> Self {
        let r = camera.rotation.map(T::of);
        Self {
            rotation: [[r[0], r[1], r[2]], [r[3], r[4], r[5]], [r[6], r[7], r[8]]],
            translation: camera.translation.map(T::of),
            fx: T::of(camera.fx),
            fy: T::of(camera.fy),
            cx: T::of(camera.cx),
            cy: T::of(camera.cy),
        }
    }
}

/// `points` to view space and to pixels.
pub fn forward<T: Real>(camera: &Camera, points: &[Vector<T>]) -> (Vec<Vector<T>>, Vec<[T; 2]>) {
    let c = Pinhole::<T>::from(camera);
    let to_view = |&x: &Vector<T>| add(mul(&c.rotation, x), c.translation);
    let view: Vec<Vector<T>> = points.iter().map(to_view).collect();
    let to_screen = |&[x, y, z]: &Vector<T>| {
        let z = z.max(T::of(Z_MIN));
        [c.fx * x / z + c.cx, c.fy * y / z + c.cy]
    };
    let screen = view.iter().map(to_screen).collect();
    (view, screen)
}

/// `grad_points += Rᵀ grad_view`
pub fn view_backward<T: Real>(camera: &Camera, grad_view: &[Vector<T>], grad_points: &mut [Vector<T>]) {
    let c = Pinhole::<T>::from(camera);
    for (grad, &g) in grad_points.iter_mut().zip(grad_view) {
        accumulate(grad, mul_transposed(&c.rotation, g));
    }
}

/// `grad_points +=` the gradient through the pixels.
pub fn screen_backward<T: Real>(
    camera: &Camera,
    points: &[Vector<T>],
    grad_screen: &[[T; 2]],
    grad_points: &mut [Vector<T>],
) {
    let c = Pinhole::<T>::from(camera);
    for (i, &[u, v]) in grad_screen.iter().enumerate() {
        let p = add(mul(&c.rotation, points[i]), c.translation);
        let z = p[2].max(T::of(Z_MIN));
        let (x, y) = (c.fx * u / z, c.fy * v / z);
        let depth = if p[2] > T::of(Z_MIN) { -(x * p[0] + y * p[1]) / z } else { T::zero() };
        accumulate(&mut grad_points[i], mul_transposed(&c.rotation, [x, y, depth]));
    }
}
