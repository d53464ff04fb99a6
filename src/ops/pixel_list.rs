//! Some pixels of an image, known before anything is drawn.

use crate::gpu::{Buffer, Gpu};

/// Indices of pixels on the device, rising, and what each of them counts.
pub struct PixelList {
    /// `[len]`, at least one entry long
    pub(super) index: Buffer<u32>,
    /// As long; absent, each counts one
    pub(super) weight: Option<Buffer<f32>>,
    len: usize,
}

impl PixelList {
    /// The pixels where `chosen` holds, in its order.
    pub fn new(gpu: &Gpu, label: &str, chosen: impl IntoIterator<Item = bool>) -> Self {
        let chosen = chosen.into_iter().enumerate().filter_map(|(i, chosen)| chosen.then_some(i as u32));
        let mut index: Vec<u32> = chosen.collect();
        let len = index.len();
        index.resize(len.max(1), 0);
        Self { index: gpu.upload(label, &index), weight: None, len }
    }

    /// The pixels whose weight is above zero, in the order of `weights`.
    pub fn weighted(gpu: &Gpu, label: &str, weights: &[f32]) -> Self {
        let list = Self::new(gpu, label, weights.iter().map(|&weight| weight > 0.0));
        let mut weights: Vec<f32> = weights.iter().copied().filter(|&weight| weight > 0.0).collect();
        weights.resize(list.index.len(), 0.0);
        Self { weight: Some(gpu.upload(label, &weights)), ..list }
    }

    pub fn len(&self) -> usize {
        self.len
    }

    pub fn is_empty(&self) -> bool {
        self.len == 0
    }
}
