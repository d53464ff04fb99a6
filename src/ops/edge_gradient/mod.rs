//! Gradients of a hard-rasterised image with respect to the borders of what it shows (Pidhorskyi et al. 2024).
//!
//! | buffer | shape | role |
//! |---|---|---|
//! | `pix_to_face`, `zbuf`, `alpha` | of [`HardRasterizer`](crate::ops::hard_rasterize::HardRasterizer) | read |
//! | `image`, `grad_image` | `[H, W, 3]` | optional colours and their gradient |
//! | `grad_alpha` | `[H, W]` | gradient of the coverage |
//! | `grad_view` | `[V, 3]` | added to |
//!
//! An edge that passes between the neighbouring pixels A and B and moves by δ pixels towards B turns the share δ of a
//! pixel from `I_B` into `I_A`, all channels together: `dL = ½ (∂L/∂I_A + ∂L/∂I_B) · (I_A − I_B) δ`. The edge belongs to
//! the nearer of both surfaces, here A's: the point that A shows takes the gradient and hands it to its triangle's corners
//! by its barycentric coordinates. Horizontal pairs give motion along x, vertical ones along y. The forward pass is
//! unchanged, and nothing is added where an edge stays inside a pixel.
//!
//! A pair counts where B shows the background, or another face more than `min_step` metres behind A's. The step keeps the
//! borders between the faces of one surface out: there the colours vary within the faces, and their gradient is that of the
//! barycentric coordinates. With one colour a face `min_step = 0` counts those borders too.

pub mod cpu;
mod gpu;

pub use gpu::EdgeGradient;
pub(super) use gpu::ScreenPass;

/// An image and its gradient, `[H, W, 3]` both.
#[derive(Clone, Copy)]
pub struct RgbGradient<'a> {
    pub image: &'a crate::gpu::Buffer<f32>,
    pub grad_image: &'a crate::gpu::Buffer<f32>,
}

#[cfg(test)]
pub(super) mod tests;
