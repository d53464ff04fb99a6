//! Some pixels of an image, known before anything is drawn.

use crate::gpu::{Buffer, Gpu};

/// Indices of pixels on the device, rising.
pub struct PixelList {
    /// `[len]`, at least one entry long
    pub(super) index: Buffer<u32>,
    len: usize,
}

impl PixelList {
    /// The pixels where `chosen` holds, in its order.
    pub fn new(gpu: &Gpu, label: &str, chosen: impl IntoIterator<Item = bool>) -> Self {
        let chosen = chosen.into_iter().enumerate().filter_map(|(i, chosen)| chosen.then_some(i as u32));
        let mut index: Vec<u32> = chosen.collect();
        let len = index.len();
        index.resize(len.max(1), 0);
        Self { index: gpu.upload(label, &index), len }
    }

    pub fn len(&self) -> usize {
        self.len
    }

    pub fn is_empty(&self) -> bool {
        self.len == 0
    }
}
