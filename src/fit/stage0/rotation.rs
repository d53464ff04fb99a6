//! Rotation vectors: the exponential map, its inverse, and the Jacobians that turn a step of a rotation
//! vector into a turn in space.

use std::f64::consts::{PI, TAU};

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

/// The rotation vector of `r` that is nearest to `last`, at most [`LONGEST`]. About half a turn, where a person stands
/// whose world has y running down, [`log`] jumps to the opposite side; a motion does not.
pub fn log_near(r: DMat3, last: DVec3) -> DVec3 {
    let short = log(r);
    let angle = short.length();
    let long = if angle > 0.0 { short * (1.0 - TAU / angle) } else { short };
    if long.length() <= LONGEST && long.distance_squared(last) < short.distance_squared(last) { long } else { short }
}

/// Near a whole turn a rotation vector hardly tells its axis.
const LONGEST: f64 = 1.5 * PI;

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turn_in_a_world_that_runs_down_has_no_jumps() {
        // A turn and a half about the body's own axis, leaning to and fro.
        let facing = |t: i32| {
            DMat3::from_rotation_x(PI + 0.05 * (0.9 * f64::from(t)).sin()) * DMat3::from_rotation_y(0.1 * f64::from(t))
        };
        let (mut near, mut far, mut last) = (0, 0, log(facing(0)));
        let mut before = last;
        for t in 1..94 {
            let vector = log_near(facing(t), last);
            assert!((exp(vector) - facing(t)).to_cols_array().iter().all(|x| x.abs() < 1e-9));
            near += usize::from(vector.distance(last) > 0.3);
            far += usize::from(log(facing(t)).distance(before) > 0.3);
            (last, before) = (vector, log(facing(t)));
        }
        assert_eq!(near, 0);
        assert!(far > 10, "{far}: the turn of the test has nothing to tell");
    }

    #[test]
    fn a_small_rotation_stays_small() {
        let w = DVec3::new(0.1, -0.2, 0.3);
        assert!(log_near(exp(w), w * (-TAU / w.length())).distance(w) < 1e-12);
        assert_eq!(log_near(DMat3::IDENTITY, DVec3::X), DVec3::ZERO);
    }
}
