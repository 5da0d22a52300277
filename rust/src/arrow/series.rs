//! The columns of a table: where their values come from, and how they become arrays.

use std::ops::Range;
use std::sync::{Arc, OnceLock};

use arrow_array::types::{
    ArrowPrimitiveType, Float32Type, Float64Type, Int8Type, Int16Type, Int32Type, Int64Type, UInt8Type, UInt16Type,
    UInt32Type, UInt64Type,
};
use arrow_array::{Array, ArrayRef, PrimitiveArray};
use arrow_buffer::{Buffer, ScalarBuffer};
use arrow_schema::Field;

use super::copies::width_of;
use super::fields;
use super::sink::{Number, Sink};
use crate::column::{Column, Values};
use crate::huge_pages;
use crate::log::TimedPart;
use crate::packet::record_size;
use crate::table::{self, Kind, Wire, data_id};
use crate::utc;

const UTC_TIME: u16 = data_id("utc_time");
const ROTATION_MATRIX: u16 = data_id("rotation_matrix");

/// One column of a table.
#[derive(Clone, Debug)]
pub struct Series {
    pub field: Field,
    source: Source,
    places: Places,
}

/// Where the values are.
#[derive(Clone, Debug)]
enum Source {
    /// The index of the sample of each row, counted from `first`; as an array once one is asked for.
    Samples { first: u64, count: usize, indices: OnceLock<PrimitiveArray<Int64Type>> },
    /// A time of each sample; and whether every sample has one, once that is known.
    Times { times: Times, is_complete: OnceLock<bool> },
    /// Element `element` of each row of a column of numbers.
    Numbers { column: Arc<Column>, element: usize },
    /// The number at byte `at` of each record.
    Records { column: Arc<Column>, is_entry: bool, at: usize, wire: Wire },
    /// The same in the unit of the field.
    Scaled { column: Arc<Column>, is_entry: bool, at: usize, field: &'static table::Field },
    /// Nanoseconds since 1970, [`i64::MIN`] for null.
    Utc(Arc<Vec<i64>>),
    /// The bus identifier of each row.
    Bids(PrimitiveArray<UInt8Type>),
}

/// The times of the samples, NaN for a sample without one.
#[derive(Clone, Debug)]
enum Times {
    /// Seconds on the device clock.
    Device(Arc<TimedPart>),
    /// Seconds since 1970 on the host's clock.
    Host(Arc<Vec<f64>>),
}

/// Which row of the source goes into which row of the table.
#[derive(Clone, Debug)]
enum Places {
    /// Each row into the row of the same number.
    Same,
    /// Row `i` into row `places[i]`; the other rows of the table are null. The places ascend. If one occurs twice, the
    /// last row with it counts.
    Into(Arc<Vec<usize>>),
    /// Row `i` of the table from row `rows[i]`.
    From(Arc<Vec<usize>>),
}

/// What the columns of a table have in common.
pub struct Shared<'a> {
    pub part: &'a Arc<TimedPart>,
    pub host_times: Option<&'a Arc<Vec<f64>>>,
    /// Whether fields of records are integers as on the wire, not in their units.
    pub is_raw: bool,
}

