//! Tables: record batches made from columns when somebody asks for them, handed over by the Arrow C stream interface.
//!
//! A scalar that every row has is handed over as it lies in memory. Components of vectors, fields of records, and what
//! some samples lack, are copied once, batch by batch.

use std::ffi::CStr;
use std::sync::Arc;

use arrow_array::builder::BooleanBufferBuilder;
use arrow_array::ffi_stream::FFI_ArrowArrayStream;
use arrow_array::types::{
    ArrowPrimitiveType, Float32Type, Float64Type, Int8Type, Int16Type, Int32Type, Int64Type, TimestampNanosecondType,
    UInt8Type, UInt16Type, UInt32Type, UInt64Type,
};
use arrow_array::{Array, ArrayRef, PrimitiveArray, RecordBatch, RecordBatchIterator};
use arrow_buffer::{Buffer, NullBuffer, ScalarBuffer};
use arrow_schema::{ArrowError, DataType, Field, Metadata, Schema, SchemaRef, TimeUnit};
use numpy::{PyReadonlyArray1, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyCapsule;

use super::reader::{Column as PyColumn, Part as PyPart, Shared};
use crate::column::{Column, Subject, Values};
use crate::packet::{Precision, record_size};
use crate::table::{self, Kind, Wire};

/// Rows of a batch where a table is made in pieces.
const BATCH: usize = 1 << 18;

/// The name that the Arrow PyCapsule interface asks for.
const CAPSULE: &CStr = c"arrow_array_stream";

/// Some columns of a part as a table; asked for it, it hands over a stream of record batches.
#[pyclass(module = "xbus._core", frozen)]
pub struct ArrowStream {
    shared: Arc<Shared>,
    shape: Shape,
    /// Host time of each sample, where that is known.
    host: Option<Arc<Vec<f64>>>,
}

#[derive(Clone)]
enum Shape {
    /// One row for each sample of the part, these columns side by side.
    Wide(Vec<usize>),
    /// One row for each row of one column.
    Rows(usize),
    /// One row for each entry of a list column.
    Entries(usize),
}

#[pymethods]
impl ArrowStream {
    /// One row for each sample of `part`, with all of its columns, or with `columns` only. `host` has their host times.
    #[staticmethod]
    #[pyo3(signature = (part, columns=None, host=None))]
    fn wide(
        part: &PyPart,
        columns: Option<Vec<PyRef<'_, PyColumn>>>,
        host: Option<PyReadonlyArray1<'_, f64>>,
    ) -> PyResult<Self> {
        let shared = part.0.clone();
        let chosen = match columns {
            Some(columns) => {
                if columns.iter().any(|it| !Arc::ptr_eq(&it.shared, &shared)) {
                    return Err(PyValueError::new_err("the columns of a table come from one log"));
                }
                columns.iter().map(|it| it.index).collect()
            }
            None => (0..shared.part.columns.len()).collect(),
        };
        let host = host_times(&shared, host)?;
        Ok(Self { shared, shape: Shape::Wide(chosen), host })
    }

    /// One row for each row of `column`; for each satellite, where it is a list of them. `host` has the host times of the
    /// samples.
    #[staticmethod]
    #[pyo3(signature = (column, host=None))]
    fn rows(column: &PyColumn, host: Option<PyReadonlyArray1<'_, f64>>) -> PyResult<Self> {
        let list = matches!(kind(column.column()), Some(Kind::List(..)));
        let shape = if list { Shape::Entries(column.index) } else { Shape::Rows(column.index) };
        let host = host_times(&column.shared, host)?;
        Ok(Self { shared: column.shared.clone(), shape, host })
    }

    /// The stream, in a capsule. A requested schema is not looked at: the interface leaves that to the producer.
    #[pyo3(signature = (requested_schema=None))]
    fn __arrow_c_stream__<'py>(
        &self,
        py: Python<'py>,
        requested_schema: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyCapsule>> {
        let _ = requested_schema;
        let (shared, shape, host) = (self.shared.clone(), self.shape.clone(), self.host.clone());
        let (schema, batches) = py.detach(move || batches(&shared, &shape, host.as_ref()));
        let reader = RecordBatchIterator::new(batches, schema);
        PyCapsule::new_with_value(py, FFI_ArrowArrayStream::new(Box::new(reader)), CAPSULE)
    }
}

/// The host times of all samples, if they are given.
fn host_times(shared: &Shared, host: Option<PyReadonlyArray1<'_, f64>>) -> PyResult<Option<Arc<Vec<f64>>>> {
    let Some(host) = host else { return Ok(None) };
    if host.len() != shared.part.len() {
        return Err(PyValueError::new_err("there must be one host time for each sample"));
    }
    Ok(Some(Arc::new(host.as_array().to_vec())))
}

type Batches = Box<dyn Iterator<Item = Result<RecordBatch, ArrowError>> + Send>;

fn batches(shared: &Arc<Shared>, shape: &Shape, host: Option<&Arc<Vec<f64>>>) -> (SchemaRef, Batches) {
    let (rows, series) = match shape {
        Shape::Wide(columns) => (shared.part.len(), wide(shared, columns, host)),
        Shape::Rows(column) => {
            let rows = Rows::of(shared, *column);
            (rows.len(), one(shared, *column, &rows, host))
        }
        Shape::Entries(column) => {
            let (rows, series) = entries(shared, *column, host);
            (rows, series)
        }
    };
    let schema = Arc::new(Schema::new(series.iter().map(|it| it.field.clone()).collect::<Vec<_>>()));
    // Whole, where nothing has to be made; otherwise in pieces, so that no more than a piece is held twice.
    let step = if series.iter().all(Series::is_lent) { rows.max(1) } else { BATCH };
    let made = schema.clone();
    let batches = (0..rows.div_ceil(step)).map(move |batch| {
        let (from, to) = (batch * step, rows.min((batch + 1) * step));
        RecordBatch::try_new(made.clone(), series.iter().map(|it| it.array(from, to)).collect())
    });
    (schema, Box::new(batches))
}

/// One column of a table.
struct Series {
    field: Field,
    source: Source,
    places: Places,
}

/// Where the values are.
enum Source {
    /// Numbers in memory of their own, used as they are.
    Made(ArrayRef),
    /// Element `element` of each row of a column of numbers.
    Numbers { shared: Arc<Shared>, column: usize, element: usize },
    /// A number at byte `at` of each record.
    Records { shared: Arc<Shared>, column: usize, entries: bool, at: usize, wire: Wire },
    /// The time stamps of the records.
    Utc { shared: Arc<Shared>, column: usize },
    /// A time of each sample.
    Time(Times),
}

/// The times of the samples, NaN where one has none.
#[derive(Clone)]
enum Times {
    /// Seconds on the device clock.
    Device(Arc<Shared>),
    /// Seconds since 1970 on the host's clock.
    Host(Arc<Vec<f64>>),
}

impl Times {
    fn seconds(&self) -> &[f64] {
        match self {
            Self::Device(shared) => &shared.times().time,
            Self::Host(times) => times,
        }
    }

    fn lent(&self) -> PrimitiveArray<Float64Type> {
        match self {
            Self::Device(shared) => lend::<Float64Type, _>(shared, self.seconds()),
            Self::Host(times) => lend::<Float64Type, _>(times, self.seconds()),
        }
    }
}

/// Which row of the source goes into which row of the table.
#[derive(Clone)]
enum Places {
    /// Row by row.
    Same,
    /// Into these rows, ascending; the others are null. Where a row is named twice, the last counts.
    At(Arc<Vec<i64>>),
    /// From these rows.
    From(Arc<Vec<i64>>),
}

/// The samples that the rows of a column belong to, counted from the beginning of the part.
struct Rows(Arc<Vec<i64>>);

impl Rows {
    #[allow(clippy::cast_possible_wrap)]
    fn of(shared: &Shared, column: usize) -> Self {
        let part = &shared.part;
        let first = part.first as i64;
        let mut samples = part.samples_of(&part.columns[column]);
        samples.iter_mut().for_each(|it| *it -= first);
        Self(Arc::new(samples))
    }

    fn len(&self) -> usize {
        self.0.len()
    }
}

fn kind(column: &Column) -> Option<Kind> {
    match column.subject {
        Subject::Known(quantity, _) => Some(quantity.kind),
        Subject::Unknown(_) => None,
    }
}

fn sample_field() -> Field {
    Field::new("sample", DataType::Int64, false)
}

/// Number of the sample, its time, and its host time where that is known.
fn stamps(shared: &Arc<Shared>, samples: Vec<i64>, host: Option<&Arc<Vec<f64>>>, places: &Places) -> Vec<Series> {
    let time = |name: &str, times: Times| Series {
        field: Field::new(name, DataType::Float64, true)
            .with_metadata(Metadata::from([("unit".to_owned(), "s".to_owned())])),
        source: Source::Time(times),
        places: places.clone(),
    };
    let mut series = vec![
        Series { field: sample_field(), source: made::<Int64Type>(samples), places: Places::Same },
        time("time", Times::Device(shared.clone())),
    ];
    series.extend(host.map(|it| time("host_time", Times::Host(it.clone()))));
    series
}

/// One row for each sample.
#[allow(clippy::cast_possible_wrap)]
fn wide(shared: &Arc<Shared>, columns: &[usize], host: Option<&Arc<Vec<f64>>>) -> Vec<Series> {
    let part = &shared.part;
    let first = part.first as i64;
    let samples: Vec<i64> = (first..first + part.len() as i64).collect();
    let mut series = stamps(shared, samples, host, &Places::Same);
    for &column in columns {
        let places =
            if part.is_dense(&part.columns[column]) { Places::Same } else { Places::At(Rows::of(shared, column).0) };
        series.extend(of_column(shared, column, &places, columns));
    }
    series
}

/// One row for each row of a column.
#[allow(clippy::cast_possible_wrap)]
fn one(shared: &Arc<Shared>, column: usize, rows: &Rows, host: Option<&Arc<Vec<f64>>>) -> Vec<Series> {
    let first = shared.part.first as i64;
    let samples: Vec<i64> = rows.0.iter().map(|it| it + first).collect();
    let mut series = stamps(shared, samples, host, &Places::From(rows.0.clone()));
    series.extend(of_column(shared, column, &Places::Same, &[column]));
    series
}

/// One row for each entry of a list.
#[allow(clippy::cast_possible_wrap)]
fn entries(shared: &Arc<Shared>, column: usize, host: Option<&Arc<Vec<f64>>>) -> (usize, Vec<Series>) {
    let source = &shared.part.columns[column];
    let (Some(Kind::List(head, entry)), Values::Records(heads)) = (kind(source), &source.values) else {
        return (0, vec![]);
    };
    let counts = heads.chunks_exact(record_size(head)).map(|it| usize::from(it[head[0].wire.size()]));
    let rows: Vec<i64> = (0i64..).zip(counts).flat_map(|(row, count)| std::iter::repeat_n(row, count)).collect();
    let owner = Rows::of(shared, column).0;
    let places: Vec<i64> = rows.iter().map(|&row| owner[usize::try_from(row).unwrap_or(0)]).collect();
    let first = shared.part.first as i64;
    let samples: Vec<i64> = places.iter().map(|it| it + first).collect();
    let mut series = stamps(shared, samples, host, &Places::From(Arc::new(places)));
    let rows = Arc::new(rows);
    for (list, entries, places) in [(head, false, Places::From(rows.clone())), (entry, true, Places::Same)] {
        let mut at = 0;
        for field in list {
            let meta = metadata(source, &raw_unit(field));
            let source = Source::Records { shared: shared.clone(), column, entries, at, wire: field.wire };
            let arrow = Field::new(field.name, arrow_type(field.wire), false).with_metadata(meta);
            series.push(Series { field: arrow, source, places: places.clone() });
            at += field.wire.size();
        }
    }
    (rows.len(), series)
}

/// What a field of a table says of the column that it comes from.
fn metadata(column: &Column, unit: &str) -> Metadata {
    let Subject::Known(quantity, coordinates) = column.subject else { return Metadata::default() };
    let id = if column.mixed_ids { quantity.id } else { column.id };
    let mut meta = vec![("data_id".to_owned(), format!("{id:#06X}"))];
    if !unit.is_empty() {
        meta.push(("unit".to_owned(), unit.to_owned()));
    }
    if let Some(coordinates) = coordinates {
        meta.push(("coordinates".to_owned(), coordinates.name().to_owned()));
    }
    if matches!(quantity.kind, Kind::Real(_)) && !column.mixed_precisions {
        meta.push(("precision".to_owned(), Precision::of(column.id).name().to_owned()));
    }
    meta.into_iter().collect()
}

/// The unit of a raw integer: `"1e-7 deg"`.
fn raw_unit(field: &table::Field) -> String {
    #[allow(clippy::float_cmp)] // a constant of the table
    if field.scale == 1.0 {
        field.unit.to_owned()
    } else {
        format!("{:e} {}", field.scale, field.unit).trim().to_owned()
    }
}

/// The table columns that a column of the log becomes.
fn of_column(shared: &Arc<Shared>, index: usize, places: &Places, chosen: &[usize]) -> Vec<Series> {
    let columns = &shared.part.columns;
    let column = &columns[index];
    let Subject::Known(quantity, coordinates) = column.subject else { return vec![] };
    let is_same = |it: &usize| matches!(columns[*it].subject, Subject::Known(other, _) if other.id == quantity.id);
    let mixed = chosen.iter().filter(|it| is_same(it)).count() > 1;
    let mut stem = quantity.name.to_owned();
    if let (true, Some(coordinates)) = (mixed, coordinates) {
        stem = format!("{stem}_{}", coordinates.name().to_lowercase());
    }
    let nullable = !matches!(places, Places::Same);
    let series = |name: String, data_type: DataType, unit: &str, source: Source| Series {
        field: Field::new(name, data_type, nullable).with_metadata(metadata(column, unit)),
        source,
        places: places.clone(),
    };
    match quantity.kind {
        _ if quantity.name == "utc_time" => {
            let source = Source::Utc { shared: shared.clone(), column: index };
            let mut utc = series(stem, DataType::Timestamp(TimeUnit::Nanosecond, Some("UTC".into())), "", source);
            utc.field = utc.field.with_nullable(true);
            vec![utc]
        }
        Kind::Struct(fields) | Kind::List(fields, _) => {
            let mut at = 0;
            let mut list = vec![];
            for field in fields {
                let source =
                    Source::Records { shared: shared.clone(), column: index, entries: false, at, wire: field.wire };
                list.push(series(format!("{stem}_{}", field.name), arrow_type(field.wire), &raw_unit(field), source));
                at += field.wire.size();
            }
            list
        }
        _ => {
            let element = |element| Source::Numbers { shared: shared.clone(), column: index, element };
            let data_type = number_type(&column.values);
            if quantity.components.is_empty() {
                return vec![series(stem, data_type, quantity.unit, element(0))];
            }
            let mut order: Vec<usize> = (0..quantity.components.len()).collect();
            if quantity.name == "rotation_matrix" {
                order.sort_by_key(|&it| quantity.components[it]); // m11, m12, m13, m21, ...
            }
            let name = |it: usize| format!("{stem}_{}", quantity.components[it]);
            order.into_iter().map(|it| series(name(it), data_type.clone(), quantity.unit, element(it))).collect()
        }
    }
}

fn arrow_type(wire: Wire) -> DataType {
    match wire {
        Wire::U1 => DataType::UInt8,
        Wire::U2 => DataType::UInt16,
        Wire::U4 => DataType::UInt32,
        Wire::U8 => DataType::UInt64,
        Wire::I1 => DataType::Int8,
        Wire::I2 => DataType::Int16,
        Wire::I4 => DataType::Int32,
        Wire::F4 => DataType::Float32,
    }
}

fn number_type(values: &Values) -> DataType {
    match values {
        Values::U8(_) => DataType::UInt8,
        Values::U16(_) => DataType::UInt16,
        Values::U32(_) => DataType::UInt32,
        Values::U64(_) => DataType::UInt64,
        Values::I8(_) => DataType::Int8,
        Values::I16(_) => DataType::Int16,
        Values::I32(_) => DataType::Int32,
        Values::F32(_) => DataType::Float32,
        Values::F64(_) => DataType::Float64,
        Values::Records(_) | Values::Raw(_) => DataType::Null,
    }
}

fn made<T: ArrowPrimitiveType>(values: Vec<T::Native>) -> Source {
    Source::Made(Arc::new(PrimitiveArray::<T>::new(values.into(), None)))
}

/// Numbers as an Arrow buffer, without a copy.
fn lend<T: ArrowPrimitiveType, O: Send + Sync + 'static>(owner: &Arc<O>, numbers: &[T::Native]) -> PrimitiveArray<T> {
    let bytes = std::ptr::NonNull::from(numbers).cast();
    let keep = Arc::new(Keep(owner.clone()));
    // SAFETY: the numbers belong to `owner`, which the buffer keeps alive, and which nobody changes after it was made.
    #[allow(unsafe_code)]
    let buffer = unsafe { Buffer::from_custom_allocation(bytes, size_of_val(numbers), keep) };
    PrimitiveArray::new(ScalarBuffer::new(buffer, 0, numbers.len()), None)
}

