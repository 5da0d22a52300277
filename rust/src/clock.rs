//! Device time and packet counters, unwrapped.
//!
//! Everything is decided from what came before, so a log that is read in parts gives the same as one that is read whole.

mod even;

use crate::device;
use crate::frame::device_of;
use crate::packet::{Reading, packets};
use crate::table::{self, ClockRole, Series, Wire};

pub use even::Stretch;

/// What the packets of one sample say about when it was taken; the last one counts where there are several.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stamps {
    /// `PacketCounter`.
    pub counter: Option<u16>,
    /// `SampleTimeFine`, 0.1 ms.
    pub fine: Option<u32>,
    /// `SampleTimeCoarse`, s.
    pub coarse: Option<u32>,
    /// Time stamp of a TriggerIn packet, µs.
    pub trigger: Option<u32>,
    /// Whether the sample has data of the GNSS receiver.
    pub gnss: bool,
}

impl Stamps {
    /// Whether the sample comes when it was taken. Samples with data of the GNSS receiver or of a trigger come later.
    #[must_use]
    pub const fn lead(&self) -> bool {
        !self.gnss && self.trigger.is_none()
    }

    /// The stamps of a sample's packets.
    #[must_use]
    pub fn read(payload: &[u8]) -> Self {
        let mut stamps = Self::default();
        // Of several trigger lines the highest counts, whatever the order of the packets.
        let mut line = 0;
        for packet in packets(payload).flatten() {
            let Some(Reading { quantity, .. }) = packet.reading() else { continue };
            match (quantity.clock, packet.data) {
                (Some(ClockRole::Counter), &[a, b]) => stamps.counter = Some(u16::from_be_bytes([a, b])),
                (Some(ClockRole::Fine), data) => stamps.fine = u32_of(data),
                (Some(ClockRole::Coarse), data) => stamps.coarse = u32_of(data),
                (Some(ClockRole::Trigger), data) if quantity.id >= line => {
                    line = quantity.id;
                    stamps.trigger = u32_of(&data[TRIGGER_STAMP..]);
                }
                (Some(ClockRole::Receiver), _) => stamps.gnss = true,
                _ => {}
            }
        }
        stamps
    }
}

fn u32_of(data: &[u8]) -> Option<u32> {
    data.first_chunk().map(|bytes| u32::from_be_bytes(*bytes))
}

/// Where a trigger's record has its time stamp: after line and polarity.
pub(crate) const TRIGGER_STAMP: usize = 2 * Wire::U1.size();

/// Samples lost by the packet counter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "python", derive(pyo3::IntoPyObject))]
pub struct Losses {
    /// How many.
    pub samples: u64,
    /// At how many places.
    pub gaps: u64,
}

impl Losses {
    /// What was lost in these gaps.
    #[must_use]
    pub fn of(gaps: &[Gap]) -> Self {
        Self { samples: gaps.iter().map(|gap| gap.lost).sum(), gaps: gaps.len() as u64 }
    }

    /// Adds what was lost before one sample.
    pub fn add(&mut self, lost: u64) {
        self.samples += lost;
        self.gaps += u64::from(lost > 0);
    }
}

/// A place where samples are missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Gap {
    /// Index of the sample after the gap.
    pub sample: u64,
    /// Number of samples that are missing.
    pub lost: u64,
    /// Bus identifier of the device.
    pub bid: u8,
}

/// The first sample of a run, other than the first run of its device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Restart {
    /// Index of the sample.
    pub sample: u64,
    /// Bus identifier of the device.
    pub bid: u8,
}

/// When a sample was taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Seconds on the device clock, unwrapped; NaN without a time stamp.
    pub seconds: f64,
    /// The packet counter, unwrapped; -1 without one.
    pub counter: i64,
    /// Number of samples that are missing before this one.
    pub lost: u64,
    /// Whether the device restarted between its last sample and this one.
    pub restarted: bool,
}

/// A change of a clock by a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Change {
    /// The message names the device, whose fine time wraps after this many ticks.
    Wrap(u64),
    /// The device sends on CAN. Its fine time wraps at 32 bits, and its counter counts groups of frames.
    Can,
    /// A new run starts: the counter may start again, and nothing was lost.
    Restart,
}

impl Change {
    /// What this message changes, if anything.
    #[must_use]
    pub fn of(mid: u8, payload: &[u8]) -> Option<Self> {
        if table::restarts(mid) {
            return Some(Self::Restart);
        }
        device::wrap_of_message(mid, payload).map(Self::Wrap)
    }
}

