//! Columns: one quantity of a log, the same packet of many messages, byte-swapped once into rows of numbers.

use std::slice::ChunksExactMut;
use std::sync::Arc;

use crate::error::ShapeError;
use crate::huge_pages;
use crate::packet::{Coordinates, Form, Precision, Reading, record_size};
use crate::real;
use crate::table::{Field, Kind, Quantity, Wire};

/// The numbers of a column, row by row, in native byte order.
#[derive(Clone, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[allow(missing_docs)] // the variants are the types
pub enum Values {
    U8(Vec<u8>),
    U16(Vec<u16>),
    U32(Vec<u32>),
    U64(Vec<u64>),
    I8(Vec<i8>),
    I16(Vec<i16>),
    I32(Vec<i32>),
    F32(Vec<f32>),
    F64(Vec<f64>),
    /// Records, without padding between their fields.
    Records(Vec<u8>),
    /// Raw packets of an unknown identifier.
    Raw(Pieces),
}

/// Byte strings of any length, joined.
#[derive(Clone, Debug, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Pieces {
    /// All bytes.
    pub bytes: Vec<u8>,
    /// Where each piece ends.
    pub ends: Vec<u64>,
}

impl Pieces {
    /// Adds one piece.
    pub fn push(&mut self, piece: &[u8]) {
        huge_pages::extend(&mut self.bytes, piece.iter().copied());
        huge_pages::push(&mut self.ends, self.bytes.len() as u64);
    }

    /// Adds all pieces of another one.
    pub fn append(&mut self, other: &Self) {
        let before = self.bytes.len() as u64;
        huge_pages::extend(&mut self.bytes, other.bytes.iter().copied());
        huge_pages::extend(&mut self.ends, other.ends.iter().map(|end| before + end));
    }
}

impl Values {
    /// No numbers, of the same type.
    #[must_use]
    pub const fn like(&self) -> Self {
        match self {
            Self::U8(_) => Self::U8(vec![]),
            Self::U16(_) => Self::U16(vec![]),
            Self::U32(_) => Self::U32(vec![]),
            Self::U64(_) => Self::U64(vec![]),
            Self::I8(_) => Self::I8(vec![]),
            Self::I16(_) => Self::I16(vec![]),
            Self::I32(_) => Self::I32(vec![]),
            Self::F32(_) => Self::F32(vec![]),
            Self::F64(_) => Self::F64(vec![]),
            Self::Records(_) => Self::Records(vec![]),
            Self::Raw(_) => Self::Raw(Pieces { bytes: vec![], ends: vec![] }),
        }
    }

    /// Whether the numbers have the same type.
    fn is_like(&self, other: &Self) -> bool {
        std::mem::discriminant(self) == std::mem::discriminant(other)
    }

    /// Converts the numbers to the type of others if that is the wider one.
    fn widen_like(&mut self, other: &Self, progress: Progress) {
        match (&mut *self, other) {
            (Self::F32(narrow), Self::F64(_)) => *self = Self::F64(widened(narrow, progress)),
            (Self::U32(narrow), Self::U64(_)) => *self = Self::U64(widened(narrow, progress)),
            _ => {}
        }
    }

    /// Appends numbers. If the two types differ, the result has the wider one.
    ///
    /// # Panics
    /// If one type is not wider than the other.
    pub fn append(&mut self, other: &Self, progress: Progress) {
        self.widen_like(other, progress);
        match (self, other) {
            (Self::U8(out), Self::U8(more)) | (Self::Records(out), Self::Records(more)) => extend(out, more, progress),
            (Self::U16(out), Self::U16(more)) => extend(out, more, progress),
            (Self::U32(out), Self::U32(more)) => extend(out, more, progress),
            (Self::U64(out), Self::U64(more)) => extend(out, more, progress),
            (Self::U64(out), Self::U32(more)) => extend(out, &widened(more, progress), progress),
            (Self::I8(out), Self::I8(more)) => extend(out, more, progress),
            (Self::I16(out), Self::I16(more)) => extend(out, more, progress),
            (Self::I32(out), Self::I32(more)) => extend(out, more, progress),
            (Self::F32(out), Self::F32(more)) => extend(out, more, progress),
            (Self::F64(out), Self::F64(more)) => extend(out, more, progress),
            (Self::F64(out), Self::F32(more)) => extend(out, &widened(more, progress), progress),
            (Self::Raw(out), Self::Raw(more)) => out.append(more),
            (out, more) => unreachable!("{more:?} to {out:?}"),
        }
    }

