//! Rates of a live stream, over a window that does not depend on who asks.

use std::collections::{BTreeMap, VecDeque};

use super::Counts;

/// Length of the window, in ns: long enough for outputs of a few hertz, short enough to follow a change.
const WINDOW: i64 = 2_000_000_000;
/// Least time between two snapshots of the counts, in ns.
const INTERVAL: i64 = 250_000_000;
/// Least time over which rates are computed, in ns.
const LEAST: i64 = 500_000_000;

/// How often quantities, strings and other messages arrive, in Hz.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "python", derive(pyo3::IntoPyObject))]
pub struct Rates {
    /// Packets by data identifier without format bits.
    pub quantities: BTreeMap<u16, f64>,
    /// Strings by name, as in [`Counts`].
    pub strings: BTreeMap<&'static str, f64>,
    /// Messages that are no samples, by their identifier.
    pub mids: BTreeMap<u8, f64>,
}

/// Snapshots of counts, from which rates are computed.
///
/// A rate is what was counted between two arrivals, divided by the time between these. So it is exact for a steady output,
/// whenever it is asked for.
#[derive(Debug, Default)]
pub(super) struct Meter {
    snapshots: VecDeque<Snapshot>,
    /// Frames and strings so far, and when the last one arrived.
    newest: Option<(u64, i64)>,
}

#[derive(Debug)]
struct Snapshot {
    time: i64,
    quantities: BTreeMap<u16, u64>,
    strings: BTreeMap<&'static str, u64>,
    mids: BTreeMap<u8, u64>,
}

impl Meter {
    /// Adds the counts after the bytes that arrive now.
    pub fn note(&mut self, counts: &Counts, now: i64) {
        let total = counts.frames + counts.strings.values().sum::<u64>();
        let (before, last) = self.newest.unwrap_or((0, now));
        if total == before {
            return; // part of a frame
        }
        self.newest = Some((total, now));
        if now.saturating_sub(last) >= WINDOW {
            self.snapshots.clear(); // an average over a pause would be the rate of nothing
        }
        let is_due = |last: &Snapshot| now.saturating_sub(last.time) >= INTERVAL;
        if self.snapshots.back().is_none_or(is_due) {
            let (quantities, strings, mids) = (counts.quantities.clone(), counts.strings.clone(), counts.mids.clone());
            self.snapshots.push_back(Snapshot { time: now, quantities, strings, mids });
        }
        while self.snapshots.get(1).is_some_and(|second| now.saturating_sub(second.time) >= WINDOW) {
            self.snapshots.pop_front();
        }
    }

