//! The shape of a log: its columns without their values.
//!
//! A part of a log has the columns of its own samples: a quantity that starts later is missing, and one that becomes
//! Float64 later is still Float32. Tables of the parts would differ. So a first pass, in which a reader only counts rows
//! ([`Options::values`](super::Options::values)), finds the shape of the whole log, and each part gets it: all columns of
//! the log, in its order, with its types.

use std::sync::Arc;

use super::{Part, TimedPart, Times, Wanted, is_wanted};
use crate::column::{Column, Progress, Subject};
use crate::error::ShapeError;
use crate::frame::device_of;

/// The columns of a log without their values, and the devices that sent its samples.
#[derive(Clone, Debug, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Shape {
    columns: Vec<ColumnShape>,
    /// The bus identifier of the first sample of each device.
    bids: Vec<u8>,
    samples: u64,
}

#[derive(Clone, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct ColumnShape {
    /// The column with its number of rows, but without values.
    column: Column,
    /// Whether each sample of the parts in which it occurs has one row.
    is_dense: bool,
}

/// What a part knows of the log that it belongs to.
#[derive(Clone, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Whole {
    /// For each column of the part whether each sample of the log has one row.
    pub is_dense: Vec<bool>,
    /// The bus identifier of the first sample of each device of the log.
    pub bids: Vec<u8>,
}

const NOTHING: Progress = Progress { done: 0, total: 0 };

impl Shape {
    /// Adds the part that follows those that were added before.
    pub fn add(&mut self, part: &Part) {
        for column in part.columns.iter().filter(|column| column.quantity().is_some()) {
            let is_dense = part.is_dense(column);
            let place = self.place(column).unwrap_or_else(|| {
                self.columns.push(ColumnShape { column: column.like(), is_dense });
                self.columns.len() - 1
            });
            let shape = &mut self.columns[place];
            shape.column.admit_column(column, NOTHING);
            shape.column.rows += column.rows;
            shape.is_dense &= is_dense;
        }
        let is_new = |bid: &u8| self.bids.iter().all(|known| device_of(*known) != device_of(*bid));
        if part.sent_bids().any(|bid| is_new(&bid)) {
            for bid in part.bids() {
                if self.bids.iter().all(|known| device_of(*known) != device_of(bid)) {
                    self.bids.push(bid);
                }
            }
        }
        self.samples += part.len() as u64;
    }

    /// The same shape with these quantities only, and those that clocks and counters need.
    #[must_use]
    pub fn of_wanted(&self, wanted: &Wanted) -> Self {
        let columns = self.columns.iter().filter(|shape| match shape.column.subject {
            Subject::Known(quantity, coordinates) => is_wanted(wanted, quantity, coordinates),
            Subject::Unknown(_) => false,
        });
        Self { columns: columns.cloned().collect(), bids: self.bids.clone(), samples: self.samples }
    }

    /// The shape of one device of the log, whose samples alone have the shape `device`: the types are those of the log, as
    /// for [`TimedPart::of_device`].
    #[must_use]
    pub fn of_device(&self, device: &Self) -> Self {
        let columns = self.columns.iter().filter_map(|shape| {
            let own = &device.columns[device.place(&shape.column)?];
            let column = Column { rows: own.column.rows, ..shape.column.clone() };
            Some(ColumnShape { column, is_dense: own.is_dense })
        });
        Self { columns: columns.collect(), bids: device.bids.clone(), samples: device.samples }
    }

    /// Number of samples of the log.
    #[must_use]
    pub const fn samples(&self) -> u64 {
        self.samples
    }

    fn place(&self, column: &Column) -> Option<usize> {
        self.columns.iter().position(|shape| shape.column.subject == column.subject)
    }
}

impl TimedPart {
    /// A part without samples, of a log of this shape.
    #[must_use]
    pub fn empty(shape: &Shape) -> Self {
        let columns = shape.columns.iter().map(|shape| Arc::new(shape.column.like()));
        let mut part = Part { columns: columns.collect(), ..Part::default() };
        let shaped = part.take_shape(shape);
        debug_assert!(shaped.is_ok());
        Self::of(part, Times::default())
    }

    /// The part with the columns of its log: those that it lacks have no rows, and all have the types that they have in the
    /// whole log. Columns of unknown identifiers follow.
    ///
    /// # Errors
    /// [`ShapeError`] if the part has a column that the log does not have.
    pub fn shaped(mut self, shape: &Shape) -> Result<Self, ShapeError> {
        self.part.take_shape(shape)?;
        Ok(self)
    }
}

impl Part {
    fn take_shape(&mut self, shape: &Shape) -> Result<(), ShapeError> {
        let mut own: Vec<_> = std::mem::take(&mut self.columns).into_iter().map(Some).collect();
        let mut places = vec![0; own.len()];
        for ColumnShape { column: shaped, .. } in &shape.columns {
            let is_same =
                |column: &Option<Arc<Column>>| column.as_ref().is_some_and(|own| own.subject == shaped.subject);
            let column = if let Some(place) = own.iter().position(is_same) {
                places[place] = self.columns.len();
                own[place].take()
            } else {
                None
            };
            let mut column = column.unwrap_or_else(|| shaped.like().into());
            if !column.has_type_of(shaped) {
                Arc::make_mut(&mut column).take_type_of(shaped)?;
            }
            self.columns.push(column);
        }
        for (place, column) in places.iter_mut().zip(own) {
            let Some(column) = column else { continue };
            if column.quantity().is_some() {
                return Err(ShapeError);
            }
            *place = self.columns.len();
            self.columns.push(column);
        }
        for slot in self.layouts.iter_mut().flat_map(|layout| &mut layout.slots) {
            slot.column = places[slot.column];
        }
        let is_dense = |shaped: &ColumnShape| shaped.is_dense && shaped.column.rows as u64 == shape.samples;
        self.whole = Some(Whole { is_dense: shape.columns.iter().map(is_dense).collect(), bids: shape.bids.clone() });
        Ok(())
    }
}
