//! CSV files: a header, one line for each row, empty fields for nulls.
//!
//! The text is that of pyarrow. Floats have the fewest digits that give the same number again, in decimal notation from
//! 1e-6 to 1e10. Names and text are in quotes. Points in time are in UTC.

use std::io::Write as _;

use arrow_array::cast::AsArray;
use arrow_array::types::{
    ArrowPrimitiveType, Date32Type, Float32Type, Float64Type, Int8Type, Int16Type, Int32Type, Int64Type,
    Time64MicrosecondType, TimestampNanosecondType, UInt8Type, UInt16Type, UInt32Type, UInt64Type,
};
use arrow_array::{Array, RecordBatch, StringArray};
use arrow_buffer::NullBuffer;
use arrow_schema::{ArrowError, DataType, Schema, TimeUnit};
use chrono::{DateTime, Datelike as _, NaiveDate, Timelike as _};

/// Bytes of a field, about.
const FIELD: usize = 12;

/// The names of the columns.
pub fn header(schema: &Schema) -> Vec<u8> {
    let mut line = vec![];
    for (place, field) in schema.fields().iter().enumerate() {
        if place > 0 {
            line.push(b',');
        }
        quoted(&mut line, field.name());
    }
    line.push(b'\n');
    line
}

/// The lines of batches.
pub fn lines(batches: &[RecordBatch]) -> Result<Vec<u8>, ArrowError> {
    let fields: usize = batches.iter().map(|batch| batch.num_rows() * batch.num_columns()).sum();
    let mut text = Vec::with_capacity(fields * FIELD);
    for batch in batches {
        let columns = batch.columns().iter().map(|array| Column::of(array.as_ref())).collect::<Result<Vec<_>, _>>()?;
        for row in 0..batch.num_rows() {
            for (place, column) in columns.iter().enumerate() {
                if place > 0 {
                    text.push(b',');
                }
                if column.nulls.is_none_or(|nulls| nulls.is_valid(row)) {
                    column.values.write(&mut text, row);
                }
            }
            text.push(b'\n');
        }
    }
    Ok(text)
}

/// One column of a batch.
struct Column<'a> {
    values: Values<'a>,
    nulls: Option<&'a NullBuffer>,
}

