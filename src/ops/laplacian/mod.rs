//! Smoothness of the offsets: `Σ_v |D_v − mean_{n∈N(v)} D_n|²` with the uniform Laplacian. Not in the paper; it keeps
//! parts that no picture shows from drifting.
//!
//! | buffer | shape | role |
//! |---|---|---|
//! | `offsets` | `[V, 3]` | metres |
//! | `grad_offsets` | `[V, 3]` | `+= 2λ (r_v − Σ_{n∈N(v)} r_n / deg n)`, r the residuals that `forward` left |
//!
//! `backward` follows `forward` of the same offsets. A vertex without neighbours does not count.

pub mod cpu;
mod gpu;

pub use gpu::Laplacian;

#[cfg(test)]
mod tests;
