//! Reference twin.

use super::{Light, WRAP};
use crate::ops::Real;

/// The parts of `shade(n)` of the ambient light and of the lamp where nothing is in the way, for a normal of any length.
pub fn parts<T: Real>(light: &Light, n: [T; 3]) -> [T; 2] {
    let length = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
    if length == T::zero() {
        return [T::one(), T::zero()];
    }
    let [slope, cosine] = [light.slope, light.direction].map(|d| {
        let d = d.map(|x| T::of(x.into()));
        (n[0] * d[0] + n[1] * d[1] + n[2] * d[2]) / length
    });
    let wrap = T::of(WRAP.into());
    [(T::one() + slope).max(T::zero()), ((cosine + wrap) / (T::one() + wrap)).max(T::zero())]
}

/// `shade(n)`, for a normal of any length; `exposure`: `open^occlusion` and `visible`.
pub fn shade<T: Real>(light: &Light, n: [T; 3], exposure: [T; 2]) -> [T; 3] {
    let [ambient, lamp] = parts(light, n);
    let (ambient, lamp) = (exposure[0] * ambient, exposure[1] * lamp);
    std::array::from_fn(|k| T::of(light.ambient[k].into()) * ambient + T::of(light.strength[k].into()) * lamp)
}

/// `values · shade(normals)`, `[P, 3]` both, `exposure [P, 2]`.
pub fn apply<T: Real>(light: &Light, normals: &[T], exposure: &[T], values: &[T]) -> Vec<T> {
    let (normals, exposure, values) = (normals.as_chunks::<3>().0, exposure.as_chunks().0, values.as_chunks::<3>().0);
    let rows = normals.iter().zip(exposure).zip(values);
    rows.flat_map(|((&n, &exposure), value)| {
        let shade = shade(light, n, exposure);
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
