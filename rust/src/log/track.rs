//! The rows of a column, sample by sample.

use std::sync::Arc;

use super::Part;
use crate::clock::TRIGGER_STAMP;
use crate::column::{Column, Values};
use crate::layout::Slot;

/// Follows the rows of one column through the samples of its part.
pub(super) struct Track<'a> {
    column: Option<&'a Column>,
    /// Whether a layout feeds the column, by layout plus one.
    fed: [bool; 256],
    single: &'a [u64],
    row: usize,
}

impl<'a> Track<'a> {
    pub fn new(part: &Part, column: Option<&'a Column>) -> Self {
        let mut fed = [false; 256];
        if let Some(column) = column {
            let feeds = |slot: &Slot| std::ptr::eq(Arc::as_ptr(&part.columns[slot.column]), column);
            for (fed, layout) in fed[1..].iter_mut().zip(&part.layouts) {
                *fed = layout.slots.iter().any(feeds);
            }
        }
        Self { column, fed, single: column.map_or(&[], |column| &column.single), row: 0 }
    }

    /// Whether the column exists.
    pub const fn has_rows(&self) -> bool {
        self.column.is_some()
    }

    /// Whether samples of a layout, counted from 1, have a row.
    pub const fn is_fed(&self, layout: u8) -> bool {
        self.fed[layout as usize]
    }

    /// The numbers from the next sample on, if samples of this layout have one.
    pub fn u16s(&self, layout: u8) -> Option<&'a [u16]> {
        match &self.column?.values {
            Values::U16(values) if self.is_fed(layout) => Some(&values[self.row..]),
            _ => None,
        }
    }

    /// The same for a column of longer numbers.
    pub fn u32s(&self, layout: u8) -> Option<&'a [u32]> {
        match &self.column?.values {
            Values::U32(values) if self.is_fed(layout) => Some(&values[self.row..]),
            _ => None,
        }
    }

    /// Passes samples of one layout.
    pub fn skip(&mut self, layout: u8, samples: usize) {
        self.row += if self.is_fed(layout) { samples } else { 0 };
    }

    /// Number of rows of the next sample.
    #[inline]
    pub fn rows(&mut self, layout: u8, sample: u64) -> usize {
        if self.column.is_none() {
            return 0; // most logs have no trigger, no GNSS data and no coarse time
        }
        let rows = if layout == 0 {
            let rows = self.single.iter().take_while(|single| **single == sample).count();
            self.single = &self.single[rows..];
            rows
        } else {
            usize::from(self.fed[usize::from(layout)])
        };
        self.row += rows;
        rows
    }

    /// The last row of the next sample: its number, or the time stamp of a trigger.
    pub fn last(&mut self, layout: u8, sample: u64) -> Option<u32> {
        if self.rows(layout, sample) == 0 {
            return None;
        }
        let column = self.column?;
        match &column.values {
            Values::U16(values) => Some(values[self.row - 1].into()),
            Values::U32(values) => Some(values[self.row - 1]),
            Values::Records(bytes) => {
                let record = &bytes[(self.row - 1) * column.width..];
                record[TRIGGER_STAMP..].first_chunk().map(|bytes| u32::from_ne_bytes(*bytes))
            }
            _ => None,
        }
    }
}