/// Clock and counter of one device.
#[allow(clippy::struct_excessive_bools)] // they change independently
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Clock {
    /// Where the fine time wraps, once the log has named the device.
    wrap: Option<i64>,
    /// Last fine time, and the same unwrapped.
    time: Option<(i64, i64)>,
    /// Last counter, unwrapped.
    counter: Option<i64>,
    /// Whether the counter is a frame by itself, which can be lost alone.
    counts_groups: bool,
    /// Samples since the last counter that it counted, but whose frame with the counter was lost.
    uncounted: u64,
    /// How fast the counter counts.
    pace: Pace,
    /// Counts per second of a device that sends no time stamps, if known.
    rate: Option<f64>,
    /// Whether a sample had a time stamp.
    is_stamped: bool,
    /// Whether the device has sent a sample.
    has_begun: bool,
    /// Whether the device restarted after its last sample.
    restarted: bool,
    /// Whether the device restarted after its last counter: the next one counts no loss.
    recounts: bool,
}

/// The two turns of the fine time, in ticks: a day, and all of 32 bits.
const DAY: i64 = Series::Hundred.fine_wrap().cast_signed();
const U32: i64 = Series::SixHundred.fine_wrap().cast_signed();
/// Ticks of the fine time in a second.
const TICKS: i64 = 10_000;
/// A clock that steps back by more ticks than this, with a counter that does not continue, has restarted.
const RESTART_STEP: i64 = TICKS;
/// The longest step of a counter that continues while the clock steps back.
const SHORT_GAP: i64 = 256;
/// Where the packet counter wraps.
const COUNTS: i64 = 1 << 16;

impl Clock {
    /// Makes a change between two samples.
    pub fn change(&mut self, change: Change) {
        match change {
            Change::Wrap(ticks) => self.wrap = Some(ticks.cast_signed()),
            Change::Can => (self.wrap, self.counts_groups) = (Some(U32), true),
            Change::Restart => (self.restarted, self.recounts) = (true, true),
        }
    }

    /// The moment of the next sample.
    #[inline(always)] // so that the moment stays in registers
    #[allow(clippy::cast_precision_loss)] // below 2^53 for centuries
    pub fn sample(&mut self, stamps: Stamps) -> Moment {
        let before = self.time;
        let mut seconds = self.seconds(stamps);
        // The time of a sample of the GNSS receiver is no measure.
        let now = if stamps.fine.is_some() && !stamps.gnss { self.time.map(|(_, ticks)| ticks) } else { None };
        if let (Some((_, before)), Some(now)) = (before, now)
            && before - now > RESTART_STEP
            && !self.continues(stamps.counter)
        {
            (self.restarted, self.recounts) = (true, true);
        }
        // A sample without either may be late frames of the group before, which the counter does not count again.
        self.uncounted += u64::from(self.counts_groups && stamps.counter.is_none() && stamps.fine.is_some());
        let (counter, lost) = stamps.counter.map_or((-1, 0), |counter| self.count(counter, now));
        if seconds.is_nan() {
            if let (Some(rate), false, 0..) = (self.rate, self.is_stamped, counter) {
                seconds = counter as f64 / rate;
            }
        } else {
            self.is_stamped = true;
        }
        let restarted = std::mem::take(&mut self.restarted) && self.has_begun;
        self.has_begun = true;
        Moment { seconds, counter, lost, restarted }
    }

    /// Whether this counter follows the last one, perhaps after a short gap.
    fn continues(&self, counter: Option<u16>) -> bool {
        match (self.counter, counter) {
            (Some(last), Some(counter)) => (1..=SHORT_GAP).contains(&(i64::from(counter) - last).rem_euclid(COUNTS)),
            _ => false,
        }
    }

    #[allow(clippy::cast_precision_loss)] // below 2^53 for centuries
    fn seconds(&mut self, stamps: Stamps) -> f64 {
        let Some(fine) = stamps.fine.map(i64::from) else {
            return match (stamps.trigger, stamps.coarse) {
                (Some(trigger), _) => self.near(i64::from(trigger)) as f64 / 1e6,
                (None, Some(coarse)) => f64::from(coarse),
                (None, None) => f64::NAN,
            };
        };
        let mut unwrapped = self.unwrap(fine);
        let mut time = unwrapped;
        if let Some(coarse) = stamps.coarse {
            // The manual's "big timestamp", section 5.3.6. Where it says no more than the fine time alone, because the
            // device starts both again at the same moment, the unwrapped fine time knows better.
            let big = i64::from(coarse) * TICKS + fine % TICKS;
            let turns = big - fine;
            if turns != 0 {
                time = big;
                let whole = |wrap: i64| turns % wrap == 0;
                if turns > 0 && self.wrap.map_or(whole(DAY) || whole(U32), whole) {
                    unwrapped = big;
                }
            }
        }
        // GNSS samples run tens of milliseconds behind their neighbours, and without a fix their time is arbitrary.
        if !stamps.gnss {
            self.time = Some((fine, unwrapped));
        }
        time as f64 / TICKS as f64
    }

