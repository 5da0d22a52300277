//! Times and packet counters of the samples of a part.
//!
//! [`Part::unwrap_plainly`] defines the result: sample by sample, what the columns say goes to the clock of the device.
//! [`Part::unwrap`] gives the same in a fraction of the time. It divides the samples into runs of one device with the same
//! stamps, which in most logs are very long, and gives each run to the clock as slices of columns: see `clock/even.rs` for
//! what the clock does with them and why that is exact. A sample of another kind, or one that the clock refuses, goes the
//! plain way. The two ways share the tracks and the clocks, so they can alternate from one sample to the next.
//!
//! Nothing here decides anything about time: a run that is cut short, or refused as a whole, gives the same result.

use std::iter::Peekable;
use std::slice;
use std::sync::Arc;

use super::track::Track;
use super::{Part, Single, Times};
use crate::clock::{Change, Clocks, Gap, Restart, Stamps, Stretch};
use crate::column::{Column, Subject};
use crate::frame::device_of;
use crate::huge_pages;
use crate::table::{ClockRole, QUANTITIES};

impl Part {
    /// Times and packet counters of the samples, gaps and restarts. `clocks` are those at the beginning of the part, and
    /// on return those at its end.
    #[must_use]
    pub fn unwrap(&self, clocks: &mut Clocks) -> Times {
        let mut unwrapper = Unwrapper::new(self, clocks);
        let kinds = unwrapper.kinds();
        let mut from = 0;
        while from < self.len() {
            let until = unwrapper.change(from).min(self.len());
            let kind = kinds[usize::from(self.layout[from])];
            let end = from + alike(&self.layout[from..until], &kinds);
            while from < end {
                let even = if kind == PLAIN { 0 } else { unwrapper.even(kind, end - from) };
                if even == 0 {
                    unwrapper.sample(from);
                }
                from += even.max(1);
            }
        }
        unwrapper.finish()
    }

    /// The same, sample by sample: the reference for tests and benches.
    #[must_use]
    pub fn unwrap_plainly(&self, clocks: &mut Clocks) -> Times {
        let mut unwrapper = Unwrapper::new(self, clocks);
        for at in 0..self.len() {
            unwrapper.change(at);
            unwrapper.sample(at);
        }
        unwrapper.finish()
    }

    /// The columns of the `N` quantities that have this role, by identifier.
    fn tracks<const N: usize>(&self, role: ClockRole) -> [Track<'_>; N] {
        let mut quantities = QUANTITIES.iter().filter(|quantity| quantity.clock == Some(role));
        let tracks = std::array::from_fn(|_| {
            let id = quantities.next().expect("a quantity for each track").id;
            let is = |column: &&Column| matches!(column.subject, Subject::Known(quantity, _) if quantity.id == id);
            Track::new(self, self.columns.iter().map(Arc::as_ref).find(is))
        });
        assert!(quantities.next().is_none(), "a track for each quantity");
        tracks
    }
}

/// The kind of layouts whose samples go the plain way, and of samples without a known layout.
const PLAIN: u8 = 0;
/// Layouts that are compared at once.
const BLOCK: usize = 64;

/// How many samples at the beginning are of one kind, by their layouts. Most often they have even the same layout.
fn alike(layouts: &[u8], kinds: &[u8; 256]) -> usize {
    let kind = |layout: u8| kinds[usize::from(layout)];
    let first = layouts[0];
    let is_alike = |block: &&[u8]| {
        let is_same = block.iter().fold(true, |all, layout| all & (*layout == first));
        is_same || block.iter().all(|layout| kind(*layout) == kind(first))
    };
    let blocks = BLOCK * layouts.chunks(BLOCK).take_while(is_alike).count();
    let rest = layouts.get(blocks..).unwrap_or_default();
    layouts.len().min(blocks) + rest.iter().take_while(|layout| kind(**layout) == kind(first)).count()
}

