//! The thread that owns the device: everything that touches it happens here, one thing at a time. While a fit runs,
//! renders are drawn between its iterations.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use tokio::sync::{oneshot, watch};
use tracing::Span;

use super::engine::{Engine, FitTask};
use super::pipeline::{Observer, Outcome, PipelineError, Preview, Progress, StopReason};
use super::renders::Draughtsman;
use crate::gpu::{Gpu, GpuError};
use crate::jobs::render::{RenderError, RenderRequest};

type Answer = Box<dyn FnOnce(Result<(), RenderError>) + Send>;

enum Task {
    Open(oneshot::Sender<Result<(), GpuError>>),
    Fit { task: Box<FitTask>, control: Arc<Control>, done: oneshot::Sender<Result<Outcome, PipelineError>> },
    Draw(Box<Drawing>),
}

struct Drawing {
    request: RenderRequest,
    to: PathBuf,
    answer: Answer,
}

/// What the two sides of a running fit share.
pub struct Control {
    stop: Mutex<Option<StopReason>>,
    /// The fit's last sign of life.
    alive: Mutex<Instant>,
    /// How far the newest checkpoint has come, until it is told on.
    saved: Mutex<Option<f32>>,
    /// The newest picture with its number, until it is passed on.
    preview: Mutex<(u32, Option<Preview>)>,
    progress: watch::Sender<Option<Progress>>,
    /// The first progress of each stage, however short the stage was.
    begun: Mutex<Vec<Progress>>,
    stage_secs: Mutex<BTreeMap<&'static str, f64>>,
    /// The attempt's, in which the stages are.
    span: Span,
}

impl Default for Control {
    fn default() -> Self {
        Control {
            stop: Mutex::default(),
            alive: Mutex::new(Instant::now()),
            saved: Mutex::default(),
            preview: Mutex::default(),
            progress: watch::Sender::default(),
            begun: Mutex::default(),
            stage_secs: Mutex::default(),
            span: Span::current(),
        }
    }
}

impl Control {
    /// How long the fit has shown no step.
    pub fn silence(&self) -> Duration {
        self.alive.lock().unwrap().elapsed()
    }

    fn is_alive(&self) {
        *self.alive.lock().unwrap() = Instant::now();
    }

    /// How far the checkpoint has come, where one was written since the last call.
    pub fn take_saved(&self) -> Option<f32> {
        self.saved.lock().unwrap().take()
    }

    /// The newest picture and its number, from 1 on, where one was drawn since the last call.
    pub fn take_preview(&self) -> Option<(u32, Preview)> {
        let mut preview = self.preview.lock().unwrap();
        Some((preview.0, preview.1.take()?))
    }

    /// Asks the fit to stop. The first reason stays, but a lost lease outweighs all: nothing may be written then.
    pub fn stop(&self, reason: StopReason) {
        let mut stop = self.stop.lock().unwrap();
        if stop.is_none() || reason == StopReason::LostLease {
            *stop = Some(reason);
        }
    }

    pub fn stop_reason(&self) -> Option<StopReason> {
        *self.stop.lock().unwrap()
    }

    pub fn progress(&self) -> watch::Receiver<Option<Progress>> {
        self.progress.subscribe()
    }

    /// The beginnings of stages since the last call.
    pub fn take_begun(&self) -> Vec<Progress> {
        std::mem::take(&mut *self.begun.lock().unwrap())
    }

    /// Seconds spent in stages since the last call.
    pub fn take_stage_secs(&self) -> BTreeMap<&'static str, f64> {
        std::mem::take(&mut *self.stage_secs.lock().unwrap())
    }
}

/// The way to the device.
#[derive(Clone)]
pub struct DeviceThread {
    tasks: Sender<Task>,
    /// Why there is no device.
    trouble: watch::Receiver<Option<String>>,
}

impl DeviceThread {
    /// Starts the thread. It ends when the last handle is gone.
    pub fn start(engine: impl Engine) -> std::io::Result<DeviceThread> {
        let (tasks, inbox) = channel();
        let (told, trouble) = watch::channel(None);
        thread::Builder::new().name("device".into()).spawn(move || serve(engine, &inbox, &told))?;
        Ok(DeviceThread { tasks, trouble })
    }

    /// Opens the device, where it is not open or has failed; the receiver learns whether it is.
    pub fn open(&self) -> oneshot::Receiver<Result<(), GpuError>> {
        let (done, opened) = oneshot::channel();
        let _ = self.tasks.send(Task::Open(done));
        opened
    }

    /// Why the device did not open when that was last tried.
    pub fn trouble(&self) -> watch::Receiver<Option<String>> {
        self.trouble.clone()
    }

    /// Runs a fit; the receiver gets its end.
    pub fn fit(&self, task: FitTask, control: Arc<Control>) -> oneshot::Receiver<Result<Outcome, PipelineError>> {
        let (done, end) = oneshot::channel();
        // A thread that is gone drops the sender, which the receiver sees.
        let _ = self.tasks.send(Task::Fit { task: Box::new(task), control, done });
        end
    }

