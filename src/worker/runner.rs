//! One job under its lease: the fit runs on the device's thread, this task keeps the lease, passes progress on, listens
//! for wishes, and ends the job (`ending.rs`).

use std::io;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::watch;
use tokio::time::{MissedTickBehavior, interval};
use tracing::Instrument;

use super::claims::Hung;
use super::device_thread::DeviceThread;
use super::engine::FitTask;
use super::pipeline::{Outcome, PipelineError, PipelineInput, Preview, Progress, StopReason};
use super::running_fit::RunningFit;
use crate::capture::CaptureInputs;
use crate::jobs::{Job, JobError, Lease, ProgressReport, Queue, Repeat, Standing};
use crate::storage::Store;

/// How often the job's row is looked at: a wish to cancel is passed on within this time.
const LOOK: Duration = Duration::from_millis(200);
/// Progress is written at most this often.
const REPORT: Duration = Duration::from_secs(1);
/// The lease is renewed this often, with or without progress.
const HEARTBEAT: Duration = Duration::from_secs(10);
/// A fit that has not stopped so long after a user's wish (a step may take long on a slow device) is canceled for the
/// user; its lease is gone then, and the worker waits for it alone.
const CANCEL_GRACE: Duration = Duration::from_secs(1);

pub(super) struct Runner {
    pub queue: Arc<dyn Queue>,
    pub store: Arc<Store>,
    pub device: DeviceThread,
    /// Longest time without a step.
    pub stall: Duration,
    /// True once the process is to end.
    pub shutdown: watch::Receiver<bool>,
}

impl Runner {
    /// Runs a claimed job to its end, whatever that is; an error where the fit cannot be ended.
    pub async fn run(&self, lease: &Lease, job: &Job) -> Result<(), Hung> {
        let span = tracing::info_span!("attempt", job = %lease.job, attempt = job.attempt);
        self.run_attempt(lease, job).instrument(span).await
    }

    async fn run_attempt(&self, lease: &Lease, job: &Job) -> Result<(), Hung> {
        let started = Instant::now();
        tracing::info!(job = %lease.job, epoch = lease.epoch, attempt = job.attempt, "the fit begins");
        let running = Arc::new(RunningFit::default());
        let end = match self.task(lease, job).await {
            Ok(task) => {
                let end = self.accompany(lease, task, &running).await;
                self.pass_begun(lease, &running).await;
                self.pass_preview(lease, &running).await;
                self.pass_stage_secs(lease, &running).await;
                match end {
                    Some(end) => end,
                    None => return Err(self.give_up(lease, &running).await),
                }
            }
            Err(error) => Err(PipelineError::Internal(error.into())),
        };
        match &end {
            Ok(_) => tracing::info!(job = %lease.job, secs = started.elapsed().as_secs(), "the fit is done"),
            Err(error) => tracing::warn!(job = %lease.job, %error, "the fit ended without an avatar"),
        }
        self.finish(lease, job, end).await;
        Ok(())
    }

    /// Ends the attempt of a fit that hangs.
    async fn give_up(&self, lease: &Lease, running: &RunningFit) -> Hung {
        let secs = running.silence().as_secs();
        tracing::error!(job = %lease.job, secs, "the fit hangs");
        let stage = running.progress().borrow().as_ref().map_or("first", |progress| progress.stage.name());
        let error = JobError::new("stalled", format!("no step for {secs} s in the {stage} stage"));
        // Where this cannot be written, the reaper finds the process dead.
        if let Err(error) = self.queue.fail(lease, error, Repeat::Killed).await {
            tracing::error!(job = %lease.job, %error, "the end of the attempt could not be written");
        }
        Hung::Fit { job: lease.job, secs }
    }

    async fn task(&self, lease: &Lease, job: &Job) -> std::io::Result<FitTask> {
        let inputs = self.store.inputs(lease.job);
        let task = FitTask {
            input: PipelineInput {
                files: CaptureInputs::in_folder(&inputs, |part| job.inputs.contains_key(part)),
                options: job.options.clone(),
            },
            data_dir: self.store.root().into(),
            work_dir: self.store.work(lease.job),
            out_dir: self.store.results(lease.job, lease.epoch),
        };
        tokio::fs::create_dir_all(&task.work_dir).await?;
        tokio::fs::create_dir_all(&task.out_dir).await?;
        Ok(task)
    }

