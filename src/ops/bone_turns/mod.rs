//! Poses from how far each bone has turned **in space**, so that a bone can turn without those that hang on it.
//!
//! | buffer | shape | role |
//! |---|---|---|
//! | `start` | `[N, 24, 3]` | axis-angle, relative to the parent as SMPL has it: where nothing has turned |
//! | `turns`, `grad_turns` | `[N, 24, 3]` | rotation vectors, radians; `backward` adds to `grad_turns` |
//! | `poses` | `[N, 24, 3]` | axis-angle; overwritten |
//! | `grad_poses` | `[N, 24, 3]` | read |
//!
//! With `exp` the rotation of a rotation vector, `Gˢ_j` the orientation in space of joint j in `start` and `p` its parent: a joint `in_space`
//! turns its bone about the bone's own axes, `G_j = Gˢ_j exp(turns_j)`, and `poses_j = log(G_pᵀ G_j)`: the children follow in place, not
//! in orientation. Every other joint has `poses_j = start_j + turns_j` and `G_j = G_p exp(poses_j)`: its turn takes along all that hangs
//! on it, up to the next joint in space.
//!
//! Why: in SMPL's angles three joints must move at once, against each other, to turn a pelvis between a chest and legs that are right,
//! and each of them alone makes a picture much worse. An optimiser that scales each number by its own gradients goes along
//! such a valley slowly (docs/lab/poses.md).
//!
//! `log` gives the rotation vector of the branch of `start_j`, which goes on beyond half a turn: somebody upright before a camera whose
//! y runs down stands there. It is not differentiable at a whole turn.
//!
//! Derivatives are taken by turns from the right, `R exp(δ)`: by `w` of `exp(w)` they are `J(w)ᵀ` times those, and back `J(w)⁻ᵀ`, with
//! `Jᵀ(w) = I + (1 − cos t) / t² [w]× + (t − sin t) / t³ [w]×²` and `J⁻ᵀ(w) = I − ½ [w]× + (1 − t/2 cot t/2) / t² [w]×²`, `t = |w|`
//! (Chirikjian 2012, "Stochastic Models, Information Theory, and Lie Groups" 2, §10.6).

pub mod cpu;
mod gpu;
mod quaternion;

pub use cpu::Joints;
pub use gpu::BoneTurns;

#[cfg(test)]
mod tests;
