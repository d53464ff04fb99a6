//! What the device gives at best: a launch, memory, arithmetic.

use std::sync::Arc;

use super::{Case, Counts, Times, interleaved};
use crate::gpu::{Buffer, Gpu, GpuError, Kernel, linear_groups};

/// Floats that the copy moves, beyond any cache; on a device with memory of its own, whose caches hold more.
const COPIED: [usize; 2] = [16 << 20, 64 << 20];
/// Invocations of the multiply-adds; enough for any device with many cores.
const LANES: [usize; 2] = [1 << 17, 1 << 20];
const ROUNDS: usize = 64;
const CHAINS: usize = 4;

/// Kernels and buffers that show the limits of a device, as cases of the benchmark; [`Peaks`] are read off their times.
pub struct Ceilings {
    copy: Arc<Kernel>,
    fma: Arc<Kernel>,
    from: Buffer<f32>,
    to: Buffer<f32>,
    sums: Buffer<f32>,
    copied: usize,
    lanes: usize,
}

/// The device's limits, from the times of [`Ceilings::cases`] alone on the device ([`Times::alone_ms`]).
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct Peaks {
    /// Of an almost empty submission.
    pub launch_ms: f64,
    /// Read and written bytes together.
    pub copy_gb_per_s: f64,
    /// A fused multiply-add is two operations.
    pub fma_gflop_per_s: f64,
}

impl Peaks {
    /// No device of these limits does the work in less.
    pub fn floor_ms(&self, needs: Counts) -> f64 {
        (1e-6 * needs.bytes / self.copy_gb_per_s).max(1e-6 * needs.flops / self.fma_gflop_per_s)
    }
}

impl std::fmt::Display for Peaks {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { copy_gb_per_s: copied, fma_gflop_per_s: fma, launch_ms } = self;
        write!(f, "{copied:.2} GB/s copied, {fma:.1} GFLOP/s of FMA, {launch_ms:.3} ms a launch")
    }
}

impl Ceilings {
    pub fn new(gpu: &Gpu) -> Self {
        let constants = [("ROUNDS", format!("{ROUNDS}u")), ("CHAINS", format!("{CHAINS}u"))];
        let hardware = usize::from(!gpu.info().software);
        // No more than it binds at once.
        let copied = COPIED[hardware].min(gpu.info().max_binding_bytes as usize / size_of::<f32>());
        let lanes = LANES[hardware];
        Self {
            copy: gpu.kernel("bench/copy", include_str!("../../shaders/bench/copy.wgsl"), &[]),
            fma: gpu.kernel("bench/fma", include_str!("../../shaders/bench/fma.wgsl"), &constants),
            from: gpu.zeros("bench/from", copied),
            to: gpu.zeros("bench/to", copied),
            sums: gpu.zeros("bench/sums", lanes),
            copied,
            lanes,
        }
    }

    /// Launch, copy, multiply-add.
    pub fn cases(&self) -> Vec<Case<'_>> {
        let copy = |len4: usize| -> Case<'_> {
            Case {
                name: if len4 == 1 { "device/launch" } else { "device/copy" },
                needs: Counts { bytes: 32.0 * len4 as f64, flops: 0.0 },
                record: Box::new(move |recorder| {
                    let groups = linear_groups(len4, 64);
                    recorder.dispatch(&self.copy, &[len4 as u32, 0, 0, 0], &[&self.from, &self.to], groups);
                }),
            }
        };
        let lanes = self.lanes;
        let fma = Case {
            name: "device/fma",
            // A vector of four in each chain, eight steps in each round.
            needs: Counts { bytes: 4.0 * lanes as f64, flops: 2.0 * (4 * CHAINS * 8 * ROUNDS * lanes) as f64 },
            record: Box::new(move |recorder| {
                let groups = [(lanes / 64) as u32, 1, 1];
                recorder.dispatch(&self.fma, &[0.5f32, 0.0, 0.0, 0.0], &[&self.sums], groups);
            }),
        };
        vec![copy(1), copy(self.copied / 4), fma]
    }

    /// Measures them.
    pub fn measure(gpu: &Gpu, repeats: u32) -> Result<Peaks, GpuError> {
        let ceilings = Self::new(gpu);
        Ok(ceilings.peaks(gpu, &interleaved(gpu, &ceilings.cases(), repeats)?))
    }

    /// From the times of [`Ceilings::cases`].
    fn peaks(&self, gpu: &Gpu, times: &[Times]) -> Peaks {
        let cases = self.cases();
        Peaks {
            launch_ms: times[0].best_ms,
            copy_gb_per_s: 1e-6 * cases[1].needs.bytes / times[1].alone_ms(gpu),
            fma_gflop_per_s: 1e-6 * cases[2].needs.flops / times[2].alone_ms(gpu),
        }
    }
}
