//! The device's order of the weights: input-major and padded to vectors of four, `w0 [E, H]`, `w1 [H, H]`, `w2 [H, 4]`
//! in one buffer. What pads is zero and stays zero: its inputs and its deltas are zero.

use super::{TextureFieldConfig, TextureFieldParams};

/// The padded widths.
#[derive(Clone, Copy, Debug)]
pub(super) struct Layout {
    width: usize,
    hidden_width: usize,
    /// `encoded` and hidden widths in vectors of four.
    pub encoded4: usize,
    pub hidden4: usize,
}

impl Layout {
    pub fn new(config: &TextureFieldConfig) -> Self {
        let width = config.encoded_width();
        let hidden_width = config.hidden_width;
        Self { width, hidden_width, encoded4: width.div_ceil(4), hidden4: hidden_width.div_ceil(4) }
    }

    /// First vector of each layer, and of what follows them.
    pub fn offsets4(&self) -> [usize; 4] {
        let w1 = 4 * self.encoded4 * self.hidden4;
        let w2 = w1 + 4 * self.hidden4 * self.hidden4;
        [0, w1, w2, w2 + 4 * self.hidden4]
    }

    /// Vectors of all layers.
    pub fn weights4(&self) -> usize {
        self.offsets4()[3]
    }

    /// (first value, inputs, outputs, padded outputs) of the layers.
    fn layers(&self) -> [(usize, usize, usize, usize); 3] {
        let [w0, w1, w2, _] = self.offsets4().map(|v| 4 * v);
        let h = self.hidden_width;
        [(w0, self.width, h, 4 * self.hidden4), (w1, h, h, 4 * self.hidden4), (w2, h, 3, 4)]
    }

    pub fn pack(&self, params: &TextureFieldParams) -> Vec<f32> {
        let mut packed = vec![0.0; 4 * self.weights4()];
        for ((first, inputs, outputs, stride), w) in self.layers().into_iter().zip([&params.w0, &params.w1, &params.w2])
        {
            for o in 0..outputs {
                for i in 0..inputs {
                    packed[first + i * stride + o] = w[o * inputs + i];
                }
            }
        }
        packed
    }

    /// `(w0, w1, w2)` out of the device's order.
    pub fn unpack(&self, packed: &[f32]) -> [Vec<f32>; 3] {
        self.layers().map(|(first, inputs, outputs, stride)| {
            let value = |k: usize| packed[first + k % inputs * stride + k / inputs];
            (0..outputs * inputs).map(value).collect()
        })
    }
}
