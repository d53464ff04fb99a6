//! The differentiable operators. Each folder holds its contract (`mod.rs`), its kernels' host side (`gpu.rs`) and its
//! reference twin (`cpu.rs`), with the same names in the same order.
//!
//! Conventions of all contracts: arrays are C order and tightly packed f32 (`[N, 3]` is 3·N floats, no padding); a
//! forward pass overwrites its results; a backward pass **adds** to every `grad_<name>` it is given, and the caller
//! clears them.
//!
//! Losses share one buffer `losses [n_slots]`. The `forward` of a loss adds its value, **unweighted**, to the slot it is
//! given ([`LossSlot`], summed by [`reduce::Sum`]), so that the frames of a batch add up; its `backward` takes the weight
//! λ and adds λ·∂L/∂x. The caller clears the slots.

/// The kernel of `shaders/<path>.wgsl`; `path` is its label too.
macro_rules! kernel {
    ($gpu:expr, $path:literal) => {
        kernel!($gpu, $path, &[])
    };
    ($gpu:expr, $path:literal, $constants:expr) => {
        $gpu.kernel($path, include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/shaders/", $path, ".wgsl")), $constants)
    };
}

pub mod adam;
pub mod add;
pub mod anchor;
pub mod angular_acceleration;
mod corners;
pub mod diffuse;
pub mod edge_gradient;
pub mod exact_sum;
pub mod face_area;
pub mod face_normals;
mod fill;
pub mod hard_rasterize;
pub mod interpolate;
pub mod keypoints;
pub mod laplacian;
pub mod large_steps;
pub mod light;
mod linear;
pub mod nmr;
pub mod normal_consistency;
mod pixel_list;
pub mod project;
mod real;
pub mod reduce;
pub mod rgb_l1;
pub mod silhouette_iou;
pub mod skinning;
pub mod soft_rasterize;
mod target;
pub mod temporal;
#[cfg(test)]
pub(crate) mod testing;
pub mod texel_map;
pub mod texture_field;
pub mod topology;
pub mod tridiagonal;

pub use corners::Corners;
pub use pixel_list::PixelList;
pub use real::Real;
pub use reduce::LossSlot;
pub use target::{Target, pack_pixel};
pub use topology::{Rows, Topology};
