//! Clocks: the machine's, and one for tests.

#[cfg(target_os = "linux")]
use std::sync::OnceLock;
use std::sync::{Arc, Mutex};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use super::Timestamp;

/// The time since the machine's start. It passes as time does, sleep included, whatever is done to the wall clock.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Steady {
    /// Which start that was.
    pub boot: String,
    pub ms: i64,
}

/// The time as the service sees it, so that tests can own it.
pub trait Clock: Send + Sync + 'static {
    fn now(&self) -> Timestamp;

    /// None where the system does not tell.
    fn steady(&self) -> Option<Steady>;
}

/// The machine's wall clock.
pub struct SystemClock;

impl Clock for SystemClock {
    #[expect(clippy::disallowed_methods, reason = "this is the clock that is injected")]
    fn now(&self) -> Timestamp {
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Timestamp(since.as_millis() as i64)
    }

    #[cfg(target_os = "linux")]
    fn steady(&self) -> Option<Steady> {
        static BOOT: OnceLock<Option<String>> = OnceLock::new();
        let boot = BOOT.get_or_init(|| {
            let id = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").ok()?;
            Some(id.trim().to_string())
        });
        let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
        // SAFETY: writes the time into a struct of ours.
        let told = unsafe { libc::clock_gettime(libc::CLOCK_BOOTTIME, &raw mut time) } == 0;
        let ms = time.tv_sec * 1000 + time.tv_nsec / 1_000_000;
        boot.clone().filter(|_| told).map(|boot| Steady { boot, ms })
    }

    #[cfg(not(target_os = "linux"))]
    fn steady(&self) -> Option<Steady> {
        None
    }
}

/// A clock that stands still until it is moved.
pub struct ManualClock(Mutex<Manual>);

struct Manual {
    now: Timestamp,
    steady: Steady,
}

impl ManualClock {
    pub fn new(start: Timestamp) -> Arc<Self> {
        Arc::new(ManualClock(Mutex::new(Manual { now: start, steady: Steady { boot: "1".into(), ms: 0 } })))
    }

    /// Time passes.
    pub fn advance(&self, by: Duration) {
        let mut clock = self.0.lock().unwrap();
        clock.now = clock.now.plus(by);
        clock.steady.ms += by.as_millis() as i64;
    }

    /// Somebody sets the wall clock.
    pub fn leap(&self, by: Duration, forward: bool) {
        let now = &mut self.0.lock().unwrap().now;
        now.0 += by.as_millis() as i64 * if forward { 1 } else { -1 };
    }

    /// The machine starts anew, with this on its wall clock.
    pub fn restart(&self, now: Timestamp) {
        let mut clock = self.0.lock().unwrap();
        let boot = format!("{}+", clock.steady.boot);
        *clock = Manual { now, steady: Steady { boot, ms: 0 } };
    }
}

impl Clock for ManualClock {
    fn now(&self) -> Timestamp {
        self.0.lock().unwrap().now
    }

    fn steady(&self) -> Option<Steady> {
        Some(self.0.lock().unwrap().steady.clone())
    }
}