    /// An empty column of the type that holds this number.
    #[must_use]
    pub const fn of(wire: Wire) -> Self {
        match wire {
            Wire::U1 => Self::U8(vec![]),
            Wire::U2 => Self::U16(vec![]),
            Wire::U4 => Self::U32(vec![]),
            Wire::U8 => Self::U64(vec![]),
            Wire::I1 => Self::I8(vec![]),
            Wire::I2 => Self::I16(vec![]),
            Wire::I4 => Self::I32(vec![]),
            Wire::F4 => Self::F32(vec![]),
        }
    }
}

/// What a column contains.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Subject {
    /// A quantity, in one coordinate system if it has any.
    Known(#[cfg_attr(feature = "serde", serde(with = "by_id"))] &'static Quantity, Option<Coordinates>),
    /// Packets that the tables do not explain, with their identifier as received.
    Unknown(u16),
}

impl PartialEq for Subject {
    fn eq(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Known(own, coordinates), Self::Known(other, others)) => own.id == other.id && coordinates == others,
            (Self::Unknown(own), Self::Unknown(other)) => own == other,
            _ => false,
        }
    }
}

/// A row of the table as its data identifier.
#[cfg(feature = "serde")]
mod by_id {
    use serde::de::{Deserialize, Deserializer, Error};
    use serde::ser::Serializer;

    use crate::table::{self, Quantity};

    #[allow(clippy::trivially_copy_pass_by_ref)] // serde's signature
    pub fn serialize<S: Serializer>(quantity: &&'static Quantity, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_u16(quantity.id)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<&'static Quantity, D::Error> {
        let id = u16::deserialize(deserializer)?;
        table::column_quantity(id)
            .ok_or_else(|| D::Error::custom(format_args!("no quantity has the identifier {id:#06X}")))
    }
}

/// How much of the input has been decoded. From it follows how much memory a column will need.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// Bytes read.
    pub done: u64,
    /// Bytes of the whole input; 0 if unknown.
    pub total: u64,
}

/// A column, complete or growing.
#[derive(Clone, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Column {
    /// What it contains.
    pub subject: Subject,
    /// Data identifier of the first packet, as received.
    pub id: u16,
    /// Whether packets with another identifier followed, that is, with other format bits.
    pub mixed_ids: bool,
    /// Whether packets in another precision followed.
    pub mixed_precisions: bool,
    /// The numbers.
    pub values: Values,
    /// Numbers of a row; bytes of a record.
    pub width: usize,
    /// The entries of a list quantity, those of all rows joined.
    pub entries: Vec<u8>,
    /// Number of rows.
    pub rows: usize,
    /// Samples of the rows that the plain path decoded; the others follow from the layouts of the samples.
    pub single: Vec<u64>,
    /// Whether rows are only counted, and have no values.
    pub counted: bool,
}

impl Column {
    /// An empty column for packets with this identifier and reading.
    #[must_use]
    pub fn new(id: u16, reading: Option<&Reading>) -> Self {
        let (subject, values, width) = match reading {
            None => (Subject::Unknown(id), Values::Raw(Pieces::default()), 0),
            Some(reading) => {
                let (values, width) = match reading.form {
                    Form::Real(Precision::Float32, n) => (Values::F32(vec![]), n),
                    Form::Real(_, n) => (Values::F64(vec![]), n),
                    Form::Fixed(wire, n) => (Values::of(wire), n),
                    Form::Steps(_) => (Values::U32(vec![]), 1),
                    Form::Struct(fields) | Form::List(fields, _) => (Values::Records(vec![]), record_size(fields)),
                };
                (Subject::Known(reading.quantity, reading.coordinates), values, width)
            }
        };
        Self::empty(subject, id, values, width)
    }

    /// A column of this type without rows. `values` must be empty.
    #[must_use]
    pub const fn empty(subject: Subject, id: u16, values: Values, width: usize) -> Self {
        Self {
            subject,
            id,
            mixed_ids: false,
            mixed_precisions: false,
            values,
            width,
            entries: vec![],
            rows: 0,
            single: vec![],
            counted: false,
        }
    }