/// A position in a part, the clocks there, and the result so far.
struct Unwrapper<'a> {
    part: &'a Part,
    clocks: &'a mut Clocks,
    counter: Track<'a>,
    fine: Track<'a>,
    coarse: Track<'a>,
    triggers: [Track<'a>; 3],
    gnss: [Track<'a>; 2],
    singles: slice::Iter<'a, Single>,
    changes: Peekable<slice::Iter<'a, (u64, u8, Change)>>,
    times: Times,
}

impl<'a> Unwrapper<'a> {
    fn new(part: &'a Part, clocks: &'a mut Clocks) -> Self {
        let [counter] = part.tracks(ClockRole::Counter);
        let [fine] = part.tracks(ClockRole::Fine);
        let [coarse] = part.tracks(ClockRole::Coarse);
        let times = Times {
            time: huge_pages::with_capacity(part.len()),
            counter: huge_pages::with_capacity(part.len()),
            has_counter: counter.has_rows(),
            ..Times::default()
        };
        Self {
            part,
            clocks,
            counter,
            fine,
            coarse,
            triggers: part.tracks(ClockRole::Trigger),
            gnss: part.tracks(ClockRole::Receiver),
            singles: part.singles.iter(),
            changes: part.changes.iter().peekable(),
            times,
        }
    }

    /// For each layout, counted from 1, the first one of the same kind: of the same device, with the same stamps.
    fn kinds(&self) -> [u8; 256] {
        let is_plain = |layout: u8| {
            let mut late = self.triggers.iter().chain(&self.gnss);
            late.any(|track| track.is_fed(layout)) || self.coarse.is_fed(layout) && !self.fine.is_fed(layout)
        };
        let traits = |layout: u8| {
            let device = device_of(self.part.layouts[usize::from(layout) - 1].bid);
            (device, [&self.counter, &self.fine, &self.coarse].map(|track| track.is_fed(layout)))
        };
        let mut kinds = [PLAIN; 256];
        for layout in (1..=u8::MAX).take(self.part.layouts.len()).filter(|layout| !is_plain(*layout)) {
            let mut before = kinds[1..usize::from(layout)].iter().copied().filter(|kind| *kind != PLAIN);
            let kind = before.find(|kind| traits(*kind) == traits(layout)).unwrap_or(layout);
            kinds[usize::from(layout)] = kind;
        }
        kinds
    }

    /// Makes the changes that are due before a sample. Returns before which sample the next one is due.
    fn change(&mut self, at: usize) -> usize {
        let sample = self.part.first + at as u64;
        while let Some((_, bid, change)) = self.changes.next_if(|change| change.0 <= sample) {
            self.clocks.of(*bid).change(*change);
        }
        let next = self.changes.peek().map(|change| change.0 - self.part.first);
        next.and_then(|next| usize::try_from(next).ok()).unwrap_or(usize::MAX)
    }

    /// Unwraps the next samples, which are of one kind, as long as they are even. Returns their number.
    fn even(&mut self, kind: u8, samples: usize) -> usize {
        let clock = self.clocks.of(self.part.layouts[usize::from(kind) - 1].bid);
        let (counter, fine, coarse) = (self.counter.u16s(kind), self.fine.u32s(kind), self.coarse.u32s(kind));
        let stretch = Stretch { samples, counter, fine, coarse };
        let even = clock.even(stretch, &mut self.times.time, &mut self.times.counter);
        self.counter.skip(kind, even);
        self.fine.skip(kind, even);
        self.coarse.skip(kind, even);
        even
    }

    /// Unwraps the next sample, of any kind.
    fn sample(&mut self, at: usize) {
        let (layout, sample) = (self.part.layout[at], self.part.first + at as u64);
        let bid = match layout {
            0 => self.singles.next().map_or(0, |single| single.bid),
            _ => self.part.layouts[usize::from(layout) - 1].bid,
        };
        let stamps = Stamps {
            #[allow(clippy::cast_possible_truncation)] // a U2
            counter: self.counter.last(layout, sample).map(|counter| counter as u16),
            fine: self.fine.last(layout, sample),
            coarse: self.coarse.last(layout, sample),
            // Every track must advance, even if a later one decides.
            trigger: self.triggers.iter_mut().fold(None, |stamp, track| track.last(layout, sample).or(stamp)),
            gnss: self.gnss.iter_mut().map(|track| track.rows(layout, sample)).sum::<usize>() > 0,
        };
        let moment = self.clocks.of(bid).sample(stamps);
        let times = &mut self.times;
        times.time.push(moment.seconds);
        times.counter.push(moment.counter);
        if moment.lost > 0 {
            huge_pages::push(&mut times.gaps, Gap { sample, lost: moment.lost, bid });
        }
        if moment.restarted {
            huge_pages::push(&mut times.restarts, Restart { sample, bid });
        }
    }

    /// Makes the changes after the last sample.
    fn finish(self) -> Times {
        self.changes.for_each(|(_, bid, change)| self.clocks.of(*bid).change(*change));
        self.times
    }
}