    /// Until the fit ends; None where it hangs.
    async fn accompany(
        &self,
        lease: &Lease,
        task: FitTask,
        running: &Arc<RunningFit>,
    ) -> Option<Result<Outcome, PipelineError>> {
        let mut end = self.device.fit(task, running.clone());
        let mut progress = running.progress();
        let mut shutdown = self.shutdown.clone();
        let mut looks = interval(LOOK);
        looks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut reported = Instant::now();
        let mut renewed = Instant::now();
        let mut cancel_since: Option<Instant> = None;
        loop {
            tokio::select! {
                end = &mut end => {
                    let gone = |_| Err(PipelineError::Internal(anyhow::anyhow!("the device's thread ended")));
                    return Some(end.unwrap_or_else(gone));
                }
                _ = looks.tick() => {}
            }
            if running.silence() > self.stall {
                return None;
            }
            if *shutdown.borrow_and_update() {
                running.stop(StopReason::Shutdown);
            }
            self.pass_begun(lease, running).await;
            self.pass_saved(lease, running).await;
            self.pass_preview(lease, running).await;
            let news = if reported.elapsed() >= REPORT && progress.has_changed().unwrap_or(false) {
                progress.borrow_and_update().clone()
            } else {
                None
            };
            let standing = if let Some(news) = news {
                reported = Instant::now();
                renewed = reported;
                self.pass_stage_secs(lease, running).await;
                self.queue.report(lease, &report(&news)).await
            } else if renewed.elapsed() >= HEARTBEAT {
                renewed = Instant::now();
                self.queue.heartbeat(lease).await
            } else {
                self.queue.standing(lease).await
            };
            match standing {
                Ok(Standing::Held) => {}
                Ok(Standing::Canceling) => {
                    running.stop(StopReason::Cancel);
                    if cancel_since.get_or_insert_with(Instant::now).elapsed() > CANCEL_GRACE
                        && let Err(error) = self.queue.confirm_cancel(lease).await
                    {
                        tracing::warn!(job = %lease.job, %error, "the job cannot be canceled yet");
                    }
                }
                Ok(Standing::Lost) => running.stop(StopReason::LostLease),
                // The fit goes on: the epoch guards the end should the lease run out meanwhile.
                Err(error) => tracing::warn!(job = %lease.job, %error, "the queue cannot be reached"),
            }
        }
    }

    /// Short stages would else go unseen between two reports.
    async fn pass_begun(&self, lease: &Lease, running: &RunningFit) {
        for begun in running.take_begun() {
            if let Err(error) = self.queue.report(lease, &report(&begun)).await {
                tracing::warn!(job = %lease.job, %error, "the beginning of a stage goes untold");
            }
        }
    }

    async fn pass_saved(&self, lease: &Lease, running: &RunningFit) {
        if running.take_begun_anew() {
            tracing::info!(job = %lease.job, "the fit begins anew: its checkpoint is of another program, body or clip");
            if let Err(error) = self.queue.begun_anew(lease).await {
                tracing::warn!(job = %lease.job, %error, "a beginning goes untold");
            }
        }
        if let Some(progress) = running.take_saved()
            && let Err(error) = self.queue.saved(lease, f64::from(progress)).await
        {
            tracing::warn!(job = %lease.job, %error, "a checkpoint goes untold");
        }
    }

    /// The file first, then the row that names it: what the row names is there.
    async fn pass_preview(&self, lease: &Lease, running: &RunningFit) {
        let Some((nth, Preview { jpeg, at })) = running.take_preview() else { return };
        let name = Store::preview_name(lease.epoch, nth);
        let (store, job, file) = (self.store.clone(), lease.job, name.clone());
        let written = tokio::task::spawn_blocking(move || store.put_preview(job, &file, &jpeg)).await;
        if let Err(error) = written.unwrap_or_else(|panic| Err(panic.into())) {
            return tracing::warn!(%job, %error, "a preview is lost");
        }
        let shown = self.queue.show(lease, &name, &report(&at)).await;
        let store = self.store.clone();
        let tidied = tokio::task::spawn_blocking(move || match shown {
            Ok(Standing::Held | Standing::Canceling) => store.drop_previews_before(job, &name),
            Ok(Standing::Lost) => store.drop_preview(job, &name),
            // The row may name it all the same: the next one removes it.
            Err(error) => Err(io::Error::other(error)),
        });
        if let Err(error) = tidied.await.unwrap_or_else(|panic| Err(panic.into())) {
            tracing::warn!(%job, %error, "a preview goes unseen, or an older one stays");
        }
    }

    async fn pass_stage_secs(&self, lease: &Lease, running: &RunningFit) {
        for (stage, secs) in running.take_stage_secs() {
            if let Err(error) = self.queue.add_stage_time(lease, stage, secs).await {
                tracing::warn!(job = %lease.job, %error, "the time of a stage is lost");
            }
        }
    }
}

fn report(progress: &Progress) -> ProgressReport {
    ProgressReport {
        stage: progress.stage.name().into(),
        step: progress.step,
        steps: progress.steps,
        // What an f32 knows, without the tail of digits that it has as an f64.
        progress: (f64::from(progress.progress) * 1e4).round() / 1e4,
        eta_secs: progress.eta_secs,
        losses: progress.losses.clone(),
    }
}
