//! Parts that other readers have read, joined to the part of a reader.

use std::sync::Arc;

use super::{Key, Part, Reader, Single};
use crate::column::{Column, Subject};
use crate::huge_pages;
use crate::mtdata::Outputs;
use crate::scan::Scanner;

impl Reader {
    /// Appends a part that another reader has read, which began at the seam where this one stands and has arrived where
    /// `scanner` stands. The result is as if this reader had read the part.
    pub(super) fn append(&mut self, mut part: Part, scanner: &Scanner, finished: bool) {
        debug_assert!(self.batch.is_empty() && self.scanner.seam().is_some());
        let progress = self.progress(scanner.at());
        let first = self.next_sample();
        let columns: Vec<usize> = part.columns.iter().map(|column| self.column_like(column)).collect();
        let numbers = self.adopt_layouts(&mut part, &columns);
        for (column, &place) in part.columns.iter().zip(&columns) {
            self.columns[place].append(column, first, progress);
        }

        let own = &mut self.part;
        huge_pages::reserve(&mut own.layout, part.len(), progress);
        own.layout.extend(part.layout.iter().map(|layout| numbers[usize::from(*layout)]));
        huge_pages::extend(&mut own.jumps, part.jumps.iter().map(|&(sample, offset)| (first + sample, offset)));
        huge_pages::extend(&mut own.singles, part.singles);
        huge_pages::extend(
            &mut own.changes,
            part.changes.iter().map(|&(sample, bid, change)| (first + sample, bid, change)),
        );
        huge_pages::extend(&mut own.messages.mid, part.messages.mid);
        huge_pages::extend(&mut own.messages.bid, part.messages.bid);
        huge_pages::extend(&mut own.messages.offset, part.messages.offset);
        huge_pages::extend(&mut own.messages.sample, part.messages.sample.iter().map(|sample| first + sample));
        own.messages.payload.append(&part.messages.payload);
        huge_pages::extend(&mut own.strings.place, part.strings.place);
        huge_pages::extend(&mut own.strings.offset, part.strings.offset);
        huge_pages::extend(&mut own.strings.sample, part.strings.sample.iter().map(|sample| first + sample));
        own.strings.bytes.append(&part.strings.bytes);
        huge_pages::reserve(&mut own.damage, part.damage.len(), progress);
        own.damage.extend(part.damage);
        own.stats.skipped_bytes += part.stats.skipped_bytes;
        own.stats.malformed += part.stats.malformed;
        own.stats.unfit += part.stats.unfit;
        own.sharing += part.sharing;

        self.scanner.go_on_from(scanner);
        self.finished = finished;
        self.end = u64::MAX;
    }

    /// Goes on with these settings of `MTData`.
    pub(super) fn go_on_with(&mut self, outputs: Outputs) {
        if outputs != self.outputs {
            self.outputs = outputs;
            self.mtdata.clear();
            self.layouts.stop_using_all();
        }
    }

    /// The place of the column for the same packets; a new one if there is none yet.
    fn column_like(&mut self, column: &Column) -> usize {
        let key = match column.subject {
            Subject::Known(quantity, coordinates) => Key::Known(quantity.id, coordinates),
            Subject::Unknown(id) => Key::Unknown(id),
        };
        *self.places.entry(key).or_insert_with(|| {
            self.columns.push(column.like());
            self.columns.len() - 1
        })
    }

    /// For each value of [`Part::layout`] the value that it has here. If these are too many layouts, the samples of `part`
    /// become those of the plain path.
    fn adopt_layouts(&mut self, part: &mut Part, columns: &[usize]) -> Vec<u8> {
        let mut numbers = vec![0];
        for layout in &part.layouts {
            let Some(number) = self.layouts.adopt(layout, columns) else {
                part.forget_layouts();
                return vec![0];
            };
            numbers.push(number + 1);
        }
        numbers
    }
}

impl Part {
    /// Makes all samples those of the plain path, which says for each where it is and which columns have its rows.
    fn forget_layouts(&mut self) {
        let samples: Vec<Vec<u64>> = (self.columns.iter())
            .map(|column| self.samples_of(column).into_iter().map(i64::cast_unsigned).collect())
            .collect();
        let frames = self.frames().zip(self.bids());
        #[allow(clippy::cast_possible_truncation)] // at most 65535 and a header
        let singles = frames.map(|((offset, length), bid)| Single { offset, length: length as u32, bid }).collect();
        self.singles = singles;
        for (column, samples) in self.columns.iter_mut().zip(samples) {
            Arc::make_mut(column).single = samples;
        }
        self.layout.fill(0);
        self.layouts.clear();
        self.jumps.clear();
    }
}
