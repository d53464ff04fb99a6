//! Time a kernel, for profiles: every dispatch is submitted and awaited alone. On from the start with
//! `EFFIGY_GPU_PROFILE` set.

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use super::device::Gpu;

/// Calls and total time of one kernel.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct KernelTime {
    pub calls: u64,
    pub secs: f64,
    /// Of all the process's threads: what a device that computes on the CPU used, whoever else uses the machine.
    pub cpu_secs: f64,
}

#[derive(Default)]
pub(super) struct Timings {
    pub(super) on: AtomicBool,
    by_label: Mutex<BTreeMap<String, KernelTime>>,
}

/// CPU time of this process, all threads.
pub fn cpu_secs() -> f64 {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: the call writes one timespec, which is ours; it fails for unknown clocks alone.
    unsafe { libc::clock_gettime(libc::CLOCK_PROCESS_CPUTIME_ID, &mut time) };
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

impl Timings {
    pub(super) fn measure<R>(&self, label: &str, work: impl FnOnce() -> R) -> R {
        let (start, cpu_start) = (Instant::now(), cpu_secs());
        let result = work();
        let (secs, cpu_secs) = (start.elapsed().as_secs_f64(), cpu_secs() - cpu_start);
        let mut all = self.by_label.lock().unwrap();
        let entry = all.entry(label.to_owned()).or_default();
        entry.calls += 1;
        entry.secs += secs;
        entry.cpu_secs += cpu_secs;
        result
    }
}

impl Gpu {
    /// Whether dispatches are timed from now on.
    pub fn set_profiling(&self, on: bool) {
        self.timings.on.store(on, Ordering::Relaxed);
    }

    pub(super) fn profiling(&self) -> bool {
        self.timings.on.load(Ordering::Relaxed)
    }

    /// Times since the device was opened or the last call, by kernel label. Empty unless profiling was on.
    pub fn take_timings(&self) -> BTreeMap<String, KernelTime> {
        std::mem::take(&mut self.timings.by_label.lock().unwrap())
    }
}
