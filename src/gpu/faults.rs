//! What the device reports as wrong, and whose it is: the device's, which is then of no more use, or that of work done
//! [apart](Gpu::apart), which nobody else need bear.
//!
//! The driver's answers come on the thread that asked. wgpu's own error scopes go by that too, but tell of a fault only at
//! their end, with the work done on buffers that are none.

use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, ThreadId};

use super::device::{Gpu, GpuError};

#[derive(Clone, Debug)]
enum Fault {
    Lost(String),
    Failed(String),
}

impl From<Fault> for GpuError {
    fn from(fault: Fault) -> Self {
        match fault {
            Fault::Lost(reason) => GpuError::Lost(reason),
            Fault::Failed(reason) => GpuError::Failed(reason),
        }
    }
}

#[derive(Default)]
struct Found {
    /// The first of the device's.
    lasting: Option<Fault>,
    /// The first of each thread that works apart.
    apart: HashMap<ThreadId, Option<Fault>>,
}

/// The faults of one device.
#[derive(Clone, Default)]
pub(super) struct Faults(Arc<Mutex<Found>>);

impl Faults {
    /// Hears of all of them from now on.
    pub fn listen(&self, device: &wgpu::Device) {
        let lost = self.clone();
        device.set_device_lost_callback(move |reason, message| {
            if reason != wgpu::DeviceLostReason::Destroyed {
                lost.lose(message);
            }
        });
        let failed = self.clone();
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| failed.fail(error.to_string())));
    }

    fn found(&self) -> MutexGuard<'_, Found> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A lost device is lost to all.
    fn lose(&self, reason: String) {
        self.found().lasting.get_or_insert(Fault::Lost(reason));
    }

    fn fail(&self, reason: String) {
        let found = &mut *self.found();
        let whose = found.apart.get_mut(&thread::current().id()).unwrap_or(&mut found.lasting);
        whose.get_or_insert(Fault::Failed(reason));
    }

    /// The device's, or else that of this thread's work apart.
    fn first(&self) -> Option<Fault> {
        let found = self.found();
        found.lasting.clone().or_else(|| found.apart.get(&thread::current().id()).cloned().flatten())
    }
}

impl Gpu {
    /// The first error that the device reported since it was opened, if any. Errors stay, but for those of work [apart](Self::apart):
    /// open a fresh device.
    pub fn check(&self) -> Result<(), GpuError> {
        self.faults.first().map_or(Ok(()), |fault| Err(fault.into()))
    }

    /// Does work that others do not depend on: what the device reports meanwhile to this thread, as that it has no memory, is this
    /// work's error, and the device stays of use. What the work made must not be used then. A panic that comes of such a fault
    /// is taken for it.
    ///
    /// # Panics
    /// In work that is apart already.
    pub fn apart<R>(&self, work: impl FnOnce() -> R) -> Result<R, GpuError> {
        let (me, first) = (thread::current().id(), self.memory.number());
        assert!(self.faults.found().apart.insert(me, None).is_none(), "apart within apart");
        let end = catch_unwind(AssertUnwindSafe(work));
        let fault = self.faults.found().apart.remove(&me).flatten();
        if fault.is_some() || end.is_err() {
            // Others would take them for whole.
            self.kernels.lock().unwrap_or_else(PoisonError::into_inner).retain(|_, kernel| kernel.number < first);
            self.memory.renew_bindings();
        }
        match (fault, end) {
            (Some(fault), _) => Err(fault.into()),
            (None, Ok(made)) => Ok(made),
            (None, Err(panic)) => resume_unwind(panic),
        }
    }

    /// Whether this thread does such work.
    pub(super) fn is_apart(&self) -> bool {
        self.faults.found().apart.contains_key(&thread::current().id())
    }

    /// Destroys the device under those who use it, as a driver that resets does. For rehearsals.
    pub(super) fn lose(&self) {
        self.device.destroy();
        self.faults.lose("destroyed in a rehearsal".into());
    }

    /// Leaves the fault that a device without memory reports. For rehearsals.
    pub(super) fn run_out_of_memory(&self, label: &str) {
        self.faults.fail(format!("Not enough memory left for {label} (a rehearsal)"));
    }
}

