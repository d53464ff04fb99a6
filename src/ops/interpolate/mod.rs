//! The list of covered pixels with the vertices' attributes interpolated to each, and the way back to images.
//!
//! | buffer | shape | role |
//! |---|---|---|
//! | `pix_to_face`, `bary_coords` | `[H, W]` i32, `[H, W, 3]` | the hard rasteriser's results; −1 is no face |
//! | `faces` | `[F, 3]` u32 | corners |
//! | `texcoords` | `[V, 3]` | the attribute; the learned 3D texture coordinates |
//! | `count` | `[1]` u32 | result: listed pixels |
//! | `pixel_index` | `[P]` u32 | result: `row · W + column`, rising |
//! | `coords` | `[P, 3]` | result: `Σ_c bary_coords[pixel, c] · texcoords[faces[face, c]]` |
//! | `grad_coords` | `[P, 3]` | upstream of `backward` |
//! | `grad_texcoords`, `grad_bary` | `[V, 3]`, `[H, W, 3]` | added to |
//!
//! The list keeps the order of the pixels whatever the timing: a mask for 32 pixels, a scan over the masks, a write.
//! With a [`Sampling`] it holds a random part of the covered pixels, the same for the same seed. Where more pixels are
//! kept than the capacity, those at the end are left out.
//!
//! `scatter` puts `rgb [P, 3]` into an image over one background colour; `gather` is its derivative, and overwrites,
//! because each row has one source. Rows from `count` on are neither read nor written by any pass.

pub mod cpu;
mod gpu;

pub use gpu::Interpolate;

/// A random part of the covered pixels: each is kept with probability `rate`, decided by a hash of pixel and seed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampling {
    /// In `(0, 1]`; 1 keeps all.
    pub rate: f64,
    pub seed: u32,
}

impl Sampling {
    pub const ALL: Self = Self { rate: 1.0, seed: 0 };

    /// The highest hash that is kept.
    pub(super) fn threshold(&self) -> u32 {
        ((self.rate * 4_294_967_296.0).round().clamp(1.0, 4_294_967_296.0) as u64 - 1) as u32
    }

    /// Whether a pixel is in the sample, if it is covered.
    pub(super) fn keeps(&self, pixel: u32) -> bool {
        pcg(pcg(self.seed).wrapping_add(pixel)) <= self.threshold()
    }
}

/// As in `shaders/shared/sample.wgsl`.
fn pcg(value: u32) -> u32 {
    let state = value.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
    let word = ((state >> ((state >> 28) + 4)) ^ state).wrapping_mul(277_803_737);
    (word >> 22) ^ word
}

#[cfg(test)]
mod tests;
