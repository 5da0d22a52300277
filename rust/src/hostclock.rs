//! Device time on the clock of the computer that received it.
//!
//! An arrival can only be late: by the least transport delay, and by whatever it had to wait for on top, a USB burst of
//! 16 ms or a busy computer. So of all points (device time, arrival) only the lower convex hull says anything about the
//! clocks, and a line along it is the arrival of a sample that did not have to wait. A line through the middle of the
//! cloud would be late by the mean of all waiting.
//!
//! ```
//! use xbus::hostclock::HostClock;
//!
//! // A second of samples at 1 kHz on a clock that is 20 µs late in it, read every 16 ms, 1.2 ms after they were sent.
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

/// Seconds of device time that the hull looks back. Long, because what quantises arrivals (USB frames of 1 ms, the 16 ms of
/// an adapter) may beat slowly against the samples: at 1 kHz and 12 ppm a sample that did not wait comes every 83 s. Short,
/// because clocks drift differently as they warm up: a change of 1 ppm in these ten minutes costs 0.1 ms.
const WINDOW: f64 = 600.0;
/// The window moves by so much: a hull cannot forget its oldest point alone, since what that had hidden is gone.
const BLOCK: f64 = 60.0;
/// Points that a hull may have. Noise leaves a few dozen; only a cloud that is smooth and bent has more.
const POINTS: usize = 1024;
/// Over how much of its length a hull tells the drift: its ends are short edges that say little. As good as the mean over
/// all lines that the points allow, by their likelihood.
const MIDDLE: [f64; 2] = [0.3, 0.7];
/// Largest drift: crystals differ by less. Without a limit a minute of load, in a fit as young, would pass for drift.
const DRIFT: f64 = 200e-6;
/// Seconds until a fit has a drift of its own. Before that it would be noise, and that of the fit before serves better.
const SETTLED: f64 = 10.0;
/// Seconds that a sample may be older than one before it, or a receiver's be away from the others.
const AWAY: f64 = 1.0;
/// Seconds by which nothing arrives too early, unless a clock was set.
const EARLY: f64 = 0.02;
/// Arrivals that are late by so many seconds, ...
const LATE: f64 = 0.1;
/// ... for so many nanoseconds, are so because a clock was set.
const LATE_FOR: i64 = 10_000_000_000;
/// Seconds over which the residual is a mean.
const MEAN: f64 = 10.0;
/// Steps that are remembered.
const STEPS: usize = 100;

/// Why a new fit began.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reason {
    /// Device time went back: the device began anew.
    Back,
    /// An arrival before it was possible: the host's clock was set back or stood still, or the device's was set ahead.
    Early,
    /// All arrivals late, for a while: the host's clock was set ahead, or the device's stood still.
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

/// Where one of the clocks made a step, and a new fit began.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Device time of the first sample behind it.
    pub time: f64,
    /// Arrival of that sample, in ns since 1970.
    pub arrival: i64,
    /// What stepped.
    pub reason: Reason,
}

/// A device time, and how much later than it something is; both in seconds since the fit began.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Point {
    x: f64,
    y: f64,
}

/// A lower convex hull, from left to right.
#[derive(Clone, Debug, Default)]
struct Hull(Vec<Point>);

impl Hull {
    /// Takes in a point to the right of all others.
    fn push(&mut self, point: Point) {
        while let [.., a, b] = self.0[..] {
            // Seen from a, is b above the line to the point, or on it?
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

    /// Its height at `x`, which lies between its ends.
    fn at(&self, x: f64) -> f64 {
        let right = self.0.partition_point(|it| it.x <= x);
        let (Some(b), Some(a)) = (self.0.get(right), self.0.get(right.wrapping_sub(1))) else {
            return self.0[self.0.len() - 1].y;
        };
        a.y + (b.y - a.y) * (x - a.x) / (b.x - a.x)
    }

    /// How steep it is in its middle.
    fn slope(&self) -> f64 {
        let [from, to] = MIDDLE.map(|part| self.0[0].x + part * self.span());
        (self.at(to) - self.at(from)) / (to - from)
    }

    /// The line of this slope that touches it from below: its height at zero.
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

    /// From its first point to its last.
    fn span(&self) -> f64 {
        self.0[self.0.len() - 1].x - self.0[0].x
    }
}

/// What has been learned since the last step.
#[derive(Clone, Debug)]
struct Fit {
    /// Device time and arrival of its first sample; everything else is relative to these.
    time: f64,
    arrival: i64,
    /// Of the window, and of each minute of it, by its number.
    hull: Hull,
    blocks: VecDeque<(f64, Hull)>,
    /// The line: its height at zero, and its slope.
    offset: f64,
    drift: f64,
    /// What the clock said of the samples of the last second: device time and host time.
    said: VecDeque<(f64, f64)>,
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
            said: [(0.0, 0.0)].into(),
            residual: 0.0,
            late: None,
        }
    }

    /// Device time of the newest sample.
    fn newest(&self) -> f64 {
        self.said[self.said.len() - 1].0
    }

    /// How much later than device time the line is.
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

    /// What shows that this sample, newer than all others, belongs to a new fit.
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