#[cfg(test)]
mod tests {
    use super::super::{DeviceSelect, linear_groups};
    use super::*;
    use crate::ops::testing::gpu as shared;

    const DOUBLE: &str = "@group(0) @binding(0) var<uniform> params: vec4<u32>;
@group(0) @binding(1) var<storage, read_write> values: array<f32>;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x < params.x { values[id.x] *= 2.0; }
}
";

    /// One of its own: the tests beside share theirs.
    fn gpu(test: &str) -> Option<Arc<Gpu>> {
        shared(test)?;
        Some(Gpu::open(&DeviceSelect::Auto).unwrap())
    }

    /// Compiles its kernel at the first call.
    fn doubled(gpu: &Gpu) -> Result<Vec<f32>, GpuError> {
        let values = gpu.upload("test/values", &[1.0f32, 2.0, 3.0]);
        let mut recorder = gpu.recorder("test/double");
        let kernel = gpu.kernel("test/double", DOUBLE, &[]);
        recorder.dispatch(&kernel, &[3u32, 0, 0, 0], &[&values], linear_groups(3, 64));
        recorder.submit()?;
        gpu.read(&values)
    }

    /// More bytes than any device has.
    const TOO_MANY: usize = 1 << 50;

    #[test]
    fn a_fault_of_work_apart_is_not_the_devices() {
        let Some(gpu) = gpu("faults::a_fault_of_work_apart_is_not_the_devices") else { return };
        let fault = gpu.apart(|| {
            // What is first needed in here must not stay as it is.
            doubled(&gpu).unwrap();
            let buffer = gpu.zeros::<u8>("test/too_large", TOO_MANY);
            assert!(gpu.check().is_err(), "it learns at once");
            gpu.read_front(&buffer, 16)
        });
        let fault = fault.unwrap_err().to_string();
        assert!(fault.contains("test/too_large"), "{fault}");
        gpu.check().unwrap();
        assert_eq!(doubled(&gpu).unwrap(), [2.0, 4.0, 6.0]);
        assert_eq!(gpu.apart(|| doubled(&gpu)).unwrap().unwrap(), [2.0, 4.0, 6.0]);
    }

    #[test]
    fn a_spoilt_kernel_does_not_stay() {
        let Some(gpu) = gpu("faults::a_spoilt_kernel_does_not_stay") else { return };
        let compile = || drop(gpu.kernel("test/wrong", "@group(0) @binding(0) var<uniform> params: vec4<u32>;", &[]));
        assert!(gpu.apart(compile).is_err());
        assert!(gpu.apart(compile).is_err(), "it is compiled anew");
        assert_eq!(doubled(&gpu).unwrap(), [2.0, 4.0, 6.0]);
    }

    #[test]
    fn a_panic_over_a_fault_is_the_fault() {
        let Some(gpu) = gpu("faults::a_panic_over_a_fault_is_the_fault") else { return };
        let fault = gpu.apart(|| {
            let _ = gpu.zeros::<u8>("test/too_large", TOO_MANY);
            panic!("over it");
        });
        assert!(fault.unwrap_err().to_string().contains("test/too_large"));
        let panic = catch_unwind(AssertUnwindSafe(|| gpu.apart(|| panic!("a bug"))));
        assert_eq!(panic.map(|_: Result<(), _>| ()).unwrap_err().downcast_ref::<&str>(), Some(&"a bug"));
        gpu.check().unwrap();
        assert_eq!(doubled(&gpu).unwrap(), [2.0, 4.0, 6.0]);
    }

    #[test]
    fn other_threads_faults_stay_the_devices() {
        let Some(gpu) = gpu("faults::other_threads_faults_stay_the_devices") else { return };
        let spoil = || drop(gpu.zeros::<u8>("test/too_large", TOO_MANY));
        let work = gpu.apart(|| thread::scope(|scope| scope.spawn(spoil).join().unwrap()));
        assert!(work.is_ok());
        assert!(gpu.check().is_err());
    }
}
