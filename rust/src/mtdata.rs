//! An `MTData` payload: items without identifiers, one after another, in the layout that `OutputMode` and `OutputSettings`
//! decide.
//!
//! [`Output`] is the layout of one device, and [`Outputs`] what is in force in a stream; [`crate::table::MTDATA_ITEMS`]
//! declares the items.

mod outputs;

use std::fmt;

use crate::error::{EncodeError, OutputError};
use crate::frame::Frame;
use crate::packet::{Coordinates, Form, Packet, Precision, Reading, record_size};
use crate::table::{Kind, MTDATA, MTDATA_ITEMS, MtDataItem, Wire, output_mode, output_settings};
use crate::value::{Number, write_data};

pub use outputs::{MessageLayout, Outputs};

/// What a device sends as `MTData`: its `OutputMode` and `OutputSettings`.
///
/// ```
/// use xbus::mtdata::Output;
/// // The factory settings of an MTi: quaternion and packet counter.
/// let output = Output { mode: 0x0004, settings: 0x0000_0001 };
/// let names: Vec<_> = output.items().unwrap().iter().map(|item| item.reading.quantity.name).collect();
/// assert_eq!((names, output.size()), (vec!["quaternion", "packet_counter"], Ok(18)));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Output {
    /// `OutputMode`: which items there are.
    pub mode: u16,
    /// `OutputSettings`: in which form.
    pub settings: u32,
}

/// One item of a payload.
#[derive(Clone, Copy, Debug)]
pub struct Item {
    /// Data identifier of the same numbers in `MTData2`.
    pub id: u16,
    /// Where it begins in the payload.
    pub at: usize,
    /// Its bytes.
    pub size: usize,
    /// How to read it.
    pub reading: Reading,
}

impl Output {
    /// The items of a payload, in the order of the wire.
    ///
    /// # Errors
    /// [`OutputError`] if no source gives the layout.
    pub fn items(self) -> Result<Vec<Item>, OutputError> {
        self.check()?;
        let mut at = 0;
        let rows = MTDATA_ITEMS.iter().filter(|row| row.is_in(self.mode, self.settings));
        let item = |row| {
            let item = self.item(row, at);
            at += item.size;
            item
        };
        Ok(rows.map(item).collect())
    }

    /// Bytes of a payload.
    ///
    /// # Errors
    /// As [`Self::items`].
    pub fn size(self) -> Result<usize, OutputError> {
        Ok(self.items()?.last().map_or(0, |item| item.at + item.size))
    }

    /// The number format of real numbers.
    #[must_use]
    pub const fn precision(self) -> Precision {
        #[allow(clippy::cast_possible_truncation)] // the two low bits count
        Precision::of((self.settings >> output_settings::PRECISION_SHIFT) as u16)
    }

    /// The coordinate system of orientation and velocity.
    #[must_use]
    pub const fn coordinates(self) -> Coordinates {
        if self.settings & output_settings::NED == 0 { Coordinates::Nwu } else { Coordinates::Ned }
    }

    fn check(self) -> Result<(), OutputError> {
        use {output_mode as mode, output_settings as settings};
        let has = |bit| self.mode & bit != 0;
        let form = |mask| self.settings & mask;
        if has(mode::MT9) {
            Err(OutputError::Mt9(self))
        } else if has(mode::ORIENTATION) && form(settings::ORIENTATION) == settings::EULER | settings::MATRIX {
            Err(OutputError::Orientation(self))
        } else if has(mode::POSITION) && form(settings::POSITION) != 0 {
            Err(OutputError::Position(self))
        } else if has(mode::VELOCITY) && form(settings::VELOCITY) != 0 {
            Err(OutputError::Velocity(self))
        } else {
            Ok(())
        }
    }

