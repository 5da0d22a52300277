//! Device time on the clock of the computer that received it.
//!
//! An arrival can only be late: by the least transport delay, plus a wait, for example for a USB burst of 16 ms or a busy
//! computer. So of all points (device time, arrival) only the lower convex hull carries information about the clocks, and a
//! line along it gives the arrival of a sample that did not have to wait. A line through the middle of the points would be
//! late by the mean wait.
//!
//! ```
//! use xbus::hostclock::HostClock;
//!
//! // A second of samples at 1 kHz on a clock that loses 20 ppm, read every 16 ms, 1.2 ms after they were sent.
//! let mut clock = HostClock::default();
//! let mut host_time = 0.0;
//! for tick in 0..=1_000 {
//!     let sent: i64 = tick * 1_000_020;
//!     let arrival = (sent + 15_999_999) / 16_000_000 * 16_000_000 + 1_200_000;
//!     host_time = clock.update(tick as f64 * 1e-3, arrival, true);
//! }
//! assert!((host_time - (1.000_020 + 0.001_2)).abs() < 2e-4);
//! ```

use std::collections::VecDeque;

/// Seconds of device time that the hull covers. Long, because the period of arrivals (USB frames of 1 ms, the 16 ms of an
/// adapter) may beat slowly against that of the samples: at 1 kHz and 12 ppm only one sample in 83 s does not wait. Short,
/// because drift changes as clocks warm up: a change of 1 ppm in ten minutes costs 0.1 ms.
const WINDOW: f64 = 600.0;
/// Seconds by which the window moves. A single old point cannot be removed from a hull, because the points that it hid
/// were dropped.
const BLOCK: f64 = 60.0;
/// Most points of a hull. With noise it has a few dozen; only smooth, curved data have more.
const POINTS: usize = 1024;
/// The part of the hull from which the drift is computed: the short edges at its ends carry little information. This is as
/// good as the mean over all possible lines, weighted by likelihood.
const MIDDLE: [f64; 2] = [0.3, 0.7];
/// Largest drift: crystals differ by less. Without a limit, a minute of load would be taken for drift in a young fit.
const DRIFT: f64 = 200e-6;
/// Seconds after which a fit computes its drift. Before that it would be noise, and the drift of the fit before is better.
const SETTLED: f64 = 10.0;
/// Seconds by which a sample may be older than the one before it, or that of a receiver differ from the others.
const AWAY: f64 = 1.0;
/// An arrival that is early by more seconds than this means that a clock was set.
const EARLY: f64 = 0.02;
/// Arrivals that are late by more seconds than this, ...
const LATE: f64 = 0.1;
/// ... for more nanoseconds than this, mean that a clock was set.
const LATE_FOR: i64 = 10_000_000_000;
/// Seconds over which the residual is a mean.
const MEAN: f64 = 10.0;
/// Steps that are kept.
const STEPS: usize = 100;

/// Why a new fit began.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Reason {
    /// Device time went back: the device restarted.
    Back,
    /// An impossibly early arrival: the host's clock was set back or stopped, or the device's clock was set ahead.
    Early,
    /// All arrivals are late for a while: the host's clock was set ahead, or the device's clock stopped.
    Late,
}

impl Reason {
    /// What happened, in words.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self {
            Self::Back => "device time went back",
            Self::Early => "arrivals became early",
            Self::Late => "arrivals became late",
        }
    }
}

/// A step of one of the clocks, at which a new fit began.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "python", pyo3::pyclass(module = "xbus._core", name = "ClockStep", frozen, get_all))]
pub struct Step {
    /// Device time of the first sample after it, in seconds.
    pub time: f64,
    /// Arrival of that sample, in ns since 1970.
    pub arrival: i64,
    /// What happened.
    pub reason: Reason,
}

/// A device time `x`, and how much later the arrival is, `y`; in seconds since the fit began.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Point {
    x: f64,
    y: f64,
}

/// A lower convex hull, from left to right.
#[derive(Clone, Debug, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Hull(Vec<Point>);

