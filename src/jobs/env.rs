//! Time and chance, injected.

use std::sync::{Arc, Mutex};

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use uuid::Uuid;

use super::{Clock, Steady, SystemClock, Timestamp};

/// What a service takes from the world besides its inputs.
#[derive(Clone)]
pub struct Env {
    clock: Arc<dyn Clock>,
    random: Arc<Mutex<Pcg64Mcg>>,
    last_id: Arc<Mutex<LastId>>,
}

/// Where the newest id lies in time: its millisecond and its count within.
#[derive(Default)]
struct LastId {
    ms: u64,
    count: u16,
}

impl LastId {
    /// A UUIDv7 has 12 bits after the millisecond.
    const COUNTS: u16 = 1 << 12;

    /// The place of the next id: later than the last, also within one millisecond or when the clock was set back.
    fn advance(&mut self, now: u64) -> (u64, u16) {
        if now > self.ms {
            (self.ms, self.count) = (now, 0);
        } else {
            self.count += 1;
            if self.count == Self::COUNTS {
                (self.ms, self.count) = (self.ms + 1, 0);
            }
        }
        (self.ms, self.count)
    }
}

impl Env {
    /// The machine's clock, and randomness seeded by the operating system.
    pub fn system() -> Self {
        Self::new(Arc::new(SystemClock), Uuid::new_v4().as_u128() as u64)
    }

    pub fn new(clock: Arc<dyn Clock>, seed: u64) -> Self {
        Env { clock, random: Arc::new(Mutex::new(Pcg64Mcg::seed_from_u64(seed))), last_id: Arc::default() }
    }

    pub fn now(&self) -> Timestamp {
        self.clock.now()
    }

    /// The time since the machine's start, where the system tells it.
    pub fn steady(&self) -> Option<Steady> {
        self.clock.steady()
    }

    /// A UUIDv7 of the present moment, greater than all that this environment gave before: ids are the order of jobs.
    pub fn new_id(&self) -> Uuid {
        let mut bytes = [0; 10];
        self.random.lock().unwrap().fill_bytes(&mut bytes);
        let (ms, count) = self.last_id.lock().unwrap().advance(self.now().0.max(0) as u64);
        bytes[..2].copy_from_slice(&count.to_be_bytes());
        uuid::Builder::from_unix_timestamp_millis(ms, &bytes).into_uuid()
    }

    /// Uniform in [0, 1).
    pub fn unit(&self) -> f64 {
        (self.random.lock().unwrap().next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::jobs::ManualClock;

    #[test]
    fn ids_rise_within_a_millisecond_and_when_the_clock_is_set_back() {
        let clock = ManualClock::new(Timestamp(1_700_000_000_000));
        let env = Env::new(clock.clone(), 1);
        let mut ids: Vec<Uuid> = (0..5000).map(|_| env.new_id()).collect();
        clock.leap(Duration::from_secs(100_000_000), false);
        ids.extend((0..10).map(|_| env.new_id()));
        assert!(ids.is_sorted_by(|a, b| a < b));
    }

    #[test]
    fn ids_sort_by_time_and_repeat_with_the_seed() {
        let clock = ManualClock::new(Timestamp(1_700_000_000_000));
        let ids = |seed| {
            let env = Env::new(clock.clone(), seed);
            let first = env.new_id();
            clock.advance(Duration::from_millis(1));
            let second = env.new_id();
            assert!(first < second && first.to_string() < second.to_string());
            first
        };
        let first = ids(1);
        assert_ne!(first, ids(2));
        assert_eq!(first.get_version_num(), 7);
    }
}
