//! Columns of CAN messages.

use std::sync::Arc;

use crate::column::{Column, Subject, Values};
use crate::huge_pages;
use crate::packet::{Coordinates, Precision, record_size};
use crate::table::{CAN_MESSAGES, CanContent, CanMessage, Kind, Quantity, Wire};

use super::DATA_SIZE;

/// The columns while they grow, in the order of their first rows.
#[derive(Default)]
pub struct Columns {
    columns: Vec<Column>,
    /// The column of each message, by its place in the table.
    places: [Option<usize>; CAN_MESSAGES.len()],
}

impl Columns {
    #[inline]
    pub fn add(&mut self, place: usize, sample: u64, data: [u8; DATA_SIZE]) {
        let (message, columns) = (&CAN_MESSAGES[place], &mut self.columns);
        let Some(quantity) = message.content.quantity() else { return };
        let place = *self.places[place].get_or_insert_with(|| {
            let is_same = |column: &Column| column.quantity().is_some_and(|own| own.id == quantity.id);
            columns.iter().position(is_same).unwrap_or_else(|| {
                columns.push(column_of(message, quantity));
                columns.len() - 1
            })
        });
        let column = &mut columns[place];
        if let CanContent::Component(_, element) = message.content {
            component(column, message, element, sample, data);
            return;
        }
        numbers(column, message, data);
        column.rows += 1;
        huge_pages::push(&mut column.single, sample);
    }

    pub fn into_columns(self) -> Vec<Arc<Column>> {
        self.columns.into_iter().map(Arc::new).collect()
    }
}

/// The coordinates of the values of a quantity, which the frames do not name: those of a device as delivered.
pub fn coordinates_of(quantity: &Quantity) -> Option<Coordinates> {
    quantity.rotates.then_some(Coordinates::Enu)
}

/// An empty column for a message.
fn column_of(message: &CanMessage, quantity: &'static Quantity) -> Column {
    let is_single = is_exact_in_single(message);
    let (values, width) = match message.content {
        CanContent::Integer(_) => (Values::of(message.signals[0].wire), 1),
        CanContent::Record(_) | CanContent::Utc(_) => {
            let Kind::Struct(fields) = quantity.kind else { unreachable!("a struct") };
            (Values::Records(vec![]), record_size(fields))
        }
        CanContent::Component(..) => (Values::F64(vec![]), quantity.components.len()),
        _ if is_single => (Values::F32(vec![]), quantity.components.len().max(1)),
        _ => (Values::F64(vec![]), quantity.components.len().max(1)),
    };
    // The identifier that the packets of a device would have: with the bits of the precision, and with those of ENU, zero.
    let precision = match (quantity.kind, &values) {
        (Kind::Real(_), Values::F64(_)) => Precision::Float64 as u16,
        _ => 0,
    };
    Column::empty(Subject::Known(quantity, coordinates_of(quantity)), quantity.id | precision, values, width)
}

/// Whether a single has every value: integers of 16 bits, scaled by a power of two.
fn is_exact_in_single(message: &CanMessage) -> bool {
    message.signals.iter().all(|signal| signal.wire.size() <= 2 && signal.per_unit.is_power_of_two())
}

/// Appends a row.
#[inline]
fn numbers(column: &mut Column, message: &CanMessage, data: [u8; DATA_SIZE]) {
    match (&mut column.values, message.content) {
        (Values::F32(out), CanContent::Scaled(_)) => {
            let exponent = i32::from(data[message.size() - 1]);
            let unit = 2.0_f32.powi(-exponent);
            huge_pages::extend(out, (0..3).map(|at| f32::from(i16_at(data, 2 * at)) * unit));
        }
        (Values::F32(out), _) => {
            #[allow(clippy::cast_precision_loss)] // powers of two
            let unit = 1.0 / message.signals[0].per_unit as f32;
            huge_pages::extend(out, (0..message.signals.len()).map(|at| f32::from(i16_at(data, 2 * at)) * unit));
        }
        (Values::F64(out), _) => {
            let mut at = 0;
            for signal in message.signals {
                let count = integer(signal.wire, &data[at..]);
                huge_pages::push(out, count / f64::from(signal.per_unit));
                at += signal.wire.size();
            }
        }
        (Values::U16(out), _) => huge_pages::push(out, u16::from_be_bytes([data[0], data[1]])),
        (Values::U32(out), _) => huge_pages::push(out, u32::from_be_bytes([data[0], data[1], data[2], data[3]])),
        (Values::Records(out), CanContent::Utc(_)) => {
            let [year, month, day, hour, minute, second, high, low] = data;
            // More than 9999 is no time; what does not fit into the field is not one either.
            let ns = u32::from(u16::from_be_bytes([high, low])).saturating_mul(100_000);
            let year = if year < 70 { 2000 } else { 1900 } + u16::from(year);
            let record = [&ns.to_ne_bytes()[..], &year.to_ne_bytes(), &[month, day, hour, minute, second]];
            record.iter().for_each(|bytes| out.extend_from_slice(bytes));
            // A device sends the time only while it has one.
            out.push(crate::utc::UTC_VALID);
        }
        (Values::Records(out), _) => {
            let mut at = 0;
            for signal in message.signals {
                let (size, old) = (signal.wire.size(), out.len());
                out.extend_from_slice(&data[at..at + size]);
                if cfg!(target_endian = "little") {
                    out[old..].reverse();
                }
                at += size;
            }
        }
        (values, content) => unreachable!("{content:?} into {values:?}"),
    }
}

/// Puts one component into the row of its sample; those that do not arrive are NaN.
fn component(column: &mut Column, message: &CanMessage, element: usize, sample: u64, data: [u8; DATA_SIZE]) {
    let Values::F64(out) = &mut column.values else { return };
    if column.single.last() != Some(&sample) {
        huge_pages::extend(out, std::iter::repeat_n(f64::NAN, column.width));
        huge_pages::push(&mut column.single, sample);
        column.rows += 1;
    }
    let row = out.len() - column.width;
    let signal = &message.signals[0];
    out[row + element] = integer(signal.wire, &data) / f64::from(signal.per_unit);
}

#[inline]
fn i16_at(data: [u8; DATA_SIZE], at: usize) -> i16 {
    i16::from_be_bytes([data[at], data[at + 1]])
}

/// The integer at the start of some data.
#[inline]
fn integer(wire: Wire, data: &[u8]) -> f64 {
    match wire {
        Wire::U1 => data[0].into(),
        Wire::I1 => data[0].cast_signed().into(),
        Wire::U2 => u16::from_be_bytes([data[0], data[1]]).into(),
        Wire::I2 => i16::from_be_bytes([data[0], data[1]]).into(),
        Wire::I4 => i32::from_be_bytes([data[0], data[1], data[2], data[3]]).into(),
        Wire::U4 => u32::from_be_bytes([data[0], data[1], data[2], data[3]]).into(),
        Wire::U8 | Wire::F4 => f64::NAN, // no signal has them
    }
}