impl Hull {
    /// Adds a point to the right of all others.
    fn push(&mut self, point: Point) {
        while let [.., a, b] = self.0[..] {
            // Keep b only if it is below the line from a to the point.
            if (b.y - a.y) * (point.x - a.x) < (point.y - a.y) * (b.x - a.x) {
                break;
            }
            self.0.pop();
        }
        if self.0.len() == POINTS {
            let mut index = 0;
            self.0.retain(|_| {
                index += 1;
                index % 2 == 1 || index == POINTS
            });
        }
        self.0.push(point);
    }

    /// Its height at `x`, which must be between its ends.
    fn at(&self, x: f64) -> f64 {
        let right = self.0.partition_point(|point| point.x <= x);
        let (Some(b), Some(a)) = (self.0.get(right), self.0.get(right.wrapping_sub(1))) else {
            return self.0[self.0.len() - 1].y;
        };
        a.y + (b.y - a.y) * (x - a.x) / (b.x - a.x)
    }

    /// The slope of its middle part.
    fn slope(&self) -> f64 {
        let [from, to] = MIDDLE.map(|part| self.0[0].x + part * self.span());
        (self.at(to) - self.at(from)) / (to - from)
    }

    /// The height at zero of the line with this slope that touches it from below.
    fn touch(&self, slope: f64) -> f64 {
        let is_left = |at: usize| {
            let (a, b) = (self.0[at], self.0[at + 1]);
            b.y - a.y < slope * (b.x - a.x)
        };
        let (mut low, mut high) = (0, self.0.len() - 1);
        while low < high {
            let middle = usize::midpoint(low, high);
            if is_left(middle) { low = middle + 1 } else { high = middle }
        }
        self.0[low].y - slope * self.0[low].x
    }

    /// The distance from its first to its last point.
    fn span(&self) -> f64 {
        self.0[self.0.len() - 1].x - self.0[0].x
    }
}

/// What is known since the last step.
#[derive(Clone, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Fit {
    /// Device time of its first sample, to which all others are relative.
    time: f64,
    /// Arrival of its first sample, to which all others are relative.
    arrival: i64,
    /// The hull of the window.
    hull: Hull,
    /// The hull of each block of the window, with the number of the block.
    blocks: VecDeque<(f64, Hull)>,
    /// Height of the line at zero.
    offset: f64,
    /// Slope of the line.
    drift: f64,
    /// Device time and host time of the samples of the last second.
    recent: VecDeque<(f64, f64)>,
    residual: f64,
    /// Since when all arrivals are late.
    late: Option<i64>,
}

impl Fit {
    fn new(time: f64, arrival: i64, drift: f64) -> Self {
        let mut hull = Hull::default();
        hull.push(Point { x: 0.0, y: 0.0 });
        Self {
            time,
            arrival,
            blocks: [(0.0, hull.clone())].into(),
            hull,
            offset: 0.0,
            drift,
            recent: [(0.0, 0.0)].into(),
            residual: 0.0,
            late: None,
        }
    }

    /// Device time of the newest sample.
    fn newest(&self) -> f64 {
        self.recent[self.recent.len() - 1].0
    }

    /// Height of the line: how much later than device time it is.
    fn line(&self, x: f64) -> f64 {
        self.offset + self.drift * x
    }

    #[allow(clippy::cast_precision_loss)] // less than a nanosecond in a hundred days
    fn since(&self, arrival: i64) -> f64 {
        arrival.saturating_sub(self.arrival) as f64 / 1e9
    }

    /// Seconds since 1970.
    #[allow(clippy::cast_precision_loss)] // 64 bits have a resolution of 0.24 µs there
    fn absolute(&self, seconds: f64) -> f64 {
        self.arrival.div_euclid(1_000_000_000) as f64 + (self.arrival.rem_euclid(1_000_000_000) as f64 / 1e9 + seconds)
    }

    /// Why a new fit must begin with this sample, which is newer than all others; `None` if it belongs to this fit.
    fn step(&mut self, Point { x, y }: Point, arrival: i64) -> Option<Reason> {
        let late = y - self.line(x);
        if late < -EARLY {
            return Some(Reason::Early);
        }
        if late <= LATE {
            self.late = None;
            return None;
        }
        let since = *self.late.get_or_insert(arrival);
        (arrival.saturating_sub(since) > LATE_FOR).then_some(Reason::Late)
    }

