//! The worker: claims jobs, runs them on the device's own thread, and draws for the server.
//!
//! ```text
//! server process                          worker process
//!   http ── Supervisor ── JSON lines ──► channel ──► device thread ── Engine (fits and renders)
//!              restarts it                  claims ──┘   ▲ stop, progress
//!   reaper                                  runner ──────┘ heartbeat, events, publishing ──► queue, store
//! ```
//!
//! A driver that crashes takes this process down, not the server; the lease of the job that it had is released as soon
//! as the process is gone, because the lock on its file is gone too ([`owner`]). A fit that hangs ends the process too: its thread cannot be
//! stopped.

pub mod channel;
mod claims;
mod device_thread;
mod ending;
mod engine;
mod fit_observer;
mod owner;
pub mod pipeline;
mod reaper;
mod renders;
mod runner;
mod running_fit;
mod supervisor;
#[cfg(test)]
mod tests;

pub use claims::{Hung, Worker, WorkerSettings};
pub use device_thread::DeviceThread;
pub use engine::{DeviceEngine, Engine, FitTask};
pub use owner::Owner;
pub use reaper::Reaper;
pub use supervisor::{Supervisor, SupervisorSettings};

/// How long a fit may take to write its checkpoint and stop, when its process is asked to end. What waits for the process waits a
/// little longer: the supervisor, and deploy/ (90 s).
pub const STOP_GRACE: std::time::Duration = std::time::Duration::from_secs(60);
