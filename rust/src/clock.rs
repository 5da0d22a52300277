//! Device time and packet counters, unwrapped.
//!
//! Everything is decided from what came before, so a log that is read in parts gives the same as one that is read whole.

use crate::table::Series;

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

/// Samples that the counter says were lost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Losses {
    /// How many.
    pub samples: u64,
    /// At how many places.
    pub gaps: u64,
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
    /// The log names the device: its fine time wraps after so many ticks.
    pub fn set_wrap(&mut self, ticks: u64) {
        self.wrap = Some(ticks.cast_signed());
    }

    /// The device has gone to Measurement or has been reset: its counter may start anew, and nothing was lost.
    pub fn restart(&mut self) {
        self.restarted = true;
    }

    /// Seconds on the device clock, and the counter, of the next sample; NaN and -1 where it carries none.
    pub fn sample(&mut self, stamps: Stamps, losses: &mut Losses) -> (f64, i64) {
        (self.seconds(stamps), stamps.counter.map_or(-1, |counter| self.count(counter, losses)))
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

    fn count(&mut self, counter: u16, losses: &mut Losses) -> i64 {
        let counter = i64::from(counter);
        let restarted = std::mem::take(&mut self.restarted);
        let Some(last) = self.counter.replace(counter) else { return counter };
        let step = (counter - last).rem_euclid(1 << 16);
        // Shorter backwards than forwards: an older sample, unless that would lead below zero.
        let step = if step < 1 << 15 || last + step < 1 << 16 { step } else { step - (1 << 16) };
        if step > 1 && !restarted {
            losses.gaps += 1;
            losses.samples += step.unsigned_abs() - 1;
        }
        self.counter = Some(last + step);
        last + step
    }
}

/// The clocks of all devices of a log. A stand-alone device answers to FF and to 1: they are the same one.
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
        &mut self.0[usize::from(if bid == crate::frame::MASTER { 1 } else { bid })]
    }
}