    /// Adds a sample that is newer than all others, and returns its host time.
    fn push(&mut self, point: Point) -> f64 {
        let elapsed = point.x - self.newest();
        let block = (point.x / BLOCK).floor();
        if self.blocks.back().is_none_or(|last| last.0 < block) {
            let oldest = block - WINDOW / BLOCK;
            let count = self.blocks.len();
            self.blocks.retain(|block| block.0 >= oldest);
            if self.blocks.len() < count {
                self.hull.0.clear();
                self.blocks.iter().flat_map(|block| &block.1.0).for_each(|point| self.hull.push(*point));
            }
            self.blocks.push_back((block, Hull::default()));
        }
        self.hull.push(point);
        if let Some((_, hull)) = self.blocks.back_mut() {
            hull.push(point);
        }
        if self.hull.span() >= SETTLED {
            self.drift = self.hull.slope().clamp(-DRIFT, DRIFT);
        }
        self.offset = self.hull.touch(self.drift);
        let line = self.line(point.x);
        self.residual += (point.y - line - self.residual) * elapsed / (MEAN + elapsed);
        // The line may have moved down, but host time never decreases.
        let host = (point.x + line).max(self.recent[self.recent.len() - 1].1);
        self.recent.push_back((point.x, host));
        while self.recent.get(1).is_some_and(|sample| sample.0 <= point.x - AWAY) {
            self.recent.pop_front();
        }
        host
    }

    /// Host time of any device time: interpolated between recent samples, otherwise by the line.
    fn host_time(&self, x: f64) -> f64 {
        let right = self.recent.partition_point(|sample| sample.0 <= x);
        let host = x + self.line(x);
        match (right.checked_sub(1).map(|left| self.recent[left]), self.recent.get(right)) {
            (Some(a), Some(b)) => a.1 + (b.1 - a.1) * (x - a.0) / (b.0 - a.0),
            (Some(last), None) => host.max(last.1),
            (None, Some(first)) => host.min(first.1),
            (None, None) => host,
        }
    }
}

/// Maps device time to host time, from the arrivals of samples.
///
/// The host time of a sample depends on this sample and those before it. It never decreases, unless the host's own clock
/// was set back. Memory is bounded, and the cost of a sample is constant.
#[derive(Clone, Debug, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct HostClock {
    fit: Option<Fit>,
    steps: VecDeque<Step>,
    fits: u64,
}

impl HostClock {
    /// Adds a sample and returns its host time in seconds since 1970. `time` is its device time in seconds, unwrapped,
    /// `arrival` when its last byte arrived, in ns since 1970.
    ///
    /// Samples that do not `lead` do not move the clock: those of a GNSS receiver, whose time is late or arbitrary. Their
    /// host time follows from their device time; NaN if that is more than a second away from the other samples.
    pub fn update(&mut self, time: f64, arrival: i64, leads: bool) -> f64 {
        if !time.is_finite() {
            return f64::NAN;
        }
        let Some(fit) = &mut self.fit else {
            return if leads { self.begin(Fit::new(time, arrival, 0.0)) } else { f64::NAN };
        };
        let x = time - fit.time;
        let ahead = x - fit.newest();
        if !leads || (-AWAY..=0.0).contains(&ahead) {
            return if ahead.abs() <= AWAY { fit.absolute(fit.host_time(x)) } else { f64::NAN };
        }
        let point = Point { x, y: fit.since(arrival) - x };
        let reason = if ahead < 0.0 { Some(Reason::Back) } else { fit.step(point, arrival) };
        let Some(reason) = reason else {
            let host = fit.push(point);
            return fit.absolute(host);
        };
        let next = Fit::new(time, arrival, fit.drift);
        if reason == Reason::Early && fit.newest() < SETTLED {
            // The first arrivals were late; no clock was set.
            self.fits -= 1;
        } else {
            self.steps.push_back(Step { time, arrival, reason });
            if self.steps.len() > STEPS {
                self.steps.pop_front();
            }
        }
        self.begin(next)
    }

    fn begin(&mut self, fit: Fit) -> f64 {
        self.fits += 1;
        self.fit.insert(fit).absolute(0.0)
    }

    /// Host time of any device time, in seconds since 1970, by the current line; in the last second as [`Self::update`]
    /// returned it. NaN before the first sample.
    #[must_use]
    pub fn host_time(&self, time: f64) -> f64 {
        self.fit.as_ref().map_or(f64::NAN, |fit| fit.absolute(fit.host_time(time - fit.time)))
    }