impl Shared<'_> {
    /// One row for each sample.
    pub fn wide(&self, columns: &[usize]) -> Vec<Series> {
        let part = &self.part.part;
        let chosen: Vec<_> = columns.iter().map(|&column| &part.columns[column]).collect();
        let others: Vec<_> = chosen.iter().map(AsRef::as_ref).collect();
        let mut series = self.stamps(0..part.len(), &Places::Same);
        if let Some(stamps) = utc::nanoseconds_of_samples(part, &chosen) {
            series.push(Series { field: fields::utc(), source: Source::Utc(Arc::new(stamps)), places: Places::Same });
        }
        for (&column, &index) in chosen.iter().zip(columns) {
            let is_dense = part.is_dense(column);
            let places = if is_dense { Places::Same } else { Places::Into(Arc::new(samples_of(self.part, column))) };
            series.extend(self.of_column(column, &places, !part.is_dense_in_log(index), &others));
        }
        series
    }

    /// One row for each row of a column.
    pub fn rows(&self, column: usize) -> Vec<Series> {
        let column = &self.part.part.columns[column];
        let samples = samples_of(self.part, column);
        let mut series = self.stamps(samples.iter().copied(), &Places::From(Arc::new(samples.clone())));
        series.extend(self.of_column(column, &Places::Same, false, &[column]));
        series
    }

    /// One row for each entry of a list column: the number of rows, and the series.
    pub fn entries(&self, column: usize) -> (usize, Vec<Series>) {
        let column = &self.part.part.columns[column];
        let kind = column.quantity().map(|quantity| quantity.kind);
        let (Some(Kind::List(head, entry)), Values::Records(heads)) = (kind, &column.values) else {
            return (0, vec![]);
        };
        let count = |record: &[u8]| usize::from(record[head[0].wire.size()]);
        let counts = heads.chunks_exact(record_size(head)).map(count);
        let rows: Vec<usize> = counts.enumerate().flat_map(|(row, count)| std::iter::repeat_n(row, count)).collect();
        let samples_of_rows = samples_of(self.part, column);
        let samples: Vec<usize> = rows.iter().map(|&row| samples_of_rows[row]).collect();
        let mut series = self.stamps(samples.iter().copied(), &Places::From(Arc::new(samples.clone())));
        let rows = Arc::new(rows);
        for (record, is_entry, places) in [(head, false, Places::From(rows.clone())), (entry, true, Places::Same)] {
            let name = |field: &table::Field| field.name.to_owned();
            series.extend(self.of_records(column, record, is_entry, &places, false, name));
        }
        (rows.len(), series)
    }

    /// The index of the sample of each row, its time, its host time if it is known, and its bus identifier if the part
    /// has samples of several devices. `samples` count from the beginning of the part.
    fn stamps(&self, samples: impl ExactSizeIterator<Item = usize>, places: &Places) -> Vec<Series> {
        let series = |field: Field, source: Source| Series { field, source, places: places.clone() };
        let times = |name: &str, times: Times| {
            series(fields::seconds(name), Source::Times { times, is_complete: OnceLock::new() })
        };
        let (first, count) = (self.part.part.first, samples.len());
        let mut list = vec![
            series(fields::sample(), Source::Samples { first, count, indices: OnceLock::new() }),
            times("time", Times::Device(self.part.clone())),
        ];
        list.extend(self.host_times.map(|host_times| times("host_time", Times::Host(host_times.clone()))));
        if let Some(bids) = self.part.part.bids_of_several() {
            let bids = samples.map(|sample| bids[sample]).collect::<Vec<_>>();
            let source = Source::Bids(PrimitiveArray::new(bids.into(), None));
            list.push(Series { field: fields::bid(), source, places: Places::Same });
        }
        list
    }

    /// The fields of the records of a column, or of its entries.
    fn of_records(
        &self,
        column: &Arc<Column>,
        record: &'static [table::Field],
        is_entry: bool,
        places: &Places,
        is_nullable: bool,
        name: impl Fn(&table::Field) -> String,
    ) -> Vec<Series> {
        let mut at = 0;
        let mut list = vec![];
        for field in record {
            let column = column.clone();
            let name = name(field);
            #[allow(clippy::float_cmp)] // a constant of the table
            let (field_of_table, source) = if self.is_raw || field.scale == 1.0 {
                let field_of_table = fields::record_field(name, &column, field, is_nullable);
                (field_of_table, Source::Records { column, is_entry, at, wire: field.wire })
            } else {
                let field_of_table = fields::scaled_field(name, &column, field, is_nullable);
                (field_of_table, Source::Scaled { column, is_entry, at, field })
            };
            list.push(Series { field: field_of_table, source, places: places.clone() });
            at += field.wire.size();
        }
        list
    }

    /// The series of one column of the log, in a table that has the columns `others`.
    fn of_column(&self, column: &Arc<Column>, places: &Places, is_nullable: bool, others: &[&Column]) -> Vec<Series> {
        let (Some(quantity), Some(stem)) = (column.quantity(), fields::stem(column, others)) else { return vec![] };
        let series = |field: Field, source: Source| Series { field, source, places: places.clone() };
        match quantity.kind {
            _ if quantity.id == UTC_TIME => {
                let stamps = utc::valid_nanoseconds_of_column(column).unwrap_or_default();
                vec![series(fields::utc_of(&stem, column), Source::Utc(Arc::new(stamps)))]
            }
            Kind::Struct(record) | Kind::List(record, _) => {
                self.of_records(column, record, false, places, is_nullable, |field| format!("{stem}_{}", field.name))
            }
            _ => {
                let number = |name: String, element: usize| {
                    let source = Source::Numbers { column: column.clone(), element };
                    series(fields::number(name, column, is_nullable), source)
                };
                if quantity.components.is_empty() {
                    return vec![number(stem, 0)];
                }
                let mut order: Vec<usize> = (0..quantity.components.len()).collect();
                if quantity.id == ROTATION_MATRIX {
                    // Column by column on the wire, row by row in the table: m11, m12, m13, m21, ...
                    order.sort_by_key(|&element| quantity.components[element]);
                }
                let name = |element: usize| format!("{stem}_{}", quantity.components[element]);
                order.into_iter().map(|element| number(name(element), element)).collect()
            }
        }
    }
}

