//! What the device gives at best: a launch, memory, arithmetic.

use std::sync::Arc;

use effigy::gpu::{Buffer, Gpu, Kernel, linear_groups};

use super::Case;

/// Floats that the copy moves: beyond any cache, within what WebGPU binds.
const COPIED: usize = 16 << 20;
const LANES: usize = 1 << 17;
const ROUNDS: usize = 64;
const CHAINS: usize = 4;

pub struct Ceilings {
    copy: Arc<Kernel>,
    fma: Arc<Kernel>,
    from: Buffer<f32>,
    to: Buffer<f32>,
    sums: Buffer<f32>,
}

impl Ceilings {
    pub fn new(gpu: &Gpu) -> Self {
        let constants = [("ROUNDS", format!("{ROUNDS}u")), ("CHAINS", format!("{CHAINS}u"))];
        Self {
            copy: gpu.kernel("bench/copy", include_str!("../../../shaders/bench/copy.wgsl"), &[]),
            fma: gpu.kernel("bench/fma", include_str!("../../../shaders/bench/fma.wgsl"), &constants),
            from: gpu.zeros("bench/from", COPIED),
            to: gpu.zeros("bench/to", COPIED),
            sums: gpu.zeros("bench/sums", LANES),
        }
    }

    pub fn cases(&self) -> Vec<Case<'_>> {
        let copy = |len4: usize| -> Case<'_> {
            Case {
                name: if len4 == 1 { "device/launch" } else { "device/copy" },
                bytes: 32.0 * len4 as f64,
                flops: None,
                record: Box::new(move |recorder| {
                    let groups = linear_groups(len4, 64);
                    recorder.dispatch(&self.copy, &[len4 as u32, 0, 0, 0], &[&self.from, &self.to], groups);
                }),
            }
        };
        let fma = Case {
            name: "device/fma",
            bytes: 4.0 * LANES as f64,
            // A vector of four in each chain, eight steps in each round.
            flops: Some(2.0 * (4 * CHAINS * 8 * ROUNDS * LANES) as f64),
            record: Box::new(|recorder| {
                let groups = [(LANES / 64) as u32, 1, 1];
                recorder.dispatch(&self.fma, &[0.5f32, 0.0, 0.0, 0.0], &[&self.sums], groups);
            }),
        };
        vec![copy(1), copy(COPIED / 4), fma]
    }
}