enum Values<'a> {
    U8(&'a [u8]),
    U16(&'a [u16]),
    U32(&'a [u32]),
    U64(&'a [u64]),
    I8(&'a [i8]),
    I16(&'a [i16]),
    I32(&'a [i32]),
    I64(&'a [i64]),
    F32(&'a [f32]),
    F64(&'a [f64]),
    /// Nanoseconds since 1970.
    Stamps(&'a [i64]),
    /// Microseconds since midnight.
    Times(&'a [i64]),
    /// Days since 1970.
    Dates(&'a [i32]),
    Text(&'a StringArray),
}

impl<'a> Column<'a> {
    fn of(array: &'a dyn Array) -> Result<Self, ArrowError> {
        fn slice<T: ArrowPrimitiveType>(array: &dyn Array) -> &[T::Native] {
            array.as_primitive::<T>().values()
        }
        let values = match array.data_type() {
            DataType::UInt8 => Values::U8(slice::<UInt8Type>(array)),
            DataType::UInt16 => Values::U16(slice::<UInt16Type>(array)),
            DataType::UInt32 => Values::U32(slice::<UInt32Type>(array)),
            DataType::UInt64 => Values::U64(slice::<UInt64Type>(array)),
            DataType::Int8 => Values::I8(slice::<Int8Type>(array)),
            DataType::Int16 => Values::I16(slice::<Int16Type>(array)),
            DataType::Int32 => Values::I32(slice::<Int32Type>(array)),
            DataType::Int64 => Values::I64(slice::<Int64Type>(array)),
            DataType::Float32 => Values::F32(slice::<Float32Type>(array)),
            DataType::Float64 => Values::F64(slice::<Float64Type>(array)),
            DataType::Timestamp(TimeUnit::Nanosecond, _) => Values::Stamps(slice::<TimestampNanosecondType>(array)),
            DataType::Time64(TimeUnit::Microsecond) => Values::Times(slice::<Time64MicrosecondType>(array)),
            DataType::Date32 => Values::Dates(slice::<Date32Type>(array)),
            DataType::Utf8 => Values::Text(array.as_string()),
            other => return Err(ArrowError::NotYetImplemented(format!("CSV of the type {other}"))),
        };
        Ok(Self { values, nulls: array.nulls() })
    }
}

impl Values<'_> {
    fn write(&self, text: &mut Vec<u8>, row: usize) {
        match self {
            Self::U8(values) => integer(text, values[row]),
            Self::U16(values) => integer(text, values[row]),
            Self::U32(values) => integer(text, values[row]),
            Self::U64(values) => integer(text, values[row]),
            Self::I8(values) => integer(text, values[row]),
            Self::I16(values) => integer(text, values[row]),
            Self::I32(values) => integer(text, values[row]),
            Self::I64(values) => integer(text, values[row]),
            Self::F32(values) => float(text, values[row], 1e-4..1e10),
            Self::F64(values) => float(text, values[row], 1e-4..1e10),
            Self::Stamps(values) => stamp(text, values[row]),
            Self::Times(values) => time(text, values[row]),
            Self::Dates(values) => date(text, NaiveDate::from_epoch_days(values[row]).unwrap_or(NaiveDate::MAX)),
            Self::Text(values) => quoted(text, values.value(row)),
        }
    }
}

fn integer(text: &mut Vec<u8>, value: impl itoa::Integer) {
    append(text, itoa::Buffer::new().format(value).as_bytes());
}

/// Appends a few bytes. A copy whose length is not known until then is a call, which takes as long as half of a number.
#[inline(always)]
fn append(text: &mut Vec<u8>, bytes: &[u8]) {
    match bytes.len() {
        1 => text.push(bytes[0]),
        2..4 => append_ends::<2>(text, bytes),
        4..8 => append_ends::<4>(text, bytes),
        8..16 => append_ends::<8>(text, bytes),
        16..=32 => append_ends::<16>(text, bytes),
        _ => text.extend_from_slice(bytes),
    }
}

/// Appends the first and the last `N` bytes, which overlap: there are at least `N`, and at most twice as many.
#[inline(always)]
fn append_ends<const N: usize>(text: &mut Vec<u8>, bytes: &[u8]) {
    if let (Some(first), Some(last)) = (bytes.first_chunk::<N>(), bytes.last_chunk::<N>()) {
        let end = text.len() + bytes.len();
        text.extend_from_slice(first);
        text.truncate(end - N);
        text.extend_from_slice(last);
    }
}

/// What `float` has to know of `f32` and `f64`.
trait Float: zmij::Float + Copy + PartialOrd {
    fn magnitude(self) -> Self;
}

impl Float for f32 {
    fn magnitude(self) -> Self {
        self.abs()
    }
}

impl Float for f64 {
    fn magnitude(self) -> Self {
        self.abs()
    }
}

/// `plain` are the magnitudes that zmij writes without an exponent, as wanted.
fn float<F: Float>(text: &mut Vec<u8>, value: F, plain: std::ops::Range<F>) {
    let mut buffer = zmij::Buffer::new();
    let shortest = buffer.format(value);
    if plain.contains(&value.magnitude()) {
        append(text, shortest.strip_suffix(".0").unwrap_or(shortest).as_bytes());
    } else {
        unusual(text, shortest);
    }
}

/// The text of a number that is very small, very large, zero or not finite, from a text with the same digits.
#[cold]
fn unusual(text: &mut Vec<u8>, shortest: &str) {
    let (sign, magnitude) = shortest.strip_prefix('-').map_or(("", shortest), |magnitude| ("-", magnitude));
    if !magnitude.starts_with(|first: char| first.is_ascii_digit()) {
        let sign = if magnitude == "NaN" { "" } else { sign };
        text.extend_from_slice(sign.as_bytes());
        text.extend_from_slice(magnitude.to_lowercase().as_bytes());
        return;
    }
    text.extend_from_slice(sign.as_bytes());
    let (mantissa, exponent) = magnitude.split_once('e').unwrap_or((magnitude, "0"));
    let (whole, fraction) = mantissa.split_once('.').unwrap_or((mantissa, ""));
    let all = format!("{whole}{fraction}");
    let digits = all.trim_start_matches('0');
    let digits = digits.trim_end_matches('0');
    if digits.is_empty() {
        text.push(b'0');
        return;
    }
    // The number is 0.DIGITS times ten to the power of `point`.
    let leading = all.len() - all.trim_start_matches('0').len();
    let count = |digits: usize| i32::try_from(digits).unwrap_or(i32::MAX);
    let point = count(whole.len()) - count(leading) + exponent.parse::<i32>().unwrap_or(0);
    let written = match point {
        -5..=0 => write!(text, "0.{}{digits}", "0".repeat(point.unsigned_abs() as usize)),
        1..=10 if count(digits.len()) <= point => {
            write!(text, "{digits:0<width$}", width = point.unsigned_abs() as usize)
        }
        1..=10 => {
            let (whole, fraction) = digits.split_at(point.unsigned_abs() as usize);
            write!(text, "{whole}.{fraction}")
        }
        _ => {
            let (first, rest) = digits.split_at(1);
            let dot = if rest.is_empty() { "" } else { "." };
            write!(text, "{first}{dot}{rest}e{:+}", point - 1)
        }
    };
    written.expect("a vector takes every byte");
}

fn stamp(text: &mut Vec<u8>, nanoseconds: i64) {
    let stamp = DateTime::from_timestamp_nanos(nanoseconds);
    date(text, stamp.date_naive());
    text.push(b' ');
    clock(text, stamp.num_seconds_from_midnight());
    padded(text, b'.', stamp.nanosecond(), 9);
    text.push(b'Z');
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // less than a day
fn time(text: &mut Vec<u8>, microseconds: i64) {
    let microseconds = microseconds.rem_euclid(86_400_000_000);
    clock(text, (microseconds / 1_000_000) as u32);
    padded(text, b'.', (microseconds % 1_000_000) as u32, 6);
}

fn date(text: &mut Vec<u8>, date: NaiveDate) {
    write!(text, "{:04}-{:02}-{:02}", date.year(), date.month(), date.day()).expect("a vector takes every byte");
}

/// A time of day in seconds.
fn clock(text: &mut Vec<u8>, seconds: u32) {
    for (before, number) in [(None, seconds / 3600), (Some(b':'), seconds / 60 % 60), (Some(b':'), seconds % 60)] {
        text.extend(before);
        let [tens, ones] = [number / 10, number % 10].map(|digit| b"0123456789"[digit as usize]);
        text.extend_from_slice(&[tens, ones]);
    }
}

/// A separator, and a number with leading zeros.
fn padded(text: &mut Vec<u8>, before: u8, number: u32, width: usize) {
    text.push(before);
    let mut buffer = itoa::Buffer::new();
    let digits = buffer.format(number);
    text.extend(std::iter::repeat_n(b'0', width.saturating_sub(digits.len())));
    text.extend_from_slice(digits.as_bytes());
}

fn quoted(text: &mut Vec<u8>, value: &str) {
    text.push(b'"');
    for byte in value.bytes() {
        if byte == b'"' {
            text.push(b'"');
        }
        text.push(byte);
    }
    text.push(b'"');
}
