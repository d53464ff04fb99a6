//! The soft rasteriser (Liu et al. 2019): every face near a pixel has a share in its colour and coverage.
//!
//! | buffer | shape | role |
//! |---|---|---|
//! | `view` | `[V, 3]` | vertices in camera space, metres |
//! | `face_colours` | `[F, 3]` | one colour a face |
//! | `surface` | `[H, W]` | optional: the hard image's `zbuf`, −1 where nothing is |
//! | `rgb`, `alpha` | `[H, W, 3]`, `[H, W]` | results; without `alpha` where `surface` is given |
//! | `grad_rgb`, `grad_alpha` | as above | read by `backward` |
//! | `grad_view`, `grad_face_colours` | `[V, 3]`, `[F, 3]` | added to by `backward` |
//!
//! On the image plane in units of `norm_px` pixels, `d²` is the squared distance from the pixel's centre to the
//! triangle's boundary, `x = ±d²/σ` (+ inside) and `D = sigmoid(x)`. With the screen-space barycentric coordinates
//! clamped to [0, 1] and scaled to sum to one, `z = 1/Σ(b_k/z_k)`, `ẑ = (far − z)/(far − near)`. A face counts at a pixel
//! when `near < z < far` and `x > −cut`. Then
//!
//! - `rgb = Σ w_j C_j + w_b C_b` with `w_j ∝ D_j exp(ẑ_j/γ)`, `w_b ∝ exp(ε/γ)`, summing to one;
//! - `alpha = 1 − Π (1 − D_j)`.
//!
//! Both orientations count. Weights are formed from the scores `ln D_j + ẑ_j/γ` less the greatest one, the
//! background's included, and `ln(1 − D)` from the sign form of the softplus, so that neither σ nor γ is too small.
//! Not drawn: faces with a corner at `z ≤ 0`, faces without area. The function is not differentiable where a face
//! begins to count, where the nearest boundary point changes its edge, and where a barycentric coordinate meets its bound.
//!
//! **Exactness.** `cut` is the one approximation of the formula: the reference codes' 9.21 leaves out faces with
//! `D < 1e-4`. With a small γ such a face may still outweigh the background, so the cut decides how far colours bleed
//! over the silhouette; an infinite-like cut (`1e6`) gives the formula itself.
//!
//! **Colours alone.** Where coverage is not wanted, `forward` takes the depths of the hard image of the same view and leaves
//! out, tile by tile, the faces that lie so deep behind all that the tile shows that their share is below `e⁻¹²`. Half
//! of a body is its far side.
//!
//! **Forward** bins faces into tiles of 4 × 4 pixels. The lists together hold `list_capacity` entries; a tile whose list
//! does not fit goes through all the faces instead: slow, never wrong; [`SoftRasterizer::list_length`] tells. Faces come into
//! a list as they arrive and are then put in order, so that every run sums them alike.
//!
//! **Backward** goes face by face over the pixels within reach and writes each face's corners once, in a fixed order and without
//! float atomics.
//!
//! Where many cores run side by side, a workgroup takes a tile or a face and shares it among its invocations (`forward_spread`,
//! `backward_spread`); a driver that computes on the CPU has an invocation take it alone (`forward`, `backward`).

pub mod cpu;
mod gpu;

pub use gpu::SoftRasterizer;

/// The constants of one image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SoftRasterizeParams {
    /// Squared normalised distance over which coverage fades.
    pub sigma: f64,
    /// Softness of depth in units of `far − near`.
    pub gamma: f64,
    /// The background's depth `ẑ`.
    pub eps: f64,
    /// Metres.
    pub near: f64,
    /// Metres.
    pub far: f64,
    /// Faces further outside than `d² = cut·σ` do not count.
    pub cut: f64,
    /// The unit of the normalised image plane, in pixels: half the longer side of the full image, also for a crop.
    pub norm_px: f64,
    pub background: [f64; 3],
}

impl SoftRasterizeParams {
    /// The reference codes' [`SoftRasterizeParams::cut`].
    pub const CUT: f64 = 9.21;

    /// The reference values for a full image of `width × height`.
    pub fn new(width: u32, height: u32) -> Self {
        Self {
            sigma: 1e-5,
            gamma: 1e-4,
            eps: 1e-3,
            near: 1.0,
            far: 100.0,
            cut: Self::CUT,
            norm_px: f64::from(width.max(height)) / 2.0,
            background: [0.0; 3],
        }
    }

    /// How far outside its border a face still counts, in pixels.
    pub fn reach_px(&self) -> f64 {
        (self.cut * self.sigma).sqrt() * self.norm_px
    }
}

#[cfg(test)]
mod tests;
