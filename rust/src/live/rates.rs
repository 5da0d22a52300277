//! Rates of a live stream, over a window that does not depend on who asks.

use std::collections::{BTreeMap, VecDeque};

use super::Counts;

/// Length of the window, in ns: long enough for outputs of a few hertz, short enough to follow a change.
const WINDOW: i64 = 2_000_000_000;
/// Least time between two snapshots of the counts, in ns.
const INTERVAL: i64 = 250_000_000;
/// Least time over which rates are computed, in ns.
const LEAST: i64 = 500_000_000;

/// How often quantities and strings arrive, in Hz.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "python", derive(pyo3::IntoPyObject))]
pub struct Rates {
    /// Packets by data identifier without format bits.
    pub quantities: BTreeMap<u16, f64>,
    /// Strings by name, as in [`Counts`].
    pub strings: BTreeMap<&'static str, f64>,
}

/// Snapshots of counts, from which rates are computed.
#[derive(Debug, Default)]
pub(super) struct Meter {
    snapshots: VecDeque<Snapshot>,
}

#[derive(Debug)]
struct Snapshot {
    time: i64,
    quantities: BTreeMap<u16, u64>,
    strings: BTreeMap<&'static str, u64>,
}

impl Meter {
    /// Takes note of the counts before the bytes that arrive now.
    pub fn note(&mut self, counts: &Counts, now: i64) {
        if self.snapshots.back().is_some_and(|last| now - last.time < INTERVAL) {
            return;
        }
        let (quantities, strings) = (counts.quantities.clone(), counts.strings.clone());
        self.snapshots.push_back(Snapshot { time: now, quantities, strings });
        while self.snapshots.get(1).is_some_and(|second| now - second.time >= WINDOW) {
            self.snapshots.pop_front();
        }
    }

    /// The rates at `now`, over the last two seconds or, in the beginning, since the first bytes. None are known in the
    /// first half second.
    pub fn rates(&self, counts: &Counts, now: i64, last_arrival: Option<i64>) -> Rates {
        let is_old = |snapshot: &&Snapshot| now - snapshot.time >= WINDOW;
        let is_silent = last_arrival.is_none_or(|last| now - last >= WINDOW);
        let Some(start) = self.snapshots.iter().rev().find(is_old).or(self.snapshots.front()) else {
            return Rates::default();
        };
        if now - start.time < LEAST {
            return Rates::default();
        }
        #[allow(clippy::cast_precision_loss)] // nanoseconds and counts of seconds
        let rate = |count: u64, before: Option<&u64>| {
            let more = if is_silent { 0 } else { count - before.copied().unwrap_or_default() };
            more as f64 / ((now - start.time) as f64 / 1e9)
        };
        Rates {
            quantities: counts.quantities.iter().map(|(id, n)| (*id, rate(*n, start.quantities.get(id)))).collect(),
            strings: counts.strings.iter().map(|(name, n)| (*name, rate(*n, start.strings.get(name)))).collect(),
        }
    }
}
