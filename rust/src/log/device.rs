//! One device of a log with several.

use super::{Messages, Part, Single, Stats, TimedPart, Times};
use crate::clock::{Gap, Restart};
use crate::column::{Column, Pieces, Values};
use crate::frame::{EXTENDED_FROM, HEADER_SIZE, device_of};
use crate::packet::record_size;
use crate::table::{self, Kind};

impl TimedPart {
    /// The samples and messages of one device, as if they had been alone; offsets are those in the whole input. Damage is
    /// that of the whole input, because it could be frames of any device. Strings are left out: they name no device.
    /// `first` is the index of the first sample.
    #[must_use]
    pub fn of_device(&self, bid: u8, first: u64) -> Self {
        let (part, times) = (&self.part, self.times());
        let is_own: Vec<bool> = part.bids().into_iter().map(|other| device_of(other) == device_of(bid)).collect();
        // For each sample the number of samples of the device before it.
        let mut before = vec![0; is_own.len() + 1];
        for (at, own) in is_own.iter().enumerate() {
            before[at + 1] = before[at] + u64::from(*own);
        }
        let index = |sample: u64| first + before[usize::try_from(sample - part.first).unwrap_or(usize::MAX)];
        let own = |sample: u64| is_own[usize::try_from(sample - part.first).unwrap_or(usize::MAX)];
        let frames = part.frames().zip(part.bids()).zip(&is_own).filter(|(_, own)| **own);
        #[allow(clippy::cast_possible_truncation)] // at most 65535 and a header
        let singles: Vec<_> =
            frames.map(|(((offset, length), bid), _)| Single { offset, length: length as u32, bid }).collect();
        let messages = messages_of(&part.messages, bid, index);
        let sent = messages.payload.ends.iter().scan(0, |from, &end| Some(end - std::mem::replace(from, end)));
        // The extended length has two more bytes.
        let sizes = sent.map(|size| (HEADER_SIZE + 1) as u64 + size + if size < EXTENDED_FROM as u64 { 0 } else { 2 });
        let count = |mid| messages.mid.iter().map(|own| u64::from(*own == mid)).sum();
        let frame_bytes = singles.iter().map(|single| u64::from(single.length)).sum::<u64>() + sizes.sum::<u64>();
        let stats = Stats {
            bytes: frame_bytes + part.stats.skipped_bytes,
            frames: (singles.len() + messages.mid.len()) as u64,
            samples: singles.len() as u64,
            messages: messages.mid.len() as u64,
            malformed: count(table::MTDATA2),
            unfit: count(table::MTDATA),
            skipped_bytes: part.stats.skipped_bytes,
            checksum_errors: part.stats.checksum_errors,
            ..Stats::default()
        };
        let columns = part.columns.iter().map(|column| column_of(part, column, own, index));
        let device = Part {
            first,
            columns: columns.filter(|column| column.rows > 0).map(Column::shared).collect(),
            layout: vec![0; singles.len()],
            singles,
            messages,
            damage: part.damage.clone(),
            stats,
            ..Part::default()
        };
        let filtered = |values: &[f64]| values.iter().zip(&is_own).filter(|(_, own)| **own).map(|(v, _)| *v).collect();
        let counter: Vec<_> = times.counter.iter().zip(&is_own).filter(|(_, own)| **own).map(|(n, _)| *n).collect();
        let gaps = times.gaps.iter().filter(|gap| own(gap.sample));
        let restarts = times.restarts.iter().filter(|restart| own(restart.sample));
        let times = Times {
            time: filtered(&times.time),
            has_counter: counter.iter().any(|counter| *counter != -1),
            counter,
            gaps: gaps.map(|gap| Gap { sample: index(gap.sample), ..*gap }).collect(),
            restarts: restarts.map(|restart| Restart { sample: index(restart.sample), ..*restart }).collect(),
        };
        Self::of(device, times)
    }
}

#[allow(clippy::cast_possible_truncation)] // offsets in memory
fn messages_of(all: &Messages, bid: u8, index: impl Fn(u64) -> u64) -> Messages {
    let mut own = Messages::default();
    let mut from = 0;
    for (at, &end) in all.payload.ends.iter().enumerate() {
        let payload = &all.payload.bytes[from as usize..end as usize];
        from = end;
        if device_of(all.bid[at]) == device_of(bid) {
            own.mid.push(all.mid[at]);
            own.bid.push(all.bid[at]);
            own.offset.push(all.offset[at]);
            own.sample.push(index(all.sample[at]));
            own.payload.push(payload);
        }
    }
    own
}

#[allow(clippy::cast_sign_loss)] // samples of a part
fn column_of(part: &Part, column: &Column, own: impl Fn(u64) -> bool, index: impl Fn(u64) -> u64) -> Column {
    let samples = part.samples_of(column);
    let rows: Vec<usize> = (0..column.rows).filter(|row| own(samples[*row] as u64)).collect();
    Column {
        values: if column.counted { column.values.like() } else { values_of(&column.values, column.width, &rows) },
        entries: if column.counted { vec![] } else { entries_of(column, &rows) },
        rows: rows.len(),
        single: rows.iter().map(|row| index(samples[*row] as u64)).collect(),
        ..Column { values: Values::U8(vec![]), entries: vec![], single: vec![], ..*column }
    }
}

#[allow(clippy::cast_possible_truncation)] // offsets in memory
fn values_of(values: &Values, width: usize, rows: &[usize]) -> Values {
    fn chosen<T: Copy>(values: &[T], width: usize, rows: &[usize]) -> Vec<T> {
        rows.iter().flat_map(|row| &values[row * width..(row + 1) * width]).copied().collect()
    }
    match values {
        Values::U8(values) => Values::U8(chosen(values, width, rows)),
        Values::U16(values) => Values::U16(chosen(values, width, rows)),
        Values::U32(values) => Values::U32(chosen(values, width, rows)),
        Values::U64(values) => Values::U64(chosen(values, width, rows)),
        Values::I8(values) => Values::I8(chosen(values, width, rows)),
        Values::I16(values) => Values::I16(chosen(values, width, rows)),
        Values::I32(values) => Values::I32(chosen(values, width, rows)),
        Values::F32(values) => Values::F32(chosen(values, width, rows)),
        Values::F64(values) => Values::F64(chosen(values, width, rows)),
        Values::Records(bytes) => Values::Records(chosen(bytes, width, rows)),
        Values::Raw(all) => {
            let mut own = Pieces::default();
            for &row in rows {
                let from = if row == 0 { 0 } else { all.ends[row - 1] };
                own.push(&all.bytes[from as usize..all.ends[row] as usize]);
            }
            Values::Raw(own)
        }
    }
}

/// The entries of these rows of a list column.
fn entries_of(column: &Column, rows: &[usize]) -> Vec<u8> {
    let kind = column.quantity().map(|quantity| quantity.kind);
    let (Some(Kind::List(head, entry)), Values::Records(heads)) = (kind, &column.values) else { return vec![] };
    let mut ends = vec![0];
    for record in heads.chunks_exact(record_size(head)) {
        let count = usize::from(record[head[0].wire.size()]);
        ends.push(ends[ends.len() - 1] + count * record_size(entry));
    }
    rows.iter().flat_map(|&row| &column.entries[ends[row]..ends[row + 1]]).copied().collect()
}
