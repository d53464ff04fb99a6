//! Reference twin.

use super::DEGENERATE;
use crate::ops::Real;
use crate::ops::linear::{Vector, accumulate, cross, dot, scale, sub};

/// `[F]`
pub fn forward<T: Real>(faces: &[[u32; 3]], vertices: &[Vector<T>]) -> Vec<Vector<T>> {
    let normal = |face: &[u32; 3]| {
        let [a, b, c] = face.map(|v| vertices[v as usize]);
        cross(sub(b, a), sub(c, a))
    };
    faces.iter().map(normal).collect()
}

/// `∂L/∂v_k = (v_{k+1} − v_{k+2}) × ∂L/∂n` at corner k.
pub fn backward<T: Real>(
    faces: &[[u32; 3]],
    vertices: &[Vector<T>],
    grad_normals: &[Vector<T>],
    grad_vertices: &mut [Vector<T>],
) {
    for (face, &grad) in faces.iter().zip(grad_normals) {
        for k in 0..3 {
            let [v, next, previous] = [k, (k + 1) % 3, (k + 2) % 3].map(|k| face[k] as usize);
            accumulate(&mut grad_vertices[v], cross(sub(vertices[next], vertices[previous]), grad));
        }
    }
}

/// Direction and length of a normal; zero and zero for a face without area.
pub fn unit_or_zero<T: Real>(normal: Vector<T>) -> (Vector<T>, T) {
    let norm = dot(normal, normal).sqrt();
    if norm > T::of(DEGENERATE) { (scale(T::one() / norm, normal), norm) } else { ([T::zero(); 3], T::zero()) }
}
