//! Packets one at a time: bytes to numbers, and names and numbers to bytes.
//!
//! `xbus dump` prints with it, virtual devices encode with it, and tests compare columns with it.

use crate::error::EncodeError;
use crate::frame::Frame;
use crate::packet::{Coordinates, Form, Packet, Precision, Reading};
use crate::real;
use crate::table::{self, Field, Kind, Quantity, Wire};

/// One number of a packet.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "python", derive(pyo3::IntoPyObject))]
pub enum Number {
    /// An integer of at most 32 bits.
    Integer(i64),
    /// An integer of 8 bytes.
    Wide(u64),
    /// A Float32, bit by bit.
    Single(f32),
    /// Any other real number.
    Double(f64),
}

/// The numbers of a packet, in the order of the wire; of a list packet, those of its head, then those of its entries.
///
/// ```
/// use xbus::{packet::Packet, value::{Number, numbers}};
/// let packet = Packet { id: 0x1020, at: 0, data: &[0xDF, 0xC5] };
/// assert_eq!(numbers(&packet.reading().unwrap(), packet.data), [Number::Integer(57285)]);
/// ```
#[must_use]
pub fn numbers(reading: &Reading, data: &[u8]) -> Vec<Number> {
    match reading.form {
        Form::Real(precision, _) => {
            data.chunks_exact(precision.size()).map(|bytes| read_real(precision, bytes)).collect()
        }
        Form::Fixed(wire, _) => data.chunks_exact(wire.size()).map(|bytes| read_fixed(wire, bytes)).collect(),
        Form::Steps(step) => vec![Number::Integer(i64::from(step) * i64::from(u16::from_be_bytes(head(data))))],
        Form::Struct(fields) => read_records(data, fields).collect(),
        Form::List(head, entry) => {
            let (first, rest) = data.split_at(crate::packet::record_size(head));
            read_records(first, head).chain(read_records(rest, entry)).collect()
        }
    }
}

fn read_records<'a>(mut data: &'a [u8], fields: &'a [Field]) -> impl Iterator<Item = Number> + 'a {
    let fields = fields.iter().cycle();
    fields.map_while(move |field| {
        let (number, rest) = data.split_at_checked(field.wire.size())?;
        data = rest;
        Some(read_fixed(field.wire, number))
    })
}

/// # Panics
/// If there are too few bytes. A packet that has a reading has them.
fn head<const N: usize>(bytes: &[u8]) -> [u8; N] {
    *bytes.first_chunk().expect("a packet that has a reading has its size")
}

fn read_real(precision: Precision, bytes: &[u8]) -> Number {
    match precision {
        Precision::Float32 => Number::Single(real::float32(head(bytes))),
        Precision::Fp1220 => Number::Double(real::fp1220(head(bytes))),
        Precision::Fp1632 => Number::Double(real::fp1632(head(bytes))),
        Precision::Float64 => Number::Double(real::float64(head(bytes))),
    }
}

fn read_fixed(wire: Wire, bytes: &[u8]) -> Number {
    match wire {
        Wire::U1 => Number::Integer(bytes[0].into()),
        Wire::U2 => Number::Integer(u16::from_be_bytes(head(bytes)).into()),
        Wire::U4 => Number::Integer(u32::from_be_bytes(head(bytes)).into()),
        Wire::U8 => Number::Wide(u64::from_be_bytes(head(bytes))),
        Wire::I1 => Number::Integer(i8::from_be_bytes(head(bytes)).into()),
        Wire::I2 => Number::Integer(i16::from_be_bytes(head(bytes)).into()),
        Wire::I4 => Number::Integer(i32::from_be_bytes(head(bytes)).into()),
        Wire::F4 => Number::Single(real::float32(head(bytes))),
    }
}

/// Appends a packet to an MTData2 payload.
///
/// Real numbers are written in `precision` (`None` for Float32); in fixed point they are rounded half away from zero and
/// saturated. A device identifier has 8 bytes, as on the 600-series, if it is a [`Number::Wide`], otherwise 4.
///
/// ```
/// use xbus::{packet::Precision, table, value::{Number, write_packet}};
/// let temperature = table::quantity_named("temperature").unwrap();
/// let mut payload = vec![];
/// write_packet(&mut payload, temperature, Some(Precision::Fp1632), None, &[Number::Double(24.375)]).unwrap();
/// assert_eq!(payload, [0x08, 0x12, 6, 0x60, 0, 0, 0, 0, 0x18]);
/// ```
///
/// # Errors
/// Any [`EncodeError`] but [`EncodeError::PayloadTooLong`]; `payload` is then unchanged.
pub fn write_packet(
    payload: &mut Vec<u8>,
    quantity: &Quantity,
    precision: Option<Precision>,
    coordinates: Option<Coordinates>,
    numbers: &[Number],
) -> Result<(), EncodeError> {
    let start = payload.len();
    let written = write(payload, quantity, precision, coordinates, numbers);
    if written.is_err() {
        payload.truncate(start);
    }
    written
}

