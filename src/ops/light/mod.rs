//! The light that a clip was filmed in: ambient light and one wide lamp far away, both still while the person turns.
//!
//! `shade(n) = ambient · open^occlusion · (1 + n·slope) + strength · visible · max(0, (n·direction + w) / (1 + w))` a channel,
//! on sRGB values, with unit normals in the world, `slope` towards where the ambient light is brightest, `direction` the unit
//! vector towards the lamp, `open` the share of its surroundings that the point sees ([`occlusion`]), `visible` the share of the
//! lamp ([`shadow`]) and [`WRAP`] w: a lamp with an extent reaches a little round the body. A picture shows `albedo · shade`, at
//! most white. An ambient part and a clamped cosine rather than spherical harmonics of a higher degree: a single camera sees
//! only normals that face it, and polynomials run wild on those that it did not see (docs/lab/light.md).
//!
//! | buffer | shape | role |
//! |---|---|---|
//! | `normals` | `[R, 3]` | of any length; one without length is shaded by the ambient light alone, without its slope |
//! | `exposure` | `[V, 2]` | of each vertex in one frame `open^occlusion` and `visible`, 0 to 1 |
//! | `parts` | `[R, 2]` | of the shade: `open^occlusion · (1 + n·slope)` and `visible · max(0, …)` of the formula; overwritten |
//! | `count` | `[1]` u32 | how many rows are used, on the device |
//! | `values`, `shaded` | `[R, 3]` | `shaded = values · (ambient · parts₀ + strength · parts₁)`, see [`Write`] |
//!
//! Linear in `values` and diagonal, so the backward pass by `values` is the same product on gradients. It passes the cut at
//! white: under the L1 loss a colour that is cut has no gradient where the picture is white too, and where the picture is
//! darker the colour shall come down. There is no gradient by the normals: shading shall explain the light, and must not bend
//! the mesh to paint stripes.
//!
//! [`Shading::vertex_normals`] sums face normals (twice the area long) at each vertex and makes the sums unit,
//! [`Shading::pixel_parts`] interpolates those and `exposure` to listed pixels as [`super::interpolate`] does with coordinates,
//! [`Shading::face_parts`] takes a face's own normal and the mean of its corners' `exposure`.

pub mod cpu;
mod depth_map;
mod gpu;
pub mod occlusion;
pub mod shadow;

pub use gpu::{ShadedRows, Shading, Write};

/// How far the lamp reaches round the body, as the cosine beyond the terminator.
pub const WRAP: f32 = 0.6;
/// No point is shut off from all light: cloth against cloth, as in a skirt's folds, lets some through, and a mesh's edges lie within it.
const LEAST_OPEN: f32 = 0.05;

/// A light; see the formula above.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Light {
    /// A channel
    pub ambient: [f32; 3],
    /// A channel
    pub strength: [f32; 3],
    /// Unit vector towards the lamp, world space
    pub direction: [f32; 3],
    /// The power of a point's openness that is left of the ambient light; none in files of before it was told, where zero
    /// means that ambient light reaches everywhere
    #[serde(default)]
    pub occlusion: f32,
    /// Where the ambient light is brighter and by how much, world space, at most 1 long; zero in files of before it was told
    #[serde(default)]
    pub slope: [f32; 3],
}

/// What of a light reaches a point of the surface, 0 to 1.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Exposure {
    /// Of the ambient light
    pub ambient: f32,
    /// Of the lamp, were it straight above
    pub lamp: f32,
}

impl Exposure {
    /// Nothing is in the way.
    pub const FULL: Self = Self { ambient: 1.0, lamp: 1.0 };

    /// A sum by weights.
    pub fn weighted(terms: impl Iterator<Item = (f32, Self)>) -> Self {
        terms.fold(Self { ambient: 0.0, lamp: 0.0 }, |sum, (weight, of)| Self {
            ambient: sum.ambient + weight * of.ambient,
            lamp: sum.lamp + weight * of.lamp,
        })
    }
}

impl Light {
    /// The same from everywhere: pictures show the albedo.
    pub const EVEN: Self =
        Self { ambient: [1.0; 3], strength: [0.0; 3], direction: [0.0, -1.0, 0.0], occlusion: 0.0, slope: [0.0; 3] };

    /// Whether every number is finite and the direction a unit vector.
    pub fn is_sound(&self) -> bool {
        let all = [self.ambient, self.strength, self.direction, self.slope];
        let [length, slope] = [self.direction, self.slope].map(|v| v.iter().map(|x| x * x).sum::<f32>());
        let finite = all.as_flattened().iter().all(|x| x.is_finite());
        finite && (length - 1.0).abs() < 1e-3 && slope < 1.001 && self.occlusion.is_finite() && self.occlusion >= 0.0
    }

    /// What a surface with normal `n` gives back of its albedo where this much of the light reaches it.
    pub fn shade(&self, n: [f32; 3], exposure: Exposure) -> [f32; 3] {
        cpu::shade(self, n, [exposure.ambient, exposure.lamp])
    }

    /// What of the light reaches a point that sees these shares of its surroundings and of the lamp.
    pub fn exposure(&self, open: f32, visible: f32) -> Exposure {
        Exposure { ambient: open.max(LEAST_OPEN).powf(self.occlusion), lamp: visible }
    }

    /// What of the light reaches each vertex of a posed mesh, `[V]`; faces show their outside counter-clockwise.
    ///
    /// # Panics
    /// When a face names a vertex that there is not.
    pub fn exposures(&self, vertices: &[[f32; 3]], faces: &[[u32; 3]]) -> Vec<Exposure> {
        let all = || vec![1.0; vertices.len()];
        let open = if self.occlusion > 0.0 { occlusion::openness(vertices, faces) } else { all() };
        let visible = if self.has_lamp() { shadow::visibility(self.direction, vertices, faces) } else { all() };
        open.into_iter().zip(visible).map(|(open, visible)| self.exposure(open, visible)).collect()
    }

    /// Whether there is a lamp, and with it shadows.
    pub fn has_lamp(&self) -> bool {
        self.strength != [0.0; 3]
    }
}

#[cfg(test)]
mod tests;
