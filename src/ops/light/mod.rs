//! The light that a clip was filmed in: ambient light and one wide lamp far away, both still while the person turns.
//!
//! `shade(n) = ambient + strength · visible · max(0, (n·direction + w) / (1 + w))` a channel, on sRGB values, with unit
//! normals in the world, `direction` the unit vector towards the lamp, `visible` the share of the lamp that the point sees
//! ([`shadow`]) and [`WRAP`] w: a lamp with an extent reaches a little round the body. A picture shows `albedo · shade`, at
//! most white. An ambient part and a clamped cosine rather than spherical harmonics of a higher degree: a single camera sees
//! only normals that face it, and polynomials run wild on those that it did not see (docs/lab/light.md).
//!
//! | buffer | shape | role |
//! |---|---|---|
//! | `normals` | `[R, 3]` | of any length; one without length is shaded by the ambient light alone |
//! | `visible` | `[N, V]` | of each vertex in each of N frames, 0 to 1 |
//! | `lamps` | `[R]` | the lamp's part of the shade, `visible · max(0, …)` of the formula; overwritten |
//! | `count` | `[1]` u32 | how many rows are used, on the device |
//! | `values`, `shaded` | `[R, 3]` | `shaded = values · (ambient + strength · lamps)`, see [`Write`] |
//!
//! Linear in `values` and diagonal, so the backward pass by `values` is the same product on gradients. It passes the cut at
//! white: under the L1 loss a colour that is cut has no gradient where the picture is white too, and where the picture is
//! darker the colour shall come down. There is no gradient by the normals: shading shall explain the light, and must not bend
//! the mesh to paint stripes.
//!
//! [`Shading::vertex_normals`] sums face normals (twice the area long) at each vertex and makes the sums unit,
//! [`Shading::pixel_lamps`] interpolates those and `visible` to listed pixels as [`super::interpolate`] does with coordinates,
//! [`Shading::face_lamps`] takes a face's own normal and the mean of its corners' `visible`.

pub mod cpu;
mod gpu;
pub mod shadow;

pub use gpu::{ShadedRows, Shading, VisibleAt, Write};

/// How far the lamp reaches round the body, as the cosine beyond the terminator.
pub const WRAP: f32 = 0.6;

/// A light; see the formula above.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Light {
    /// A channel
    pub ambient: [f32; 3],
    /// A channel
    pub strength: [f32; 3],
    /// Unit vector towards the lamp, world space
    pub direction: [f32; 3],
}

impl Light {
    /// The same from everywhere: pictures show the albedo.
    pub const EVEN: Self = Self { ambient: [1.0; 3], strength: [0.0; 3], direction: [0.0, -1.0, 0.0] };

    /// Whether every number is finite and the direction a unit vector.
    pub fn is_sound(&self) -> bool {
        let all = [self.ambient, self.strength, self.direction];
        let length = self.direction.iter().map(|x| x * x).sum::<f32>();
        all.as_flattened().iter().all(|x| x.is_finite()) && (length - 1.0).abs() < 1e-3
    }

    /// What a surface with normal `n` gives back of its albedo where it sees this share of the lamp.
    pub fn shade(&self, n: [f32; 3], visible: f32) -> [f32; 3] {
        cpu::shade(self, n, visible)
    }

    /// Whether there is a lamp, and with it shadows.
    pub fn has_lamp(&self) -> bool {
        self.strength != [0.0; 3]
    }
}

#[cfg(test)]
mod tests;