fn write(
    payload: &mut Vec<u8>,
    quantity: &Quantity,
    precision: Option<Precision>,
    coordinates: Option<Coordinates>,
    numbers: &[Number],
) -> Result<(), EncodeError> {
    let name = quantity.name;
    let mut id = quantity.id;
    if table::quantity(id).is_none() {
        return Err(EncodeError::NoPacket { name });
    }
    match (quantity.rotates, coordinates) {
        (true, system) => id |= system.unwrap_or(Coordinates::Enu).bits(),
        (false, Some(_)) => return Err(EncodeError::Coordinates { name }),
        (false, None) => {}
    }
    let form = match (quantity.kind, precision) {
        (Kind::Real(n), precision) => {
            let precision = precision.unwrap_or(Precision::Float32);
            id |= precision as u16;
            Form::Real(precision, n)
        }
        (_, Some(_)) => return Err(EncodeError::Precision { name }),
        (Kind::Fixed(wire, n), None) => Form::Fixed(wire, n),
        (Kind::Id, None) => Form::Fixed(if matches!(numbers, [Number::Wide(_)]) { Wire::U8 } else { Wire::U4 }, 1),
        (Kind::Struct(fields), None) => Form::Struct(fields),
        (Kind::List(head, entry), None) => Form::List(head, entry),
    };
    let mut data = Vec::new();
    write_data(&mut data, name, form, numbers)?;
    let length = data.len();
    let size = u8::try_from(length).map_err(|_| EncodeError::PacketTooLong { name, length })?;
    payload.extend(id.to_be_bytes());
    payload.push(size);
    payload.extend(data);
    Ok(())
}

/// Appends the numbers of a quantity in this form.
///
/// # Errors
/// Those of [`write_packet`]; `data` may then have some of the numbers.
pub(crate) fn write_data(
    data: &mut Vec<u8>,
    name: &'static str,
    form: Form,
    numbers: &[Number],
) -> Result<(), EncodeError> {
    let expect = |expected: usize| {
        let found = numbers.len();
        if found == expected { Ok(()) } else { Err(EncodeError::Count { name, expected, found }) }
    };
    match form {
        Form::Real(precision, n) => {
            expect(n)?;
            numbers.iter().try_for_each(|number| write_real(data, name, precision, *number))
        }
        Form::Fixed(wire, n) => {
            expect(n)?;
            numbers.iter().try_for_each(|number| write_fixed(data, name, wire, *number))
        }
        Form::Steps(step) => {
            expect(1)?;
            let steps = (real_of(numbers[0]) / f64::from(step)).round();
            write_fixed(data, name, Wire::U2, Number::Double(steps))
        }
        Form::Struct(fields) => {
            expect(fields.len())?;
            write_fields(data, numbers, fields.iter())
        }
        Form::List(head, entry) => {
            let from = data.len();
            write_fields(data, numbers, head.iter().chain(entry.iter().cycle()))?;
            let count = data.get(from + head[0].wire.size()).copied().map_or(0, usize::from);
            expect(head.len() + count * entry.len())
        }
    }
}

fn write_fields<'a>(
    data: &mut Vec<u8>,
    numbers: &[Number],
    fields: impl Iterator<Item = &'a Field>,
) -> Result<(), EncodeError> {
    numbers.iter().zip(fields).try_for_each(|(number, field)| write_fixed(data, field.name, field.wire, *number))
}

#[allow(clippy::cast_precision_loss)] // to the precision of a double
fn real_of(number: Number) -> f64 {
    match number {
        Number::Integer(value) => value as f64,
        Number::Wide(value) => value as f64,
        Number::Single(value) => f64::from(value),
        Number::Double(value) => value,
    }
}

#[allow(clippy::cast_possible_truncation)] // to the requested precision
fn write_real(data: &mut Vec<u8>, name: &'static str, precision: Precision, number: Number) -> Result<(), EncodeError> {
    let value = real_of(number);
    let refused = EncodeError::NotANumber { name, precision: precision.name() };
    match (precision, number) {
        (Precision::Float32, Number::Single(value)) => data.extend(value.to_bits().to_be_bytes()),
        (Precision::Float32, _) => data.extend((value as f32).to_be_bytes()),
        (Precision::Fp1220, _) => data.extend(real::to_fp1220(value).ok_or(refused)?),
        (Precision::Fp1632, _) => data.extend(real::to_fp1632(value).ok_or(refused)?),
        (Precision::Float64, _) => data.extend(value.to_bits().to_be_bytes()),
    }
    Ok(())
}

