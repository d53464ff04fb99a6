//! The two textures that stage 2 can train: the hash texture (paper §3.2), and the plain texel map it is compared with.

use crate::fit::FitError;
use crate::fit::checkpointed::{Checkpointed, Checkpointer};
use crate::fit::config::FitConfig;
use crate::fit::state::FitState;
use crate::gpu::{Buffer, Gpu, Recorder};
use crate::ops::adam::{Adam, AdamConfig};
use crate::ops::texel_map::TexelMap;
use crate::ops::texture_field::TextureField;

/// Adam for the field (Müller et al. 2022).
const FIELD_ADAM: AdamConfig = AdamConfig { beta1: 0.9, beta2: 0.99, eps: 1e-15 };

/// Colours at coordinates, with parameters, gradients and optimiser.
pub enum TextureModel {
    Hash { field: Box<TextureField>, table: Adam, weights: Adam },
    Texels { map: TexelMap, adam: Adam },
}

impl TextureModel {
    /// The texel map of the state where it has one, else its field; for up to `capacity` coordinates a pass.
    pub fn new(gpu: &Gpu, config: &FitConfig, state: &FitState, capacity: usize) -> Result<Self, FitError> {
        if let Some(texels) = &state.texels {
            let map = TexelMap::new(gpu, texels.side, &texels.values, capacity);
            return Ok(Self::Texels { adam: Adam::new(gpu, "texels", texels.values.len(), FIELD_ADAM), map });
        }
        let field = Box::new(TextureField::new(gpu, config.field, &state.field, capacity)?);
        Ok(Self::Hash {
            table: Adam::new(gpu, "table", field.table.len(), FIELD_ADAM),
            weights: Adam::new(gpu, "weights", field.weights.len(), FIELD_ADAM),
            field,
        })
    }

    /// `[P, 3]` of the last forward pass.
    pub fn rgb(&self) -> &Buffer<f32> {
        match self {
            Self::Hash { field, .. } => &field.rgb,
            Self::Texels { map, .. } => &map.rgb,
        }
    }

    pub fn clear(&self, recorder: &mut Recorder<'_>) {
        match self {
            Self::Hash { field, .. } => field.clear_gradients(recorder),
            Self::Texels { map, .. } => recorder.clear(&map.grad_texels),
        }
    }

    pub fn forward(&self, recorder: &mut Recorder<'_>, coords: &Buffer<f32>, count: &Buffer<u32>, n_max: usize) {
        match self {
            Self::Hash { field, .. } => field.forward(recorder, coords, count, n_max),
            Self::Texels { map, .. } => map.forward(recorder, coords, count, n_max),
        }
    }

    /// Of the last forward pass, with the same arguments; adds to `grad_coords`.
    pub fn backward(
        &self,
        recorder: &mut Recorder<'_>,
        coords: &Buffer<f32>,
        count: &Buffer<u32>,
        n_max: usize,
        grad_rgb: &Buffer<f32>,
        grad_coords: &Buffer<f32>,
    ) {
        match self {
            Self::Hash { field, .. } => field.backward(recorder, coords, count, n_max, grad_rgb, grad_coords),
            Self::Texels { map, .. } => map.backward(recorder, coords, count, n_max, grad_rgb, grad_coords),
        }
    }

    /// Records the `n`-th step.
    pub fn step(&mut self, recorder: &mut Recorder<'_>, rate: f32, n: u32) {
        match self {
            Self::Hash { field, table, weights } => {
                field.settle(recorder);
                let whole = (0..field.table.len(), 0..field.weights.len());
                table.step(recorder, &field.table, &field.grad_table, whole.0, rate, n);
                weights.step(recorder, &field.weights, &field.grad_weights, whole.1, rate, n);
            }
            Self::Texels { map, adam } => {
                adam.step(recorder, &map.texels, &map.grad_texels, 0..map.texels.len(), rate, n);
            }
        }
    }

    pub fn read_into(&self, gpu: &Gpu, state: &mut FitState) -> Result<(), FitError> {
        match (self, &mut state.texels) {
            (Self::Hash { field, .. }, _) => state.field = field.params(gpu)?,
            (Self::Texels { map, .. }, Some(texels)) => texels.values = gpu.read(&map.texels)?,
            (Self::Texels { .. }, None) => {}
        }
        Ok(())
    }
}

impl Checkpointed for TextureModel {
    /// The moments; the parameters are the state's.
    fn checkpoint(&mut self, checkpointer: &mut Checkpointer<'_>, name: &str) -> Result<(), FitError> {
        match self {
            Self::Hash { table, weights, .. } => {
                table.checkpoint(checkpointer, &format!("{name}.table"))?;
                weights.checkpoint(checkpointer, &format!("{name}.weights"))
            }
            Self::Texels { adam, .. } => adam.checkpoint(checkpointer, &format!("{name}.texels")),
        }
    }
}
