//! How the device's thread accompanies its own fit: it tells how the fit goes, and draws what waits between its iterations.

use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

use tracing::Span;

use super::device_thread::{Task, answer_with};
use super::pipeline::{Observer, PipelineError, Preview, Progress, StopReason};
use super::renders::CachedRenderers;
use super::running_fit::RunningFit;
use crate::gpu::Gpu;
use crate::jobs::render::{RenderError, RenderRequest};

/// The thread's own view of its running fit.
pub(super) struct FitObserver<'a> {
    running: Arc<RunningFit>,
    inbox: &'a Receiver<Task>,
    renderers: CachedRenderers,
    stage: Option<(&'static str, Instant, Span)>,
    turns: Turns,
}

impl<'a> FitObserver<'a> {
    pub fn new(running: Arc<RunningFit>, inbox: &'a Receiver<Task>) -> Self {
        let turns = Turns::from(Instant::now());
        Self { running, inbox, renderers: CachedRenderers::default(), stage: None, turns }
    }

    /// Counts the time of the stage that ran.
    pub fn end_stage(&mut self) {
        if let Some((stage, since, _span)) = self.stage.take() {
            self.running.add_stage_secs(stage, since.elapsed().as_secs_f64());
        }
    }
}

impl Observer for FitObserver<'_> {
    fn progress(&mut self, progress: &Progress) {
        self.running.mark_alive();
        let stage = progress.stage.name();
        if self.stage.as_ref().is_none_or(|(current, ..)| *current != stage) {
            self.end_stage();
            let span = self.running.begin_stage(progress.clone());
            self.stage = Some((stage, Instant::now(), span));
        }
        self.running.set_progress(progress.clone());
    }

    fn begins_anew(&mut self) {
        self.running.set_begun_anew();
    }

    fn saved(&mut self, progress: f32) {
        self.running.set_saved(progress);
    }

    fn takes_previews(&self) -> bool {
        true
    }

    fn preview(&mut self, preview: Preview) {
        self.running.mark_alive();
        self.running.set_preview(preview);
    }

    fn stop(&mut self) -> Option<StopReason> {
        self.running.mark_alive();
        self.running.stop_reason()
    }

    /// As long as the fit has had the device, renders may have it, and one of them always: whatever takes long, and however
    /// many clients there are, neither side starves the other.
    fn idle(&mut self, gpu: &Arc<Gpu>) {
        let began = Instant::now();
        let Some(share) = self.turns.share(began) else { return };
        draw_waiting(self.inbox, &self.running, share, |request, to| self.renderers.draw(gpu, request, to));
        self.turns.end(began, Instant::now());
    }
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

/// Draws what waits, in order, until `share` has passed. A fit that is to stop hears of it first: its checkpoint has little
/// time, and what still waits then is drawn after it.
fn draw_waiting(
    inbox: &Receiver<Task>,
    running: &RunningFit,
    share: Duration,
    mut draw: impl FnMut(&RenderRequest, &Path) -> Result<(), RenderError>,
) {
    let since = Instant::now();
    while running.stop_reason().is_none()
        && let Ok(task) = inbox.try_recv()
    {
        match task {
            Task::Draw(drawing) => {
                answer_with(*drawing, &mut draw);
                // Many pictures take long, and none of them is the fit's fault.
                running.mark_alive();
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
    use std::sync::Mutex;
    use std::sync::mpsc::{Sender, channel};

    use super::*;
    use crate::jobs::render::What;
    use crate::worker::device_thread::{Answer, Drawing};

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
        let running = RunningFit::default();
        clients.ask(0);
        for steps in 1..=20 {
            let mut asked = 0;
            // The next one comes while one is drawn; a fit that waits for all of them waits for a hundred.
            draw_waiting(&clients.inbox, &running, Duration::ZERO, |_, _| {
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
        draw_waiting(&clients.inbox, &RunningFit::default(), Duration::MAX, |_, _| Ok(()));
        assert_eq!(clients.drawn(), [0, 1, 2, 3, 4]);
    }

    #[test]
    fn a_fit_that_is_to_stop_does_not_wait_for_pictures() {
        let clients = Clients::new();
        let running = RunningFit::default();
        (0..3).for_each(|number| clients.ask(number));
        draw_waiting(&clients.inbox, &running, Duration::MAX, |_, _| {
            running.stop(StopReason::Shutdown);
            Ok(())
        });
        draw_waiting(&clients.inbox, &running, Duration::MAX, |_, _| Ok(()));
        assert_eq!(clients.drawn(), [0], "the others are the thread's, after the fit");
        assert_eq!(clients.inbox.try_iter().count(), 2);
    }
}
