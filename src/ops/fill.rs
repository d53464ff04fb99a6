//! One colour all over an image, for operators that then draw where something is.

use std::sync::Arc;

use crate::gpu::{Buffer, Gpu, Kernel, Recorder, linear_groups};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    n_pixels: u32,
    colour: [f32; 3],
}

pub(super) struct Fill(Arc<Kernel>);

impl Fill {
    pub fn new(gpu: &Gpu) -> Self {
        Self(kernel!(gpu, "fill/colour"))
    }

    /// Records `image [n_pixels, 3] = colour`; what lies beyond the pixels may become zero.
    pub fn record(&self, recorder: &mut Recorder<'_>, n_pixels: usize, colour: [f32; 3], image: &Buffer<f32>) {
        assert!(image.len() >= 3 * n_pixels, "{}: length", image.label());
        if colour == [0.0; 3] {
            // The device's own way is faster than a kernel.
            recorder.clear(image);
        } else {
            let params = Params { n_pixels: n_pixels as u32, colour };
            recorder.dispatch(&self.0, &params, &[image], linear_groups(n_pixels, 64));
        }
    }
}
