//! The silhouette gradient of the neural mesh renderer (Kato et al. 2018): pixels far from a border pull on it too.
//!
//! Buffers are those of [`edge_gradient`](crate::ops::edge_gradient), and so is which borders there are: a pixel p whose
//! surface ends before its neighbour q and hides what q shows. From each, along the row or the column,
//!
//! - **outward** to the border of the image: at each pixel r, `Δ = (I_r − I_p) · ∂L/∂I_r` is what the loss would fall by if
//!   the surface reached r, at distance `d` from the border;
//! - **inward** while r shows the same face, to its opposite edge: `Δ = (I_r − I_q) · ∂L/∂I_r`, if the surface ended before r.
//!
//! Only `Δ > 0` counts. The derivative of the loss for the border moving outward is `Σ inward Δ/d − Σ outward Δ/d`; it
//! goes to the point that p shows and from there to its triangle's corners. The border is taken to lie midway between p
//! and q. Edges inside the silhouette, which move nothing that is seen, are not swept: the work is that of the borders.
//!
//! This is a surrogate, not the derivative of anything: it gives a direction where the image's own derivative is zero.
//! Colours have their exact gradient in [`hard_rasterize`](crate::ops::hard_rasterize).

pub mod cpu;
mod gpu;

pub use gpu::{Nmr, NmrConfig};

#[cfg(test)]
mod tests;