    /// Has something drawn; `answer` is called from the device's thread.
    pub fn draw(
        &self,
        request: RenderRequest,
        to: PathBuf,
        answer: impl FnOnce(Result<(), RenderError>) + Send + 'static,
    ) {
        let answer: Answer = Box::new(answer);
        if let Err(error) = self.tasks.send(Task::Draw(Box::new(Drawing { request, to, answer })))
            && let Task::Draw(drawing) = error.0
        {
            (drawing.answer)(Err(RenderError::Unavailable("the device's thread has ended".into())));
        }
    }
}

fn serve(mut engine: impl Engine, inbox: &Receiver<Task>, trouble: &watch::Sender<Option<String>>) {
    while let Ok(task) = inbox.recv() {
        match task {
            Task::Open(done) => {
                let opened = catch_unwind(AssertUnwindSafe(|| engine.open()));
                let opened = opened.unwrap_or_else(|panic| Err(GpuError::Failed(panicked(panic.as_ref()).to_string())));
                let now = opened.as_ref().err().map(ToString::to_string);
                trouble.send_if_modified(|trouble| std::mem::replace(trouble, now.clone()) != now);
                let _ = done.send(opened);
            }
            Task::Fit { task, control, done } => {
                let mut observer = FitObserver {
                    control,
                    inbox,
                    draughtsman: Draughtsman::default(),
                    stage: None,
                    turns: Turns::from(Instant::now()),
                };
                let run = catch_unwind(AssertUnwindSafe(|| engine.fit(&task, &mut observer)));
                observer.end_stage();
                // Nobody may be waiting any more; the end is the same.
                let _ = done.send(run.unwrap_or_else(|panic| Err(panicked(panic.as_ref()))));
            }
            Task::Draw(drawing) => answer_with(*drawing, |request, to| engine.draw(request, to)),
        }
    }
}

fn answer_with(drawing: Drawing, draw: impl FnOnce(&RenderRequest, &Path) -> Result<(), RenderError>) {
    let drawn = catch_unwind(AssertUnwindSafe(|| draw(&drawing.request, &drawing.to)));
    let failed = |panic: Box<dyn std::any::Any + Send>| Err(RenderError::Failed(panicked(panic.as_ref()).to_string()));
    (drawing.answer)(drawn.unwrap_or_else(failed));
}

fn panicked(panic: &(dyn std::any::Any + Send)) -> PipelineError {
    let message = panic.downcast_ref::<String>().map(String::as_str);
    let message = message.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no message");
    PipelineError::Internal(anyhow::anyhow!("panicked: {message}"))
}

/// The thread's own view of its running fit.
struct FitObserver<'a> {
    control: Arc<Control>,
    inbox: &'a Receiver<Task>,
    draughtsman: Draughtsman,
    stage: Option<(&'static str, Instant, Span)>,
    turns: Turns,
}

/// How a fit and the renders meanwhile share the device.
struct Turns {
    /// When the fit had it back.
    fits_since: Instant,
    /// For how long it has it then, before renders have another turn.
    owed: Duration,
}

impl Turns {
    /// Pictures of many pixels take longer, and requests for others wait for a minute at most.
    const LONGEST: Duration = Duration::from_secs(5);

    fn from(now: Instant) -> Turns {
        Turns { fits_since: now, owed: Duration::ZERO }
    }

    /// How long renders may have the device; none while it is the fit's turn. Where steps are short, as the frames are that are read, one
    /// render a step would be most of the time.
    fn share(&self, now: Instant) -> Option<Duration> {
        let share = now - self.fits_since;
        (share >= self.owed).then_some(share)
    }

    fn end(&mut self, began: Instant, now: Instant) {
        *self = Turns { fits_since: now, owed: (now - began).min(Turns::LONGEST) };
    }
}

impl FitObserver<'_> {
    fn end_stage(&mut self) {
        if let Some((stage, since, _span)) = self.stage.take() {
            *self.control.stage_secs.lock().unwrap().entry(stage).or_default() += since.elapsed().as_secs_f64();
        }
    }
}

impl Observer for FitObserver<'_> {
    fn progress(&mut self, progress: &Progress) {
        self.control.is_alive();
        let stage = progress.stage.name();
        if self.stage.as_ref().is_none_or(|(current, ..)| *current != stage) {
            self.end_stage();
            let span = tracing::info_span!(parent: &self.control.span, "stage", stage);
            self.stage = Some((stage, Instant::now(), span));
            self.control.begun.lock().unwrap().push(progress.clone());
        }
        self.control.progress.send_replace(Some(progress.clone()));
    }

    fn saved(&mut self, progress: f32) {
        *self.control.saved.lock().unwrap() = Some(progress);
    }

    fn takes_previews(&self) -> bool {
        true
    }

    fn preview(&mut self, preview: Preview) {
        self.control.is_alive();
        let mut newest = self.control.preview.lock().unwrap();
        *newest = (newest.0 + 1, Some(preview));
    }

    fn stop(&mut self) -> Option<StopReason> {
        self.control.is_alive();
        self.control.stop_reason()
    }

    /// As long as the fit has had the device, renders may have it, and one of them always: whatever takes long, and however
    /// many clients there are, neither side starves the other.
    fn idle(&mut self, gpu: &Arc<Gpu>) {
        let began = Instant::now();
        let Some(share) = self.turns.share(began) else { return };
        draw_waiting(self.inbox, &self.control, share, |request, to| self.draughtsman.draw(gpu, request, to));
        self.turns.end(began, Instant::now());
    }
}

