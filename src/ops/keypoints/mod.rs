//! Keypoints on the body and their loss, the paper's L_kps weighted by confidence.
//!
//! [`KeypointGather`] reads keypoints off the posed mesh and skeleton ([`KeypointSource`](crate::body::KeypointSource):
//! a joint or a mean); [`project`](crate::ops::project) takes them to pixels; [`KeypointLoss`] compares them:
//! `Σ_k c_k ρ(|k̂_k − k_k|²)` with `ρ(r²) = r²`, or Geman & McClure's `ρ² r² / (r² + ρ²)`, which a wrong detection pulls
//! no farther than ρ² (SMPLify-X uses ρ = 100 px). As ρ grows the second becomes the first.
//!
//! | buffer | shape | space, role |
//! |---|---|---|
//! | `vertices`, `joints` and their gradients | `[V, 3]`, `[24, 3]` | world |
//! | `keypoints`, `grad_keypoints` | `[K, 3]` | world; a keypoint without source stays at 0 |
//! | `screen`, `grad_screen` | `[K, 2]` | pixels of the whole image, or of the crop that `targets` are in |
//! | `targets` | `[N, K, 3]` | x, y, confidence; one frame's is read; confidence ≤ 0: not seen, x and y may be anything |

pub mod cpu;
mod gather;
mod gpu;

pub use gather::KeypointGather;
pub use gpu::KeypointLoss;

#[cfg(test)]
mod tests;
