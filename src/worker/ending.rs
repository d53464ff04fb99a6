//! How a job ends: its files are sealed and its end is written, with what its user learns of a failure.

use std::time::Duration;

use super::pipeline::{Outcome, PipelineError, StopReason};
use super::runner::Runner;
use crate::capture::CaptureError;
use crate::jobs::{AvatarFile, Job, JobError, Lease, NewAvatar, QueueError, Repeat, Standing};
use crate::storage::Published;

/// Tries to write the end of a job while the database refuses, before the lease is left to run out.
const END_TRIES: u32 = 10;
const END_WAIT: Duration = Duration::from_secs(3);

impl Runner {
    /// Writes the end of an attempt, whatever it is, and removes what nobody needs then.
    pub(super) async fn finish(&self, lease: &Lease, job: &Job, end: Result<Outcome, PipelineError>) {
        let sealed = match end {
            Ok(outcome) => match self.seal(lease).await {
                Ok(files) => Ok(new_avatar(job, outcome, files)),
                Err(error) => Err(PipelineError::Internal(error)),
            },
            Err(error) => Err(error),
        };
        if sealed.is_err() {
            // What the attempt made is worth nothing, and on a full disk the database needs the room to say so.
            let (store, lease) = (self.store.clone(), lease.clone());
            let discarded = tokio::task::spawn_blocking(move || store.discard_results(lease.job, lease.epoch)).await;
            if let Err(error) = discarded.unwrap_or_else(|panic| Err(panic.into())) {
                tracing::warn!(%error, "files of a failed attempt stay");
            }
        }
        for attempt in 1..=END_TRIES {
            match self.write_end(lease, &sealed).await {
                Ok(standing) => {
                    let mine = standing != Standing::Lost;
                    self.tidy(lease, mine && sealed.is_ok(), mine && !is_repeatable(&sealed)).await;
                    return;
                }
                Err(error) => {
                    tracing::error!(job = %lease.job, attempt, %error, "the end of the job could not be written");
                    tokio::time::sleep(END_WAIT).await;
                }
            }
        }
    }

    async fn write_end(&self, lease: &Lease, end: &Result<NewAvatar, PipelineError>) -> Result<Standing, QueueError> {
        match end {
            Ok(avatar) => self.queue.succeed(lease, avatar.clone()).await,
            Err(PipelineError::Stopped(StopReason::Cancel)) => self.queue.confirm_cancel(lease).await,
            Err(PipelineError::Stopped(StopReason::Shutdown)) => self.queue.give_back(lease).await,
            Err(PipelineError::Stopped(StopReason::LostLease)) => Ok(Standing::Lost),
            Err(error) => {
                let repeat = if is_repeatable(end) { Repeat::Counted } else { Repeat::Never };
                self.queue.fail(lease, job_error(error, self.store.has_room(0)), repeat).await
            }
        }
    }

    async fn seal(&self, lease: &Lease) -> anyhow::Result<Vec<AvatarFile>> {
        let folder = self.store.results(lease.job, lease.epoch);
        let sealed = tokio::task::spawn_blocking(move || Published::seal(&folder)).await??;
        let files = sealed.into_iter().map(|f| AvatarFile { name: f.name, bytes: f.bytes, sha256: f.sha256 });
        Ok(files.collect())
    }

    /// Removes what nobody needs any more: after success all but the results; else this attempt's results, and where
    /// a repetition would only repeat the failure, its checkpoints. Of a lost lease the job is another attempt's by now.
    async fn tidy(&self, lease: &Lease, published: bool, final_failure: bool) {
        let (store, lease) = (self.store.clone(), lease.clone());
        let tidied = tokio::task::spawn_blocking(move || {
            if published {
                store.tidy_job(lease.job, Some(lease.epoch))
            } else if final_failure {
                store.tidy_job(lease.job, None)
            } else {
                store.discard_results(lease.job, lease.epoch)
            }
        });
        match tidied.await {
            Ok(Ok(())) => {}
            Ok(Err(error)) => tracing::warn!(%error, "files of a finished attempt stay"),
            Err(error) => tracing::error!(%error, "tidying panicked"),
        }
    }
}

/// Failures of the moment: a device or a disk may do better next time. A stop is no failure and keeps its checkpoint.
fn is_repeatable<T>(end: &Result<T, PipelineError>) -> bool {
    match end {
        Ok(_) | Err(PipelineError::Stopped(_) | PipelineError::Device(_) | PipelineError::Internal(_)) => true,
        Err(PipelineError::BadInput(error)) => error.bad_input().is_none(),
        Err(PipelineError::Diverged { .. } | PipelineError::Unfit(_)) => false,
    }
}

fn new_avatar(job: &Job, outcome: Outcome, files: Vec<AvatarFile>) -> NewAvatar {
    NewAvatar {
        body: job.options.body.clone(),
        frames: outcome.frames,
        camera: outcome.camera,
        metrics: outcome.metrics,
        files,
    }
}

/// What a user learns; `has_room` tells whether the disk has more than its reserve.
fn job_error(error: &PipelineError, has_room: bool) -> JobError {
    match error {
        PipelineError::BadInput(CaptureError::Bad(bad)) => JobError {
            part: Some(bad.part.to_string()),
            frame: bad.frame,
            expected: Some(bad.expected.clone()),
            ..JobError::new("bad-input", bad.message.clone())
        },
        PipelineError::Diverged { losses, .. } => {
            // A loss that is no number has no JSON.
            let losses = losses.iter().filter(|(_, v)| v.is_finite()).map(|(k, v)| (k.clone(), *v)).collect();
            JobError { losses, ..JobError::new("diverged", error.to_string()) }
        }
        PipelineError::Unfit(_) => JobError::new("unfit", error.to_string()),
        PipelineError::Device(_) => JobError::new("device", error.to_string()),
        // Causes of the server's own name its paths: they are for the log.
        PipelineError::Internal(_) | PipelineError::BadInput(_) | PipelineError::Stopped(_) if has_room => {
            JobError::new("internal", "something went wrong inside the server; its log has the cause")
        }
        _ => JobError::new("disk-full", "the server's disk is full"),
    }
}

#[cfg(test)]
mod tests {
    use std::io;

    use super::*;

    #[test]
    fn users_learn_of_a_full_disk_and_of_no_path() {
        const PATH: &str = "/var/lib/effigy/jobs/7/work/checkpoint.npz";
        let io = || io::Error::new(io::ErrorKind::StorageFull, format!("{PATH}: no"));
        for error in [
            PipelineError::Internal(anyhow::Error::from(io()).context("the checkpoint")),
            PipelineError::BadInput(CaptureError::Internal { what: "cannot read".into(), source: io() }),
            PipelineError::Internal(anyhow::anyhow!("panicked: {PATH}")),
        ] {
            assert!(error.to_string().contains(PATH), "the log has it: {error}");
            for (has_room, kind) in [(true, "internal"), (false, "disk-full")] {
                let told = job_error(&error, has_room);
                assert_eq!(told.kind, kind, "{error}");
                assert!(!told.detail.contains('/'), "{told:?}");
            }
        }
    }
}
