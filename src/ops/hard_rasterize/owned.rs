//! The pixels of an image that show a face, and the faces that a pixel shows: what is done for them alone costs as much as
//! they are, not as the image is large.

use std::sync::Arc;

use crate::gpu::{Buffer, Gpu, Kernel, Recorder};

/// The lists of the last image, in no order, with the workgroups of 64 that they take.
pub(in crate::ops) struct Owned {
    groups_pass: Arc<Kernel>,
    /// `[2]`: of pixels, of faces
    pub counts: Buffer<u32>,
    /// `[2, 3]`
    groups: Buffer<u32>,
    pub pixels: Buffer<u32>,
    /// `[F]`: 1 where a face is listed
    pub owns: Buffer<u32>,
    pub faces: Buffer<u32>,
}

/// Which list.
#[derive(Clone, Copy)]
pub(in crate::ops) enum Each {
    Pixel,
    Face,
}

impl Owned {
    pub fn new(gpu: &Gpu, max_pixels: usize, n_faces: usize) -> Self {
        Self {
            groups_pass: kernel!(gpu, "hard_rasterize/groups"),
            counts: gpu.zeros("hard_rasterize/counts", 2),
            groups: gpu.zeros("hard_rasterize/groups", 6),
            pixels: gpu.zeros("hard_rasterize/owned", max_pixels),
            owns: gpu.zeros("hard_rasterize/owns", n_faces),
            faces: gpu.zeros("hard_rasterize/owners", n_faces),
        }
    }

    /// Records empty lists.
    pub fn clear(&self, recorder: &mut Recorder<'_>) {
        recorder.clear(&self.counts);
        recorder.clear(&self.owns);
    }

    /// Records how many workgroups a list takes that is complete.
    pub fn count(&self, recorder: &mut Recorder<'_>, list: Each) {
        recorder.dispatch(&self.groups_pass, &[list as u32, 0, 0, 0], &[&self.counts, &self.groups], [1, 1, 1]);
    }

    /// The workgroups of a list and their place, for [`Recorder::dispatch_indirect`].
    pub fn groups(&self, list: Each) -> (&Buffer<u32>, usize) {
        (&self.groups, 3 * list as usize)
    }
}
