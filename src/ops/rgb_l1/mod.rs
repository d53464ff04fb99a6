//! The colour loss `Σ_p w_p Σ_c |Î − I|` (the paper's L_RGB), summed, not averaged.
//!
//! | buffer | shape | role |
//! |---|---|---|
//! | `image` | `[H, W, 3]` | the rendered image Î |
//! | target | [`Target`](crate::ops::Target) | the masked ground truth I |
//! | `weights` | `[H, W]` | optional weight of each pixel |
//! | `grad_image` | `[H, W, 3]` | `backward` adds `λ w sign(Î − I)`, zero where both are equal |
//!
//! `forward_backward` does both in one pass, over all pixels with weight one or over listed ones with the weights of their
//! [`PixelList`](crate::ops::PixelList), and, against the rule, overwrites `grad_image`: nothing has to be read first. Pixels
//! that are not listed do not count. Of a sample of the listed ones both are estimates: a kept pixel counts 1 / rate times.

pub mod cpu;
mod gpu;

pub use gpu::{Pixels, RgbL1};

#[cfg(test)]
mod tests;
