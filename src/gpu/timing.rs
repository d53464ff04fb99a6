//! Time a kernel, for profiles: by the device's clock where it has one, else every dispatch is submitted and awaited alone.
//! On from the start with `EFFIGY_GPU_PROFILE` set.

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use super::device::{Gpu, GpuError};

/// Calls and total time of one kernel.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct KernelTime {
    pub calls: u64,
    pub secs: f64,
    /// Of all the process's threads: what a device that computes on the CPU used, whoever else uses the machine. Zero where
    /// the device's clock was asked.
    pub cpu_secs: f64,
}

#[derive(Default)]
pub(super) struct Timings {
    pub(super) on: AtomicBool,
    by_label: Mutex<BTreeMap<String, KernelTime>>,
}

/// CPU time of this process, all threads; zero where the system has no such clock.
#[cfg(not(unix))]
pub fn cpu_secs() -> f64 {
    0.0
}

/// CPU time of this process, all threads.
#[cfg(unix)]
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
        self.add(label, start.elapsed().as_secs_f64(), cpu_secs() - cpu_start);
        result
    }

    pub(super) fn add(&self, label: &str, secs: f64, cpu_secs: f64) {
        let mut all = self.by_label.lock().unwrap();
        let entry = all.entry(label.to_owned()).or_default();
        entry.calls += 1;
        entry.secs += secs;
        entry.cpu_secs += cpu_secs;
    }
}

/// Places for readings of the device's clock within one submission.
pub(super) struct Stamps {
    pub(super) set: wgpu::QuerySet,
    /// No [`super::Buffer`], whose end would let go of what dispatches bind.
    ticks: wgpu::Buffer,
}

impl Stamps {
    /// Commands whose two readings a set holds.
    pub(super) const MOST: usize = wgpu::QUERY_SET_MAX_QUERIES as usize / 2;

    pub(super) fn new(gpu: &Gpu, count: usize) -> Self {
        let set = gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
            label: Some("gpu/stamps"),
            ty: wgpu::QueryType::Timestamp,
            count: count as u32,
        });
        let ticks = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("gpu/ticks"),
            size: (count * size_of::<u64>()) as u64,
            usage: wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        Self { set, ticks }
    }

    /// Submits what has been encoded, and waits. All readings in seconds.
    pub(super) fn submit(&self, gpu: &Gpu, mut encoder: wgpu::CommandEncoder) -> Result<Vec<f64>, GpuError> {
        let size = self.ticks.size();
        encoder.resolve_query_set(&self.set, 0..(size / 8) as u32, &self.ticks, 0);
        gpu.queue.submit([encoder.finish()]);
        let tick = 1e-9 * f64::from(gpu.queue.get_timestamp_period());
        let ticks: Vec<u64> = bytemuck::pod_collect_to_vec(&gpu.read_bytes(&self.ticks, size, "gpu/ticks")?);
        // Of the differences alone: the clock itself has more digits than a double.
        Ok(ticks.iter().map(|&t| t.wrapping_sub(ticks[0]) as f64 * tick).collect())
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
