//! The way back through a lens, and how far it goes.

use super::{BadInput, Part};
use crate::camera::Camera;

/// The inverse of [`Camera::distorted`] by damped Newton steps with a numeric Jacobian.
pub(super) fn undistort(lens: &Camera, [u, v]: [f64; 2], valid_radius: f64) -> Option<[f64; 2]> {
    const STEP: f64 = 1e-6;
    let (mut x, mut y) = (u, v);
    // Far points start on the border of where the inverse exists.
    let radius = x.hypot(y);
    if radius > valid_radius {
        (x, y) = (x * valid_radius / radius, y * valid_radius / radius);
    }
    for _ in 0..50 {
        let [a, b] = lens.distorted([x, y]);
        let (eu, ev) = (a - u, b - v);
        if eu.hypot(ev) < 1e-10 {
            return (x.hypot(y) <= valid_radius * (1.0 + 1e-9)).then_some([x, y]);
        }
        let [ax, bx] = lens.distorted([x + STEP, y]);
        let [ay, by] = lens.distorted([x, y + STEP]);
        let (jxx, jyx, jxy, jyy) = ((ax - a) / STEP, (bx - b) / STEP, (ay - a) / STEP, (by - b) / STEP);
        let determinant = jxx * jyy - jxy * jyx;
        if determinant.abs() < 1e-9 {
            return None;
        }
        let (dx, dy) = ((jyy * eu - jxy * ev) / determinant, (jxx * ev - jyx * eu) / determinant);
        // Steps longer than a part of the field would jump over the fold.
        let damping = (0.25 / dx.hypot(dy)).min(1.0);
        (x, y) = (x - damping * dx, y - damping * dy);
    }
    None
}

/// Up to which normalised radius the radial part grows. It must reach most of the way to the image's corners: a
/// polynomial that turns back earlier is no calibration of these images.
pub(super) fn valid_radius(camera: &Camera) -> Result<f64, BadInput> {
    let far = |centre: f64, side: u32, focal: f64| centre.abs().max((f64::from(side) - centre).abs()) / focal;
    let corner = far(camera.cx, camera.width, camera.fx).hypot(far(camera.cy, camera.height, camera.fy));
    let most = 2.0 * corner;
    for i in 1..=512 {
        let r = most * f64::from(i) / 512.0;
        if camera.radial_growth(r * r) <= 0.05 {
            if r < 0.7 * corner {
                let message = "the distortion folds the image over within its borders";
                return Err(BadInput::new(Part::Camera, message, "k1, k2, p1, p2, k3 of OpenCV's model"));
            }
            return Ok(r);
        }
    }
    Ok(most)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inverse_inverts_within_the_valid_radius_and_refuses_beyond() {
        let distortion = [-0.3, 0.05, 0.001, -0.002, 0.0];
        let lens = Camera { distortion, ..Camera::pinhole(640, 480, [500.0, 500.0, 320.0, 240.0]) };
        for i in 0..100 {
            let (u, v) = (f64::from(i % 10) / 10.0 - 0.45, f64::from(i / 10) / 10.0 - 0.45);
            let distorted = lens.distorted([u, v]);
            let [x, y] = undistort(&lens, distorted, 0.9).unwrap();
            assert!((x - u).abs() < 1e-8 && (y - v).abs() < 1e-8, "({u}, {v}) came back as ({x}, {y})");
        }
        assert_eq!(undistort(&lens, [5.0, 5.0], 0.9), None);
    }
}
