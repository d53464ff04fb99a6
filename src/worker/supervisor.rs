//! The server's side of its worker: keeps a child process alive and passes renders to it.

use std::collections::HashMap;
use std::path::PathBuf;
use std::process::Stdio;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use futures_util::future::BoxFuture;
use tempfile::TempPath;
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader, Lines};
use tokio::process::{Child, ChildStdout, Command};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc, oneshot, watch};
use tokio::time::{Instant, timeout_at};

use super::channel::{Answer, Request, Word};
use crate::jobs::render::{RenderError, RenderRequest, Renderer, What};

/// How the server's worker process is started, waited for and started anew.
#[derive(Clone, Debug)]
pub struct SupervisorSettings {
    /// The worker's command line; its standard input and output become the channel.
    pub program: PathBuf,
    pub arguments: Vec<String>,
    /// Where answers are written.
    pub renders: PathBuf,
    /// Renders that may wait or run at a time; more are refused.
    pub queue: usize,
    /// From a request to its answer, restarts of the worker included.
    pub timeout: Duration,
    /// A worker that answers nothing for so long, while a request waits for it, hangs, and is killed. A fit that hangs ends by
    /// itself, and sooner.
    pub silence: Duration,
    /// Wait before the first restart; doubles while the worker keeps dying young.
    pub backoff: Duration,
    pub backoff_max: Duration,
    /// How long a worker may take to give its job back when the server ends.
    pub grace: Duration,
}

impl SupervisorSettings {
    pub fn new(program: PathBuf, arguments: Vec<String>, renders: PathBuf) -> Self {
        SupervisorSettings {
            program,
            arguments,
            renders,
            queue: 16,
            timeout: Duration::from_secs(60),
            silence: Duration::from_secs(660),
            backoff: Duration::from_millis(500),
            backoff_max: Duration::from_secs(30),
            grace: super::STOP_GRACE + Duration::from_secs(10),
        }
    }
}

/// A worker that lived this long was healthy: the backoff begins anew.
const HEALTHY: Duration = Duration::from_secs(30);
/// A request that kills its worker is not given to a third.
const MAX_DEATHS: u32 = 2;

/// Keeps one worker process.
pub struct Supervisor {
    settings: SupervisorSettings,
    /// One for each request until it is answered, also where its client has gone away.
    slots: Arc<Semaphore>,
    next_id: AtomicU64,
    line: Mutex<Line>,
    /// Whether a worker is there; turns with each start and end.
    up: watch::Sender<bool>,
    stop: watch::Sender<bool>,
}

/// The connection to the present worker, if there is one.
struct Line {
    requests: Option<mpsc::UnboundedSender<String>>,
    waiting: HashMap<u64, Waiting>,
    /// When the worker last answered, or was asked with nothing else to answer.
    quiet_since: Instant,
    /// Why the worker has no device, as it says.
    trouble: Option<String>,
}

impl Line {
    fn new(requests: Option<mpsc::UnboundedSender<String>>) -> Line {
        Line { requests, waiting: HashMap::new(), quiet_since: Instant::now(), trouble: None }
    }
}

struct Waiting {
    /// Removed with the wait, with the answer that nobody takes, or by who took it. What a crash leaves, the next start removes.
    to: TempPath,
    answer: oneshot::Sender<Result<TempPath, RenderError>>,
    slot: Arc<OwnedSemaphorePermit>,
}

impl Supervisor {
    pub fn new(settings: SupervisorSettings) -> Arc<Supervisor> {
        let slots = Arc::new(Semaphore::new(settings.queue));
        Arc::new(Supervisor {
            settings,
            slots,
            next_id: AtomicU64::new(1),
            line: Mutex::new(Line::new(None)),
            up: watch::Sender::new(false),
            stop: watch::Sender::new(false),
        })
    }

    /// Asks the worker to end, and [`Supervisor::run`] with it.
    pub fn stop(&self) {
        self.stop.send_replace(true);
    }

