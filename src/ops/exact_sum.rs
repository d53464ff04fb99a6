//! Sums of numbers that many invocations add at once, the same whatever the order in which they come.
//!
//! Floats lose digits by their order, and the order of atomic additions is that of arrival: two runs would differ, and a fit
//! that goes on for thousands of steps makes millimetres of it. Whole numbers do not. A kernel that declares
//! `array<exact_sum>` and `#exact_sum BUFFER` adds each number as a whole multiple of 2⁻⁵⁰ in 64 bits;
//! [`ExactSum::settle`] then adds the sums to floats. Where a device has no 64-bit atomics, two additions of 32 bits come to
//! the same.
//!
//! | buffer | shape | role |
//! |---|---|---|
//! | `sums` | `[N, 2]` u32 | low and high words; zero at first and after `settle` |
//! | `values` | `[N]` | added to by `settle` |
//!
//! A number beyond ±4096 counts as ±4096, what lies below 2⁻⁵⁰ (9e-16) is cut off towards zero, and a sum must stay within
//! ±8192: gradients of losses that are means over pixels do.

use std::sync::Arc;

use crate::gpu::{Buffer, Gpu, Kernel, Recorder, linear_groups};

/// The sums of one kernel's results.
pub struct ExactSum {
    settle: Arc<Kernel>,
    len: usize,
    /// `[N, 2]`
    pub sums: Buffer<u32>,
}

impl ExactSum {
    /// `len` sums; `label` names their buffer.
    pub fn new(gpu: &Gpu, label: &str, len: usize) -> Self {
        let sums = gpu.zeros(label, 2 * len.next_multiple_of(4));
        Self { settle: kernel!(gpu, "exact_sum/settle"), len, sums }
    }

    /// Records `values += sums`; the sums are zero afterwards.
    ///
    /// # Panics
    /// When the lengths differ.
    pub fn settle(&self, recorder: &mut Recorder<'_>, values: &Buffer<f32>) {
        assert_eq!(values.len(), self.len, "{}: length", values.label());
        // Buffers end with whole vectors; beyond the last value both hold zeros.
        let len4 = self.len.div_ceil(4);
        let params = [len4 as u32, 0, 0, 0];
        recorder.dispatch(&self.settle, &params, &[&self.sums, values], linear_groups(len4, 64));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ops::testing::{gpu, random};

    /// A kernel that adds `values[i]` to sum `i % n` in the order of arrival.
    const ADD: &str = "#import shared/exact_sum
struct Params { len: u32, n: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> values: array<f32>;
@group(0) @binding(2) var<storage, read_write> sums: array<exact_sum>;
#exact_sum sums
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x < params.len { sums_add(id.x % params.n, values[id.x]); }
}
";

    /// `start` and the sums of `values`, with 64-bit additions where the device has them, and without.
    fn sums(gpu: &Gpu, values: &[f32], start: &[f32]) -> Vec<f32> {
        let [wide, narrow] = [gpu.info().wide_sums, false].map(|wide| sums_with(gpu, wide, values, start));
        assert_eq!(wide, narrow, "64 bits at once and word by word");
        wide
    }

    fn sums_with(gpu: &Gpu, wide: bool, values: &[f32], start: &[f32]) -> Vec<f32> {
        let op = ExactSum::new(gpu, "sums", start.len());
        let (from, into) = (gpu.upload("values", values), gpu.upload("into", start));
        let kernel = gpu.kernel_with("test/exact_sum", ADD, &[], wide);
        let mut recorder = gpu.recorder("exact_sum/test");
        let params = [values.len() as u32, start.len() as u32, 0, 0];
        recorder.dispatch(&kernel, &params, &[&from, &op.sums], [values.len().div_ceil(64) as u32, 1, 1]);
        op.settle(&mut recorder, &into);
        // Nothing is left over.
        op.settle(&mut recorder, &into);
        recorder.submit().unwrap();
        gpu.read(&into).unwrap()
    }

    #[test]
    fn sums_are_right_at_every_size() {
        let Some(gpu) = gpu("exact_sum::sums_are_right_at_every_size") else { return };
        for size in [1e-12, 1e-9, 1e-5, 1.0, 50.0] {
            let values: Vec<f32> = random(3, 5000).iter().map(|&x| (x * size) as f32).collect();
            let start = vec![0.0; 7];
            for (k, got) in sums(&gpu, &values, &start).into_iter().enumerate() {
                let terms = || values.iter().skip(k).step_by(7).map(|&x| f64::from(x));
                let (want, n) = (terms().sum::<f64>(), terms().count() as f64);
                let allowed = n * 2f64.powi(-50) + 2f64.powi(-23) * want.abs();
                assert!((f64::from(got) - want).abs() <= allowed, "{size}, {k}: {got}, expected {want}");
            }
        }
    }

    /// Bit by bit, where sums of floats differ: large terms that cancel and leave small ones.
    #[test]
    fn the_order_makes_no_difference() {
        let Some(gpu) = gpu("exact_sum::the_order_makes_no_difference") else { return };
        let mut values: Vec<f32> = random(4, 4096).iter().map(|&x| (x * x * x * 30.0) as f32).collect();
        let first = sums(&gpu, &values, &[0.25; 1]);
        values.reverse();
        values.rotate_left(1234);
        assert_eq!(sums(&gpu, &values, &[0.25; 1]), first);
        let floats = |values: &[f32]| values.iter().sum::<f32>();
        assert_ne!(floats(&values), floats(&values.iter().rev().copied().collect::<Vec<_>>()), "no hard case");
    }

    #[test]
    fn what_is_too_large_or_too_small_is_cut() {
        let Some(gpu) = gpu("exact_sum::what_is_too_large_or_too_small_is_cut") else { return };
        let values = [1e9, 1e-17, -f32::INFINITY, -1e-17, 2f32.powi(-50), -(2f32.powi(-50))];
        let got = sums(&gpu, &values, &[0.0; 6]);
        assert_eq!(got, [4096.0, 0.0, -4096.0, 0.0, 2f32.powi(-50), -(2f32.powi(-50))]);
    }
}
