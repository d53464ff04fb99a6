//! The claim loop of a worker process.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;

use super::device_thread::DeviceThread;
use super::owner::Owner;
use super::runner::Runner;
use crate::gpu::GpuError;
use crate::jobs::{Job, Lease, Queue, QueueError};
use crate::storage::Store;

/// The rhythm of a worker.
#[derive(Clone, Debug)]
pub struct WorkerSettings {
    /// How often an idle worker looks for a job.
    pub poll: Duration,
    /// A fit that shows no step for longer hangs: its attempt ends, and the process with it.
    pub stall: Duration,
    /// How often a device that does not open is tried again.
    pub reopen: Duration,
}

impl Default for WorkerSettings {
    fn default() -> Self {
        WorkerSettings {
            poll: Duration::from_millis(500),
            stall: Duration::from_secs(600),
            reopen: Duration::from_secs(10),
        }
    }
}

/// The device's thread is stuck.
#[derive(Debug, thiserror::Error)]
pub enum Hung {
    #[error("the fit of job {job} has shown no step for {secs} s")]
    Fit { job: uuid::Uuid, secs: u64 },
    #[error("the device has not been opened for {secs} s")]
    Opening { secs: u64 },
}

/// Claims jobs one after the other and runs them.
pub struct Worker {
    pub queue: Arc<dyn Queue>,
    pub store: Arc<Store>,
    pub device: DeviceThread,
    pub owner: Owner,
    pub settings: WorkerSettings,
}

impl Worker {
    /// Works until `shutdown` turns true; a job that runs then is given back with its checkpoint. Where a fit hangs,
    /// nothing more can be done on the device: the process must end.
    pub async fn run(self, mut shutdown: watch::Receiver<bool>) -> Result<(), Hung> {
        tracing::info!(owner = self.owner.id(), "the worker waits for jobs");
        let runner = Runner {
            queue: self.queue.clone(),
            store: self.store.clone(),
            device: self.device.clone(),
            stall: self.settings.stall,
            shutdown: shutdown.clone(),
        };
        let (mut had_room, mut had_device) = (true, true);
        while !*shutdown.borrow_and_update() {
            // A fit that fills the disk takes the whole service down: it waits, and so do the jobs.
            let has_room = self.store.has_room(0);
            if had_room != has_room {
                tracing::warn!(reserve_bytes = self.store.reserve_bytes(), has_room, "the disk's reserve");
                had_room = has_room;
            }
            // Without a device each job would spend its attempts within seconds, and the next one after it.
            let opened = tokio::select! {
                opened = self.open() => opened?,
                changed = shutdown.changed() => if changed.is_err() { break } else { continue },
            };
            let has_device = opened.is_ok();
            match opened {
                Err(error) if had_device => tracing::warn!(%error, "no device: jobs wait"),
                Ok(()) if !had_device => tracing::info!("the device is open"),
                _ => {}
            }
            had_device = has_device;
            match self.claim_if(has_room && has_device).await {
                Ok(Some((lease, job))) => {
                    runner.run(&lease, &job).await?;
                    continue;
                }
                Ok(None) => {}
                Err(error) => tracing::warn!(%error, "no claim"),
            }
            tokio::select! {
                () = tokio::time::sleep(if has_device { self.settings.poll } else { self.settings.reopen }) => {}
                // The sender's end is the end of the process.
                changed = shutdown.changed() => if changed.is_err() { break },
            }
        }
        tracing::info!(owner = self.owner.id(), "the worker has ended");
        Ok(())
    }

    /// Waits for pictures that are being drawn, as a fit would.
    async fn open(&self) -> Result<Result<(), GpuError>, Hung> {
        match tokio::time::timeout(self.settings.stall, self.device.open()).await {
            Ok(Ok(opened)) => Ok(opened),
            Ok(Err(_)) => Ok(Err(GpuError::Lost("the device's thread ended".into()))),
            Err(_) => Err(Hung::Opening { secs: self.settings.stall.as_secs() }),
        }
    }

    async fn claim_if(&self, may: bool) -> Result<Option<(Lease, Job)>, QueueError> {
        if may { self.queue.claim(self.owner.id()).await } else { Ok(None) }
    }
}