/// Keeps what a buffer borrows from alive.
struct Keep<O>(#[allow(dead_code)] Arc<O>);

impl<O> std::panic::RefUnwindSafe for Keep<O> {}

impl Series {
    /// Whether the values are handed over as they are.
    fn is_lent(&self) -> bool {
        match &self.source {
            Source::Made(_) => true,
            Source::Numbers { shared, column, .. } => {
                matches!(self.places, Places::Same) && shared.part.columns[*column].width == 1
            }
            Source::Time(times) => matches!(self.places, Places::Same) && !times.seconds().iter().any(|it| it.is_nan()),
            Source::Records { .. } | Source::Utc { .. } => false,
        }
    }

    /// Rows `from` to `to` of the table.
    fn array(&self, from: usize, to: usize) -> ArrayRef {
        match &self.source {
            Source::Made(array) => array.slice(from, to - from),
            Source::Time(times) => {
                let time = times.seconds();
                if self.is_lent() {
                    return Arc::new(times.lent().slice(from, to - from));
                }
                let array = self.gather::<Float64Type>(from, to, |row| time[row]);
                let valid: NullBuffer = array.values().iter().map(|it| !it.is_nan()).collect();
                Arc::new(PrimitiveArray::<Float64Type>::new(array.values().clone(), Some(valid)))
            }
            Source::Numbers { shared, column, element } => {
                let values = &shared.part.columns[*column];
                match &values.values {
                    Values::U8(it) => self.numbers::<UInt8Type>(values, it, *element, from, to),
                    Values::U16(it) => self.numbers::<UInt16Type>(values, it, *element, from, to),
                    Values::U32(it) => self.numbers::<UInt32Type>(values, it, *element, from, to),
                    Values::U64(it) => self.numbers::<UInt64Type>(values, it, *element, from, to),
                    Values::I8(it) => self.numbers::<Int8Type>(values, it, *element, from, to),
                    Values::I16(it) => self.numbers::<Int16Type>(values, it, *element, from, to),
                    Values::I32(it) => self.numbers::<Int32Type>(values, it, *element, from, to),
                    Values::F32(it) => self.numbers::<Float32Type>(values, it, *element, from, to),
                    Values::F64(it) => self.numbers::<Float64Type>(values, it, *element, from, to),
                    Values::Records(_) | Values::Raw(_) => unreachable!("records have a source of their own"),
                }
            }
            Source::Records { shared, column, entries, at, wire } => {
                let source = &shared.part.columns[*column];
                let (bytes, width) = match (&source.values, kind(source), entries) {
                    (_, Some(Kind::List(_, entry)), true) => (&source.entries, record_size(entry)),
                    (Values::Records(bytes), _, _) => (bytes, source.width),
                    _ => unreachable!("only records have fields"),
                };
                let field = |row: usize| &bytes[row * width + at..];
                match wire {
                    Wire::U1 => Arc::new(self.gather::<UInt8Type>(from, to, |row| field(row)[0])),
                    Wire::I1 => Arc::new(self.gather::<Int8Type>(from, to, |row| field(row)[0].cast_signed())),
                    Wire::U2 => {
                        Arc::new(self.gather::<UInt16Type>(from, to, |row| u16::from_ne_bytes(head(field(row)))))
                    }
                    Wire::I2 => {
                        Arc::new(self.gather::<Int16Type>(from, to, |row| i16::from_ne_bytes(head(field(row)))))
                    }
                    Wire::U4 => {
                        Arc::new(self.gather::<UInt32Type>(from, to, |row| u32::from_ne_bytes(head(field(row)))))
                    }
                    Wire::I4 => {
                        Arc::new(self.gather::<Int32Type>(from, to, |row| i32::from_ne_bytes(head(field(row)))))
                    }
                    Wire::U8 => {
                        Arc::new(self.gather::<UInt64Type>(from, to, |row| u64::from_ne_bytes(head(field(row)))))
                    }
                    Wire::F4 => {
                        Arc::new(self.gather::<Float32Type>(from, to, |row| f32::from_ne_bytes(head(field(row)))))
                    }
                }
            }
            Source::Utc { shared, column } => {
                let source = &shared.part.columns[*column];
                let Values::Records(bytes) = &source.values else { unreachable!("UtcTime is a record") };
                let stamp = |row: usize| super::utc::nanoseconds(&bytes[row * source.width..]);
                let stamps = self.gather::<Int64Type>(from, to, |row| stamp(row).unwrap_or(i64::MIN));
                let valid: NullBuffer =
                    (0..stamps.len()).map(|it| stamps.values()[it] != i64::MIN).collect::<Vec<_>>().into();
                let valid = NullBuffer::union(Some(&valid), stamps.nulls());
                let array = PrimitiveArray::<TimestampNanosecondType>::new(stamps.values().clone(), valid);
                Arc::new(array.with_timezone("UTC"))
            }
        }
    }

    fn numbers<T: ArrowPrimitiveType>(
        &self,
        column: &Arc<Column>,
        numbers: &[T::Native],
        element: usize,
        from: usize,
        to: usize,
    ) -> ArrayRef {
        let width = column.width;
        if width == 1 && matches!(self.places, Places::Same) {
            return Arc::new(lend::<T, _>(column, numbers).slice(from, to - from));
        }
        Arc::new(self.gather::<T>(from, to, |row| numbers[row * width + element]))
    }

    /// Copies rows `from` to `to` of the table from wherever they are.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_possible_wrap)] // rows
    fn gather<T: ArrowPrimitiveType>(
        &self,
        from: usize,
        to: usize,
        value: impl Fn(usize) -> T::Native,
    ) -> PrimitiveArray<T> {
        match &self.places {
            Places::Same => PrimitiveArray::new((from..to).map(value).collect::<Vec<_>>().into(), None),
            Places::From(rows) => PrimitiveArray::new(
                rows[from..to].iter().map(|row| value(*row as usize)).collect::<Vec<_>>().into(),
                None,
            ),
            Places::At(places) => {
                let first = places.partition_point(|place| *place < from as i64);
                let last = places.partition_point(|place| *place < to as i64);
                let mut values = vec![T::default_value(); to - from];
                let mut valid = BooleanBufferBuilder::new(to - from);
                valid.append_n(to - from, false);
                for row in first..last {
                    let place = places[row] as usize - from;
                    values[place] = value(row);
                    valid.set_bit(place, true);
                }
                PrimitiveArray::new(values.into(), Some(NullBuffer::new(valid.finish())))
            }
        }
    }
}

fn head<const N: usize>(bytes: &[u8]) -> [u8; N] {
    *bytes.first_chunk().expect("a record has all of its fields")
}
