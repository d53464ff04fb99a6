//! The device's life.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};

use super::adapters::{candidates, first_that_opens, lack};
use super::bindings::Bindings;
use super::faults::Faults;
use super::kernel::Kernel;
use super::timing::Timings;

/// Why the device could not be had or did not finish its work.
#[derive(Debug, thiserror::Error)]
pub enum GpuError {
    #[error("no graphics adapter was found ({0}); install a Vulkan driver (Debian: mesa-vulkan-drivers libvulkan1)")]
    NoAdapter(String),
    #[error("the adapter {adapter} could not be opened: {reason}")]
    Open { adapter: String, reason: String },
    #[error("no adapter could be opened: {0}")]
    NoneOpens(String),
    #[error("the device was lost: {0}")]
    Lost(String),
    #[error("the device reported: {0}")]
    Failed(String),
}

/// Which adapter to use.
#[derive(Clone, Debug, Default)]
pub enum DeviceSelect {
    /// The fastest hardware adapter that opens, else a software one. `EFFIGY_DEVICE`, a text as for `Named`, overrides it.
    #[default]
    Auto,
    /// The first adapter whose name contains this text, without regard to case, or with `#2` at its end the second; no other one.
    Named(String),
}

/// What the device is, for reports and test output.
#[derive(Clone, Debug, serde::Serialize)]
pub struct DeviceInfo {
    pub name: String,
    pub backend: String,
    pub driver: String,
    /// True for a driver that computes on the CPU.
    pub software: bool,
    /// Whether a 64-bit number in memory can be raised atomically.
    pub wide_atomics: bool,
    /// Whether one can be added to.
    pub wide_sums: bool,
    /// Whether kernels are divided among many slow cores, as a graphics processor has them, rather than among few fast ones.
    pub wide: bool,
    /// Whether profiles go by the device's own clock: a driver that computes on the CPU has none of its own.
    pub clock: bool,
    pub max_binding_bytes: u64,
    /// Invocations of a workgroup, at most.
    pub max_workgroup: u32,
}

/// An open device with its queue and its compiled kernels.
pub struct Gpu {
    pub(super) device: wgpu::Device,
    pub(super) queue: wgpu::Queue,
    info: DeviceInfo,
    skipped: Vec<String>,
    pub(super) kernels: Mutex<HashMap<u64, Arc<Kernel>>>,
    pub(super) memory: Arc<Memory>,
    pub(super) faults: Faults,
    pub(super) timings: Timings,
    /// What offsets of uniform bindings are multiples of.
    pub(super) params_alignment: usize,
}

/// Bytes of buffers alive now and at most, and what binds them.
#[derive(Default)]
pub(super) struct Memory {
    now: AtomicU64,
    peak: AtomicU64,
    /// The next of [`Memory::number`].
    numbers: AtomicU64,
    /// Buffers dropped so far.
    dropped: AtomicU64,
    bindings: Mutex<Bindings>,
}

impl Memory {
    pub(super) fn add(&self, bytes: u64) {
        let now = self.now.fetch_add(bytes, Ordering::Relaxed) + bytes;
        self.peak.fetch_max(now, Ordering::Relaxed);
    }

    /// Takes note that a buffer is dropped. Bind groups hold it too: they go at once or, where a submission is just being made,
    /// with the next one.
    pub(super) fn drop_buffer(&self, bytes: u64) {
        self.now.fetch_sub(bytes, Ordering::Relaxed);
        self.dropped.fetch_add(1, Ordering::Relaxed);
        match self.bindings.try_lock() {
            Ok(mut bindings) => bindings.forget(),
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner().forget(),
            Err(TryLockError::WouldBlock) => {}
        }
    }

    /// What dispatches bind, for one submission; others wait until it is made.
    pub(super) fn bindings(&self, gpu: &Gpu, params: &[u8]) -> MutexGuard<'_, Bindings> {
        // Whoever panicked in a submission has left groups that are whole.
        let mut bindings = self.bindings.lock().unwrap_or_else(PoisonError::into_inner);
        bindings.begin(&gpu.device, &gpu.queue, params, self.dropped.load(Ordering::Relaxed));
        bindings
    }

    /// Lets go of all that dispatches bind, also of the buffer of their parameters: it may not be whole.
    pub(super) fn renew_bindings(&self) {
        *self.bindings.lock().unwrap_or_else(PoisonError::into_inner) = Bindings::default();
    }

    /// A number that nothing else on the device has.
    pub(super) fn number(&self) -> u64 {
        self.numbers.fetch_add(1, Ordering::Relaxed)
    }
}