    /// The fine time, continued from the last one. A step that is shorter backwards than forwards around the wrap is a
    /// step back, unless it would lead below zero.
    fn unwrap(&self, fine: i64) -> i64 {
        let Some((last, unwrapped)) = self.time else { return fine };
        let wrap = match self.wrap {
            Some(wrap) => wrap,
            None if fine >= last => return unwrapped + fine - last,
            None if last < DAY => DAY,
            None => U32,
        };
        if (0..=wrap / 2).contains(&(fine - last)) {
            return unwrapped + fine - last; // nearly always, and without a division
        }
        let ahead = (fine - last).rem_euclid(wrap);
        if ahead > wrap / 2 && unwrapped + ahead >= wrap { unwrapped + ahead - wrap } else { unwrapped + ahead }
    }

    /// A trigger's microseconds, which wrap at 2^32 (72 minutes), brought next to the present time.
    fn near(&self, micros: i64) -> i64 {
        let Some((_, ticks)) = self.time else { return micros };
        let now = ticks * (1_000_000 / TICKS);
        micros + U32 * ((now - micros + U32 / 2).div_euclid(U32)).max(0)
    }

    /// The counter, continued from the last one, and the samples that are missing between the two. `now` is the unwrapped
    /// fine time of the sample, if it has one that is a measure.
    #[inline(always)]
    fn count(&mut self, counter: u16, now: Option<i64>) -> (i64, u64) {
        let counter = i64::from(counter);
        let restarted = std::mem::take(&mut self.recounts);
        let uncounted = std::mem::take(&mut self.uncounted);
        let Some(last) = self.counter.replace(counter) else {
            self.pace = Pace::from(now, counter);
            return (counter, 0);
        };
        let step = (counter - last).rem_euclid(COUNTS);
        // Shorter backwards than forwards: an older sample, unless that would lead below zero.
        let mut step = if step < COUNTS / 2 || last + step < COUNTS { step } else { step - COUNTS };
        if restarted {
            self.pace = Pace::from(now, last + step);
        } else if let Some(now) = now {
            step += COUNTS * self.pace.wraps(now, last + step);
        }
        let missing = if step > 1 && !restarted { (step.unsigned_abs() - 1).saturating_sub(uncounted) } else { 0 };
        self.counter = Some(last + step);
        (last + step, missing)
    }
}

/// How fast a counter counts, measured since the last restart. It shows how often the counter wrapped inside a gap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Pace {
    /// Fine time and counter, both unwrapped, of the last sample that has both.
    last: Option<(i64, i64)>,
    /// Ticks that `counts` took.
    ticks: i64,
    counts: i64,
}

/// Counts after which older ones have half the weight.
const MEMORY: i64 = 1 << 12;
/// Largest step of the counter that is compared with the time.
const MAX_STEP: i64 = 1 << 20;

impl Pace {
    fn from(now: Option<i64>, counter: i64) -> Self {
        Self { last: now.map(|now| (now, counter)), ticks: 0, counts: 0 }
    }

    /// How often the counter has wrapped unseen since the last sample. Neither a pause, after which the counter goes on
    /// where it stopped, nor a clock that was set is a wrap: the time must agree with the counter to 1/16.
    #[inline(always)]
    fn wraps(&mut self, now: i64, counter: i64) -> i64 {
        let Some((before, last)) = self.last.replace((now, counter)) else { return 0 };
        let (elapsed, step) = (now - before, counter - last);
        if elapsed <= 0 || elapsed >= DAY || step.abs() >= MAX_STEP {
            return 0;
        }
        if elapsed * self.counts > (step + COUNTS / 2) * self.ticks {
            return self.wraps_of_gap(elapsed, step);
        }
        if step > 0 {
            self.add(elapsed, step);
        }
        0
    }

    #[inline(always)]
    fn add(&mut self, elapsed: i64, step: i64) {
        (self.ticks, self.counts) = (self.ticks + elapsed, self.counts + step);
        if self.counts > MEMORY {
            (self.ticks, self.counts) = (self.ticks / 2, self.counts / 2);
        }
    }

    #[cold]
    fn wraps_of_gap(&mut self, elapsed: i64, step: i64) -> i64 {
        let expected = elapsed * self.counts / self.ticks.max(1);
        let wraps = (expected - step + COUNTS / 2) / COUNTS;
        let difference = (expected - step - wraps * COUNTS).abs();
        if difference > (expected / 16).min(COUNTS / 4) {
            return 0;
        }
        if let Some((_, counter)) = &mut self.last {
            *counter += wraps * COUNTS;
        }
        wraps
    }
}

/// The clocks of all devices of a log.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Clocks(Box<[Clock]>);

impl Default for Clocks {
    fn default() -> Self {
        Self::new(None)
    }
}

impl Clocks {
    /// Clocks at the beginning of a log. `rate` is that of the packet counter, in Hz, for devices that send it without
    /// time stamps: their time is the counter's.
    #[must_use]
    pub fn new(rate: Option<f64>) -> Self {
        Self(vec![Clock { rate, ..Clock::default() }; 256].into())
    }

    /// The clock of the device with this bus identifier.
    pub fn of(&mut self, bid: u8) -> &mut Clock {
        &mut self.0[usize::from(device_of(bid))]
    }
}