    /// Starts the worker and starts it again whenever it ends, until [`Supervisor::stop`].
    pub async fn run(self: Arc<Self>) {
        let mut backoff = self.settings.backoff;
        let mut stop = self.stop.subscribe();
        while !*stop.borrow_and_update() {
            let born = Instant::now();
            match self.start() {
                Ok(mut child) => self.accompany(&mut child, &mut stop).await,
                Err(error) => tracing::error!(%error, program = %self.settings.program.display(), "no worker"),
            }
            if born.elapsed() > HEALTHY {
                backoff = self.settings.backoff;
            }
            tokio::select! {
                () = tokio::time::sleep(backoff) => {}
                // The sender is ours, so this only ends with the wish.
                _ = stop.wait_for(|stop| *stop) => {}
            }
            backoff = (backoff * 2).min(self.settings.backoff_max);
        }
    }

    fn start(&self) -> std::io::Result<Child> {
        Command::new(&self.settings.program)
            .args(&self.settings.arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .kill_on_drop(true)
            .spawn()
    }

    /// Lives with a worker until it ends, or ends it.
    async fn accompany(&self, child: &mut Child, stop: &mut watch::Receiver<bool>) {
        let (Some(mut stdin), Some(stdout)) = (child.stdin.take(), child.stdout.take()) else { return };
        let (requests, mut outgoing) = mpsc::unbounded_channel::<String>();
        *self.line.lock().unwrap() = Line::new(Some(requests));
        self.up.send_replace(true);
        tracing::info!(pid = child.id(), "the worker has started");
        let write = async move {
            while let Some(line) = outgoing.recv().await {
                stdin.write_all(line.as_bytes()).await?;
            }
            std::io::Result::Ok(())
        };
        let mut write = Box::pin(write);
        let mut answers = BufReader::new(stdout).lines();
        let ended = tokio::select! {
            () = self.pass_answers(&mut answers) => child.wait().await,
            _ = &mut write => child.wait().await,
            () = self.silence() => {
                tracing::error!("the worker answers nothing and is killed");
                self.hang_up();
                // Not even a kill ends a process that waits in a driver.
                let killed = child.start_kill();
                let ended = tokio::time::timeout(self.settings.grace, child.wait()).await;
                killed.and(ended.unwrap_or_else(|_| Err(std::io::ErrorKind::TimedOut.into())))
            }
            _ = stop.changed() => {
                // The end of its input tells the worker to write a checkpoint and give its job back.
                drop(write);
                self.hang_up();
                tokio::select! {
                    ended = child.wait() => ended,
                    () = self.pass_answers(&mut answers) => child.wait().await,
                    () = tokio::time::sleep(self.settings.grace) => {
                        tracing::warn!("the worker did not end in time");
                        child.start_kill().and(child.wait().await)
                    }
                }
            }
        };
        self.hang_up();
        match ended {
            Ok(status) if *stop.borrow() => tracing::info!(%status, "the worker has ended"),
            Ok(status) => tracing::warn!(%status, "the worker has died"),
            Err(error) => tracing::error!(%error, "the worker is lost"),
        }
    }

    /// Until a request has waited too long for a worker that answers nothing.
    async fn silence(&self) {
        let quiet = || {
            let line = self.line.lock().unwrap();
            if line.waiting.is_empty() { Duration::ZERO } else { line.quiet_since.elapsed() }
        };
        while let Some(rest) = self.settings.silence.checked_sub(quiet()).filter(|rest| !rest.is_zero()) {
            tokio::time::sleep(rest).await;
        }
    }

    /// Until the worker closes its output.
    async fn pass_answers(&self, answers: &mut Lines<BufReader<ChildStdout>>) {
        while let Ok(Some(line)) = answers.next_line().await {
            match serde_json::from_str::<Word>(&line) {
                Ok(Word::Answer(answer)) => self.pass(answer),
                Ok(Word::Device { device }) => self.line.lock().unwrap().trouble = device.err(),
                Err(error) => tracing::warn!(%error, line, "the worker said something else"),
            }
        }
    }

    fn pass(&self, answer: Answer) {
        let mut line = self.line.lock().unwrap();
        line.quiet_since = Instant::now();
        let waiting = line.waiting.remove(&answer.id);
        drop(line);
        let Some(Waiting { to, answer: waits, slot }) = waiting else { return };
        // Whoever is answered finds the place free: the request's own hold ends with it.
        drop(slot);
        // The client may have gone away meanwhile.
        let _ = waits.send(answer.result.map(|()| to));
    }

    /// The worker is gone: whoever waits for it learns so.
    fn hang_up(&self) {
        self.up.send_replace(false);
        *self.line.lock().unwrap() = Line::new(None);
    }

    async fn try_render(&self, request: RenderRequest) -> Result<TempPath, RenderError> {
        let deadline = Instant::now() + self.settings.timeout;
        let unavailable = |why: &str| RenderError::Unavailable(why.into());
        let mut stop = self.stop.subscribe();
        // Kept over the worker's death.
        let slot = Arc::new(self.slots.clone().try_acquire_owned().map_err(|_| RenderError::Busy)?);
        for _ in 0..MAX_DEATHS {
            let mut up = self.up.subscribe();
            let there = tokio::select! {
                there = timeout_at(deadline, up.wait_for(|up| *up)) => there,
                // The sender is ours, so this only ends with the wish.
                _ = stop.wait_for(|stop| *stop) => return Err(unavailable("the server ends")),
            };
            there.map_err(|_| unavailable("it is starting"))?.map_err(|_| unavailable("it has ended"))?;
            let id = self.next_id.fetch_add(1, Ordering::Relaxed);
            let answer = self.send(id, &request, slot.clone())?;
            match timeout_at(deadline, answer).await {
                Ok(Ok(result)) => return result,
                Ok(Err(_)) if *self.stop.borrow() => return Err(unavailable("the server ends")),
                // It died with the request; a fresh one may do better.
                Ok(Err(_)) => {}
                // The answer may still come; it is then removed as nobody's.
                Err(_) => return Err(unavailable("it did not answer in time")),
            }
        }
        Err(RenderError::Failed("the worker died of it twice".into()))
    }

    fn send(
        &self,
        id: u64,
        request: &RenderRequest,
        slot: Arc<OwnedSemaphorePermit>,
    ) -> Result<oneshot::Receiver<Result<TempPath, RenderError>>, RenderError> {
        let failed = |error: &dyn std::error::Error| RenderError::Failed(error.to_string());
        let extension = match request.what {
            What::Image(_) => "png",
            What::Mesh { .. } => "ply",
        };
        let to = self.settings.renders.join(format!("{}.{extension}", uuid::Uuid::new_v4()));
        let message = Request { id, request: request.clone(), to: to.clone() };
        let mut line = serde_json::to_string(&message).map_err(|error| failed(&error))?;
        line.push('\n');
        let to = TempPath::try_from_path(to).map_err(|error| failed(&error))?;
        let (answer, answered) = oneshot::channel();
        let mut present = self.line.lock().unwrap();
        // Where the worker died since it was seen up, dropping `answer` tells the caller.
        if present.requests.as_ref().is_some_and(|requests| requests.send(line).is_ok()) {
            if present.waiting.is_empty() {
                present.quiet_since = Instant::now();
            }
            present.waiting.insert(id, Waiting { to, answer, slot });
        }
        Ok(answered)
    }
}

impl Renderer for Supervisor {
    fn render(&self, request: RenderRequest) -> BoxFuture<'_, Result<TempPath, RenderError>> {
        Box::pin(self.try_render(request))
    }

    fn trouble(&self) -> Option<String> {
        if !*self.up.borrow() {
            return Some("the worker is starting".into());
        }
        self.line.lock().unwrap().trouble.as_ref().map(|why| format!("the worker waits for a device: {why}"))
    }
}