    /// Takes in a sample that is newer than all others.
    fn push(&mut self, point: Point) -> f64 {
        let elapsed = point.x - self.newest();
        let block = (point.x / BLOCK).floor();
        if self.blocks.back().is_none_or(|last| last.0 < block) {
            let oldest = block - WINDOW / BLOCK;
            let count = self.blocks.len();
            self.blocks.retain(|it| it.0 >= oldest);
            if self.blocks.len() < count {
                self.hull.0.clear();
                self.blocks.iter().flat_map(|it| &it.1.0).for_each(|it| self.hull.push(*it));
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
        // The line may have sunk; host time waits for it.
        let host = (point.x + line).max(self.said[self.said.len() - 1].1);
        self.said.push_back((point.x, host));
        while self.said.get(1).is_some_and(|it| it.0 <= point.x - AWAY) {
            self.said.pop_front();
        }
        host
    }

    /// Host time of any device time: what was said of it, or what the line says.
    fn host_time(&self, x: f64) -> f64 {
        let right = self.said.partition_point(|it| it.0 <= x);
        let host = x + self.line(x);
        match (right.checked_sub(1).map(|left| self.said[left]), self.said.get(right)) {
            (Some(a), Some(b)) => a.1 + (b.1 - a.1) * (x - a.0) / (b.0 - a.0),
            (Some(last), None) => host.max(last.1),
            (None, Some(first)) => host.min(first.1),
            (None, None) => host,
        }
    }
}

/// Maps device time to host time, from the arrivals of samples.
///
/// What it says of a sample is decided by this sample and those before, and never runs backwards, unless the host's own
/// clock was set back. Memory is bounded, and a sample costs the same however many came before.
#[derive(Clone, Debug, Default)]
pub struct HostClock {
    fit: Option<Fit>,
    steps: VecDeque<Step>,
    fits: u64,
}

impl HostClock {
    /// Takes in a sample: its device time in seconds, unwrapped, and when its last byte arrived, in ns since 1970. Its host
    /// time in seconds since 1970.
    ///
    /// Samples that do not `lead` say nothing about the clocks: those of a receiver, whose time runs behind or is arbitrary.
    /// Their host time is that of their own device time; NaN where this is more than a second away from that of the others.
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
            // The first arrivals were late, and no clock was set.
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

    /// Host time in seconds since 1970 of any device time, by the line of the present; within the last second what was said
    /// of the samples then. NaN before the first sample.
    #[must_use]
    pub fn host_time(&self, time: f64) -> f64 {
        self.fit.as_ref().map_or(f64::NAN, |fit| fit.absolute(fit.host_time(time - fit.time)))
    }

    /// Seconds by which the line is later than device time, at the newest sample. NaN before the first.
    #[must_use]
    pub fn offset(&self) -> f64 {
        self.fit.as_ref().map_or(f64::NAN, |fit| fit.absolute(fit.line(fit.newest())) - fit.time)
    }

    /// What the host's clock gains on the device's, in seconds per second; 0 in the first ten seconds. NaN before.
    #[must_use]
    pub fn drift(&self) -> f64 {
        self.fit.as_ref().map_or(f64::NAN, |fit| fit.drift)
    }

    /// By how many seconds samples arrive later than the line: a mean over about ten seconds. NaN before the first sample.
    #[must_use]
    pub fn residual(&self) -> f64 {
        self.fit.as_ref().map_or(f64::NAN, |fit| fit.residual)
    }

    /// Device time at which the fit began. NaN before the first sample.
    #[must_use]
    pub fn since(&self) -> f64 {
        self.fit.as_ref().map_or(f64::NAN, |fit| fit.time)
    }

    /// How many fits there were: one more than steps.
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

    /// Samples every 10 ms, each late by what it is given, in seconds; says how much later than sent the last one is said to be.
    fn fed(clock: &mut HostClock, late: impl IntoIterator<Item = f64>) -> f64 {
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
        // Bent and smooth: every point is one of the hull.
        let mut clock = HostClock::default();
        let late = (0_i32..200_000).map(|it| f64::from(it).powi(2) * 1e-12);
        let off = fed(&mut clock, late);
        let fit = clock.fit.unwrap();
        assert!(fit.hull.0.len() <= POINTS && fit.hull.0.len() > POINTS / 4);
        assert!(fit.blocks.len() <= 11 && fit.blocks.iter().all(|it| it.1.0.len() <= POINTS));
        assert!(fit.said.len() <= 102);
        assert!((off - 0.04).abs() < 5e-3, "{off}");
    }

    #[test]
    fn the_window_is_ten_minutes() {
        // The first minute was faster than all others, which at first looks like drift.
        let late = (0..120_000).map(|it| if it < 6_000 { 0.0 } else { 0.001 });
        let [mut young, mut old] = [HostClock::default(), HostClock::default()];
        fed(&mut young, late.clone().take(60_000));
        assert!((young.drift() - 0.001 / 540.0).abs() < 1e-8);
        let off = fed(&mut old, late);
        assert!(old.drift().abs() < 1e-9 && (off - 0.001).abs() < 1e-6);
    }

    #[test]
    fn hulls() {
        let mut hull = Hull::default();
        for (x, y) in [(0.0, 4.0), (1.0, 3.0), (2.0, 0.0), (3.0, 0.0), (4.0, 1.0), (5.0, 0.0), (6.0, 3.0)] {
            hull.push(Point { x, y });
        }
        let left: Vec<_> = hull.0.iter().map(|it| (it.x, it.y)).collect();
        assert_eq!(left, [(0.0, 4.0), (2.0, 0.0), (5.0, 0.0), (6.0, 3.0)]);
        for (x, y) in [(0.0, 4.0), (1.0, 2.0), (3.5, 0.0), (5.5, 1.5), (6.0, 3.0)] {
            assert!((hull.at(x) - y).abs() < 1e-12);
        }
        for (slope, height) in [(-5.0, 4.0), (-1.0, 2.0), (0.5, -2.5), (9.0, -51.0)] {
            assert!((hull.touch(slope) - height).abs() < 1e-12);
        }
    }
}
