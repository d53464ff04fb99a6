//! Moments, and how they are written.

use std::time::Duration;

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
}
