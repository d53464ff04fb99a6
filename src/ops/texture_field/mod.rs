//! The texture as a field over learned 3D coordinates: multiresolution hash encoding and a small perceptron
//! (Müller et al. 2022; the paper's section on the texture model).
//!
//! | buffer | shape | role |
//! |---|---|---|
//! | `coords` | `[P, 3]` | positions in `[0, 1]³`; what lies outside is clamped, and gets no gradient |
//! | `count` | `[1]` u32 | how many of the `P` rows are used, on the device; rows from there on are left alone |
//! | `table` | `[entries, 2]` | parameters of all levels, level after level |
//! | `weights` | `[weights4, 4]` | `w0 [H, 2L]`, `w1 [H, H]`, `w2 [3, H]`, in the order that `layout.rs` gives |
//! | `rgb` | `[P, 3]` | result in `(0, 1)` |
//!
//! Level `l` has `scale = N_min · growth^l − 1` cells and `resolution = ⌈scale⌉ + 1` points along an axis. A coordinate
//! lies at `position = x · scale + 0.5`; its level's two features are interpolated trilinearly over the eight corners of
//! `⌊position⌋`. A corner's entry is `x + y·res + z·res²` where `res³` fits the level's entries, else the hash
//! `x ⊕ y·2654435761 ⊕ z·805459861` in 32 bits, both modulo the entries. A level has `min(res³, 2^log2_hashmap_size)`
//! entries, rounded up to a multiple of 8 and capped at `2^log2_hashmap_size`.
//! Then `rgb = sigmoid(W2 · relu(W1 · relu(W0 · encoded)))`, without bias.
//!
//! Not differentiable, and one-sided there: by the coordinate at the borders of cells (the cell above counts), by the
//! weights at ReLU's kink (zero counts).
//!
//! Backward reads the activations of the last forward pass over the same coordinates. Gradients of the weights are
//! summed in a fixed order, those of the table as whole numbers ([`super::exact_sum`]), which go into
//! `grad_table` once for all passes of a step.

pub mod cpu;
mod gpu;
mod layout;

pub use gpu::TextureField;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;

use crate::gpu::WORKGROUP_BYTES;

/// Features of a table entry; the kernels read an entry as one vector.
pub const FEATURES: usize = 2;
/// The most levels that the kernels' uniform block holds.
pub const MAX_LEVELS: usize = 32;

/// The sizes of a field.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct TextureFieldConfig {
    pub n_levels: usize,
    /// 2 is the only number that is supported.
    pub n_features_per_level: usize,
    pub log2_hashmap_size: u32,
    pub base_resolution: u32,
    /// Growth of the resolution from a level to the next.
    pub per_level_scale: f64,
    /// Width of both hidden layers.
    pub hidden_width: usize,
}

impl Default for TextureFieldConfig {
    fn default() -> Self {
        Self {
            n_levels: 12,
            n_features_per_level: FEATURES,
            log2_hashmap_size: 15,
            base_resolution: 16,
            per_level_scale: 1.38,
            hidden_width: 32,
        }
    }
}

/// Sizes that the field cannot have.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TextureFieldError {
    #[error("texture field: {what} is {got}, expected {expected}")]
    Config { what: &'static str, got: String, expected: &'static str },
    #[error("texture field: {array} has {got} values, expected {expected}")]
    Length { array: &'static str, got: usize, expected: usize },
}

/// One level of the encoding.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Level {
    pub scale: f64,
    pub resolution: u32,
    /// The first entry in the table.
    pub offset: u32,
    pub entries: u32,
    /// True where the grid's points do not fit the entries. `entries` is then a power of two.
    pub hashed: bool,
}

/// Where a hashed level has a point, modulo its entries.
fn hash([x, y, z]: [u32; 3]) -> u32 {
    x ^ y.wrapping_mul(2_654_435_761) ^ z.wrapping_mul(805_459_861)
}

