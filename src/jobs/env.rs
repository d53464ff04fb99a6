//! Time and chance, injected.

#[cfg(target_os = "linux")]
use std::sync::OnceLock;
use std::sync::{Arc, Mutex};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use uuid::Uuid;

/// Milliseconds since 1970, UTC.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Timestamp(pub i64);

impl Timestamp {
    pub fn plus(self, duration: Duration) -> Self {
        Timestamp(self.0.saturating_add(duration.as_millis().min(i64::MAX as u128) as i64))
    }

    /// Reads RFC 3339: `2026-01-31T12:00:00Z`, with fractions (milliseconds are kept) and offsets.
    pub fn parse_rfc3339(text: &str) -> Option<Timestamp> {
        let number = |range| digits(text, range);
        let separators = [(4, b'-'), (7, b'-'), (13, b':'), (16, b':')];
        let bytes = text.as_bytes();
        let fits = text.is_ascii() && separators.iter().all(|&(at, c)| bytes.get(at) == Some(&c));
        if !fits || !matches!(bytes.get(10), Some(b'T' | b't' | b' ')) {
            return None;
        }
        let (year, month, day) = (number(0..4)?, number(5..7)?, number(8..10)?);
        let (hour, minute, second) = (number(11..13)?, number(14..16)?, number(17..19)?);
        let days = days_from_civil(year, month, day);
        // A day that the month lacks comes back as another.
        if civil_from_days(days) != (year, month, day) || hour > 23 || minute > 59 || second > 60 {
            return None;
        }
        let (ms, zone) = match text.get(19..)?.strip_prefix('.') {
            None => (0, text.get(19..)?),
            Some(rest) => {
                let count = rest.bytes().take_while(u8::is_ascii_digit).count();
                let shown = format!("{:0<3}", &rest[..count.min(3)]);
                (if count > 0 { shown.parse::<i64>().ok()? } else { return None }, &rest[count..])
            }
        };
        let offset_minutes = match (zone, zone.as_bytes().first()?) {
            ("Z" | "z", _) => 0,
            (_, sign @ (b'+' | b'-')) if zone.len() == 6 && zone.as_bytes()[3] == b':' => {
                let (hours, minutes) = (digits(zone, 1..3)?, digits(zone, 4..6)?);
                if hours > 23 || minutes > 59 {
                    return None;
                }
                (hours * 60 + minutes) * if *sign == b'-' { -1 } else { 1 }
            }
            _ => return None,
        };
        Some(Timestamp((((days * 24 + hour) * 60 + minute - offset_minutes) * 60 + second) * 1000 + ms))
    }

    /// RFC 3339 in UTC with milliseconds: `2026-01-31T12:00:00.000Z`.
    pub fn rfc3339(self) -> String {
        let (days, ms) = (self.0.div_euclid(86_400_000), self.0.rem_euclid(86_400_000));
        let (year, month, day) = civil_from_days(days);
        let (secs, ms) = (ms / 1000, ms % 1000);
        format!("{year:04}-{month:02}-{day:02}T{:02}:{:02}:{:02}.{ms:03}Z", secs / 3600, secs / 60 % 60, secs % 60)
    }
}

/// Reads a fixed number of digits.
fn digits(text: &str, range: std::ops::Range<usize>) -> Option<i64> {
    let text = text.get(range)?;
    text.bytes().all(|b| b.is_ascii_digit()).then(|| text.parse().ok())?
}

/// The inverse of [`civil_from_days`].
fn days_from_civil(year: i64, month: i64, day: i64) -> i64 {
    let year_from_march = year - i64::from(month <= 2);
    let (era, year_of_era) = (year_from_march.div_euclid(400), year_from_march.rem_euclid(400));
    let day_of_year = (153 * ((month + 9) % 12) + 2) / 5 + day - 1;
    era * 146_097 + year_of_era * 365 + year_of_era / 4 - year_of_era / 100 + day_of_year - 719_468
}

/// The proleptic Gregorian date of a day counted from 1970-01-01. Years are counted from March, so that the leap day
/// is the last of its year; 400 years have 146,097 days; 719,468 days lie between 0000-03-01 and 1970-01-01.
fn civil_from_days(days: i64) -> (i64, i64, i64) {
    let z = days + 719_468;
    let (era, day_of_era) = (z.div_euclid(146_097), z.rem_euclid(146_097));
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = if month_from_march < 10 { month_from_march + 3 } else { month_from_march - 9 };
    (year_of_era + era * 400 + i64::from(month <= 2), month, day)
}

/// The time since the machine's start. It passes as time does, sleep included, whatever is done to the wall clock.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Steady {
    /// Which start that was.
    pub boot: String,
    pub ms: i64,
}

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
    use super::*;

    #[test]
    fn dates_follow_the_gregorian_calendar() {
        for (ms, text) in [
            (0, "1970-01-01T00:00:00.000Z"),
            (951_782_400_000, "2000-02-29T00:00:00.000Z"),
            (1_709_251_199_999, "2024-02-29T23:59:59.999Z"),
            (4_107_542_400_000, "2100-03-01T00:00:00.000Z"),
            (-1, "1969-12-31T23:59:59.999Z"),
        ] {
            assert_eq!(Timestamp(ms).rfc3339(), text);
            if ms >= 0 {
                assert_eq!(Timestamp::parse_rfc3339(text), Some(Timestamp(ms)));
            }
        }
    }

    #[test]
    fn times_are_read_in_every_form_of_rfc_3339_and_nothing_else() {
        for (text, ms) in [
            ("2000-02-29T00:00:00Z", 951_782_400_000),
            ("2000-02-29T02:30:00+02:30", 951_782_400_000),
            ("2000-02-28t19:00:00.5-05:00", 951_782_400_500),
            ("2000-02-29 00:00:00.123456z", 951_782_400_123),
        ] {
            assert_eq!(Timestamp::parse_rfc3339(text), Some(Timestamp(ms)), "{text}");
        }
        for text in [
            "",
            "2000",
            "2001-02-29T00:00:00Z",
            "2000-02-29",
            "2000-02-29T00:00:00",
            "2000-02-29T24:00:00Z",
            "2000-13-01T00:00:00Z",
            "2000-02-29T00:00:00.Z",
            "2000-02-29T00:00:00+25:00",
            "2000-02-29T00:00:00Zé",
            "+000-02-29T00:00:00Z",
            "2000-00-10T00:00:00Z",
        ] {
            assert_eq!(Timestamp::parse_rfc3339(text), None, "{text}");
        }
    }

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
