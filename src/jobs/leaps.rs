//! Leaps of the wall clock: somebody has set it, forward or back. The time since the machine's start, which nobody sets,
//! tells how much time has really passed.

use std::sync::Mutex;

use super::{Env, Steady};

/// A smaller difference is left alone until it has grown: leases are a minute long.
pub(super) const LEAP_MS: i64 = 5_000;

/// Tells leaps to somebody who looks from time to time.
#[derive(Debug, Default)]
pub struct Leaps {
    /// Wall clock minus time since the machine's start, as of the last leap.
    offset_ms: Mutex<Option<i64>>,
}

impl Leaps {
    /// By how much the wall clock has moved beyond the time that passed, where that is much.
    pub fn since_last_look(&self, env: &Env) -> Option<i64> {
        // A system that does not tell has the wall clock alone.
        let Steady { ms, .. } = env.steady()?;
        let offset_ms = env.now().0 - ms;
        let mut known = self.offset_ms.lock().unwrap();
        let leap_ms = offset_ms - *known.get_or_insert(offset_ms);
        if leap_ms.abs() < LEAP_MS {
            return None;
        }
        *known = Some(offset_ms);
        Some(leap_ms)
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::super::{ManualClock, Timestamp};
    use super::*;

    #[test]
    fn a_leap_is_told_once_and_small_steps_when_they_add_up() {
        let clock = ManualClock::new(Timestamp(1_700_000_000_000));
        let (env, leaps) = (Env::new(clock.clone(), 1), Leaps::default());
        assert_eq!(leaps.since_last_look(&env), None);
        clock.advance(Duration::from_secs(3600));
        assert_eq!(leaps.since_last_look(&env), None, "time has passed");
        clock.leap(Duration::from_secs(60), false);
        assert_eq!(leaps.since_last_look(&env), Some(-60_000));
        for step in 1..=5 {
            clock.leap(Duration::from_secs(1), true);
            assert_eq!(leaps.since_last_look(&env), (step == 5).then_some(5000), "step {step}");
        }
        assert_eq!(leaps.since_last_look(&env), None);
    }
}
