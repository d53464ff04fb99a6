//! Reference twin.

use super::{Light, WRAP};
use crate::ops::Real;

/// The lamp's part of `shade(n)` where all of it is visible, for a normal of any length.
pub fn lamp<T: Real>(light: &Light, n: [T; 3]) -> T {
    let length = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
    let cosine = if length > T::zero() {
        let d = light.direction.map(|x| T::of(x.into()));
        (n[0] * d[0] + n[1] * d[1] + n[2] * d[2]) / length
    } else {
        T::of(-1.0)
    };
    let wrap = T::of(WRAP.into());
    ((cosine + wrap) / (T::one() + wrap)).max(T::zero())
}

/// `shade(n)`, for a normal of any length.
pub fn shade<T: Real>(light: &Light, n: [T; 3], visible: T) -> [T; 3] {
    let lamp = visible * lamp(light, n);
    std::array::from_fn(|k| T::of(light.ambient[k].into()) + T::of(light.strength[k].into()) * lamp)
}

/// `values · shade(normals)`, `[P, 3]` both, `visible [P]`.
pub fn apply<T: Real>(light: &Light, normals: &[T], visible: &[T], values: &[T]) -> Vec<T> {
    let rows = normals.as_chunks::<3>().0.iter().zip(visible).zip(values.as_chunks::<3>().0);
    rows.flat_map(|((&n, &visible), value)| {
        let shade = shade(light, n, visible);
        [0, 1, 2].map(|k| value[k] * shade[k])
    })
    .collect()
}

/// `[V, 3]`: the sum of the normals of the faces at each vertex, made unit; zero where there is none.
pub fn vertex_normals<T: Real>(faces: &[[u32; 3]], face_normals: &[T], n_vertices: usize) -> Vec<T> {
    let mut sums = vec![T::zero(); 3 * n_vertices];
    for (f, face) in faces.iter().enumerate() {
        for &v in face {
            (0..3).for_each(|k| sums[3 * v as usize + k] += face_normals[3 * f + k]);
        }
    }
    for n in sums.as_chunks_mut::<3>().0 {
        let length = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
        if length > T::zero() {
            n.iter_mut().for_each(|x| *x /= length);
        }
    }
    sums
}
