//! Reference twin.

use super::Sampling;
use crate::ops::Real;

/// The list of covered pixels.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PixelList<T> {
    pub pixel_index: Vec<u32>,
    pub coords: Vec<T>,
}

/// `pix_to_face [H·W]`, `bary_coords [H·W, 3]`, `faces [F, 3]`, `texcoords [V, 3]`.
pub fn forward<T: Real>(
    pix_to_face: &[i32],
    bary_coords: &[T],
    faces: &[u32],
    texcoords: &[T],
    sampling: Sampling,
) -> PixelList<T> {
    let mut list = PixelList::default();
    for (i, &face) in pix_to_face.iter().enumerate() {
        if face < 0 || !sampling.keeps(i as u32) {
            continue;
        }
        list.pixel_index.push(i as u32);
        for axis in 0..3 {
            let corner = |c: usize| bary_coords[3 * i + c] * texcoords[vertex(faces, face, c) + axis];
            list.coords.push((0..3).map(corner).sum());
        }
    }
    list
}

/// Adds to `grad_texcoords [V, 3]` and `grad_bary [H·W, 3]` what `grad_coords` of the listed pixels says.
#[expect(clippy::too_many_arguments, reason = "the operands of the contract")]
pub fn backward<T: Real>(
    pixel_index: &[u32],
    pix_to_face: &[i32],
    bary_coords: &[T],
    faces: &[u32],
    texcoords: &[T],
    grad_coords: &[T],
    grad_texcoords: &mut [T],
    grad_bary: &mut [T],
) {
    for (&i, grad) in pixel_index.iter().zip(grad_coords.chunks_exact(3)) {
        let i = i as usize;
        for c in 0..3 {
            let v = vertex(faces, pix_to_face[i], c);
            for axis in 0..3 {
                grad_texcoords[v + axis] += bary_coords[3 * i + c] * grad[axis];
                grad_bary[3 * i + c] += texcoords[v + axis] * grad[axis];
            }
        }
    }
}

/// `image [H·W, 3]` of the listed pixels' `rgb` over a background.
pub fn scatter<T: Real>(pixel_index: &[u32], rgb: &[T], background: [T; 3], n_pixels: usize) -> Vec<T> {
    let mut image = background.repeat(n_pixels);
    for (&i, color) in pixel_index.iter().zip(rgb.chunks_exact(3)) {
        image[3 * i as usize..][..3].copy_from_slice(color);
    }
    image
}

/// The listed pixels' values of `image [H·W, 3]`.
pub fn gather<T: Real>(pixel_index: &[u32], image: &[T]) -> Vec<T> {
    pixel_index.iter().flat_map(|&i| [0, 1, 2].map(|c| image[3 * i as usize + c])).collect()
}

/// Where the corner's attribute begins.
fn vertex(faces: &[u32], face: i32, corner: usize) -> usize {
    3 * faces[3 * face as usize + corner] as usize
}
