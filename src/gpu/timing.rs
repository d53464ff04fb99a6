//! Time a kernel, for profiles: with `EFFIGY_GPU_PROFILE` set every dispatch is submitted and awaited alone.

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::time::Instant;

use super::device::Gpu;

/// Calls and total wall time of one kernel.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct KernelTime {
    pub calls: u64,
    pub secs: f64,
}

#[derive(Default)]
pub(super) struct Timings {
    by_label: Mutex<BTreeMap<String, KernelTime>>,
}

impl Timings {
    pub(super) fn measure<R>(&self, label: &str, work: impl FnOnce() -> R) -> R {
        let start = Instant::now();
        let result = work();
        let secs = start.elapsed().as_secs_f64();
        let mut all = self.by_label.lock().unwrap();
        let entry = all.entry(label.to_owned()).or_default();
        entry.calls += 1;
        entry.secs += secs;
        result
    }
}

impl Gpu {
    /// Times since the device was opened or the last call, by kernel label. Empty unless profiling is on.
    pub fn take_timings(&self) -> BTreeMap<String, KernelTime> {
        self.timings.as_ref().map_or_else(BTreeMap::new, |t| std::mem::take(&mut t.by_label.lock().unwrap()))
    }
}
