//! `UtcTime` as a point in time.

use chrono::{NaiveDate, TimeDelta};

/// Nanoseconds since 1970 of a `UtcTime` record in the machine's byte order; `None` for a date or time of day that does
/// not exist, or one outside the years 1678 to 2261 that 64 bits can say.
///
/// A leap second (second 60) counts as the first one of the next minute.
pub fn nanoseconds(record: &[u8]) -> Option<i64> {
    let &[n0, n1, n2, n3, y0, y1, month, day, hour, minute, second, _valid] = record.first_chunk()?;
    let nanos = u32::from_ne_bytes([n0, n1, n2, n3]);
    let year = u16::from_ne_bytes([y0, y1]);
    if second > 60 || nanos > 1_000_000_000 {
        return None;
    }
    let minute =
        NaiveDate::from_ymd_opt(year.into(), month.into(), day.into())?.and_hms_opt(hour.into(), minute.into(), 0)?;
    let time = minute + TimeDelta::seconds(second.into()) + TimeDelta::nanoseconds(nanos.into());
    time.and_utc().timestamp_nanos_opt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(ns: u32, year: u16, rest: [u8; 6]) -> Vec<u8> {
        [&ns.to_ne_bytes()[..], &year.to_ne_bytes(), &rest].concat()
    }

    #[test]
    fn dates() {
        // Bytes of a real device: 749227324 ns, 2025-07-13 09:21:34.
        assert_eq!(nanoseconds(&record(749_227_324, 2025, [7, 13, 9, 21, 34, 0])), Some(1_752_398_494_749_227_324));
        assert_eq!(nanoseconds(&record(0, 1970, [1, 1, 0, 0, 0, 7])), Some(0));
        assert_eq!(nanoseconds(&record(0, 2000, [2, 29, 0, 0, 0, 7])), Some(951_782_400_000_000_000));
        assert_eq!(nanoseconds(&record(0, 1969, [12, 31, 23, 59, 60, 7])), Some(0));
    }

    #[test]
    fn dates_that_do_not_exist() {
        for rest in
            [[0, 1, 0, 0, 0, 0], [13, 1, 0, 0, 0, 0], [2, 29, 0, 0, 0, 0], [1, 1, 24, 0, 0, 0], [1, 1, 0, 60, 0, 0]]
        {
            assert_eq!(nanoseconds(&record(0, 2026, rest)), None, "{rest:?}");
        }
        assert_eq!(nanoseconds(&record(0, 0, [0; 6])), None);
        assert_eq!(nanoseconds(&record(0, 65535, [1, 1, 0, 0, 0, 0])), None);
    }
}
