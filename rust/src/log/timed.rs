//! Parts of a log with the times and counters of their samples.

use std::sync::OnceLock;

use super::{Part, Reader};
use crate::clock::{Clocks, Gap, Losses, Restart};

/// Times and packet counters of the samples of a part.
#[derive(Clone, Debug, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Times {
    /// Seconds on the device clock, unwrapped; NaN for a sample without a time stamp.
    pub time: Vec<f64>,
    /// The packet counter, unwrapped; -1 for a sample without one.
    pub counter: Vec<i64>,
    /// Where samples are missing.
    pub gaps: Vec<Gap>,
    /// Where devices restarted.
    pub restarts: Vec<Restart>,
    /// Whether a sample has a packet counter, without which losses are not known.
    pub has_counter: bool,
}

impl Times {
    /// The times from the earliest to the latest.
    #[must_use]
    pub fn span(&self) -> Span {
        let time = &self.time;
        if let (Some(&earliest), Some(&latest)) = (time.first(), time.last())
            && time.windows(2).fold(!earliest.is_nan(), |ascends, pair| ascends & (pair[0] <= pair[1]))
        {
            return Span { earliest, latest, known: time.len(), is_ascending: true };
        }
        let known = || time.iter().copied().filter(|time| !time.is_nan());
        Span {
            earliest: known().reduce(f64::min).unwrap_or(f64::NAN),
            latest: known().reduce(f64::max).unwrap_or(f64::NAN),
            known: known().count(),
            is_ascending: time.is_empty(),
        }
    }

    /// Losses according to the counters.
    #[must_use]
    pub fn losses(&self) -> Losses {
        Losses::of(&self.gaps)
    }
}

/// The times of the samples of a part, in short.
#[derive(Clone, Copy, Debug)]
pub struct Span {
    /// The earliest time in seconds, NaN if none is known.
    pub earliest: f64,
    /// The latest time.
    pub latest: f64,
    /// Number of samples whose time is known.
    pub known: usize,
    /// Whether all samples have a time, and none an earlier one than the sample before.
    pub is_ascending: bool,
}

/// A part of a log, and the clocks at its beginning.
#[derive(Debug)]
pub struct TimedPart {
    /// The part.
    pub part: Part,
    clocks: Clocks,
    times: OnceLock<Times>,
}

impl TimedPart {
    /// Takes what `reader` has read since the last call. `clocks` are those at the beginning of the part; on return they
    /// are those at its end, unless the input is used up and no part follows.
    pub fn take(reader: &mut Reader, clocks: &mut Clocks) -> Self {
        let timed = Self::take_last(reader, clocks.clone());
        if !reader.is_finished() {
            let _ = timed.times.set(timed.part.unwrap(clocks));
        }
        timed
    }

    /// Takes what `reader` has read since the last call, if no part is read afterwards. `clocks` are those at the beginning
    /// of the part.
    pub fn take_last(reader: &mut Reader, clocks: Clocks) -> Self {
        Self { part: reader.take(), clocks, times: OnceLock::new() }
    }

    /// The next part of a log. `clocks` are those at its beginning; on return they are those at its end.
    #[must_use]
    pub fn next(part: Part, clocks: &mut Clocks) -> Self {
        let times = part.unwrap(clocks);
        Self::of(part, times)
    }

    /// Times and counters, computed on the first call.
    pub fn times(&self) -> &Times {
        self.times.get_or_init(|| self.part.unwrap(&mut self.clocks.clone()))
    }

    /// A part whose times and counters are known already.
    #[must_use]
    pub fn of(part: Part, times: Times) -> Self {
        Self { part, clocks: Clocks::default(), times: times.into() }
    }

    /// The part with one of its columns and the times of its samples, and nothing else.
    ///
    /// # Panics
    /// If there is no such column.
    #[must_use]
    pub fn only(&self, column: usize) -> Self {
        let times = Times { counter: vec![], ..self.times().clone() };
        Self::of(self.part.only(column), times)
    }
}