/// Draws what waits, in order, until `share` has passed. A fit that is to stop hears of it first: its checkpoint has little
/// time, and what still waits then is drawn after it.
fn draw_waiting(
    inbox: &Receiver<Task>,
    control: &Control,
    share: Duration,
    mut draw: impl FnMut(&RenderRequest, &Path) -> Result<(), RenderError>,
) {
    let since = Instant::now();
    while control.stop_reason().is_none()
        && let Ok(task) = inbox.try_recv()
    {
        match task {
            Task::Draw(drawing) => {
                answer_with(*drawing, &mut draw);
                // Many pictures take long, and none of them is the fit's fault.
                control.is_alive();
            }
            // The claim loop gives one job at a time, and asks for the device before.
            Task::Open(done) => {
                let _ = done.send(Ok(()));
            }
            Task::Fit { done, .. } => {
                let _ = done.send(Err(PipelineError::Internal(anyhow::anyhow!("the device is taken"))));
            }
        }
        if since.elapsed() >= share {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::render::What;

    /// Clients that want pictures, and the numbers of those that were drawn.
    struct Clients {
        tasks: Sender<Task>,
        inbox: Receiver<Task>,
        drawn: Arc<Mutex<Vec<u32>>>,
    }

    impl Clients {
        fn new() -> Clients {
            let (tasks, inbox) = channel();
            Clients { tasks, inbox, drawn: Arc::default() }
        }

        fn ask(&self, number: u32) {
            let request = RenderRequest { model: "avatar".into(), what: What::Mesh { frame: number } };
            let drawn = self.drawn.clone();
            let answer: Answer = Box::new(move |result| {
                result.unwrap();
                drawn.lock().unwrap().push(number);
            });
            self.tasks.send(Task::Draw(Box::new(Drawing { request, to: "picture".into(), answer }))).unwrap();
        }

        fn drawn(&self) -> Vec<u32> {
            self.drawn.lock().unwrap().clone()
        }
    }

    #[test]
    fn clients_that_always_want_pictures_do_not_keep_the_fit_from_the_device() {
        let clients = Clients::new();
        let control = Control::default();
        clients.ask(0);
        for steps in 1..=20 {
            let mut asked = 0;
            // The next one comes while one is drawn; a fit that waits for all of them waits for a hundred.
            draw_waiting(&clients.inbox, &control, Duration::ZERO, |_, _| {
                asked += 1;
                if asked < 100 {
                    clients.ask(steps);
                }
                Ok(())
            });
            assert_eq!(clients.drawn().len(), steps as usize, "one a step, in the end each of them");
        }
        assert!(clients.drawn().is_sorted());
    }

    #[test]
    fn renders_wait_as_long_as_the_fit_has_waited_for_them() {
        let (start, ms) = (Instant::now(), Duration::from_millis);
        let mut turns = Turns::from(start);
        assert_eq!(turns.share(start), Some(ms(0)), "the first one need not wait");
        turns.end(start, start + ms(170));
        assert_eq!(turns.share(start + ms(339)), None);
        assert_eq!(turns.share(start + ms(341)), Some(ms(171)));
        // A picture of a minute keeps the next one for five seconds.
        turns.end(start, start + ms(60_000));
        assert_eq!((turns.share(start + ms(64_999)), turns.share(start + ms(65_000))), (None, Some(ms(5000))));
    }

    #[test]
    fn a_share_is_used_for_all_that_waits() {
        let clients = Clients::new();
        (0..5).for_each(|number| clients.ask(number));
        draw_waiting(&clients.inbox, &Control::default(), Duration::MAX, |_, _| Ok(()));
        assert_eq!(clients.drawn(), [0, 1, 2, 3, 4]);
    }

    #[test]
    fn a_fit_that_is_to_stop_does_not_wait_for_pictures() {
        let clients = Clients::new();
        let control = Control::default();
        (0..3).for_each(|number| clients.ask(number));
        draw_waiting(&clients.inbox, &control, Duration::MAX, |_, _| {
            control.stop(StopReason::Shutdown);
            Ok(())
        });
        draw_waiting(&clients.inbox, &control, Duration::MAX, |_, _| Ok(()));
        assert_eq!(clients.drawn(), [0], "the others are the thread's, after the fit");
        assert_eq!(clients.inbox.try_iter().count(), 2);
    }
}
