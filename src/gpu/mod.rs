//! The device: adapters, buffers, kernels and the recording of work. The only folder that creates pipelines.
//!
//! An operator holds [`Kernel`]s and records dispatches over [`Buffer`]s into a [`Recorder`]; one recorder is one
//! submission, so a whole optimisation step reaches the device at once.

mod adapters;
mod bindings;
mod buffer;
mod device;
mod faults;
mod kernel;
mod recorder;
mod rehearsal;
pub mod shader;
mod timing;

pub use adapters::WORKGROUP_BYTES;
pub use buffer::Buffer;
pub use device::{DeviceInfo, DeviceSelect, Gpu, GpuError};
pub use kernel::Kernel;
pub use recorder::{AnyBuffer, Recorder, linear_groups};
pub use timing::{KernelTime, cpu_secs};
