//! Sums of scratch values into a slot, in a fixed order: a run repeated gives the same bits.

use std::sync::Arc;

use crate::gpu::{Buffer, Gpu, Kernel, Recorder};

/// Up to this many values one workgroup sums alone.
const ONE_PASS: usize = 32_768;
/// Workgroups of the first of two passes.
const PARTIALS: usize = 64;

/// Where an operator adds the value of its loss: `losses[index]`, see the conventions in [`crate::ops`].
#[derive(Clone, Copy)]
pub struct LossSlot<'a> {
    pub losses: &'a Buffer<f32>,
    pub index: usize,
}

impl<'a> LossSlot<'a> {
    /// # Panics
    /// When the buffer has no such slot.
    pub fn new(losses: &'a Buffer<f32>, index: usize) -> Self {
        assert!(index < losses.len(), "{}: no slot {index}", losses.label());
        Self { losses, index }
    }
}

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    len: u32,
    slot: u32,
}

/// `losses[index] += Σ values[0 .. len]`. One object may serve any number of sums of one recorder.
pub struct Sum {
    partial: Arc<Kernel>,
    add: Arc<Kernel>,
    partials: Buffer<f32>,
}

impl Sum {
    pub fn new(gpu: &Gpu) -> Self {
        Self {
            partial: kernel!(gpu, "reduce/partial"),
            add: kernel!(gpu, "reduce/add"),
            partials: gpu.zeros("reduce/partials", PARTIALS),
        }
    }

    /// Records the sum of the first `len` values: one dispatch, or two where there are many.
    ///
    /// # Panics
    /// When `values` is shorter than `len`.
    pub fn add(&self, recorder: &mut Recorder<'_>, values: &Buffer<f32>, len: usize, into: LossSlot<'_>) {
        assert!(len <= values.len(), "{}: {len} values wanted", values.label());
        let slot = into.index as u32;
        if len <= ONE_PASS {
            let params = Params { len: len as u32, slot };
            recorder.dispatch(&self.add, &params, &[values, into.losses], [1, 1, 1]);
            return;
        }
        let params = Params { len: len as u32, slot };
        recorder.dispatch(&self.partial, &params, &[values, &self.partials], [PARTIALS as u32, 1, 1]);
        let params = Params { len: PARTIALS as u32, slot };
        recorder.dispatch(&self.add, &params, &[&self.partials, into.losses], [1, 1, 1]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ops::testing::{assert_close, gpu};

    #[test]
    fn sums_of_every_length_are_added_to_their_slot() {
        let Some(gpu) = gpu("reduce::sums_of_every_length_are_added_to_their_slot") else { return };
        let sum = Sum::new(&gpu);
        for len in [0usize, 1, 255, 256, 257, ONE_PASS, ONE_PASS + 1, 300_001] {
            // What lies past `len` must not count.
            let data: Vec<f32> = (0..len + 5).map(|i| (i * 7919 % 1000) as f32 / 1000.0 - 0.3).collect();
            let values = gpu.upload("values", &data);
            let losses = gpu.upload("losses", &[1.0f32, 2.0, 3.0]);
            let mut recorder = gpu.recorder("reduce/test");
            sum.add(&mut recorder, &values, len, LossSlot::new(&losses, 1));
            sum.add(&mut recorder, &values, len, LossSlot::new(&losses, 2));
            recorder.submit().unwrap();
            let total: f64 = data[..len].iter().map(|&x| x as f64).sum();
            assert_close("losses", &gpu.read(&losses).unwrap(), &[1.0, 2.0 + total, 3.0 + total], 1e-6);
        }
    }
}