#[allow(clippy::cast_possible_truncation)] // checked before
fn write_fixed(data: &mut Vec<u8>, name: &'static str, wire: Wire, number: Number) -> Result<(), EncodeError> {
    let refuse = |value: String, wire: &'static str| Err(EncodeError::Range { name, value, wire });
    let value = match number {
        Number::Single(value) if wire == Wire::F4 => {
            data.extend(value.to_bits().to_be_bytes());
            return Ok(());
        }
        Number::Double(value) if wire == Wire::F4 => {
            data.extend((value as f32).to_be_bytes());
            return Ok(());
        }
        Number::Integer(value) => i128::from(value),
        Number::Wide(value) => i128::from(value),
        Number::Single(value) if value.fract() == 0.0 => value as i128,
        Number::Double(value) if value.fract() == 0.0 => value as i128,
        Number::Single(value) => return refuse(value.to_string(), "the integers"),
        Number::Double(value) => return refuse(value.to_string(), "the integers"),
    };
    let (least, most, range) = match wire {
        Wire::U1 => (0, u8::MAX.into(), "U1 (0 to 255)"),
        Wire::U2 => (0, u16::MAX.into(), "U2 (0 to 65535)"),
        Wire::U4 => (0, u32::MAX.into(), "U4 (0 to 4294967295)"),
        Wire::U8 => (0, u64::MAX.into(), "U8 (0 to 18446744073709551615)"),
        Wire::I1 => (i8::MIN.into(), i8::MAX.into(), "I1 (-128 to 127)"),
        Wire::I2 => (i16::MIN.into(), i16::MAX.into(), "I2 (-32768 to 32767)"),
        Wire::I4 => (i32::MIN.into(), i32::MAX.into(), "I4 (-2147483648 to 2147483647)"),
        Wire::F4 => (-(1 << 24), 1 << 24, "the integers that a F4 holds"),
    };
    if !(least..=most).contains(&value) {
        return refuse(value.to_string(), range);
    }
    if wire == Wire::F4 {
        #[allow(clippy::cast_precision_loss)] // within 24 bits
        data.extend((value as f32).to_be_bytes());
    } else {
        let bytes = value.to_be_bytes();
        data.extend(&bytes[bytes.len() - wire.size()..]);
    }
    Ok(())
}

/// Appends a packet with this reading and these numbers.
///
/// # Errors
/// Those of [`write_packet`].
pub fn write_as(payload: &mut Vec<u8>, reading: &Reading, numbers: &[Number]) -> Result<(), EncodeError> {
    write_packet(payload, reading.quantity, reading.precision(), reading.coordinates, numbers)
}

/// The frames of `count` MTData2 messages with the same packets, joined, and where each frame ends.
///
/// A packet is a data identifier with format bits, as in an output configuration, and the numbers of all messages, those of
/// the first message first. [`write_packet`] has the rules.
///
/// ```
/// use xbus::value::{Number, write_samples};
/// let counters = (0x1020, vec![Number::Integer(1), Number::Integer(2)]);
/// let (frames, ends) = write_samples(0xFF, 2, &[counters]).unwrap();
/// assert_eq!(frames[..10], [0xFA, 0xFF, 0x36, 5, 0x10, 0x20, 2, 0, 1, 0x93]);
/// assert_eq!(ends, [10, 20]);
/// ```
///
/// # Errors
/// Any [`EncodeError`].
pub fn write_samples(
    bid: u8,
    count: usize,
    packets: &[(u16, Vec<Number>)],
) -> Result<(Vec<u8>, Vec<u64>), EncodeError> {
    let packets = packets.iter().map(|(id, numbers)| format(*id).map(|format| (format, numbers)));
    let packets = packets.collect::<Result<Vec<_>, _>>()?;
    let (mut frames, mut ends, mut payload) = (vec![], vec![], vec![]);
    for message in 0..count {
        payload.clear();
        for &((quantity, precision, coordinates), numbers) in &packets {
            let cut = |message| numbers.len() * message / count;
            let numbers = &numbers[cut(message)..cut(message + 1)];
            write_packet(&mut payload, quantity, precision, coordinates, numbers)?;
        }
        frames.extend(Frame { bid, mid: table::MTDATA2, payload: &payload }.encode()?);
        ends.push(frames.len() as u64);
    }
    Ok((frames, ends))
}

/// The arguments of [`write_packet`] for an identifier with format bits.
fn format(id: u16) -> Result<(&'static Quantity, Option<Precision>, Option<Coordinates>), EncodeError> {
    let unknown = EncodeError::Identifier { id };
    let Some(quantity) = table::quantity(id) else { return Err(unknown) };
    let precision = matches!(quantity.kind, Kind::Real(_)).then(|| Precision::of(id));
    let coordinates = if quantity.rotates { Some(Coordinates::of(id).ok_or(unknown)?) } else { None };
    Ok((quantity, precision, coordinates))
}

/// Whether the encoder would write this identifier: without format bits that have no meaning.
#[must_use]
pub fn is_canonical(packet: &Packet<'_>) -> bool {
    let Some(reading) = packet.reading() else { return false };
    let real = matches!(reading.form, Form::Real(..));
    let precision = if real { packet.id & 3 } else { 0 };
    packet.id == reading.quantity.id | precision | reading.coordinates.map_or(0, Coordinates::bits)
}
