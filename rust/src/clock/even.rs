//! Even samples: the fast path of [`Clock::sample`].
//!
//! # The idea
//!
//! Nearly every sample follows the one before evenly: its counter is one higher, and its fine time a little later. Then
//! [`Clock::sample`] takes the same branches for each of them, and what is left of it is arithmetic without a branch:
//!
//! ```text
//! seconds = (unwrapped + fine - last) / 10,000      unwrapped, last: both of the sample before the stretch
//! counter = counter + 1                             no sample is missing, nothing restarts
//! ```
//!
//! [`Clock::even`] finds out how many samples follow evenly, computes these in loops that the compiler vectorizes, and
//! brings the clock forward once for all of them. It refuses everything else, and the caller gives the next sample to
//! [`Clock::sample`], which defines the result.
//!
//! # Why the result is the same to the last bit
//!
//! - *Wraps.* A fine time is even if it is 1 to [`LONGEST_STEP`] ticks after the last one, without a wrap of 32 bits. That is
//!   less than half of any wrap, so `Clock::unwrap` adds the difference, and the differences add up. The same tick twice is
//!   even too if there is no counter: high-rate quantities have messages of their own, often two in a tick. A counter is
//!   even if it is one higher modulo 2^16, which for `Clock::count` is a step of 1, at the wrap too.
//! - *Restarts.* After a restart, and before the first sample, all samples are refused. Time that goes forward restarts
//!   nothing.
//! - *Rounding.* Fine times and the number added to them are integers below 2^53, and so are their sums: as floats they are
//!   exact, and the only rounding is that of the division, as in `Clock::seconds`. Times near 2^53 are refused.
//! - *Pace.* `Pace::wraps` does three things with an even sample. It remembers it: only the last one counts. It compares the
//!   sample with the pace: with `elapsed <= 2^15` and `counts <= ticks`, `elapsed * counts` cannot exceed
//!   `(1 + 2^15) * ticks`, so it is not a wrap; each even sample adds one to `counts` and at least one to `ticks`, and
//!   halving both keeps their order, so one comparison proves it for all. And it adds the sample to `ticks` and `counts`:
//!   the sum is added at once, and the stretch ends at the sample after which they are halved.
//! - *Coarse time* that equals the seconds of the fine time changes nothing in `Clock::seconds`; any other is refused.
//! - *What is not there* does not change. Without a fine time neither time nor pace does, and without a counter neither
//!   counter nor pace.
//!
//! Samples with triggers, data of a GNSS receiver or nothing but coarse time are not in a stretch, nor are samples of CAN.
//!
//! # What it costs
//!
//! Measured with `cargo bench --bench decode` on a 2-core x86-64 VM, as a part of the time of decoding into fresh columns.
//! `ahrs` has 5.8 million samples, the others a third to 5 million.
//!
//! | stream | stretches | sample by sample |
//! |---|---|---|
//! | ahrs | 0.14 | 1.0 |
//! | gnssins, whose every 25th sample is of the receiver | 0.13 to 0.15 | 0.5 |
//! | dirty, with a gap every few samples | 0.25 to 0.35 | 0.6 |
//! | hr, two packets in 27 bytes, often two messages in a tick | 0.4 | 3 |
//!
//! Of 4 to 5 ns a sample, 3 are the first touch of the 16 bytes of its results. Compiled for AVX2 (`simd.rs`) it is not
//! faster: a processor divides two numbers in half the time of four. Devices that take turns on a bus have stretches of
//! one sample, which take two thirds of the time.

use std::iter::repeat_n;

use super::{COUNTS, Clock, MEMORY, TICKS};

/// Stamps of samples that follow each other: of one device, all with the same stamps, and without other stamps.
#[derive(Clone, Copy, Debug)]
pub struct Stretch<'a> {
    /// Number of samples.
    pub samples: usize,
    /// `PacketCounter` of each, and perhaps of later samples; `None` if the samples have none.
    pub counter: Option<&'a [u16]>,
    /// `SampleTimeFine` of each, 0.1 ms, likewise.
    pub fine: Option<&'a [u32]>,
    /// `SampleTimeCoarse` of each, s, likewise. Only samples with fine time have it.
    pub coarse: Option<&'a [u32]>,
}

