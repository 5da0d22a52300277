//! Parquet files.

mod floats;

use std::sync::Arc;

use arrow_array::RecordBatch;
use arrow_schema::{ArrowError, DataType, Field, SchemaRef};
use parquet::arrow::ArrowSchemaConverter;
use parquet::arrow::add_encoded_arrow_schema_to_metadata;
use parquet::arrow::arrow_writer::{ArrowColumnChunk, ArrowColumnWriter, ArrowRowGroupWriterFactory, compute_leaves};
use parquet::basic::{Compression, Encoding, ZstdLevel};
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::{ColumnDescPtr, ColumnPath};
use zstd::bulk::Compressor;

/// Columns by which queries select rows, beside points in time. Only these have statistics: the range of an
/// acceleration over a row group does not let a query skip any.
const SELECTING: [&str; 3] = ["sample", "time", "host_time"];

/// Bytes of the values of a page, at most.
const PAGE_SIZE: usize = 1 << 20;
/// Level of zstd. Level 3 takes 1.6 times as long for 1 % less.
const LEVEL: i32 = 1;

/// The columns of a row group, encoded.
pub struct RowGroup(Vec<Column>);

enum Column {
    Floats(Box<floats::Pages>),
    Other(Box<ArrowColumnChunk>),
}

/// Encodes row groups.
pub struct Encoder {
    schema: SchemaRef,
    columns: Vec<ColumnDescPtr>,
    writers: ArrowRowGroupWriterFactory,
}

impl Encoder {
    pub fn new(schema: &SchemaRef) -> Result<Self, ArrowError> {
        let file = file(schema)?;
        let writers = ArrowRowGroupWriterFactory::new(&file, schema.clone());
        Ok(Self { schema: schema.clone(), columns: file.schema_descr().columns().to_vec(), writers })
    }

    /// Encodes one column after the other, so that little more than the result is in memory.
    pub fn encode(&self, batches: &[RecordBatch]) -> Result<RowGroup, ArrowError> {
        let mut compressor = Compressor::new(LEVEL)?;
        let writers = self.writers.create_column_writers(0)?.into_iter();
        let column = |(index, mut writer): (usize, ArrowColumnWriter)| {
            let arrays: Vec<_> = batches.iter().map(|batch| batch.column(index)).collect();
            let field = self.schema.field(index);
            if !is_selecting(field)
                && let Some(pages) = floats::encode(&self.columns[index], &arrays, &mut compressor)?
            {
                return Ok(Column::Floats(Box::new(pages)));
            }
            for array in arrays {
                for leaf in compute_leaves(field, array)? {
                    writer.write(&leaf)?;
                }
            }
            Ok(Column::Other(Box::new(writer.close()?)))
        };
        Ok(RowGroup(writers.enumerate().map(column).collect::<Result<_, ArrowError>>()?))
    }
}

/// Writes a Parquet file into memory, from where it is taken piece by piece.
pub struct Writer(SerializedFileWriter<Vec<u8>>);

impl Writer {
    pub fn new(schema: &SchemaRef) -> Result<Self, ArrowError> {
        Ok(Self(file(schema)?))
    }

    pub fn append(&mut self, group: RowGroup) -> Result<Vec<u8>, ArrowError> {
        let mut writer = self.0.next_row_group()?;
        for column in group.0 {
            match column {
                Column::Floats(pages) => writer.append_column(&pages.0, pages.1)?,
                Column::Other(chunk) => chunk.append_to_row_group(&mut writer)?,
            }
        }
        writer.close()?;
        self.taken()
    }

    pub fn finish(&mut self) -> Result<Vec<u8>, ArrowError> {
        self.0.finish()?;
        let mut end = self.taken()?;
        declare_type_order(&mut end, self.0.schema_descr().num_columns());
        Ok(end)
    }

    /// What was written since the last call.
    pub fn taken(&mut self) -> Result<Vec<u8>, ArrowError> {
        self.0.flush()?;
        Ok(std::mem::take(self.0.inner_mut()))
    }
}

/// Declares the order of floats that every reader knows. The crate declares IEEE 754's total order, and pyarrow ignores
/// statistics in an order that it does not know. The two differ for NaN alone, and times are null instead.
///
/// The orders are the last field of the footer: a union for each column, whose member is 1 (type) or 2 (IEEE 754).
fn declare_type_order(end: &mut [u8], columns: usize) {
    const TAIL: usize = b"\0SIZEPAR1".len();
    const TYPE: [u8; 3] = [0x1C, 0, 0];
    const IEEE_754: [u8; 3] = [0x2C, 0, 0];
    let Some(orders_end) = end.len().checked_sub(TAIL) else { return };
    let Some(orders) = orders_end.checked_sub(columns * TYPE.len()) else { return };
    let (orders, _) = end[orders..orders_end].as_chunks_mut();
    if orders.iter().all(|order| [TYPE, IEEE_754].contains(order)) {
        orders.fill(TYPE);
    }
}

fn file(schema: &SchemaRef) -> Result<SerializedFileWriter<Vec<u8>>, ArrowError> {
    let mut properties = properties(schema)?;
    // The types and metadata of Arrow that Parquet does not have.
    add_encoded_arrow_schema_to_metadata(schema, &mut properties);
    let columns = ArrowSchemaConverter::new().convert(schema)?;
    Ok(SerializedFileWriter::new(vec![], columns.root_schema_ptr(), Arc::new(properties))?)
}

/// Settings that suit sensor data: no dictionaries, floats split into their bytes, integers as differences.
fn properties(schema: &SchemaRef) -> Result<WriterProperties, ArrowError> {
    let mut properties = WriterProperties::builder()
        .set_compression(Compression::ZSTD(ZstdLevel::try_new(LEVEL)?))
        .set_dictionary_enabled(false)
        .set_statistics_enabled(EnabledStatistics::None)
        .set_offset_index_disabled(true)
        .set_data_page_size_limit(PAGE_SIZE)
        .set_data_page_row_count_limit(PAGE_SIZE);
    for field in schema.fields() {
        let path = ColumnPath::new(vec![field.name().clone()]);
        let encoding = match field.data_type() {
            DataType::Float32 | DataType::Float64 => Encoding::BYTE_STREAM_SPLIT,
            DataType::Int32 | DataType::Int64 | DataType::UInt32 | DataType::UInt64 => Encoding::DELTA_BINARY_PACKED,
            _ => Encoding::PLAIN,
        };
        properties = properties.set_column_encoding(path.clone(), encoding);
        if is_selecting(field) {
            properties = properties.set_column_statistics_enabled(path, EnabledStatistics::Chunk);
        }
    }
    Ok(properties.build())
}

/// Whether queries select rows by this column. Only such a column has statistics.
fn is_selecting(field: &Field) -> bool {
    SELECTING.contains(&field.name().as_str()) || matches!(field.data_type(), DataType::Timestamp(..))
}
