//! The numbers of a fit: weights, learning rates, schedules, presets.

use crate::ops::texture_field::TextureFieldConfig;

/// How the silhouette moves the mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SilhouetteGradient {
    /// NMR's scanline sweeps over the hard silhouette (the paper's choice).
    Nmr,
    /// The soft rasteriser's alpha.
    Soft,
}

/// Weights λ of the losses. Image sums are divided by the frame's foreground pixels first, keypoints by their number
/// and the square of a hundredth of the image side, mesh sums by the number of faces: one set serves all resolutions.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Weights {
    pub rgb: f32,
    pub silhouette: f32,
    pub keypoints: f32,
    pub normal_consistency: f32,
    pub face_area: f32,
    pub laplacian: f32,
}

/// Learning rates (Adam), at the start of a stage.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Rates {
    pub betas: f32,
    /// Radians.
    pub pose: f32,
    /// Metres.
    pub transl: f32,
    /// Metres.
    pub offsets: f32,
    pub face_colours: f32,
    pub texcoords: f32,
    pub field: f32,
}

/// One stretch of a stage at one resolution.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Phase {
    /// Passes over all frames.
    pub epochs: u32,
    /// 0 = full resolution, 1 = half.
    pub level: usize,
    /// SoftRas face blur, squared units of half the image side.
    pub sigma: f32,
    /// SoftRas depth softness.
    pub gamma: f32,
    /// Factor on all learning rates.
    pub rate: f32,
    /// Whether D is fitted in this phase (else only β, pose and placement).
    pub offsets: bool,
}

/// Everything that a fit depends on besides the clip and the body.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct FitConfig {
    pub seed: u64,
    /// Frames a step.
    pub batch: usize,
    pub silhouette_gradient: SilhouetteGradient,
    pub weights: Weights,
    pub rates: Rates,
    pub geometry: Vec<Phase>,
    pub texture: Vec<Phase>,
    /// Part of the covered pixels that a texture step looks at.
    pub pixel_rate: f32,
    #[serde(skip)]
    pub field: TextureFieldConfig,
}