impl Level {
    /// `scale` rounded towards zero. The finest scale is a whole number but for rounding; rounded up, it would put the
    /// middle of the cube on the other side of a cell's border than the exact scale does.
    fn scale_of<T: super::Real>(&self) -> T {
        let nearest = T::of(self.scale);
        if nearest.f64() > self.scale { nearest * (T::one() - T::epsilon() / T::of(2.0)) } else { nearest }
    }
}

impl TextureFieldConfig {
    /// Checks the sizes.
    pub fn validate(&self) -> Result<(), TextureFieldError> {
        let fail = |what, got: String, expected| Err(TextureFieldError::Config { what, got, expected });
        if !(1..=MAX_LEVELS).contains(&self.n_levels) {
            return fail("n_levels", self.n_levels.to_string(), "1 to 32");
        }
        if self.n_features_per_level != FEATURES {
            return fail("n_features_per_level", self.n_features_per_level.to_string(), "2");
        }
        if !(3..=24).contains(&self.log2_hashmap_size) {
            return fail("log2_hashmap_size", self.log2_hashmap_size.to_string(), "3 to 24");
        }
        // A workgroup holds all weights in its memory.
        if self.hidden_width < 1 || 16 * layout::Layout::new(self).weights4() > WORKGROUP_BYTES {
            let got = format!("{} at {} levels", self.hidden_width, self.n_levels);
            return fail("hidden_width", got, "weights of at most 32 KiB, such as 64 at 16 levels");
        }
        let finest = self.base_resolution as f64 * self.per_level_scale.powf((self.n_levels - 1) as f64);
        if self.base_resolution < 1 || !(self.per_level_scale >= 1.0 && finest <= 65_536.0) {
            let got = format!("{} · {}^level", self.base_resolution, self.per_level_scale);
            return fail("the resolution", got, "1 to 65536 at every level, growing");
        }
        Ok(())
    }

    /// The levels from coarse to fine.
    pub fn levels(&self) -> Vec<Level> {
        let cap = 1u64 << self.log2_hashmap_size;
        let mut offset = 0;
        let level = |l: usize| {
            let scale = self.base_resolution as f64 * self.per_level_scale.powf(l as f64) - 1.0;
            let resolution = scale.ceil() as u64 + 1;
            let points = resolution.pow(3);
            let entries = points.min(cap).next_multiple_of(8).min(cap);
            let this = Level {
                scale,
                resolution: resolution as u32,
                offset,
                entries: entries as u32,
                hashed: points > entries,
            };
            offset += entries as u32;
            this
        };
        (0..self.n_levels).map(level).collect()
    }

    /// Entries of all levels.
    pub fn n_entries(&self) -> usize {
        self.levels().last().map_or(0, |l| (l.offset + l.entries) as usize)
    }

    /// As this, with finer levels until a cell is no longer than `cell` of the cube's side, and tables of
    /// `2^log2_hashmap_size` entries; nothing becomes coarser or smaller, and no level is finer than there may be.
    pub fn refined(&self, cell: f64, log2_hashmap_size: u32) -> Self {
        let mut config = Self { log2_hashmap_size: self.log2_hashmap_size.max(log2_hashmap_size), ..*self };
        let is_coarse = |c: &Self| c.levels().last().is_some_and(|finest| finest.scale * cell < 1.0);
        while is_coarse(&config) {
            let finer = Self { n_levels: config.n_levels + 1, ..config };
            if finer.validate().is_err() {
                break;
            }
            config = finer;
        }
        config
    }

    /// Width of the encoding.
    pub fn encoded_width(&self) -> usize {
        self.n_levels * FEATURES
    }
}

/// A field's parameters, or their gradients, on the host. Matrices are `[outputs, inputs]` in C order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TextureFieldParams<T = f32> {
    /// `[entries, 2]`
    pub table: Vec<T>,
    /// `[H, 2L]`
    pub w0: Vec<T>,
    /// `[H, H]`
    pub w1: Vec<T>,
    /// `[3, H]`
    pub w2: Vec<T>,
}

