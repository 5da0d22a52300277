//! Arrow tables: record batches made from the columns of a log, batch by batch, when a consumer asks for them.
//!
//! A scalar that every sample has is lent to Arrow as it lies in memory. Components of vectors, fields of records and
//! columns with nulls are copied once. Columns of numbers can also be written to memory of the caller.

mod copies;
mod fields;
mod series;
mod sink;

use std::ops::Range;
use std::sync::Arc;

use arrow_array::{RecordBatch, RecordBatchIterator};
use arrow_schema::{ArrowError, Schema, SchemaRef};

use self::copies::Copies;
use self::series::{Series, Shared};
pub use self::sink::Numbers;
use self::sink::Writer;
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
    /// The names of the columns that were chosen, or all.
    names: Option<Vec<String>>,
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
        Self { part, shape: Shape::Wide(columns), host_times: None, is_raw: false, names: None }
    }

    /// One row for each row of one column of the part, or for each entry of a list column (a satellite, for instance).
    #[must_use]
    pub fn rows(part: Arc<TimedPart>, column: usize) -> Self {
        let kind = part.part.columns[column].quantity().map(|quantity| quantity.kind);
        let shape = if matches!(kind, Some(Kind::List(..))) { Shape::Entries(column) } else { Shape::Rows(column) };
        Self { part, shape, host_times: None, is_raw: false, names: None }
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
        Ok(self)
    }

    /// The same table, with fields of records as integers, as on the wire.
    #[must_use]
    pub fn raw(self) -> Self {
        Self { is_raw: true, ..self }
    }

    /// The same table with only those of its columns that have these names.
    #[must_use]
    pub fn select(mut self, names: Vec<String>) -> Self {
        self.names = Some(names);
        self
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
        let (rows, series) = self.series();
        let schema = schema(&series);
        // In steps where something is copied, so that no more than a step of it is in memory twice.
        let step = if series.iter().all(Series::is_lent) { rows.max(1) } else { BATCH_ROWS };
        let shared = schema.clone();
        let mut first = 0;
        let batches = std::iter::from_fn(move || {
            if first == rows {
                return None;
            }
            let next = rows.min(first + step);
            let batch = self::batch(&shared, &series, first..next);
            first = next; // after the batch is made: one for which there was no memory is not left out
            Some(batch)
        });
        RecordBatchIterator::new(Box::new(batches), schema)
    }

    /// Writes the numbers of all columns to `columns`, in their order. Rows that are null stay as they are there; where the
    /// device marks a number as not provided, they become NaN.
    ///
    /// # Errors
    /// [`ArrowError::InvalidArgumentError`] if there is not one place for each row of each column, of its type.
    pub fn write(&self, columns: &mut [Numbers<'_>]) -> Result<(), ArrowError> {
        let (rows, series) = self.series();
        let expected: Vec<_> = series.iter().map(|series| (series.field.data_type().clone(), rows)).collect();
        let found: Vec<_> = columns.iter().map(|column| (column.data_type(), column.len())).collect();
        if expected != found {
            return Err(ArrowError::InvalidArgumentError(format!("memory for {expected:?}, not {found:?}")));
        }
        for first in (0..rows).step_by(WRITTEN_ROWS) {
            let rows = first..rows.min(first + WRITTEN_ROWS);
            for (series, numbers) in series.iter().zip(&mut *columns) {
                series.feed(rows.clone(), Writer { numbers, first });
            }
        }
        Ok(())
    }

    fn series(&self) -> (usize, Vec<Series>) {
        let shared = Shared { part: &self.part, host_times: self.host_times.as_ref(), is_raw: self.is_raw };
        let (rows, mut series) = match &self.shape {
            Shape::Wide(columns) => (self.part.part.len(), shared.wide(columns)),
            Shape::Rows(column) => (self.part.part.columns[*column].rows, shared.rows(*column)),
            Shape::Entries(column) => shared.entries(*column),
        };
        if let Some(names) = &self.names {
            series.retain(|series| names.contains(series.field.name()));
        }
        (rows, series)
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
