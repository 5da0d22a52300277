//! Parquet files.

mod delta;
mod numbers;

use std::io;
use std::sync::{Arc, Mutex, PoisonError};

use arrow_array::{ArrayRef, RecordBatch};
use arrow_schema::{ArrowError, DataType, Field, SchemaRef};
use bytes::Bytes;
use parquet::arrow::ArrowSchemaConverter;
use parquet::arrow::add_encoded_arrow_schema_to_metadata;
use parquet::arrow::arrow_writer::{ArrowColumnWriter, ArrowRowGroupWriterFactory, compute_leaves};
use parquet::basic::{Compression, Encoding, ZstdLevel};
use parquet::column::page_store::{PageKey, PageStore, PageStoreArgs, PageStoreFactory};
use parquet::errors::ParquetError;
use parquet::file::metadata::{
    ColumnChunkMetaData, FileMetaData, ParquetMetaData, ParquetMetaDataWriter, RowGroupMetaData,
};
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::{ColumnPath, SchemaDescPtr, SchemaDescriptor};

use super::row_size;

/// Columns by which queries select rows, beside points in time. Only these have statistics: the range of an
/// acceleration over a row group does not let a query skip any.
const SELECTING: [&str; 3] = ["sample", "time", "host_time"];

/// Bytes of the values of a page, at most.
const PAGE_SIZE: usize = 1 << 20;
/// Level of zstd. Level 3 takes 1.6 times as long for 1 % less.
const LEVEL: i32 = 1;
/// The bytes that a file begins with.
pub const MAGIC: &[u8] = b"PAR1";

/// A row group as the file has it.
pub struct RowGroup {
    rows: usize,
    bytes: Vec<u8>,
    /// What the footer has of each column. Offsets count from the beginning of the row group.
    columns: Vec<ColumnChunkMetaData>,
}

/// Encodes row groups.
pub struct Encoder {
    schema: SchemaRef,
    /// The file that the crate's writers of columns take their settings from. Nothing is written to it.
    file: SerializedFileWriter<io::Sink>,
}

impl Encoder {
    pub fn new(schema: &SchemaRef) -> Result<Self, ArrowError> {
        Ok(Self { schema: schema.clone(), file: file(schema)? })
    }

    /// Encodes one column after the other, so that little more than the result is in memory.
    pub fn encode(&self, batches: &[RecordBatch]) -> Result<RowGroup, ArrowError> {
        let rows: usize = batches.iter().map(RecordBatch::num_rows).sum();
        let bytes = Vec::with_capacity(rows * row_size(&self.schema));
        let mut group = RowGroup { rows, bytes, columns: vec![] };
        let mut scratch = numbers::Scratch::new()?;
        let (pages, mut writers) = (Pages::default(), vec![]);
        for (index, field) in self.schema.fields().iter().enumerate() {
            let descr = self.file.schema_descr().column(index);
            let arrays: Vec<_> = batches.iter().map(|batch| batch.column(index)).collect();
            let start = group.bytes.len();
            let numbers = numbers::encode(&descr, &arrays, is_selecting(field), &mut group.bytes, &mut scratch)?;
            let metadata = if let Some(metadata) = numbers {
                metadata
            } else {
                if writers.is_empty() {
                    writers = self.writers(&pages)?;
                }
                let writer = writers[index].take().expect("each column is encoded once");
                pages.encode(writer, field, &arrays, &mut group.bytes)?
            };
            group.columns.push(moved(metadata, start)?);
        }
        Ok(group)
    }

    /// The crate's writers of the columns. Each has a compressor, which takes time and memory to make.
    fn writers(&self, pages: &Pages) -> Result<Vec<Option<ArrowColumnWriter>>, ParquetError> {
        let factory = ArrowRowGroupWriterFactory::new(&self.file, self.schema.clone());
        let writers = factory.with_page_store_factory(Arc::new(pages.clone())).create_column_writers(0)?;
        Ok(writers.into_iter().map(Some).collect())
    }
}

/// What the footer has of a column whose pages are moved by some bytes. There are no pages of dictionaries.
fn moved(metadata: ColumnChunkMetaData, bytes: usize) -> Result<ColumnChunkMetaData, ParquetError> {
    let offset = metadata.data_page_offset() + signed(bytes);
    metadata.into_builder().set_data_page_offset(offset).build()
}

