//! SMPL+D (Loper et al. 2015; the paper's geometry model): shape, offsets and pose to a skinned mesh.
//!
//! `v_shaped = v_template + shapedirs β`; joints follow the shape alone, **without** the offsets;
//! `v_deformed = v_shaped + D` (the paper's T-pose mesh M_D); `v_posed = v_deformed + posedirs (R(θ₁…₂₃) − I)`;
//! `vertices = Σ_k w_k A_k (v_posed, 1) + transl`, `A_j = G_j · translation(−J_j)` with G the world transforms of the
//! kinematic chain; `joints = G's translations + transl`.
//!
//! It comes in two parts, because a batch of frames shares one shape: `shape_forward`, then for each frame
//! `pose_forward`, …, `pose_backward`, then `shape_backward` once.
//!
//! | buffer | shape | space, role |
//! |---|---|---|
//! | `betas`, `grad_betas` | `[B]` | |
//! | `offsets`, `grad_offsets` | `[V, 3]` | T-pose, metres |
//! | `poses`, `grad_poses` | `[N, 24, 3]` | axis-angle; one frame's is read or added to |
//! | `transl`, `grad_transl` | `[N, 3]` | metres; likewise |
//! | `v_shaped`, `v_deformed`, `j_shaped` | `[V, 3]`, `[V, 3]`, `[24, 3]` | T-pose; results of `shape_forward` |
//! | `grad_v_deformed`, `grad_j_shaped` | `[V, 3]`, `[24, 3]` | `pose_backward` and losses on M_D add, `shape_backward` reads; the caller clears them once a batch |
//! | `vertices`, `grad_vertices` | `[V, 3]` | world |
//! | `joints`, `grad_joints` | `[24, 3]` | world |
//! | `transforms` | `[24, 3, 4]` | T-pose to world, without `transl`, row-major |
//!
//! Rows of `lbs_weights` sum to 1 (`Body`'s contract); the device takes the gradient of `transl` from that. All sums run
//! in a fixed order.

pub mod cpu;
mod gpu;
mod rodrigues;

pub use gpu::{PoseAt, PoseState, ShapeState, SkinningBody};
pub use rodrigues::{rodrigues, rodrigues_backward};

#[cfg(test)]
mod tests;