/// The sample of each row of a column, counted from the beginning of the part.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // samples of a part
fn samples_of(part: &TimedPart, column: &Column) -> Vec<usize> {
    part.part.samples_of(column).into_iter().map(|sample| (sample as u64 - part.part.first) as usize).collect()
}

impl Times {
    fn seconds(&self) -> &[f64] {
        match self {
            Self::Device(part) => &part.times().time,
            Self::Host(times) => times,
        }
    }

    fn lent(&self) -> ArrayRef {
        match self {
            Self::Device(part) => lend::<Float64Type, _>(part, self.seconds()),
            Self::Host(times) => lend::<Float64Type, _>(times, self.seconds()),
        }
    }
}

impl Series {
    /// Whether the values need no copy to become an Arrow array.
    pub fn is_lent(&self) -> bool {
        let is_same = matches!(self.places, Places::Same);
        match &self.source {
            Source::Samples { .. } | Source::Bids(_) => true,
            Source::Times { times, is_complete } => {
                is_same && *is_complete.get_or_init(|| !times.seconds().iter().any(|time| time.is_nan()))
            }
            Source::Numbers { column, .. } => is_same && column.width == 1,
            Source::Records { .. } | Source::Scaled { .. } | Source::Utc(_) => false,
        }
    }

    /// Bytes that a row takes among the copies of a batch. A column with few values is not among them: the kernel gives it
    /// zeros, and no memory where nothing is written.
    pub fn copied_width(&self) -> usize {
        let is_copied = !self.is_lent() && !matches!(self.places, Places::Into(_));
        if is_copied { width_of(self.field.data_type()) } else { 0 }
    }