fn signed(number: usize) -> i64 {
    i64::try_from(number).unwrap_or(i64::MAX)
}

/// The pages that the crate makes of a column, from where they are taken without a file.
#[derive(Clone, Debug, Default)]
struct Pages(Arc<Mutex<Vec<Bytes>>>);

impl Pages {
    /// Appends the pages of a column to the row group, and returns what the footer has of it.
    fn encode(
        &self,
        mut writer: ArrowColumnWriter,
        field: &Field,
        arrays: &[&ArrayRef],
        group: &mut Vec<u8>,
    ) -> Result<ColumnChunkMetaData, ParquetError> {
        for array in arrays {
            for leaf in compute_leaves(field, array)? {
                writer.write(&leaf)?;
            }
        }
        let chunk = writer.close()?;
        self.0.lock().unwrap_or_else(PoisonError::into_inner).drain(..).for_each(|page| group.extend(page));
        Ok(chunk.close().metadata.clone())
    }
}

impl PageStoreFactory for Pages {
    fn create(&self, _: &PageStoreArgs<'_>) -> Result<Box<dyn PageStore>, ParquetError> {
        Ok(Box::new(self.clone()))
    }
}

impl PageStore for Pages {
    fn put(&mut self, page: Bytes) -> Result<PageKey, ParquetError> {
        let mut pages = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        pages.push(page);
        Ok(PageKey::new(pages.len() as u64 - 1))
    }

    fn take(&mut self, _: PageKey) -> Result<Bytes, ParquetError> {
        Err(ParquetError::General("pages are taken by `Pages::encode`".to_owned()))
    }
}

/// Joins row groups to a file.
pub struct Writer {
    file: SerializedFileWriter<io::Sink>,
    schema: SchemaDescPtr,
    /// Number of bytes so far.
    size: usize,
    groups: Vec<RowGroupMetaData>,
}

impl Writer {
    pub fn new(schema: &SchemaRef) -> Result<Self, ArrowError> {
        let file = file(schema)?;
        let schema = SchemaDescriptor::new(file.schema_descr().root_schema_ptr()).into();
        Ok(Self { file, schema, size: MAGIC.len(), groups: vec![] })
    }

    pub fn append(&mut self, group: RowGroup) -> Result<Vec<u8>, ArrowError> {
        let columns =
            group.columns.into_iter().map(|column| moved(column, self.size)).collect::<Result<Vec<_>, _>>()?;
        let metadata = RowGroupMetaData::builder(self.schema.clone())
            .set_num_rows(signed(group.rows))
            .set_total_byte_size(columns.iter().map(ColumnChunkMetaData::uncompressed_size).sum())
            .set_column_metadata(columns)
            .set_file_offset(signed(self.size))
            .build()?;
        self.groups.push(metadata);
        self.size += group.bytes.len();
        Ok(group.bytes)
    }

    /// The footer.
    pub fn finish(&mut self) -> Result<Vec<u8>, ArrowError> {
        let properties = self.file.properties();
        let groups = std::mem::take(&mut self.groups);
        let metadata = FileMetaData::new(
            properties.writer_version().as_num(),
            groups.iter().map(RowGroupMetaData::num_rows).sum(),
            Some(properties.created_by().to_owned()),
            properties.key_value_metadata().cloned(),
            self.schema.clone(),
            None,
        );
        let mut end = vec![];
        ParquetMetaDataWriter::new(&mut end, &ParquetMetaData::new(metadata, groups)).finish()?;
        declare_type_order(&mut end, self.schema.num_columns());
        Ok(end)
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

/// A file with the settings of the columns.
fn file(schema: &SchemaRef) -> Result<SerializedFileWriter<io::Sink>, ArrowError> {
    let mut properties = properties(schema)?;
    // The types and metadata of Arrow that Parquet does not have.
    add_encoded_arrow_schema_to_metadata(schema, &mut properties);
    let columns = ArrowSchemaConverter::new().convert(schema)?;
    Ok(SerializedFileWriter::new(io::sink(), columns.root_schema_ptr(), Arc::new(properties))?)
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
            other if other.is_integer() => Encoding::DELTA_BINARY_PACKED,
            DataType::Timestamp(..) => Encoding::DELTA_BINARY_PACKED,
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