impl TextureFieldParams {
    /// Initial values from `seed`: the table uniform in ±1e-4 (Müller et al. 2022, section 4), the weights uniform in
    /// ±√(6 / inputs) (He et al. 2015).
    pub fn random(config: &TextureFieldConfig, seed: u64) -> Self {
        let mut rng = Pcg32::seed_from_u64(seed);
        let mut uniform = |n: usize, bound: f32| (0..n).map(|_| rng.random_range(-bound..bound)).collect::<Vec<f32>>();
        let (e, h) = (config.encoded_width(), config.hidden_width);
        let he = |inputs: usize| (6.0 / inputs as f32).sqrt();
        Self {
            table: uniform(config.n_entries() * FEATURES, 1e-4),
            w0: uniform(h * e, he(e)),
            w1: uniform(h * h, he(h)),
            w2: uniform(3 * h, he(h)),
        }
    }
}

impl TextureFieldParams {
    /// The same field with more room, `from` being its sizes and `to` those of [`TextureFieldConfig::refined`]: what it
    /// shows is the same, but in the cube's outermost cells, whose far points wrap round. Points that shared an entry have one
    /// each; levels that are new start at random and count for nothing until they are learned.
    ///
    /// # Panics
    /// When `to` is not refined from `from`.
    pub fn refined(&self, from: &TextureFieldConfig, to: &TextureFieldConfig, seed: u64) -> Self {
        let kept = from.n_levels;
        assert_eq!(*from, TextureFieldConfig { n_levels: kept, log2_hashmap_size: from.log2_hashmap_size, ..*to });
        assert!(kept <= to.n_levels && from.log2_hashmap_size <= to.log2_hashmap_size, "refined: smaller");
        let mut params = Self { w1: self.w1.clone(), w2: self.w2.clone(), ..Self::random(to, seed) };
        let (old, new) = (self.table.as_chunks::<FEATURES>().0, params.table.as_chunks_mut::<FEATURES>().0);
        for (small, large) in from.levels().iter().zip(to.levels()) {
            let (offset, into) = (small.offset as usize, &mut new[large.offset as usize..][..large.entries as usize]);
            let same = |index: u32| old[offset + (index % small.entries) as usize];
            if small.hashed && !large.hashed {
                let n = large.resolution;
                let points = (0..n.pow(3)).map(|i| [i % n, i / n % n, i / (n * n)]);
                into.iter_mut().zip(points).for_each(|(entry, point)| *entry = same(hash(point)));
            } else {
                // The longer hash ends as the shorter one.
                into.iter_mut().zip(0..).for_each(|(entry, index)| *entry = same(index));
            }
        }
        let (before, after) = (from.encoded_width(), to.encoded_width());
        params.w0.fill(0.0);
        for (row, known) in params.w0.chunks_exact_mut(after).zip(self.w0.chunks_exact(before)) {
            row[..before].copy_from_slice(known);
        }
        params
    }
}

impl<T: super::Real> TextureFieldParams<T> {
    /// All zeros.
    pub fn zeros(config: &TextureFieldConfig) -> Self {
        let (e, h) = (config.encoded_width(), config.hidden_width);
        let zeros = |n| vec![T::zero(); n];
        Self { table: zeros(config.n_entries() * FEATURES), w0: zeros(h * e), w1: zeros(h * h), w2: zeros(3 * h) }
    }

    /// Checks the lengths against the sizes.
    pub fn validate(&self, config: &TextureFieldConfig) -> Result<(), TextureFieldError> {
        config.validate()?;
        let (e, h) = (config.encoded_width(), config.hidden_width);
        let lengths = [
            ("table", self.table.len(), config.n_entries() * FEATURES),
            ("w0", self.w0.len(), h * e),
            ("w1", self.w1.len(), h * h),
            ("w2", self.w2.len(), 3 * h),
        ];
        for (array, got, expected) in lengths {
            if got != expected {
                return Err(TextureFieldError::Length { array, got, expected });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
