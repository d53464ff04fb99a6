//! Some pixels of an image, known before anything is drawn.

use crate::gpu::{Buffer, Gpu};

/// Indices of pixels on the device, rising, and what each of them counts.
pub struct PixelList {
    /// `[len]`, at least one entry long
    pub(super) index: Buffer<u32>,
    /// As long
    pub(super) weight: Buffer<f32>,
    len: usize,
}

impl PixelList {
    /// The pixels where `chosen` holds, in its order, each with weight one.
    pub fn new(gpu: &Gpu, label: &str, chosen: impl IntoIterator<Item = bool>) -> Self {
        Self::weighted(gpu, label, chosen.into_iter().map(|chosen| if chosen { 1.0 } else { 0.0 }))
    }

    /// The pixels whose weight is above zero, in the order of `weights`.
    pub fn weighted(gpu: &Gpu, label: &str, weights: impl IntoIterator<Item = f32>) -> Self {
        let chosen = weights.into_iter().enumerate().filter(|&(_, w)| w > 0.0);
        let (mut index, mut weight): (Vec<u32>, Vec<f32>) = chosen.map(|(i, w)| (i as u32, w)).unzip();
        let len = index.len();
        index.resize(len.max(1), 0);
        weight.resize(len.max(1), 0.0);
        Self { index: gpu.upload(label, &index), weight: gpu.upload(label, &weight), len }
    }

    pub fn len(&self) -> usize {
        self.len
    }

    pub fn is_empty(&self) -> bool {
        self.len == 0
    }
}