    /// The quantity; `None` for an identifier that the tables do not explain.
    #[must_use]
    pub const fn quantity(&self) -> Option<&'static Quantity> {
        match self.subject {
            Subject::Known(quantity, _) => Some(quantity),
            Subject::Unknown(_) => None,
        }
    }

    /// Coordinate system of its vectors; `None` for quantities without one.
    #[must_use]
    pub const fn coordinates(&self) -> Option<Coordinates> {
        match self.subject {
            Subject::Known(_, coordinates) => coordinates,
            Subject::Unknown(_) => None,
        }
    }

    /// Data identifier as received; that of the quantity, without format bits, if packets had several.
    #[must_use]
    pub fn data_id(&self) -> u16 {
        match self.quantity() {
            Some(quantity) if self.mixed_ids => quantity.id,
            _ => self.id,
        }
    }

    /// Precision of real numbers; `None` for numbers of other types and if packets had several.
    #[must_use]
    pub fn precision(&self) -> Option<Precision> {
        let is_real = self.quantity().is_some_and(|quantity| matches!(quantity.kind, Kind::Real(_)));
        (is_real && !self.mixed_precisions).then(|| Precision::of(self.id))
    }

    /// Gives back memory that was reserved and not needed.
    pub fn trim(&mut self) {
        match &mut self.values {
            Values::U8(values) | Values::Records(values) => values.shrink_to_fit(),
            Values::U16(values) => values.shrink_to_fit(),
            Values::U32(values) => values.shrink_to_fit(),
            Values::U64(values) => values.shrink_to_fit(),
            Values::I8(values) => values.shrink_to_fit(),
            Values::I16(values) => values.shrink_to_fit(),
            Values::I32(values) => values.shrink_to_fit(),
            Values::F32(values) => values.shrink_to_fit(),
            Values::F64(values) => values.shrink_to_fit(),
            Values::Raw(pieces) => pieces.bytes.shrink_to_fit(),
        }
    }

    /// The column, to be shared. Its memory counts as that of a vector: a log can have thousands of columns.
    #[must_use]
    pub fn shared(self) -> Arc<Self> {
        huge_pages::leave_room_for(size_of::<Self>());
        Arc::new(self)
    }

    /// Prepares the column for packets with this identifier and reading. If their numbers do not fit its type, it is widened
    /// (from Float32 to Float64, from 4-byte to 8-byte device identifiers).
    pub fn admit(&mut self, id: u16, reading: Option<&Reading>, progress: Progress) {
        self.mixed_ids |= id != self.id;
        let Some(reading) = reading else { return };
        match (&self.values, reading.form) {
            (Values::F32(narrow), Form::Real(precision, _)) if precision != Precision::Float32 => {
                self.values = Values::F64(widened(narrow, progress));
            }
            (Values::U32(narrow), Form::Fixed(Wire::U8, _)) => {
                self.values = Values::U64(widened(narrow, progress));
            }
            _ => {}
        }
        if let Form::Real(precision, _) = reading.form {
            self.mixed_precisions |= precision != Precision::of(self.id);
        }
    }

    /// An empty column for the same packets.
    #[must_use]
    pub fn like(&self) -> Self {
        let (values, entries, single) = (self.values.like(), vec![], vec![]);
        Self { mixed_ids: false, mixed_precisions: false, values, entries, rows: 0, single, ..*self }
    }

    /// Prepares the column for the packets of another one: see [`Self::admit`].
    pub fn admit_column(&mut self, other: &Self, progress: Progress) {
        self.mixed_ids |= other.mixed_ids || other.id != self.id;
        let is_real = matches!(self.quantity().map(|quantity| quantity.kind), Some(Kind::Real(_)));
        let differ = is_real && Precision::of(other.id) != Precision::of(self.id);
        self.mixed_precisions |= other.mixed_precisions || differ;
        self.values.widen_like(&other.values, progress);
    }

    /// Gives the column the identifier, precision and type of one that [admitted](Self::admit_column) it.
    ///
    /// # Errors
    /// If the type of the other column is narrower.
    pub fn take_type_of(&mut self, other: &Self) -> Result<(), ShapeError> {
        (self.id, self.mixed_ids, self.mixed_precisions) = (other.id, other.mixed_ids, other.mixed_precisions);
        self.values.widen_like(&other.values, Progress { done: 0, total: 0 });
        if self.values.is_like(&other.values) { Ok(()) } else { Err(ShapeError) }
    }

    /// Whether the column has the identifier, precision and type of another one.
    #[must_use]
    pub fn has_type_of(&self, other: &Self) -> bool {
        let ids = |column: &Self| (column.id, column.mixed_ids, column.mixed_precisions);
        ids(self) == ids(other) && self.values.is_like(&other.values)
    }

    /// Appends the rows of another column for the same packets, whose samples are counted from sample `first` on.
    pub fn append(&mut self, other: &Self, first: u64, progress: Progress) {
        self.admit_column(other, progress);
        self.values.append(&other.values, progress);
        huge_pages::extend(&mut self.entries, other.entries.iter().copied());
        self.rows += other.rows;
        huge_pages::reserve(&mut self.single, other.single.len(), progress);
        self.single.extend(other.single.iter().map(|sample| first + sample));
    }

    /// Appends a row for each packet, byte-swapped. [`Self::admit`] must have prepared the column for them.
    ///
    /// # Panics
    /// If it has not, or if a packet lies outside `packets.bytes`.
    #[inline(always)]
    pub fn gather(&mut self, form: Option<Form>, packets: Packets<'_>, progress: Progress) {
        let more = packets.starts.len();
        if self.counted {
            self.rows += more;
            return;
        }
        match (&mut self.values, form) {
            (Values::F32(out), Some(Form::Real(Precision::Float32, n))) => {
                packets.numbers(out, n, progress, real::float32);
            }
            (Values::F64(out), Some(Form::Real(precision, n))) => match precision {
                Precision::Float32 => packets.numbers(out, n, progress, |bytes| f64::from(real::float32(bytes))),
                Precision::Fp1220 => packets.numbers(out, n, progress, real::fp1220),
                Precision::Fp1632 => packets.numbers(out, n, progress, real::fp1632),
                Precision::Float64 => packets.numbers(out, n, progress, real::float64),
            },
            (Values::F32(out), Some(Form::Fixed(Wire::F4, n))) => packets.numbers(out, n, progress, real::float32),
            (Values::U8(out), Some(Form::Fixed(_, n))) => packets.numbers(out, n, progress, u8::from_be_bytes),
            (Values::U16(out), Some(Form::Fixed(_, n))) => packets.numbers(out, n, progress, u16::from_be_bytes),
            (Values::U32(out), Some(Form::Fixed(_, n))) => packets.numbers(out, n, progress, u32::from_be_bytes),
            (Values::U32(out), Some(Form::Steps(step))) => {
                packets.numbers(out, 1, progress, |bytes| step * u32::from(u16::from_be_bytes(bytes)));
            }
            (Values::U64(out), Some(Form::Fixed(Wire::U4, n))) => {
                packets.numbers(out, n, progress, |bytes| u64::from(u32::from_be_bytes(bytes)));
            }
            (Values::U64(out), Some(Form::Fixed(_, n))) => packets.numbers(out, n, progress, u64::from_be_bytes),
            (Values::I8(out), Some(Form::Fixed(_, n))) => packets.numbers(out, n, progress, i8::from_be_bytes),
            (Values::I16(out), Some(Form::Fixed(_, n))) => packets.numbers(out, n, progress, i16::from_be_bytes),
            (Values::I32(out), Some(Form::Fixed(_, n))) => packets.numbers(out, n, progress, i32::from_be_bytes),
            (Values::Records(out), Some(Form::Struct(fields))) => packets.records(out, fields, progress),
            (Values::Records(out), Some(Form::List(head, entry))) => {
                packets.records(out, head, progress);
                let head = record_size(head);
                for packet in packets.iter() {
                    append_records(&mut self.entries, &packet[head..], entry);
                }
            }
            (Values::Raw(out), None) => packets.iter().for_each(|packet| out.push(packet)),
            (values, form) => unreachable!("{form:?} into {values:?}"),
        }
        self.rows += more;
    }
}