    /// Hands these rows of the table over to a sink. [`Copies`](super::copies::Copies) have room for what `copied_width`
    /// states.
    pub fn feed<S: Sink>(&self, rows: Range<usize>, sink: S) -> S::Taken {
        match &self.source {
            Source::Samples { first, count, indices } => {
                let sample = |row: usize| {
                    let sample = if let Places::From(samples) = &self.places { samples[row] } else { row };
                    (first + sample as u64).cast_signed()
                };
                let all = || PrimitiveArray::new(huge_pages::collect((0..*count).map(sample)).into(), None);
                let array = || Arc::new(indices.get_or_init(all).slice(rows.start, rows.len())) as ArrayRef;
                sink.lent(rows.clone().map(sample), array)
            }
            Source::Bids(bids) => {
                let array = || Arc::new(bids.slice(rows.start, rows.len())) as ArrayRef;
                sink.lent(bids.values()[rows.clone()].iter().copied(), array)
            }
            Source::Times { times, .. } => {
                let seconds = times.seconds();
                if self.is_lent() {
                    let array = || times.lent().slice(rows.start, rows.len());
                    return sink.lent(seconds[rows.clone()].iter().copied(), array);
                }
                self.gather(rows, sink, |row| seconds[row], Some(|time| !f64::is_nan(time)))
            }
            Source::Numbers { column, element } => match &column.values {
                Values::U8(values) => self.numbers::<UInt8Type, _>(column, values, *element, rows, sink),
                Values::U16(values) => self.numbers::<UInt16Type, _>(column, values, *element, rows, sink),
                Values::U32(values) => self.numbers::<UInt32Type, _>(column, values, *element, rows, sink),
                Values::U64(values) => self.numbers::<UInt64Type, _>(column, values, *element, rows, sink),
                Values::I8(values) => self.numbers::<Int8Type, _>(column, values, *element, rows, sink),
                Values::I16(values) => self.numbers::<Int16Type, _>(column, values, *element, rows, sink),
                Values::I32(values) => self.numbers::<Int32Type, _>(column, values, *element, rows, sink),
                Values::F32(values) => self.numbers::<Float32Type, _>(column, values, *element, rows, sink),
                Values::F64(values) => self.numbers::<Float64Type, _>(column, values, *element, rows, sink),
                Values::Records(_) | Values::Raw(_) => unreachable!("records are another source"),
            },
            Source::Records { column, is_entry, at, wire } => {
                let field = RecordField::of(column, *is_entry, *at);
                match wire {
                    Wire::U1 => self.field(field, u8::from_ne_bytes, rows, sink),
                    Wire::I1 => self.field(field, i8::from_ne_bytes, rows, sink),
                    Wire::U2 => self.field(field, u16::from_ne_bytes, rows, sink),
                    Wire::I2 => self.field(field, i16::from_ne_bytes, rows, sink),
                    Wire::U4 => self.field(field, u32::from_ne_bytes, rows, sink),
                    Wire::I4 => self.field(field, i32::from_ne_bytes, rows, sink),
                    Wire::U8 => self.field(field, u64::from_ne_bytes, rows, sink),
                    Wire::F4 => self.field(field, f32::from_ne_bytes, rows, sink),
                }
            }
            Source::Scaled { column, is_entry, at, field } => {
                let records = RecordField::of(column, *is_entry, *at);
                let exists = field.missing.map(|_| |value| !f64::is_nan(value));
                self.gather(rows, sink, |row| scaled(field, records.bytes(row)), exists)
            }
            Source::Utc(stamps) => self.gather(rows, sink, |row| stamps[row], Some(|stamp| stamp != i64::MIN)),
        }
    }

    fn numbers<T: ArrowPrimitiveType<Native: Number>, S: Sink>(
        &self,
        column: &Arc<Column>,
        values: &[T::Native],
        element: usize,
        rows: Range<usize>,
        sink: S,
    ) -> S::Taken {
        if self.is_lent() {
            let array = || lend::<T, _>(column, values).slice(rows.start, rows.len());
            return sink.lent(values[rows.clone()].iter().copied(), array);
        }
        let width = column.width;
        let exists = None::<fn(T::Native) -> bool>;
        if !matches!(self.places, Places::Same) {
            return self.gather(rows, sink, |row| values[row * width + element], exists);
        }
        // The loops for the usual widths take half the time of the one for any.
        let values = &values[rows.start * width..rows.end * width];
        match width {
            3 => sink.dense(values.as_chunks::<3>().0.iter().map(|row| row[element]), exists),
            4 => sink.dense(values.as_chunks::<4>().0.iter().map(|row| row[element]), exists),
            _ => sink.dense(values.chunks_exact(width).map(|row| row[element]), exists),
        }
    }

    fn field<N: Number, S: Sink, const SIZE: usize>(
        &self,
        field: RecordField<'_>,
        number: fn([u8; SIZE]) -> N,
        rows: Range<usize>,
        sink: S,
    ) -> S::Taken {
        let value = |row: usize| number(*field.bytes(row).first_chunk().expect("a record has all of its fields"));
        self.gather(rows, sink, value, None::<fn(N) -> bool>)
    }

