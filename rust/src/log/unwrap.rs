//! Times and packet counters of the samples of a part.

use std::sync::Arc;

use super::track::Track;
use super::{Part, Times};
use crate::clock::{Clocks, Gap, Restart, Stamps};
use crate::column::{Column, Subject};
use crate::huge_pages;
use crate::table::{ClockRole, QUANTITIES};

impl Part {
    /// Times and packet counters of the samples, gaps and restarts. `clocks` are those at the beginning of the part, and
    /// on return those at its end.
    #[must_use]
    pub fn unwrap(&self, clocks: &mut Clocks) -> Times {
        let [mut counter] = self.tracks(ClockRole::Counter);
        let [mut fine] = self.tracks(ClockRole::Fine);
        let [mut coarse] = self.tracks(ClockRole::Coarse);
        let mut triggers = self.tracks::<3>(ClockRole::Trigger);
        let mut gnss = self.tracks::<2>(ClockRole::Receiver);
        let mut changes = self.changes.iter().peekable();
        let (mut gaps, mut restarts) = (vec![], vec![]);
        let (mut times, mut counters) = (huge_pages::with_capacity(self.len()), huge_pages::with_capacity(self.len()));
        for ((&layout, bid), sample) in self.layout.iter().zip(self.bids()).zip(self.first..) {
            while let Some((_, bid, change)) = changes.next_if(|change| change.0 <= sample) {
                clocks.of(*bid).change(*change);
            }
            let stamps = Stamps {
                #[allow(clippy::cast_possible_truncation)] // a U2
                counter: counter.last(layout, sample).map(|counter| counter as u16),
                fine: fine.last(layout, sample),
                coarse: coarse.last(layout, sample),
                // Every track must advance, even if a later one decides.
                trigger: triggers.iter_mut().fold(None, |stamp, track| track.last(layout, sample).or(stamp)),
                gnss: gnss.iter_mut().map(|track| track.rows(layout, sample)).sum::<usize>() > 0,
            };
            let moment = clocks.of(bid).sample(stamps);
            times.push(moment.seconds);
            counters.push(moment.counter);
            if moment.lost > 0 {
                gaps.push(Gap { sample, lost: moment.lost, bid });
            }
            if moment.restarted {
                restarts.push(Restart { sample, bid });
            }
        }
        changes.for_each(|(_, bid, change)| clocks.of(*bid).change(*change));
        let has_counter = counters.iter().any(|counter| *counter != -1);
        Times { time: times, counter: counters, gaps, restarts, has_counter }
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
