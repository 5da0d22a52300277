//! Arrow tables: record batches made from the columns of a log, batch by batch, when a consumer asks for them.
//!
//! A scalar that every sample has is lent to Arrow as it lies in memory. Components of vectors, fields of records and
//! columns with nulls are copied once. Columns of numbers can also be written to memory of the caller.

mod copies;
mod fields;
mod series;
mod sink;

use std::ops::Range;
use std::sync::{Arc, OnceLock};

use arrow_array::{RecordBatch, RecordBatchIterator};
use arrow_schema::{ArrowError, Schema, SchemaRef};

use self::copies::Copies;
use self::series::{Series, Shared};
pub use self::sink::Numbers;
use self::sink::Writer;
#[cfg(feature = "python")]
pub(crate) use self::sink::with_numbers;
use crate::error::HostTimesError;
use crate::log::TimedPart;
use crate::table::Kind;

/// Rows of a batch of a table that has anything to copy.
const BATCH_ROWS: usize = 1 << 18;
/// Rows that are written before the next column's turn, so that the components of a vector are read from the cache.
const WRITTEN_ROWS: usize = 1 << 12;

/// The batches of a table, made one by one.
pub type Batches = RecordBatchIterator<Box<dyn Iterator<Item = Result<RecordBatch, ArrowError>> + Send>>;

/// Columns of a part of a log as a table.
#[derive(Clone, Debug)]
pub struct Table {
    part: Arc<TimedPart>,
    shape: Shape,
    /// Host time of each sample, in seconds since 1970.
    host_times: Option<Arc<Vec<f64>>>,
    /// Whether fields of records are integers as on the wire, not in their units.
    is_raw: bool,
    /// The number of rows and the columns, made on the first use.
    series: OnceLock<Arc<(usize, Vec<Series>)>>,
}

#[derive(Clone, Debug)]
enum Shape {
    /// One row for each sample of the part, with these columns side by side.
    Wide(Vec<usize>),
    /// One row for each row of one column.
    Rows(usize),
    /// One row for each entry of a list column.
    Entries(usize),
}

impl Table {
    /// One row for each sample of the part, with these of its columns side by side; null where a sample lacks one.
    #[must_use]
    pub const fn wide(part: Arc<TimedPart>, columns: Vec<usize>) -> Self {
        Self { part, shape: Shape::Wide(columns), host_times: None, is_raw: false, series: OnceLock::new() }
    }

    /// One row for each row of one column of the part, or for each entry of a list column (a satellite, for instance).
    #[must_use]
    pub fn rows(part: Arc<TimedPart>, column: usize) -> Self {
        let kind = part.part.columns[column].quantity().map(|quantity| quantity.kind);
        let shape = if matches!(kind, Some(Kind::List(..))) { Shape::Entries(column) } else { Shape::Rows(column) };
        Self { part, shape, host_times: None, is_raw: false, series: OnceLock::new() }
    }

    /// The same table with a column `host_time`: seconds since 1970 for each sample of the part, NaN for null.
    ///
    /// # Errors
    /// [`HostTimesError`] if there is not one time for each sample.
    pub fn with_host_times(mut self, times: Vec<f64>) -> Result<Self, HostTimesError> {
        let (samples, found) = (self.part.part.len(), times.len());
        if found != samples {
            return Err(HostTimesError { samples, found });
        }
        self.host_times = Some(Arc::new(times));
        self.series = OnceLock::new();
        Ok(self)
    }

    /// The same table, with fields of records as integers, as on the wire.
    #[must_use]
    pub fn raw(self) -> Self {
        Self { is_raw: true, series: OnceLock::new(), ..self }
    }

    /// The same table with only these of its columns, in the order of the table.
    ///
    /// # Errors
    /// [`ArrowError::SchemaError`] if it has no column of one of the names.
    pub fn select(&self, names: &[String]) -> Result<Self, ArrowError> {
        let (rows, series) = &**self.series();
        if let Some(name) = names.iter().find(|&name| series.iter().all(|series| series.field.name() != name)) {
            return Err(ArrowError::SchemaError(format!("the table has no column {name:?}")));
        }
        let chosen = series.iter().filter(|series| names.contains(series.field.name())).cloned().collect();
        Ok(Self { series: OnceLock::from(Arc::new((*rows, chosen))), ..self.clone() })
    }

    /// The number of rows.
    #[must_use]
    pub fn row_count(&self) -> usize {
        self.series().0
    }

    /// The columns.
    #[must_use]
    pub fn schema(&self) -> SchemaRef {
        schema(&self.series().1)
    }

    /// The table's batches. One that needs no copy is a single batch.
    #[must_use]
    pub fn batches(&self) -> Batches {
        let made = self.series().clone();
        let rows = made.0;
        let schema = schema(&made.1);
        // In steps where something is copied, so that no more than a step of it is in memory twice.
        let step = if made.1.iter().all(Series::is_lent) { rows.max(1) } else { BATCH_ROWS };
        let shared = schema.clone();
        let mut first = 0;
        let batches = std::iter::from_fn(move || {
            if first == rows {
                return None;
            }
            let next = rows.min(first + step);
            let batch = self::batch(&shared, &made.1, first..next);
            first = next; // after the batch is made: one for which there was no memory is not left out
            Some(batch)
        });
        RecordBatchIterator::new(Box::new(batches), schema)
    }

    /// Writes all columns, which must be numbers, to memory of the caller. A row without a value stays as it is there; NaN
    /// marks a value that the device does not provide.
    ///
    /// # Errors
    /// [`ArrowError::InvalidArgumentError`] if there is not one place for each row of each column, of its type.
    pub fn write(&self, columns: &mut [Numbers<'_>]) -> Result<(), ArrowError> {
        let (rows, series) = &**self.series();
        let expected: Vec<_> = series.iter().map(|series| (series.field.data_type().clone(), *rows)).collect();
        let found: Vec<_> = columns.iter().map(|column| (column.data_type(), column.len())).collect();
        if expected != found {
            return Err(ArrowError::InvalidArgumentError(format!("memory for {expected:?} is needed, not {found:?}")));
        }
        for first in (0..*rows).step_by(WRITTEN_ROWS) {
            let rows = first..(first + WRITTEN_ROWS).min(*rows);
            for (series, numbers) in series.iter().zip(&mut *columns) {
                series.feed(rows.clone(), Writer { numbers, first });
            }
        }
        Ok(())
    }

    fn series(&self) -> &Arc<(usize, Vec<Series>)> {
        self.series.get_or_init(|| {
            let shared = Shared { part: &self.part, host_times: self.host_times.as_ref(), is_raw: self.is_raw };
            Arc::new(match &self.shape {
                Shape::Wide(columns) => (self.part.part.len(), shared.wide(columns)),
                Shape::Rows(column) => (self.part.part.columns[*column].rows, shared.rows(*column)),
                Shape::Entries(column) => shared.entries(*column),
            })
        })
    }
}

fn schema(series: &[Series]) -> SchemaRef {
    Arc::new(Schema::new(series.iter().map(|series| series.field.clone()).collect::<Vec<_>>()))
}

/// These rows of a table.
fn batch(schema: &SchemaRef, series: &[Series], rows: Range<usize>) -> Result<RecordBatch, ArrowError> {
    let mut copies = Copies::new(rows.len(), series.iter().map(Series::copied_width));
    let cells: Vec<_> = series.iter().map(|series| series.feed(rows.clone(), &mut copies)).collect();
    let types = schema.fields().iter().map(|field| field.data_type());
    RecordBatch::try_new(schema.clone(), copies.arrays(types.zip(cells))?)
}
