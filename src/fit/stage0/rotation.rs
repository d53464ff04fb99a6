//! Rotation vectors: the exponential map, its inverse, and the Jacobians that turn a step of a rotation
//! vector into a turn in space.

use glam::{DMat3, DQuat, DVec3};

/// `[w]×`
pub fn skew(w: DVec3) -> DMat3 {
    DMat3::from_cols(DVec3::new(0.0, w.z, -w.y), DVec3::new(-w.z, 0.0, w.x), DVec3::new(w.y, -w.x, 0.0))
}

/// The rotation by `|w|` radians about `w`.
pub fn exp(w: DVec3) -> DMat3 {
    let angle = w.length();
    if angle < 1e-12 { DMat3::IDENTITY + skew(w) } else { DMat3::from_axis_angle(w / angle, angle) }
}

/// The rotation vector of `r`, at most π long.
pub fn log(r: DMat3) -> DVec3 {
    let q = DQuat::from_mat3(&r).normalize();
    let v = DVec3::new(q.x, q.y, q.z);
    let (v, w) = if q.w < 0.0 { (-v, -q.w) } else { (v, q.w) };
    let s = v.length();
    if s < 1e-12 { v * 2.0 } else { v * (2.0 * s.atan2(w) / s) }
}

/// `J` with `exp(w + d) ≈ exp(J d) exp(w)`: its columns are the axes in space about which the three
/// components of a rotation vector turn.
pub fn left_jacobian(w: DVec3) -> DMat3 {
    let angle2 = w.length_squared();
    let k = skew(w);
    let (a, b) = if angle2 < 1e-8 {
        (0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0)
    } else {
        let angle = angle2.sqrt();
        ((1.0 - angle.cos()) / angle2, (angle - angle.sin()) / (angle2 * angle))
    };
    DMat3::IDENTITY + k * a + k * k * b
}

/// `J⁻¹` of [`left_jacobian`]; with `−w` it is the inverse of the right one.
pub fn left_jacobian_inverse(w: DVec3) -> DMat3 {
    let angle2 = w.length_squared();
    let k = skew(w);
    let b = if angle2 < 1e-8 {
        1.0 / 12.0
    } else {
        let angle = angle2.sqrt();
        1.0 / angle2 - (1.0 + angle.cos()) / (2.0 * angle * angle.sin())
    };
    DMat3::IDENTITY - k * 0.5 + k * k * b
}
