//! What a rendered image is compared with.

use crate::gpu::{AnyBuffer, Buffer};

/// A frame's crop on the device; it has as many pixels as the image that it is compared with.
#[derive(Clone, Copy)]
pub enum Target<'a> {
    /// One u32 a pixel, from pixel `offset` on: bytes r, g, b, mask, r the lowest, each over 255. Frames lie one after
    /// another. With a background the colour is `mask · rgb + (1 − mask) · background`, the masked ground truth.
    Packed { pixels: &'a Buffer<u32>, offset: usize, background: Option<[f32; 3]> },
    /// Floats: `[H, W, 3]` where colours are compared, `[H, W]` where the mask is.
    Values(&'a Buffer<f32>),
}

/// How [`Target`] packs a pixel.
pub fn pack_pixel([r, g, b]: [u8; 3], mask: u8) -> u32 {
    u32::from_le_bytes([r, g, b, mask])
}

impl<'a> Target<'a> {
    pub(super) fn is_packed(&self) -> bool {
        matches!(self, Self::Packed { .. })
    }

    /// # Panics
    /// When there are fewer than `n_pixels` pixels; `channels` is that of `Values`.
    pub(super) fn buffer(&self, n_pixels: usize, channels: usize) -> &'a dyn AnyBuffer {
        match *self {
            Self::Packed { pixels, offset, .. } => {
                assert!(offset + n_pixels <= pixels.len(), "{}: length", pixels.label());
                pixels
            }
            Self::Values(values) => {
                assert!(values.len() >= n_pixels * channels, "{}: length", values.label());
                values
            }
        }
    }

    pub(super) fn offset(&self) -> u32 {
        match *self {
            Self::Packed { offset, .. } => offset as u32,
            Self::Values(_) => 0,
        }
    }

    pub(super) fn background(&self) -> Option<[f32; 3]> {
        match *self {
            Self::Packed { background, .. } => background,
            Self::Values(_) => None,
        }
    }
}
