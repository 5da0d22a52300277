//! Device time and packet counters, unwrapped.
//!
//! Everything is decided from what came before, so a log that is read in parts gives the same as one that is read whole.

use crate::device;
use crate::frame::device_of;
use crate::packet::{Reading, packets};
use crate::table::{self, ClockRole, Series, Wire};

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
    /// Whether the sample carries GNSS receiver data.
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

/// When a sample was taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Seconds on the device clock, unwrapped; NaN without a time stamp.
    pub seconds: f64,
    /// The packet counter, unwrapped; -1 without one.
    pub counter: i64,
    /// Number of samples that are missing before this one.
    pub lost: u64,
}

/// A change of a clock by a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Change {
    /// The message names the device, whose fine time wraps after this many ticks.
    Wrap(u64),
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
#[derive(Clone, Copy, Debug, Default)]
pub struct Clock {
    /// Where the fine time wraps, once the log has named the device.
    wrap: Option<i64>,
    /// Last fine time, and the same unwrapped.
    time: Option<(i64, i64)>,
    /// Last counter, unwrapped.
    counter: Option<i64>,
    /// Whether the device began anew: the next counter counts no loss.
    restarted: bool,
}

/// The two turns of the fine time, in ticks: a day, and all of 32 bits.
const DAY: i64 = Series::Hundred.fine_wrap().cast_signed();
const U32: i64 = Series::SixHundred.fine_wrap().cast_signed();
/// Ticks of the fine time in a second.
const TICKS: i64 = 10_000;

impl Clock {
    /// Takes note of a message between two samples.
    pub fn change(&mut self, change: Change) {
        match change {
            Change::Wrap(ticks) => self.wrap = Some(ticks.cast_signed()),
            Change::Restart => self.restarted = true,
        }
    }

    /// The moment of the next sample.
    #[inline(always)] // so that the moment stays in registers
    pub fn sample(&mut self, stamps: Stamps) -> Moment {
        let seconds = self.seconds(stamps);
        let (counter, lost) = stamps.counter.map_or((-1, 0), |counter| self.count(counter));
        Moment { seconds, counter, lost }
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

    /// The counter, continued from the last one, and the samples that are missing between the two.
    #[inline(always)]
    fn count(&mut self, counter: u16) -> (i64, u64) {
        let counter = i64::from(counter);
        let restarted = std::mem::take(&mut self.restarted);
        let Some(last) = self.counter.replace(counter) else { return (counter, 0) };
        let step = (counter - last).rem_euclid(1 << 16);
        // Shorter backwards than forwards: an older sample, unless that would lead below zero.
        let step = if step < 1 << 15 || last + step < 1 << 16 { step } else { step - (1 << 16) };
        let missing = if step > 1 && !restarted { step.unsigned_abs() - 1 } else { 0 };
        self.counter = Some(last + step);
        (last + step, missing)
    }
}

/// The clocks of all devices of a log.
#[derive(Clone, Debug)]
pub struct Clocks(Box<[Clock; 256]>);

impl Default for Clocks {
    fn default() -> Self {
        Self(Box::new([Clock::default(); 256]))
    }
}

impl Clocks {
    /// The clock of the device with this bus identifier.
    pub fn of(&mut self, bid: u8) -> &mut Clock {
        &mut self.0[usize::from(device_of(bid))]
    }
}