/// Most samples at a time. Their stamps and results stay in the first-level cache.
const MOST: usize = 512;
/// Samples that are compared at once.
const BLOCK: usize = 32;
/// Longest step of an even fine time. `Pace::wraps` finds no wrap in less time, at any pace.
const LONGEST_STEP: i64 = COUNTS / 2;
/// Times from here on are refused, because sums with them might not be exact as floats.
const TOO_LARGE: i64 = 1 << 52;

impl Clock {
    /// Appends times and counters of the first samples of a stretch, as many as follow evenly, but not more than a few
    /// hundred. Returns their number. The clock is then as if [`Self::sample`] had been called for each.
    pub fn even(&mut self, stretch: Stretch<'_>, times: &mut Vec<f64>, counters: &mut Vec<i64>) -> usize {
        let n = self.count_even(stretch);
        if n > 0 {
            self.pass(n, stretch, times, counters);
        }
        n
    }

    /// How many samples follow evenly.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // stamps as received, and few samples
    fn count_even(&self, stretch: Stretch<'_>) -> usize {
        if !self.has_begun || self.restarted || self.counts_groups {
            return 0;
        }
        let mut n = stretch.samples.min(MOST);
        if let (Some(_), Some(_)) = (stretch.fine, stretch.counter) {
            let pace = &self.pace;
            let is_last = pace.last == self.time.map(|time| time.1).zip(self.counter);
            if !is_last || pace.counts > pace.ticks || pace.counts > MEMORY {
                return 0;
            }
            n = n.min((MEMORY + 1 - pace.counts) as usize);
        }
        if let Some(counter) = stretch.counter {
            let Some(last) = self.counter.filter(|last| !self.recounts && *last >= 0) else {
                return 0;
            };
            n = even(last as u16, &counter[..n], |before, counter| before.wrapping_add(1) == counter);
        }
        if let Some(fine) = stretch.fine {
            let Some((last, _)) = self.time.filter(|time| (0..TOO_LARGE).contains(&time.1)) else { return 0 };
            if self.wrap.is_some_and(|wrap| wrap / 2 < LONGEST_STEP) {
                return 0;
            }
            let shortest = u32::from(stretch.counter.is_some());
            n = even(last as u32, &fine[..n], |before, fine| {
                (fine >= before) & (shortest..=LONGEST_STEP as u32).contains(&fine.wrapping_sub(before))
            });
            if let Some(coarse) = stretch.coarse {
                let both = fine[..n].iter().zip(coarse);
                n = both.take_while(|(fine, coarse)| **fine / TICKS as u32 == **coarse).count();
            }
        }
        n
    }

    /// Appends times and counters of `n` samples that follow evenly, and brings the clock forward.
    #[allow(clippy::cast_possible_wrap, clippy::cast_precision_loss)] // few samples; below 2^53
    fn pass(&mut self, n: usize, stretch: Stretch<'_>, times: &mut Vec<f64>, counters: &mut Vec<i64>) {
        let count = n as i64;
        let counter = stretch.counter.and(self.counter).map(|last| last + count);
        if let Some(counter) = counter {
            counters.extend((1..=count).map(|step| counter - count + step));
            self.counter = Some(counter);
        } else {
            counters.extend(repeat_n(-1, n));
        }
        if let (Some(fine), Some((last, before))) = (stretch.fine, self.time) {
            let offset = before - last;
            let exact = offset as f64;
            times.extend(fine[..n].iter().map(|fine| (exact + f64::from(*fine)) / TICKS as f64));
            let last = i64::from(fine[n - 1]);
            let now = offset + last;
            self.time = Some((last, now));
            if let Some(counter) = counter {
                self.pace.add(now - before, count);
                self.pace.last = Some((now, counter));
            }
        } else if let (Some(rate), Some(_), false) = (self.rate, counter, self.is_stamped) {
            times.extend(counters[counters.len() - n..].iter().map(|counter| *counter as f64 / rate));
        } else {
            times.extend(repeat_n(f64::NAN, n));
        }
    }
}

