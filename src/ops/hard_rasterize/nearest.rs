//! Pass 1 of an image: which face owns each pixel.

use std::sync::Arc;

use super::gpu::Params;
use crate::gpu::{AnyBuffer, Buffer, Gpu, Kernel, Recorder, linear_groups};
use crate::ops::Corners;

/// The nearest face of each pixel as `n_faces - index`, zero where there is none.
pub(super) enum Nearest {
    /// Depth and face in one 64-bit number a pixel, raised in one pass; the face is the low word.
    Wide { pass: Arc<Kernel>, best: Buffer<u32> },
    /// The depths in one pass, then who has them in another.
    Narrow { depth: Arc<Kernel>, claim: Arc<Kernel>, nearest: Buffer<u32>, owner: Buffer<u32> },
}

impl Nearest {
    /// `wide`: in one pass, which the device must be able to.
    pub fn new(gpu: &Gpu, max_pixels: usize, cull_back: bool, wide: bool) -> Self {
        let cull = &[("CULL_BACK", cull_back.to_string())];
        let zeros = |name: &str, len: usize| gpu.zeros(&format!("hard_rasterize/{name}"), len);
        if wide {
            // Whole groups of four pixels.
            let best = zeros("best", 2 * max_pixels.next_multiple_of(4));
            return Self::Wide { pass: kernel!(gpu, "hard_rasterize/nearest", cull), best };
        }
        Self::Narrow {
            depth: kernel!(gpu, "hard_rasterize/depth", cull),
            claim: kernel!(gpu, "hard_rasterize/claim", cull),
            nearest: zeros("nearest", max_pixels),
            owner: zeros("owner", max_pixels),
        }
    }

    /// The constant that tells kernels how to read [`Self::owners`].
    pub fn constants(&self) -> [(&'static str, String); 1] {
        [("WIDE", matches!(self, Self::Wide { .. }).to_string())]
    }

    /// For `shared/owners`.
    pub fn owners(&self) -> &Buffer<u32> {
        match self {
            Self::Wide { best, .. } => best,
            Self::Narrow { owner, .. } => owner,
        }
    }

    /// Records who owns the pixels of an image.
    pub fn record(&self, recorder: &mut Recorder<'_>, params: &Params, view: &Buffer<f32>, corners: &Corners) {
        let (n, by_face) = (params.n_pixels(), linear_groups(corners.n_faces(), 64));
        let faces = &corners.faces;
        match self {
            Self::Wide { pass, best } => {
                recorder.clear_front(best, 2 * n);
                recorder.dispatch(pass, params, &[view, faces, best], by_face);
            }
            Self::Narrow { depth, claim, nearest, owner } => {
                recorder.clear_front(nearest, n);
                recorder.clear_front(owner, n);
                recorder.dispatch(depth, params, &[view, faces, nearest], by_face);
                let buffers: [&dyn AnyBuffer; 4] = [view, faces, nearest, owner];
                recorder.dispatch(claim, params, &buffers, by_face);
            }
        }
    }
}