    /// Hands over values one by one. `value` is the value of a row of the source. Null are rows of the table without a
    /// row of the source, and values that do not exist.
    fn gather<N: Number, S: Sink>(
        &self,
        rows: Range<usize>,
        sink: S,
        value: impl Fn(usize) -> N,
        exists: Option<impl Fn(N) -> bool>,
    ) -> S::Taken {
        match &self.places {
            Places::Same => sink.dense(rows.map(value), exists),
            Places::From(sources) => sink.dense(sources[rows].iter().map(|&row| value(row)), exists),
            Places::Into(places) => {
                let sources = places.partition_point(|&place| place < rows.start)
                    ..places.partition_point(|&place| place < rows.end);
                sink.sparse(sources.map(|row| (places[row] - rows.start, value(row))), exists)
            }
        }
    }
}

/// The number at the start of `bytes` in the unit of its field; NaN for the number that means "not provided".
fn scaled(field: &table::Field, bytes: &[u8]) -> f64 {
    let bytes = &bytes[..field.wire.size()];
    let raw = match (field.wire, bytes) {
        (Wire::U1, &[byte]) => i64::from(byte),
        (Wire::I1, &[byte]) => i64::from(byte.cast_signed()),
        (Wire::U2, &[a, b]) => i64::from(u16::from_ne_bytes([a, b])),
        (Wire::I2, &[a, b]) => i64::from(i16::from_ne_bytes([a, b])),
        (Wire::U4, &[a, b, c, d]) => i64::from(u32::from_ne_bytes([a, b, c, d])),
        (Wire::I4, &[a, b, c, d]) => i64::from(i32::from_ne_bytes([a, b, c, d])),
        (wire, _) => unreachable!("no field of {wire:?} has a scale"),
    };
    if field.missing.is_some_and(|missing| i64::from(missing) == raw) {
        return f64::NAN;
    }
    #[allow(clippy::cast_precision_loss)] // at most 32 bits
    let raw = raw as f64;
    // A power of ten is exact as a divisor, not as a factor.
    raw / (1.0 / field.scale).round()
}

/// One field of the records of a column, or of the entries of a list column.
#[derive(Clone, Copy)]
struct RecordField<'a> {
    records: &'a [u8],
    /// Bytes of a record.
    size: usize,
    /// Where the field begins in each record.
    at: usize,
}

impl<'a> RecordField<'a> {
    fn of(column: &'a Column, is_entry: bool, at: usize) -> Self {
        match (&column.values, column.quantity().map(|quantity| quantity.kind)) {
            (_, Some(Kind::List(_, entry))) if is_entry => {
                Self { records: &column.entries, size: record_size(entry), at }
            }
            (Values::Records(records), _) => Self { records, size: column.width, at },
            _ => unreachable!("only records have fields"),
        }
    }

    /// The bytes from the field of a record on.
    fn bytes(&self, row: usize) -> &'a [u8] {
        &self.records[row * self.size + self.at..]
    }
}

/// Numbers as an Arrow array, without a copy.
fn lend<T: ArrowPrimitiveType, O: Send + Sync + 'static>(owner: &Arc<O>, numbers: &[T::Native]) -> ArrayRef {
    let bytes = std::ptr::NonNull::from(numbers).cast();
    let owner = Arc::new(Owner(owner.clone()));
    // SAFETY: the numbers belong to `owner`, which the buffer keeps alive and which never changes them.
    #[allow(unsafe_code)]
    let buffer = unsafe { Buffer::from_custom_allocation(bytes, size_of_val(numbers), owner) };
    Arc::new(PrimitiveArray::<T>::new(ScalarBuffer::new(buffer, 0, numbers.len()), None))
}

/// Keeps the memory that a buffer borrows alive.
struct Owner<O>(#[allow(dead_code)] Arc<O>);

impl<O> std::panic::RefUnwindSafe for Owner<O> {}