/// How many of these values each follow the one before.
#[inline(always)]
fn even<T: Copy>(last: T, values: &[T], follows: impl Fn(T, T) -> bool) -> usize {
    if values.first().is_none_or(|first| !follows(last, *first)) {
        return 0;
    }
    let mut n = 1;
    while n < values.len() {
        let end = values.len().min(n + BLOCK);
        let pairs = || values[n - 1..].iter().zip(&values[n..end]);
        if !pairs().fold(true, |all, (before, value)| all & follows(*before, *value)) {
            return n + pairs().take_while(|(before, value)| follows(**before, **value)).count();
        }
        n = end;
    }
    n
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use proptest::sample::select;

    use super::super::{Change, DAY, Stamps};
    use super::*;

    /// Samples that follow each other in the same way, and what comes before them.
    #[derive(Clone, Debug)]
    struct Segment {
        change: Option<Change>,
        /// A sample with time and data of a GNSS receiver.
        gnss: bool,
        /// Added to counter and fine time.
        jump: (u16, u32),
        has: (bool, bool),
        /// Difference of the coarse time from the seconds of the fine time, if samples with fine time have it.
        coarse: Option<u32>,
        samples: usize,
        /// Ticks from one sample to the next.
        step: u32,
    }

    fn segment() -> impl Strategy<Value = Segment> {
        let changes = vec![
            None,
            None,
            None,
            None,
            None,
            Some(Change::Restart),
            Some(Change::Wrap(DAY.cast_unsigned())),
            Some(Change::Wrap(1 << 32)),
        ];
        let counters = vec![0, 0, 0, 1, 300, 300, 32_767, 32_768, 65_535];
        let times = vec![0, 0, 0, 1, 32_768, 32_769, 40_000, 1 << 31, 20_000_u32.wrapping_neg()];
        let has = vec![(true, true), (true, true), (true, false), (true, false), (false, true), (false, false)];
        let steps = vec![0, 1, 1, 1, 5, 100, 1000, 32_767, 32_768, 32_769, 32_770, 70_000];
        let jump = (select(counters), select(times));
        let coarse = select(vec![None, None, Some(0), Some(0), Some(1), Some(86_400)]);
        let samples = select(vec![1, 1, 2, 3, 32, 33, 34, 600, 2200]);
        (select(changes), prop::bool::weighted(0.2), jump, select(has), coarse, samples, select(steps)).prop_map(
            |(change, gnss, jump, has, coarse, samples, step)| Segment {
                change,
                gnss,
                jump,
                has,
                coarse,
                samples,
                step,
            },
        )
    }

    /// A clock at the beginning of a log or somewhere in it.
    fn clock() -> impl Strategy<Value = Clock> {
        let times = select(vec![None, None, Some(0), Some(TOO_LARGE - 1), Some(TOO_LARGE), Some((1 << 53) - 7)]);
        let counters = select(vec![None, Some(-5), Some(65_535)]);
        let rates = select(vec![None, Some(0.3), Some(0.3)]);
        (times, counters, rates, prop::bool::weighted(0.05)).prop_map(|(time, counter, rate, counts_groups)| Clock {
            rate,
            time: time.map(|time| (0, time)),
            counter,
            counts_groups,
            is_stamped: time.is_some(),
            has_begun: time.is_some() || counter.is_some(),
            ..Clock::default()
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn stretches_equal_single_samples(clock in clock(), segments in prop::collection::vec(segment(), 1..20)) {
            let [mut fast, mut plain] = [clock; 2];
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // as devices do
            let (mut count, mut ticks) = (clock.counter.unwrap_or(0) as u16, 0_u32);
            for segment in segments {
                if let Some(change) = segment.change {
                    [&mut fast, &mut plain].into_iter().for_each(|clock| clock.change(change));
                }
                (count, ticks) = (count.wrapping_add(segment.jump.0), ticks.wrapping_add(segment.jump.1));
                if segment.gnss {
                    let stamps = Stamps { counter: Some(count), fine: Some(ticks), gnss: true, ..Stamps::default() };
                    [&mut fast, &mut plain].into_iter().for_each(|clock| _ = clock.sample(stamps));
                }
                let mut next = || {
                    (count, ticks) = (count.wrapping_add(1), ticks.wrapping_add(segment.step));
                    (count, ticks)
                };
                let (counter, fine): (Vec<u16>, Vec<u32>) = (0..segment.samples).map(|_| next()).unzip();
                let seconds = |ticks: &u32| (ticks / 10_000).wrapping_add(segment.coarse.unwrap_or(0));
                let coarse: Vec<u32> = fine.iter().map(seconds).collect();
                let has_coarse = segment.has.1 && segment.coarse.is_some();
                let (mut times, mut counters) = (vec![], vec![]);
                let mut at = 0;
                while at < segment.samples {
                    let stretch = Stretch {
                        samples: segment.samples - at,
                        counter: segment.has.0.then_some(&counter[at..]),
                        fine: segment.has.1.then_some(&fine[at..]),
                        coarse: has_coarse.then_some(&coarse[at..]),
                    };
                    let even = fast.even(stretch, &mut times, &mut counters);
                    let stamps = |at| Stamps {
                        counter: segment.has.0.then_some(counter[at]),
                        fine: segment.has.1.then_some(fine[at]),
                        coarse: has_coarse.then_some(coarse[at]),
                        ..Stamps::default()
                    };
                    let mut moments = vec![];
                    for at in at..at + even {
                        let moment = plain.sample(stamps(at));
                        prop_assert_eq!((moment.lost, moment.restarted), (0, false));
                        moments.push(moment);
                    }
                    prop_assert_eq!(&fast, &plain);
                    prop_assert!(counters.drain(..).eq(moments.iter().map(|moment| moment.counter)));
                    prop_assert!(times.drain(..).map(f64::to_bits).eq(moments.iter().map(|moment| moment.seconds.to_bits())));
                    at += even;
                    if even == 0 {
                        [&mut fast, &mut plain].into_iter().for_each(|clock| _ = clock.sample(stamps(at)));
                        at += 1;
                    }
                }
            }
        }
    }

    /// Most samples take the fast path, whatever the device sends.
    #[test]
    #[allow(clippy::cast_possible_truncation)] // stamps as sent
    fn even_samples_are_passed_in_few_calls() {
        let counter: Vec<u16> = (0..30_000_u32).map(|i| (50_000 + i) as u16).collect();
        let fine: Vec<u32> = (0..30_000).map(|i| 1_000_000 + 100 * i).collect();
        let coarse: Vec<u32> = fine.iter().map(|fine| fine / 10_000).collect();
        let all = Stretch { samples: 30_000, counter: Some(&counter), fine: Some(&fine), coarse: Some(&coarse) };
        let rows = [
            all,
            Stretch { coarse: None, ..all },
            Stretch { counter: None, coarse: None, ..all },
            Stretch { fine: None, coarse: None, ..all },
            Stretch { counter: None, fine: None, coarse: None, ..all },
        ];
        for row in rows {
            let mut clock = Clock::default();
            clock.sample(Stamps { counter: Some(49_999), fine: Some(999_900), ..Stamps::default() });
            let (mut times, mut counters, mut calls) = (vec![], vec![], 0);
            while times.len() < 30_000 {
                let at = times.len();
                let rest = Stretch {
                    samples: 30_000 - at,
                    counter: row.counter.map(|counter| &counter[at..]),
                    fine: row.fine.map(|fine| &fine[at..]),
                    coarse: row.coarse.map(|coarse| &coarse[at..]),
                };
                clock.even(rest, &mut times, &mut counters);
                calls += 1;
            }
            assert!(calls < 90, "{calls}");
        }
    }
}
