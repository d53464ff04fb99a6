//! A plain square texture, looked up bilinearly: what most meshes wear, and what the hash texture is compared with (the
//! paper's section on the texture model).
//!
//! | buffer | shape | role |
//! |---|---|---|
//! | `coords` | `[P, 3]` | u to the right and v down in `[0, 1]`, as glTF has them; the third is not read |
//! | `count` | `[1]` u32 | how many of the `P` rows are used, on the device; rows from there on are left alone |
//! | `texels` | `[S, S, 3]` | the parameters, row after row from the top |
//! | `rgb` | `[P, 3]` | result, not bounded |
//!
//! Texel `(i, j)` has its middle at `u = (i + ½) / S`, `v = (j + ½) / S`. A coordinate lies at `position = x · S − ½`, held
//! in `[0, S − 1]`; its colour is the bilinear mean of the four texels around it. Held coordinates get no gradient.
//!
//! Not differentiable, and one-sided there: by the coordinate at the middles of texels (the cell above counts).
//!
//! `grad_texels` is summed as whole numbers ([`super::exact_sum`]).

pub mod cpu;
mod gpu;

pub use gpu::TexelMap;

#[cfg(test)]
mod tests;
