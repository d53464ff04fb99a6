//! Takes back leases of the dead and the silent, and removes the files of what is gone.

use std::sync::Arc;
use std::time::Duration;

use uuid::Uuid;

use super::owner::{self, Owner};
use crate::jobs::{Queue, QueueError};
use crate::storage::Store;

const ROUND: Duration = Duration::from_secs(2);
/// Free bytes that leave room beside what is kept for deletions.
const PLENTY: u64 = 32 << 20;

/// Looks every other second for leases whose worker is dead or silent, deadlines that have passed, and files that nobody needs.
pub struct Reaper {
    pub queue: Arc<dyn Queue>,
    pub store: Arc<Store>,
}

impl Reaper {
    /// Rounds for ever.
    pub async fn run(self) {
        loop {
            if let Err(error) = self.round().await {
                tracing::warn!(%error, "the reaper failed and comes again");
            }
            tokio::time::sleep(ROUND).await;
        }
    }

    /// One look, even on a full disk; then what is kept for deletions is loaded again, whoever gave it up.
    pub async fn round(&self) -> Result<(), QueueError> {
        let looked = self.store.despite_full_disk(QueueError::is_disk_full, || self.look()).await;
        // Not from the little that a deletion which is under way has won.
        if self.store.free_bytes().is_ok_and(|free| free > PLENTY) {
            self.store.reload_ballast();
        }
        looked
    }

    async fn look(&self) -> Result<(), QueueError> {
        for owner in self.queue.owners().await? {
            match Owner::remove_if_dead(&self.store.workers(), &owner) {
                Ok(true) => {
                    for job in self.queue.release_owner(&owner).await? {
                        tracing::warn!(%job, owner, "taken back from a dead worker");
                    }
                }
                Ok(false) => {}
                Err(error) => tracing::warn!(owner, %error, "cannot tell whether the worker lives"),
            }
        }
        if let Err(error) = owner::sweep(&self.store.workers()) {
            tracing::warn!(%error, "locks of dead workers stay");
        }
        let reaped = self.queue.reap().await?;
        for job in &reaped.reclaimed {
            tracing::warn!(%job, "taken back from a silent worker");
        }
        for job in &reaped.late {
            tracing::warn!(%job, "failed: its deadline has passed");
        }
        for job in reaped.expired.into_iter().chain(reaped.deleted) {
            self.remove_files(job).await;
        }
        Ok(())
    }

    async fn remove_files(&self, job: Uuid) {
        let store = self.store.clone();
        match tokio::task::spawn_blocking(move || store.delete_job(job)).await {
            Ok(Ok(())) => tracing::info!(%job, "its files are removed"),
            // The next start of a server removes what has no row, or one that has expired.
            Ok(Err(error)) => tracing::warn!(%job, %error, "its files stay"),
            Err(error) => tracing::error!(%job, %error, "removing its files panicked"),
        }
    }
}
