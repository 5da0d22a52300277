//! The clock for arrivals.

use std::time::{SystemTime, UNIX_EPOCH};

/// Nanoseconds on the host's steady clock, which is never set: that of Python's `time.monotonic_ns()` on Unix.
#[cfg(unix)]
#[must_use]
pub fn monotonic() -> i64 {
    #[cfg(target_vendor = "apple")]
    const CLOCK: libc::clockid_t = libc::CLOCK_UPTIME_RAW;
    #[cfg(not(target_vendor = "apple"))]
    const CLOCK: libc::clockid_t = libc::CLOCK_MONOTONIC;
    let mut now = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: the call writes to the structure that it is given, and cannot fail for a clock that every system has.
    #[allow(unsafe_code)]
    unsafe {
        libc::clock_gettime(CLOCK, &raw mut now);
    }
    #[allow(clippy::useless_conversion)] // narrower integers on some systems
    let (seconds, rest) = (i64::from(now.tv_sec), i64::from(now.tv_nsec));
    seconds * 1_000_000_000 + rest
}

/// Nanoseconds on the host's steady clock, which is never set, since this function was first called.
#[cfg(not(unix))]
#[must_use]
pub fn monotonic() -> i64 {
    static START: std::sync::OnceLock<std::time::Instant> = std::sync::OnceLock::new();
    let elapsed = START.get_or_init(std::time::Instant::now).elapsed();
    i64::try_from(elapsed.as_nanos()).unwrap_or(i64::MAX)
}

/// Nanoseconds as seconds.
#[allow(clippy::cast_precision_loss)] // to a microsecond for decades
#[must_use]
pub const fn in_seconds(nanoseconds: i64) -> f64 {
    nanoseconds as f64 / 1e9
}

/// Seconds as nanoseconds.
#[allow(clippy::cast_possible_truncation)] // saturates
#[must_use]
pub fn nanoseconds(seconds: f64) -> i64 {
    (seconds * 1e9).round_ties_even() as i64
}

/// What to add to [`monotonic`] for nanoseconds since 1970, according to the host's calendar clock now.
///
/// A stream reads it once and uses it to the end, so that time does not jump when the calendar clock is set meanwhile.
#[must_use]
pub fn epoch() -> i64 {
    let reading = || {
        let before = monotonic();
        let wall = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let width = monotonic() - before;
        (width, i64::try_from(wall.as_nanos()).unwrap_or(i64::MAX) - before - width / 2)
    };
    // The narrowest of four, because a thread may be suspended between two readings.
    let [first, rest @ ..] = [reading(), reading(), reading(), reading()];
    rest.into_iter().fold(first, |best, reading| if reading.0 < best.0 { reading } else { best }).1
}
