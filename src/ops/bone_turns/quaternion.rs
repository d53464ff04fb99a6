//! Rotations of the reference twin: unit quaternions and rotation vectors.

use crate::ops::Real;
use crate::ops::linear::{Vector, accumulate, add, cross, dot, scale};

/// A unit quaternion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quaternion<T> {
    pub v: Vector<T>,
    pub w: T,
}

impl<T: Real> Quaternion<T> {
    pub fn identity() -> Self {
        Self { v: [T::zero(); 3], w: T::one() }
    }

    /// The rotation by `|vector|` radians about `vector`.
    pub fn exp(vector: Vector<T>) -> Self {
        let t2 = dot(vector, vector);
        let half = T::of(0.5) * t2.sqrt();
        let factor = if t2 < T::of(1e-4) { T::of(0.5) - t2 / T::of(48.0) } else { half.sin() / (half + half) };
        Self { v: scale(factor, vector), w: half.cos() }
    }

    /// The rotation vector, of the two within a whole turn that whose quaternion is on `near`'s side.
    pub fn log(self, near: Self) -> Vector<T> {
        let side = if dot(self.v, near.v) + self.w * near.w < T::zero() { -T::one() } else { T::one() };
        let (v, w) = (scale(side, self.v), side * self.w);
        let sine = dot(v, v).sqrt();
        let factor = if sine < T::of(1e-6) { T::of(2.0) } else { T::of(2.0) * sine.atan2(w) / sine };
        scale(factor, v)
    }

    pub fn inverse(self) -> Self {
        Self { v: scale(-T::one(), self.v), w: self.w }
    }

    /// `self` after `first`.
    pub fn after(self, first: Self) -> Self {
        let (a, b) = (self, first);
        let v = add(add(scale(a.w, b.v), scale(b.w, a.v)), cross(a.v, b.v));
        Self { v, w: a.w * b.w - dot(a.v, b.v) }
    }

    pub fn rotate(self, x: Vector<T>) -> Vector<T> {
        let twice = scale(T::of(2.0), cross(self.v, x));
        add(add(x, scale(self.w, twice)), cross(self.v, twice))
    }
}

/// `Jᵀ(w) torque`: the gradient by w of `exp(w)`, from that by turns from the right.
pub fn by_vector<T: Real>(w: Vector<T>, torque: Vector<T>) -> Vector<T> {
    let t2 = dot(w, w);
    let (a, b) = if t2 < T::of(1e-2) {
        (
            T::of(0.5) - t2 / T::of(24.0) * (T::one() - t2 / T::of(30.0)),
            T::of(1.0 / 6.0) - t2 / T::of(120.0) * (T::one() - t2 / T::of(42.0)),
        )
    } else {
        let t = t2.sqrt();
        ((T::one() - t.cos()) / t2, (t - t.sin()) / (t2 * t))
    };
    combined(w, torque, a, b)
}

/// `J⁻ᵀ(w) gradient`: the gradient by turns from the right, from that by w.
pub fn by_turn<T: Real>(w: Vector<T>, gradient: Vector<T>) -> Vector<T> {
    let t2 = dot(w, w);
    let b = if t2 < T::of(1e-2) {
        T::of(1.0 / 12.0) + t2 / T::of(720.0) * (T::one() + t2 / T::of(42.0))
    } else {
        let half = T::of(0.5) * t2.sqrt();
        (T::one() - half / half.tan()) / t2
    };
    combined(w, gradient, T::of(-0.5), b)
}

/// `x + a [w]× x + b [w]×² x`
fn combined<T: Real>(w: Vector<T>, x: Vector<T>, a: T, b: T) -> Vector<T> {
    let (once, mut sum) = (cross(w, x), x);
    accumulate(&mut sum, scale(a, once));
    accumulate(&mut sum, scale(b, cross(w, once)));
    sum
}