fn extend<T: Copy>(out: &mut Vec<T>, more: &[T], progress: Progress) {
    huge_pages::reserve(out, more.len(), progress);
    out.extend_from_slice(more);
}

fn widened<T: Copy, U: From<T>>(narrow: &[T], progress: Progress) -> Vec<U> {
    let mut wide = Vec::new();
    huge_pages::reserve(&mut wide, narrow.len(), progress);
    wide.extend(narrow.iter().copied().map(U::from));
    wide
}

/// Packets of one form.
#[derive(Clone, Copy, Debug)]
pub struct Packets<'a> {
    /// The bytes that they are in.
    pub bytes: &'a [u8],
    /// Where the data of each packet begin in `bytes`, minus `shift`. The byte before the data is their size.
    pub starts: &'a [usize],
    /// What to add to each start.
    pub shift: usize,
}

impl<'a> Packets<'a> {
    /// The data of each packet.
    fn iter(self) -> impl Iterator<Item = &'a [u8]> {
        self.starts.iter().map(move |start| {
            let at = start + self.shift;
            &self.bytes[at..][..self.bytes[at - 1].into()]
        })
    }

    /// Appends the `n` numbers of each packet. Rows of the lengths that occur at high rates have loops of their own.
    #[inline(always)]
    fn numbers<const SIZE: usize, T: Copy + Default>(
        self,
        out: &mut Vec<T>,
        n: usize,
        progress: Progress,
        read: impl Fn([u8; SIZE]) -> T + Copy,
    ) {
        huge_pages::reserve(out, n * self.starts.len(), progress);
        match n {
            1 => self.rows::<SIZE, 1, 1, T>(out, read),
            2 => self.rows::<SIZE, 2, 2, T>(out, read),
            3 => self.rows::<SIZE, 3, 4, T>(out, read),
            4 => self.rows::<SIZE, 4, 4, T>(out, read),
            9 => self.rows::<SIZE, 9, 9, T>(out, read),
            _ => {
                for start in self.starts {
                    let (numbers, _) = self.bytes[start + self.shift..][..SIZE * n].as_chunks();
                    out.extend(numbers.iter().map(|number| read(*number)));
                }
            }
        }
    }

    /// Appends rows of `N` numbers, reading `W` at a time: registers hold four numbers, not three.
    #[inline(always)]
    fn rows<const SIZE: usize, const N: usize, const W: usize, T: Copy + Default>(
        self,
        out: &mut Vec<T>,
        read: impl Fn([u8; SIZE]) -> T + Copy,
    ) {
        let old = out.len();
        out.resize(old + N * self.starts.len(), T::default());
        let (rows, _) = out[old..].as_chunks_mut::<N>();
        let rows = rows.iter_mut().zip(self.starts.iter().map(|start| start + self.shift));
        let exactly = |(row, at): (&mut [T; N], usize)| {
            let (numbers, _) = self.bytes[at..][..SIZE * N].as_chunks();
            *row = std::array::from_fn(|i| read(numbers[i]));
        };
        let Some(last) = self.bytes.len().checked_sub(SIZE * W) else { return rows.for_each(exactly) };
        for (row, at) in rows {
            if at <= last {
                let (numbers, _) = self.bytes[at..][..SIZE * W].as_chunks();
                let numbers: [T; W] = std::array::from_fn(|i| read(numbers[i]));
                row.copy_from_slice(&numbers[..N]);
            } else {
                exactly((row, at));
            }
        }
    }

    /// Appends the record of each packet, field by field for all packets; adjacent fields of one byte are copied together.
    #[inline(always)]
    fn records(self, out: &mut Vec<u8>, fields: &[Field], progress: Progress) {
        let (old, size) = (out.len(), record_size(fields));
        huge_pages::reserve(out, size * self.starts.len(), progress);
        out.resize(old + size * self.starts.len(), 0);
        let mut at = 0;
        let mut fields = fields;
        while let [field, rest @ ..] = fields {
            let rows = out[old..].chunks_exact_mut(size);
            let bytes = fields.iter().take_while(|field| field.wire.size() == 1).count();
            let taken = match (field.wire.size(), bytes) {
                (1, 8..) => self.piece::<8>(rows, at, |bytes| bytes),
                (1, 4..) => self.piece::<4>(rows, at, |bytes| bytes),
                (1, 2..) => self.piece::<2>(rows, at, |bytes| bytes),
                (1, _) => self.piece::<1>(rows, at, |bytes| bytes),
                (2, _) => self.piece::<2>(rows, at, swapped),
                (4, _) => self.piece::<4>(rows, at, swapped),
                (_, _) => self.piece::<8>(rows, at, swapped),
            };
            at += taken;
            fields = if bytes == 0 { rest } else { &fields[taken..] };
        }
    }

    #[inline(always)]
    fn piece<const SIZE: usize>(
        self,
        rows: ChunksExactMut<'_, u8>,
        at: usize,
        order: impl Fn([u8; SIZE]) -> [u8; SIZE],
    ) -> usize {
        for (row, start) in rows.zip(self.starts) {
            let (piece, _) = self.bytes[start + self.shift + at..].split_first_chunk().expect("packets lie inside");
            row[at..at + SIZE].copy_from_slice(&order(*piece));
        }
        SIZE
    }
}

/// A number in native byte order.
#[inline(always)]
fn swapped<const SIZE: usize>(mut big_endian: [u8; SIZE]) -> [u8; SIZE] {
    if cfg!(target_endian = "little") {
        big_endian.reverse();
    }
    big_endian
}

/// Appends records, with each field converted from big-endian to native byte order.
fn append_records(out: &mut Vec<u8>, bytes: &[u8], fields: &[Field]) {
    let old = out.len();
    out.extend_from_slice(bytes);
    if cfg!(target_endian = "big") {
        return;
    }
    let mut rest = &mut out[old..];
    while !rest.is_empty() {
        for field in fields {
            let (number, following) = rest.split_at_mut(field.wire.size());
            number.reverse();
            rest = following;
        }
    }
}
