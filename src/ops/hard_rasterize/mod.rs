//! The hard rasteriser: which face each pixel's ray meets first, and where.
//!
//! | buffer | shape | role |
//! |---|---|---|
//! | `view` | `[V, 3]` | vertices in camera space, metres |
//! | `pix_to_face` | `[H, W]` | face index, −1 where there is none |
//! | `bary_coords` | `[H, W, 3]` | perspective-correct barycentric coordinates, zero where there is no face |
//! | `zbuf` | `[H, W]` | camera-space z, metres, −1 where there is no face |
//! | `alpha` | `[H, W]` | 1 where there is a face, else 0 |
//! | `grad_bary`, `grad_zbuf` | as above | read by `backward`, the latter optional |
//! | `grad_view` | `[V, 3]` | added to by `backward` |
//! | `grad_screen` | `[H, W, 2]` | read by `screen_backward`: what motion of a pixel's surface point in the image is worth |
//! | `face_colours`, `image` | `[F, 3]`, `[H, W, 3]` | flat shading: one colour a face over a background |
//!
//! For the ray `r = ((u − cx)/fx, (v − cy)/fy, 1)` of a pixel centre and the corners `v_k`, let `q_k = v_k.xy − r.xy·v_k.z`.
//! The ray meets the triangle where `d_k = q_{k+1} × q_{k+2}` have one sign (an edge counts for both its faces), and
//! `b_k = d_k / Σd`, `z = Σ b_k z_k`: the exact intersection in camera space, whose precision is that of the differences
//! `q`. The nearest face owns the pixel; of faces at one depth the smallest index. Faces with a corner at `z ≤ near` are
//! skipped. Both orientations are drawn unless `cull_back`; a face is a front face when its corners run counter-clockwise
//! seen from outside the body (`Σd < 0`).
//!
//! **Forward** finds the nearest face of each pixel in one pass over the faces, where the device can raise 64-bit numbers
//! atomically, else in two, which take depths a few units in the last place apart as one. Then it lists the pixels that
//! show a face and the faces that a pixel shows; all that follows, the backward passes included, looks at those alone.
//!
//! `backward` differentiates `b` and `z` with respect to the corners for fixed ownership; it is blind to the motion of
//! silhouettes, which [`crate::ops::nmr`], [`crate::ops::edge_gradient`] and [`crate::ops::soft_rasterize`] see.

pub mod cpu;
mod gpu;
mod nearest;
mod owned;

pub use gpu::HardRasterizer;
pub(in crate::ops) use owned::Each;

/// What is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HardRasterizeConfig {
    /// Metres; faces that reach this close are skipped.
    pub near: f64,
    /// Leave out faces that look away.
    pub cull_back: bool,
}

impl Default for HardRasterizeConfig {
    fn default() -> Self {
        Self { near: 0.05, cull_back: false }
    }
}

#[cfg(test)]
mod tests;