impl Gpu {
    /// Opens a device. Blocks; errors when no adapter is there, or none that may be tried is of use.
    pub fn open(select: &DeviceSelect) -> Result<Arc<Gpu>, GpuError> {
        let backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12;
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor {
            backends,
            ..wgpu::InstanceDescriptor::new_without_display_handle()
        });
        let adapters = pollster::block_on(instance.enumerate_adapters(backends));
        let kind_and_name = |adapter: &wgpu::Adapter| {
            let info = adapter.get_info();
            (info.device_type, info.name)
        };
        let adapters = candidates(adapters, select, kind_and_name)?;
        let (mut gpu, skipped) = first_that_opens(adapters, |adapter| pollster::block_on(Self::from_adapter(adapter)))?;
        gpu.skipped = skipped.iter().map(ToString::to_string).collect();
        for reason in &gpu.skipped {
            tracing::warn!(reason, taken = gpu.info.name, "a device is passed over");
        }
        Ok(Arc::new(gpu))
    }

    async fn from_adapter(adapter: &wgpu::Adapter) -> Result<Gpu, GpuError> {
        let info = adapter.get_info();
        let unfit = |reason| GpuError::Open { adapter: info.name.clone(), reason };
        let limits = adapter.limits();
        if let Some(reason) = lack(&limits) {
            return Err(unfit(reason));
        }
        let mut features = wgpu::Features::empty();
        // `EFFIGY_NO_WIDE_ATOMICS` tests what stands for them on a device that has them.
        let wide = wgpu::Features::SHADER_INT64 | wgpu::Features::SHADER_INT64_ATOMIC_MIN_MAX;
        let wide_atomics = adapter.features().contains(wide) && std::env::var_os("EFFIGY_NO_WIDE_ATOMICS").is_none();
        // Metal raises them and does not add.
        let wide_sums = wide_atomics && adapter.features().contains(wgpu::Features::SHADER_INT64_ATOMIC_ALL_OPS);
        if wide_atomics {
            features |= wide;
        }
        if wide_sums {
            features |= wgpu::Features::SHADER_INT64_ATOMIC_ALL_OPS;
        }
        let software = info.device_type == wgpu::DeviceType::Cpu;
        let stamps = wgpu::Features::TIMESTAMP_QUERY | wgpu::Features::TIMESTAMP_QUERY_INSIDE_ENCODERS;
        let clock = !software && adapter.features().contains(stamps);
        if clock {
            features |= stamps;
        }
        let params_alignment = limits.min_uniform_buffer_offset_alignment as usize;
        let max_binding_bytes = limits.max_storage_buffer_binding_size;
        let max_workgroup = limits.max_compute_invocations_per_workgroup.min(limits.max_compute_workgroup_size_x);
        let (device, queue) = adapter
            .request_device(&wgpu::DeviceDescriptor {
                label: Some("effigy"),
                required_features: features,
                required_limits: limits,
                experimental_features: wgpu::ExperimentalFeatures::disabled(),
                memory_hints: wgpu::MemoryHints::MemoryUsage,
                trace: wgpu::Trace::Off,
            })
            .await
            .map_err(|e| unfit(e.to_string()))?;
        let faults = Faults::default();
        faults.listen(&device);
        let gpu = Gpu {
            info: DeviceInfo {
                name: info.name.clone(),
                backend: info.backend.to_string(),
                driver: format!("{} {}", info.driver, info.driver_info),
                software,
                wide_atomics,
                wide_sums,
                // `EFFIGY_WIDE_KERNELS` tests on a driver that computes on the CPU what others run.
                wide: !software || std::env::var_os("EFFIGY_WIDE_KERNELS").is_some(),
                clock,
                max_binding_bytes,
                max_workgroup,
            },
            skipped: Vec::new(),
            device,
            queue,
            kernels: Mutex::default(),
            memory: Arc::default(),
            faults,
            timings: Timings::default(),
            params_alignment,
        };
        gpu.set_profiling(std::env::var_os("EFFIGY_GPU_PROFILE").is_some());
        Ok(gpu)
    }

    pub fn info(&self) -> &DeviceInfo {
        &self.info
    }

    /// Why adapters that would have come first were not taken, each by its name.
    pub fn skipped(&self) -> &[String] {
        &self.skipped
    }

    /// Waits until all submitted work is done.
    pub fn wait(&self) -> Result<(), GpuError> {
        self.device.poll(wgpu::PollType::wait_indefinitely()).map_err(|e| GpuError::Lost(e.to_string()))?;
        self.check()
    }

    /// Bytes of device buffers that are alive.
    pub fn bytes(&self) -> u64 {
        self.memory.now.load(Ordering::Relaxed)
    }

    /// The most bytes of device buffers that were alive at one time.
    pub fn peak_bytes(&self) -> u64 {
        self.memory.peak.load(Ordering::Relaxed)
    }
}