    /// Host time minus device time at the newest sample, in seconds. NaN before the first sample.
    #[must_use]
    pub fn offset(&self) -> f64 {
        self.fit.as_ref().map_or(f64::NAN, |fit| fit.absolute(fit.line(fit.newest())) - fit.time)
    }

    /// Seconds per second that the host's clock gains on the device's; 0 in the first ten seconds. NaN before the first sample.
    #[must_use]
    pub fn drift(&self) -> f64 {
        self.fit.as_ref().map_or(f64::NAN, |fit| fit.drift)
    }

    /// Mean seconds by which samples arrive later than the line, over about ten seconds. NaN before the first sample.
    #[must_use]
    pub fn residual(&self) -> f64 {
        self.fit.as_ref().map_or(f64::NAN, |fit| fit.residual)
    }

    /// Device time at which the fit began, in seconds. NaN before the first sample.
    #[must_use]
    pub fn since(&self) -> f64 {
        self.fit.as_ref().map_or(f64::NAN, |fit| fit.time)
    }

    /// Number of fits: one more than steps.
    #[must_use]
    pub const fn fits(&self) -> u64 {
        self.fits
    }

    /// The last hundred steps.
    pub fn steps(&self) -> impl Iterator<Item = &Step> {
        self.steps.iter()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Adds samples every 10 ms, each late by the given seconds; returns host time minus device time of the last one.
    fn add_late(clock: &mut HostClock, late: impl IntoIterator<Item = f64>) -> f64 {
        let mut off = f64::NAN;
        for (tick, late) in (0_i32..).zip(late) {
            let time = f64::from(tick) / 100.0;
            #[allow(clippy::cast_possible_truncation)]
            let host = clock.update(time, ((time + late) * 1e9).round() as i64, true);
            off = host - time;
        }
        off
    }

    #[test]
    fn memory_is_bounded() {
        // Smooth and curved: every point is on the hull.
        let mut clock = HostClock::default();
        let late = (0_i32..200_000).map(|tick| f64::from(tick).powi(2) * 1e-12);
        let off = add_late(&mut clock, late);
        let fit = clock.fit.unwrap();
        assert!(fit.hull.0.len() <= POINTS && fit.hull.0.len() > POINTS / 4);
        assert!(fit.blocks.len() <= 11 && fit.blocks.iter().all(|block| block.1.0.len() <= POINTS));
        assert!(fit.recent.len() <= 102);
        assert!((off - 0.04).abs() < 5e-3, "{off}");
    }

    #[test]
    fn the_window_is_ten_minutes() {
        // The first minute was faster than all others, which at first looks like drift.
        let late = (0..120_000).map(|tick| if tick < 6_000 { 0.0 } else { 0.001 });
        let [mut young, mut old] = [HostClock::default(), HostClock::default()];
        add_late(&mut young, late.clone().take(60_000));
        assert!((young.drift() - 0.001 / 540.0).abs() < 1e-8);
        let off = add_late(&mut old, late);
        assert!(old.drift().abs() < 1e-9 && (off - 0.001).abs() < 1e-6);
    }

    #[test]
    fn hulls() {
        let mut hull = Hull::default();
        for (x, y) in [(0.0, 4.0), (1.0, 3.0), (2.0, 0.0), (3.0, 0.0), (4.0, 1.0), (5.0, 0.0), (6.0, 3.0)] {
            hull.push(Point { x, y });
        }
        let left: Vec<_> = hull.0.iter().map(|point| (point.x, point.y)).collect();
        assert_eq!(left, [(0.0, 4.0), (2.0, 0.0), (5.0, 0.0), (6.0, 3.0)]);
        for (x, y) in [(0.0, 4.0), (1.0, 2.0), (3.5, 0.0), (5.5, 1.5), (6.0, 3.0)] {
            assert!((hull.at(x) - y).abs() < 1e-12);
        }
        for (slope, height) in [(-5.0, 4.0), (-1.0, 2.0), (0.5, -2.5), (9.0, -51.0)] {
            assert!((hull.touch(slope) - height).abs() < 1e-12);
        }
    }
}
