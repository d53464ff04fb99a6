//! Wall times on a machine that others may use too.

use std::collections::BTreeMap;
use std::time::Instant;

use super::Case;
use crate::gpu::{Gpu, GpuError, KernelTime, cpu_secs};
use crate::math::median;

/// Times of one thing, milliseconds.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct Times {
    /// The shortest wall time: what the device does when nobody disturbs it. Where its clock is asked, that is a part of it.
    pub best_ms: f64,
    pub median_ms: f64,
    /// The shortest CPU time, all threads together. A device that computes on the CPU takes about this over the number of
    /// cores when it has the machine for itself; on others it is the host's share.
    pub cpu_ms: f64,
    /// The median by the device's clock, where it has one: without the way to the device and back.
    pub device_ms: Option<f64>,
}

impl Times {
    /// Of pairs of wall and CPU time.
    ///
    /// # Panics
    /// Without times.
    pub fn of(pairs: &[[f64; 2]]) -> Self {
        let of = |k: usize| pairs.iter().map(move |pair| pair[k]);
        let least = |k: usize| of(k).min_by(f64::total_cmp).expect("a time or more");
        let median_ms = median(of(0)).expect("a time or more");
        Self { best_ms: least(0), median_ms, cpu_ms: least(1), device_ms: None }
    }

    /// What the work takes when it has the device for itself, as far as it uses all of it: by the device's clock, else the
    /// best wall time, or, on a device that computes on the CPU, the CPU time over the number of cores, which others on the
    /// machine hardly disturb.
    pub fn alone_ms(&self, gpu: &Gpu) -> f64 {
        if gpu.info().software { self.cpu_ms / cores() } else { self.device_ms.unwrap_or(self.best_ms) }
    }
}

/// Cores that this process may use.
pub fn cores() -> f64 {
    std::thread::available_parallelism().map_or(1.0, |n| n.get() as f64)
}

/// Wall and CPU time of a call, milliseconds.
pub fn timed<E>(work: impl FnOnce() -> Result<(), E>) -> Result<[f64; 2], E> {
    let (start, cpu_start) = (Instant::now(), cpu_secs());
    work()?;
    Ok([1e3 * start.elapsed().as_secs_f64(), 1e3 * (cpu_secs() - cpu_start)])
}

/// The kernels of some work, each dispatch timed by itself: sums over one call, as the mean of `repeats`.
pub(super) fn profiled<E>(
    gpu: &Gpu,
    repeats: u32,
    mut work: impl FnMut() -> Result<(), E>,
) -> Result<BTreeMap<String, KernelTime>, E> {
    gpu.take_timings();
    gpu.set_profiling(true);
    let result = (0..repeats).try_for_each(|_| work());
    gpu.set_profiling(false);
    result?;
    let mut kernels = gpu.take_timings();
    for time in kernels.values_mut() {
        time.calls /= u64::from(repeats);
        time.secs /= f64::from(repeats);
        time.cpu_secs /= f64::from(repeats);
    }
    Ok(kernels)
}

/// Times of submissions that are awaited: one call of each case that compiles and warms up, then `repeats` rounds over
/// all cases in turn, so that a disturbance hits all alike.
pub fn interleaved(gpu: &Gpu, cases: &[Case<'_>], repeats: u32) -> Result<Vec<Times>, GpuError> {
    let once = |case: &Case<'_>| {
        let mut device_secs = None;
        let pair = timed(|| {
            let mut recorder = gpu.recorder(case.name);
            (case.record)(&mut recorder);
            device_secs = recorder.submit_timed()?;
            Ok::<_, GpuError>(())
        })?;
        Ok::<_, GpuError>((pair, device_secs))
    };
    for case in cases {
        once(case)?;
    }
    let mut all = vec![(Vec::new(), Vec::new()); cases.len()];
    for _ in 0..repeats {
        for (case, (pairs, device)) in cases.iter().zip(&mut all) {
            let (pair, device_secs) = once(case)?;
            pairs.push(pair);
            device.extend(device_secs.map(|secs| 1e3 * secs));
        }
    }
    Ok(all.into_iter().map(|(pairs, device)| Times { device_ms: median(device), ..Times::of(&pairs) }).collect())
}
