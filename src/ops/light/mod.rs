//! The light that a clip was filmed in: ambient light and one wide lamp far away, both still while the person turns.
//!
//! `shade(n) = ambient + strength · max(0, (n·direction + w) / (1 + w))` a channel, on sRGB values, with unit normals in the
//! world, `direction` the unit vector towards the lamp and [`WRAP`] w: a lamp with an extent reaches a little round the
//! body. A picture shows `albedo · shade`. An ambient part and a clamped cosine rather than spherical harmonics of a higher
//! degree: a single camera sees only normals that face it, and polynomials run wild on those that it did not see
//! (docs/lab/light.md).
//!
//! | buffer | shape | role |
//! |---|---|---|
//! | `normals` | `[R, 3]` | of any length; one without length is shaded by the ambient light alone |
//! | `lamps` | `[R]` | the lamp's part of the shade, `max(0, …)` of the formula; overwritten |
//! | `count` | `[1]` u32 | how many rows are used, on the device |
//! | `values`, `shaded` | `[R, 3]` | `shaded = values · (ambient + strength · lamps)`, overwritten or added to |
//!
//! Linear in `values` and diagonal, so the backward pass by `values` is the same product on gradients. There is no gradient
//! by the normals: shading shall explain the light, and must not bend the mesh to paint stripes.
//!
//! [`Shading::vertex_normals`] sums face normals (twice the area long) at each vertex and makes the sums unit,
//! [`Shading::pixel_lamps`] interpolates those to listed pixels as [`super::interpolate`] does with coordinates.

pub mod cpu;
mod gpu;

pub use gpu::{ShadedRows, Shading, Write};

/// How far the lamp reaches round the body, as the cosine beyond the terminator.
pub const WRAP: f32 = 0.3;

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

    /// What a surface with unit normal `n` gives back of its albedo.
    pub fn shade(&self, n: [f32; 3]) -> [f32; 3] {
        cpu::shade(self, n)
    }
}

#[cfg(test)]
mod tests;
