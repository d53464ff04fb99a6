//! Rotations from axis-angle vectors, exact and differentiable everywhere.
//!
//! With `t = |θ|`, `K = [θ]×`: `R = I + a K + b K²`, `a = sin t / t`, `b = (1 − cos t) / t²`; because `K² = θθᵀ − t² I`
//! this is `R = (1 − b t²) I + a K + b θθᵀ`, and `1 − b t² = cos t`. A gradient `G` by `R` gives, with
//! `axial(G) = (G₂₁ − G₁₂, G₀₂ − G₂₀, G₁₀ − G₀₁)` (so that `G : K = axial(G)·θ`) and `∂t/∂θ = θ / t`,
//!
//! `∂L/∂θ = a axial(G) + b (G + Gᵀ) θ + [ −a tr G + (a′/t) axial(G)·θ + (b′/t) θᵀGθ ] θ`.
//!
//! All factors are even functions of t; near 0 they are taken from their series.

use crate::ops::Real;
use crate::ops::linear::{Matrix, Vector, add, dot, mul, mul_transposed, scale};

struct Factors<T> {
    a: T,
    b: T,
    /// `a′ / t`
    da: T,
    /// `b′ / t`
    db: T,
}

/// Below this squared angle the series are exact to double precision, and above it the closed forms lose few digits.
const SERIES_BELOW: f64 = 1e-2;

fn factors<T: Real>(t2: T) -> Factors<T> {
    let c = T::of;
    if t2 < c(SERIES_BELOW) {
        return Factors {
            a: c(1.0) - t2 / c(6.0) * (c(1.0) - t2 / c(20.0) * (c(1.0) - t2 / c(42.0))),
            b: c(0.5) - t2 / c(24.0) * (c(1.0) - t2 / c(30.0) * (c(1.0) - t2 / c(56.0))),
            da: c(-1.0 / 3.0) + t2 / c(30.0) * (c(1.0) - t2 / c(28.0)),
            db: c(-1.0 / 12.0) + t2 / c(180.0) * (c(1.0) - t2 / c(112.0 / 3.0)),
        };
    }
    let t = t2.sqrt();
    let a = t.sin() / t;
    let half = (c(0.5) * t).sin() / t;
    let b = c(2.0) * half * half;
    Factors { a, b, da: (t.cos() - a) / t2, db: (a - c(2.0) * b) / t2 }
}

/// The rotation of `theta` (axis times angle, radians).
pub fn rodrigues<T: Real>(theta: Vector<T>) -> Matrix<T> {
    let t2 = dot(theta, theta);
    let Factors { a, b, .. } = factors(t2);
    let cos = T::one() - b * t2;
    let [x, y, z] = theta;
    [
        [cos + b * x * x, b * x * y - a * z, b * x * z + a * y],
        [b * x * y + a * z, cos + b * y * y, b * y * z - a * x],
        [b * x * z - a * y, b * y * z + a * x, cos + b * z * z],
    ]
}

/// The gradient by `theta`, from the gradient `g` by the rotation.
pub fn rodrigues_backward<T: Real>(theta: Vector<T>, g: &Matrix<T>) -> Vector<T> {
    let Factors { a, b, da, db } = factors(dot(theta, theta));
    let axial = [g[2][1] - g[1][2], g[0][2] - g[2][0], g[1][0] - g[0][1]];
    let g_theta = mul(g, theta);
    let trace = g[0][0] + g[1][1] + g[2][2];
    let radial = da * dot(axial, theta) + db * dot(theta, g_theta) - a * trace;
    let symmetric = add(g_theta, mul_transposed(g, theta));
    add(add(scale(a, axial), scale(b, symmetric)), scale(radial, theta))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ops::linear::{identity, product, transpose};
    use crate::ops::testing::{assert_close, assert_gradient};

    const THETAS: [(&str, Vector<f64>); 5] = [
        ("zero", [0.0, 0.0, 0.0]),
        ("inside the series", [0.03, -0.05, 0.04]),
        ("just outside the series", [0.06, 0.05, -0.07]),
        ("large", [1.2, -0.7, 1.9]),
        ("beyond a half turn", [-2.5, 2.0, 1.5]),
    ];

    #[test]
    fn rotations_are_orthogonal_and_turn_by_the_angle() {
        for (case, theta) in THETAS {
            let r = rodrigues(theta);
            assert_close(case, product(&r, &transpose(&r)).as_flattened(), identity::<f64>().as_flattened(), 1e-13);
            assert_close(case, &mul(&r, theta), &theta, 1e-13);
            let trace = r[0][0] + r[1][1] + r[2][2];
            assert!((trace - (1.0 + 2.0 * dot(theta, theta).sqrt().cos())).abs() < 1e-13, "{case}: trace {trace}");
        }
        let quarter = rodrigues([0.0, 0.0, std::f64::consts::FRAC_PI_2]);
        assert_close("x to y", &mul(&quarter, [1.0, 0.0, 0.0]), &[0.0, 1.0, 0.0], 1e-15);
    }

    #[test]
    fn backward_agrees_with_central_differences_on_both_sides_of_the_series() {
        let g = [[0.3, -1.1, 0.7], [0.2, 0.9, -0.4], [-0.8, 0.5, 1.3]];
        for (case, theta) in THETAS {
            let gradient = rodrigues_backward(theta, &g);
            assert_gradient(case, &theta, &gradient, |x| {
                let r = rodrigues([x[0], x[1], x[2]]);
                r.as_flattened().iter().zip(g.as_flattened()).map(|(r, g)| r * g).sum()
            });
        }
    }
}
