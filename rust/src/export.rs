//! Files from record batches: Parquet, CSV and Arrow.
//!
//! A file is made of chunks. Any thread may encode batches to a chunk, which is nearly all of the work; the chunks are
//! then appended in their order. No function does input or output: each returns the bytes that the file continues with.
//!
//! ```
//! use std::sync::Arc;
//! use arrow_array::{Int64Array, RecordBatch};
//! use xbus::export::{Encoder, Format, Writer};
//!
//! let batch = RecordBatch::try_from_iter([("sample", Arc::new(Int64Array::from(vec![0, 1])) as _)])?;
//! let encoder = Encoder::new(Format::Csv, batch.schema())?;
//! let mut writer = Writer::new(Format::Csv, batch.schema())?;
//! let mut file = writer.start()?;
//! file.extend(writer.append(encoder.encode(&[batch])?)?);
//! file.extend(writer.finish()?);
//! assert_eq!(file, b"\"sample\"\n0\n1\n");
//! # Ok::<(), arrow_schema::ArrowError>(())
//! ```

mod csv;
mod ipc;
mod parquet;

use arrow_array::RecordBatch;
use arrow_schema::{ArrowError, DataType, Schema, SchemaRef};

/// Rows of a chunk, at most. As many values of a column are in memory at once.
const CHUNK_ROWS: usize = 1 << 18;
/// Bytes of the rows of a chunk in memory, about, if these are fewer than [`CHUNK_ROWS`].
const CHUNK_BYTES: usize = 16 << 20;
/// The same for CSV, whose text is longer than the numbers.
const CSV_BYTES: usize = 4 << 20;

/// The format of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Apache Parquet: a chunk is a row group.
    Parquet,
    /// Comma-separated values: a chunk is its lines.
    Csv,
    /// The file format of Arrow, also called Feather.
    Arrow,
}

impl Format {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Parquet, Self::Csv, Self::Arrow];

    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Parquet => "parquet",
            Self::Csv => "csv",
            Self::Arrow => "arrow",
        }
    }
}

/// Encoded rows.
pub struct Chunk(Encoded);

enum Encoded {
    Parquet(parquet::RowGroup),
    Csv(Vec<u8>),
    /// An Arrow file has the bytes of the arrays, so nothing is to encode.
    Arrow(Vec<RecordBatch>),
}

/// Encodes batches of one schema, on any number of threads.
pub struct Encoder {
    schema: SchemaRef,
    encoding: Encoding,
}

enum Encoding {
    Parquet(parquet::Encoder),
    Csv,
    Arrow,
}

impl Encoder {
    /// An encoder of batches that have this schema.
    ///
    /// # Errors
    /// [`ArrowError`] for a type that the format does not have.
    pub fn new(format: Format, schema: SchemaRef) -> Result<Self, ArrowError> {
        let encoding = match format {
            Format::Parquet => Encoding::Parquet(parquet::Encoder::new(&schema)?),
            Format::Csv => Encoding::Csv,
            Format::Arrow => Encoding::Arrow,
        };
        Ok(Self { schema, encoding })
    }

    /// Encodes batches to one chunk, the rows of one after those of another.
    ///
    /// # Errors
    /// [`ArrowError`] for a batch with other columns.
    pub fn encode(&self, batches: &[RecordBatch]) -> Result<Chunk, ArrowError> {
        if let Some(other) = batches.iter().find(|batch| !have_same_columns(&batch.schema(), &self.schema)) {
            let message = format!("the columns of a batch are {}, not {}", other.schema(), self.schema);
            return Err(ArrowError::SchemaError(message));
        }
        Ok(Chunk(match &self.encoding {
            Encoding::Parquet(encoder) => Encoded::Parquet(encoder.encode(batches)?),
            Encoding::Csv => Encoded::Csv(csv::lines(batches)?),
            Encoding::Arrow => Encoded::Arrow(batches.to_vec()),
        }))
    }
}

fn have_same_columns(one: &Schema, other: &Schema) -> bool {
    let columns = |schema: &Schema| schema.fields().len();
    columns(one) == columns(other)
        && one.fields().iter().zip(other.fields()).all(|(one, other)| {
            one.name() == other.name()
                && one.data_type() == other.data_type()
                && (other.is_nullable() || !one.is_nullable())
        })
}

/// Joins chunks to a file.
pub struct Writer {
    schema: SchemaRef,
    file: File,
}

enum File {
    Parquet(Box<parquet::Writer>),
    Csv,
    Arrow(Box<ipc::Writer>),
}

impl Writer {
    /// A file of batches that have this schema.
    ///
    /// # Errors
    /// [`ArrowError`] for a type that the format does not have.
    pub fn new(format: Format, schema: SchemaRef) -> Result<Self, ArrowError> {
        let file = match format {
            Format::Parquet => File::Parquet(Box::new(parquet::Writer::new(&schema)?)),
            Format::Csv => File::Csv,
            Format::Arrow => File::Arrow(Box::new(ipc::Writer::new(&schema)?)),
        };
        Ok(Self { schema, file })
    }

    /// The bytes that the file begins with.
    ///
    /// # Errors
    /// None with a schema that [`Writer::new`] has accepted.
    pub fn start(&mut self) -> Result<Vec<u8>, ArrowError> {
        match &mut self.file {
            File::Parquet(_) => Ok(parquet::MAGIC.to_vec()),
            File::Csv => Ok(csv::header(&self.schema)),
            File::Arrow(file) => file.taken(),
        }
    }

    /// The bytes of the next chunk.
    ///
    /// # Errors
    /// [`ArrowError`] for a chunk of another format or with other columns.
    pub fn append(&mut self, chunk: Chunk) -> Result<Vec<u8>, ArrowError> {
        match (&mut self.file, chunk.0) {
            (File::Parquet(file), Encoded::Parquet(group)) => file.append(group),
            (File::Csv, Encoded::Csv(lines)) => Ok(lines),
            (File::Arrow(file), Encoded::Arrow(batches)) => file.append(&batches),
            _ => Err(ArrowError::InvalidArgumentError("the chunk is of another format".to_owned())),
        }
    }

    /// The bytes that the file ends with. No chunk may follow.
    ///
    /// # Errors
    /// [`ArrowError`] if the file is finished already.
    pub fn finish(&mut self) -> Result<Vec<u8>, ArrowError> {
        match &mut self.file {
            File::Parquet(file) => file.finish(),
            File::Csv => Ok(vec![]),
            File::Arrow(file) => file.finish(),
        }
    }
}

/// How many rows of a table with this schema a chunk has, so that its size in memory is bounded.
#[must_use]
pub fn chunk_rows(format: Format, schema: &Schema) -> usize {
    let bytes = if format == Format::Csv { CSV_BYTES } else { CHUNK_BYTES };
    (bytes / row_size(schema).max(1)).clamp(1, CHUNK_ROWS)
}

/// Bytes of a row in memory, about.
fn row_size(schema: &Schema) -> usize {
    let size = |data_type: &DataType| data_type.primitive_width().unwrap_or(16);
    schema.fields().iter().map(|field| size(field.data_type())).sum()
}