    fn item(self, row: &MtDataItem, at: usize) -> Item {
        let quantity = row.quantity;
        let coordinates = quantity.rotates.then(|| self.coordinates());
        let mut id = quantity.id | coordinates.map_or(0, Coordinates::bits);
        let form = match (row.step, quantity.kind) {
            (Some(step), _) => Form::Steps(step),
            (None, Kind::Real(n)) => {
                id |= self.precision() as u16;
                Form::Real(self.precision(), n)
            }
            (None, Kind::Fixed(wire, n)) => Form::Fixed(wire, n),
            (None, Kind::Id) => Form::Fixed(Wire::U4, 1),
            (None, Kind::Struct(fields)) => Form::Struct(fields),
            (None, Kind::List(head, entry)) => Form::List(head, entry),
        };
        let size = match form {
            Form::Real(precision, n) => n * precision.size(),
            Form::Fixed(wire, n) => n * wire.size(),
            Form::Steps(_) => Wire::U2.size(),
            Form::Struct(fields) | Form::List(fields, _) => record_size(fields),
        };
        Item { id, at, size, reading: Reading { quantity, coordinates, form } }
    }
}

/// As users write it: `0006:00000001`.
impl fmt::Display for Output {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:04X}:{:08X}", self.mode, self.settings)
    }
}

impl Item {
    /// The item in a payload, as the packet that it would be in `MTData2`.
    ///
    /// # Panics
    /// If the payload is too short.
    #[must_use]
    pub fn packet<'a>(&self, payload: &'a [u8]) -> Packet<'a> {
        Packet { id: self.id, at: self.at, data: &payload[self.at..self.at + self.size] }
    }
}

/// The items of a sample from which clocks and counters are known, as an MTData2 payload.
#[must_use]
pub fn stamps(payload: &[u8], items: &[Item]) -> Vec<u8> {
    let mut stamps = vec![];
    for item in items.iter().filter(|item| item.reading.quantity.clock.is_some()) {
        let packet = item.packet(payload);
        stamps.extend(packet.id.to_be_bytes());
        #[allow(clippy::cast_possible_truncation)] // a counter or a time
        stamps.push(packet.data.len() as u8);
        stamps.extend(packet.data);
    }
    stamps
}

/// The frames of `count` messages, joined, and where each frame ends. `numbers` has for each item of [`Output::items`] the
/// numbers of all messages, those of the first message first.
///
/// Real numbers in fixed point are rounded half away from zero and saturated.
///
/// ```
/// use xbus::mtdata::{Output, write_samples};
/// use xbus::value::Number::Integer;
/// let counter = Output { mode: 0, settings: 1 };
/// let (frames, ends) = write_samples(0xFF, 2, counter, &[vec![Integer(1), Integer(2)]]).unwrap();
/// assert_eq!(frames, [0xFA, 0xFF, 0x32, 2, 0, 1, 0xCC, 0xFA, 0xFF, 0x32, 2, 0, 2, 0xCB]);
/// assert_eq!(ends, [7, 14]);
/// ```
///
/// # Errors
/// [`EncodeError`]: no source gives the layout, the wrong number of numbers, or a number that its type cannot hold.
pub fn write_samples(
    bid: u8,
    count: usize,
    output: Output,
    numbers: &[Vec<Number>],
) -> Result<(Vec<u8>, Vec<u64>), EncodeError> {
    let items = output.items().map_err(EncodeError::Output)?;
    if numbers.len() != items.len() {
        return Err(EncodeError::Items { output, expected: items.len(), found: numbers.len() });
    }
    let (mut frames, mut ends, mut payload) = (vec![], vec![], vec![]);
    for message in 0..count {
        payload.clear();
        for (item, numbers) in items.iter().zip(numbers) {
            let cut = |message| numbers.len() * message / count;
            let numbers = &numbers[cut(message)..cut(message + 1)];
            write_data(&mut payload, item.reading.quantity.name, item.reading.form, numbers)?;
        }
        frames.extend(Frame { bid, mid: MTDATA, payload: &payload }.encode()?);
        ends.push(frames.len() as u64);
    }
    Ok((frames, ends))
}