    /// The rates at `now`, over the last two seconds or, in the beginning and after a pause, since the first bytes. None are
    /// known in the first half second. If nothing has arrived for two seconds they are 0.
    pub fn rates(&self, counts: &Counts, now: i64) -> Rates {
        let (Some(start), Some((_, last))) = (self.snapshots.front(), self.newest) else {
            return Rates::default();
        };
        let is_silent = now.saturating_sub(last) >= WINDOW;
        let span = last.saturating_sub(start.time);
        if span < LEAST && !is_silent {
            return Rates::default();
        }
        #[allow(clippy::cast_precision_loss)] // nanoseconds and counts of seconds
        let rate = |count: u64, before: Option<&u64>| {
            if is_silent { 0.0 } else { (count - before.copied().unwrap_or_default()) as f64 * 1e9 / span as f64 }
        };
        Rates {
            quantities: counts.quantities.iter().map(|(id, n)| (*id, rate(*n, start.quantities.get(id)))).collect(),
            strings: counts.strings.iter().map(|(name, n)| (*name, rate(*n, start.strings.get(name)))).collect(),
            mids: counts.mids.iter().map(|(mid, n)| (*mid, rate(*n, start.mids.get(mid)))).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: i64 = 1_000_000_000;

    /// A stream of one quantity.
    #[derive(Default)]
    struct Stream {
        meter: Meter,
        counts: Counts,
    }

    impl Stream {
        const ID: u16 = 0x4020;

        /// Adds this number of samples, which arrive together.
        fn add(&mut self, samples: u64, time: i64) {
            self.counts.frames += samples;
            *self.counts.quantities.entry(Self::ID).or_default() += samples;
            self.meter.note(&self.counts, time);
        }

        fn rate(&self, now: i64) -> Option<f64> {
            self.meter.rates(&self.counts, now).quantities.get(&Self::ID).copied()
        }
    }

    #[test]
    fn a_steady_output_has_its_rate_whenever_it_is_asked_for() {
        for (hertz, burst) in [(1, 1), (4, 1), (100, 1), (100, 10), (2000, 32)] {
            let (mut stream, period) = (Stream::default(), SECOND * burst / hertz);
            for tick in 0..10 * SECOND / period {
                stream.add(burst.unsigned_abs(), tick * period);
                for now in [tick * period, (tick + 1) * period - 1] {
                    let known = tick * period >= LEAST;
                    #[allow(clippy::cast_precision_loss)] // small
                    let expected = known.then_some(hertz as f64);
                    let rate = stream.rate(now);
                    assert_eq!(
                        rate.map(|rate| (rate * 1e3).round() / 1e3),
                        expected,
                        "{hertz} Hz in {burst}, at {now}"
                    );
                }
            }
        }
    }

    #[test]
    fn pieces_of_frames_do_not_change_a_rate() {
        let mut stream = Stream::default();
        for tick in 0..300 {
            stream.add(1, tick * SECOND / 100);
            stream.add(0, tick * SECOND / 100 + 3_000_000);
        }
        assert_eq!(stream.rate(3 * SECOND), Some(100.0));
    }

    #[test]
    fn a_rate_follows_a_change_within_the_window() {
        let mut stream = Stream::default();
        (0..500).for_each(|tick| stream.add(1, tick * SECOND / 100));
        (0..25).for_each(|tick| stream.add(1, 5 * SECOND + tick * SECOND / 10));
        assert_eq!(stream.rate(5 * SECOND + 24 * SECOND / 10), Some(10.0));
    }

    #[test]
    fn a_quantity_that_stops_among_others_has_rate_zero() {
        let mut stream = Stream::default();
        (0..300).for_each(|tick| stream.add(1, tick * SECOND / 100));
        for tick in 0..230 {
            stream.counts.frames += 1;
            stream.meter.note(&stream.counts, 3 * SECOND + tick * SECOND / 100);
        }
        assert_eq!(stream.rate(3 * SECOND + 229 * SECOND / 100), Some(0.0));
    }

    #[test]
    fn after_silence_a_rate_is_zero_and_then_new() {
        let mut stream = Stream::default();
        assert_eq!(stream.rate(0), None);
        (0..=300).for_each(|tick| stream.add(1, tick * SECOND / 100));
        assert_eq!(stream.rate(5 * SECOND - 1), Some(100.0));
        assert_eq!(stream.rate(5 * SECOND), Some(0.0));
        assert_eq!(stream.rate(i64::MAX), Some(0.0));
        for tick in 0..=100 {
            let now = 60 * SECOND + tick * SECOND / 50;
            stream.add(1, now);
            assert_eq!(stream.rate(now), (tick >= 25).then_some(50.0), "never an average with the pause");
        }
    }

    #[test]
    fn a_stream_that_falls_silent_at_once_has_rate_zero() {
        let mut stream = Stream::default();
        stream.add(1, 0);
        assert_eq!((stream.rate(SECOND), stream.rate(2 * SECOND)), (None, Some(0.0)));
    }

    #[test]
    fn any_time_is_valid() {
        let times = [i64::MIN, -1, 0, 1, i64::MAX];
        for first in times {
            for second in times {
                let mut stream = Stream::default();
                stream.add(1, first);
                stream.add(1, second);
                for now in times {
                    assert!(stream.rate(now).is_none_or(|rate| rate >= 0.0), "{first} {second} {now}");
                }
            }
        }
    }

    #[test]
    fn memory_is_bounded() {
        let mut stream = Stream::default();
        (0..100_000).for_each(|tick| stream.add(1, tick * SECOND / 100));
        assert!(stream.meter.snapshots.len() <= 10);
    }
}
