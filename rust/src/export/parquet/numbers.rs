//! Columns of numbers without nulls: most of a log.
//!
//! The pages are those that the crate makes with the same settings, in less than half of the time: no list of the rows that
//! have a value, no buffers that grow, and loops that the compiler vectorises.

use std::io;

use arrow_array::cast::AsArray;
use arrow_array::types::{
    ArrowPrimitiveType, Float32Type, Float64Type, Int8Type, Int16Type, Int32Type, Int64Type, TimestampNanosecondType,
    UInt8Type, UInt16Type, UInt32Type, UInt64Type,
};
use arrow_array::{Array, ArrayRef};
use arrow_schema::{DataType, TimeUnit};
use parquet::basic::{Compression, Encoding, ZstdLevel};
use parquet::column::page::{CompressedPage, Page, PageWriter};
use parquet::errors::Result;
use parquet::file::metadata::ColumnChunkMetaData;
use parquet::file::statistics::{Statistics, ValueStatistics};
use parquet::file::writer::{SerializedPageWriter, TrackedWrite};
use parquet::schema::types::ColumnDescPtr;
use zstd::bulk::Compressor;

use super::delta::{self, Integer};
use super::{LEVEL, PAGE_SIZE, signed};

/// What all columns of a row group use, one after the other.
pub struct Scratch {
    compressor: Compressor<'static>,
    page: Vec<u8>,
}

impl Scratch {
    pub fn new() -> io::Result<Self> {
        Ok(Self { compressor: Compressor::new(LEVEL)?, page: vec![] })
    }
}

/// Appends the pages of a column that consists of these arrays to a row group, and returns what the footer has of it, with
/// offsets that count from the column's first byte. Returns `None` if these are no numbers or have nulls, or for
/// statistics that must be made of NaN.
pub fn encode(
    column: &ColumnDescPtr,
    arrays: &[&ArrayRef],
    has_statistics: bool,
    group: &mut Vec<u8>,
    scratch: &mut Scratch,
) -> Result<Option<ColumnChunkMetaData>> {
    let Some(first) = arrays.first() else { return Ok(None) };
    if arrays.iter().any(|array| array.data_type() != first.data_type() || array.null_count() > 0) {
        return Ok(None);
    }
    let mut chunk = Chunk { column, group, scratch, statistics: None };
    if has_statistics {
        chunk.statistics = match first.data_type() {
            DataType::Float64 => range_of_floats(&parts::<Float64Type>(arrays)),
            DataType::Int64 => Some(range_of_integers(&parts::<Int64Type>(arrays))),
            DataType::Timestamp(TimeUnit::Nanosecond, _) => {
                Some(range_of_integers(&parts::<TimestampNanosecondType>(arrays)))
            }
            _ => None,
        };
        if chunk.statistics.is_none() {
            return Ok(None);
        }
    }
    let metadata = match first.data_type() {
        DataType::Float32 => chunk.floats(&parts::<Float32Type>(arrays), |value, byte| value.to_le_bytes()[byte]),
        DataType::Float64 => chunk.floats(&parts::<Float64Type>(arrays), |value, byte| value.to_le_bytes()[byte]),
        DataType::UInt8 => chunk.integers(&parts::<UInt8Type>(arrays), i32::from),
        DataType::Int8 => chunk.integers(&parts::<Int8Type>(arrays), i32::from),
        DataType::UInt16 => chunk.integers(&parts::<UInt16Type>(arrays), i32::from),
        DataType::Int16 => chunk.integers(&parts::<Int16Type>(arrays), i32::from),
        DataType::UInt32 => chunk.integers(&parts::<UInt32Type>(arrays), u32::cast_signed),
        DataType::Int32 => chunk.integers(&parts::<Int32Type>(arrays), |value| value),
        DataType::UInt64 => chunk.integers(&parts::<UInt64Type>(arrays), u64::cast_signed),
        DataType::Int64 => chunk.integers(&parts::<Int64Type>(arrays), |value| value),
        DataType::Timestamp(TimeUnit::Nanosecond, _) => {
            chunk.integers(&parts::<TimestampNanosecondType>(arrays), |value| value)
        }
        _ => return Ok(None),
    };
    metadata.map(Some)
}

fn parts<'a, T: ArrowPrimitiveType>(arrays: &[&'a ArrayRef]) -> Vec<&'a [T::Native]> {
    arrays.iter().map(|array| &array.as_primitive::<T>().values()[..]).collect()
}

/// A column of a row group.
struct Chunk<'a> {
    column: &'a ColumnDescPtr,
    group: &'a mut Vec<u8>,
    scratch: &'a mut Scratch,
    statistics: Option<Statistics>,
}

impl Chunk<'_> {
    /// `byte_of` is one byte of a value, the lowest first.
    fn floats<T: Copy>(self, parts: &[&[T]], byte_of: impl Fn(T, usize) -> u8) -> Result<ColumnChunkMetaData> {
        self.pages(parts, Encoding::BYTE_STREAM_SPLIT, |slices, rows, start, page| {
            page.resize(start + rows * size_of::<T>(), 0);
            split(slices, rows, &byte_of, &mut page[start..]);
        })
    }

    fn integers<T: Copy, I: Integer>(self, parts: &[&[T]], stored: impl Fn(T) -> I) -> Result<ColumnChunkMetaData> {
        let mut values = vec![];
        self.pages(parts, Encoding::DELTA_BINARY_PACKED, |slices, _, start, page| {
            page.truncate(start);
            values.clear();
            slices.for_each(|slice| values.extend(slice.iter().map(|value| stored(*value))));
            delta::append(&values, page);
        })
    }

    /// `write` writes the rows of a page from a byte on. What the page has there is from the page before: to fill it with
    /// zeros again takes time.
    fn pages<'a, T>(
        self,
        parts: &'a [&'a [T]],
        encoding: Encoding,
        mut write: impl FnMut(&mut dyn Iterator<Item = &'a [T]>, usize, usize, &mut Vec<u8>),
    ) -> Result<ColumnChunkMetaData> {
        let rows: usize = parts.iter().map(|part| part.len()).sum();
        let mut sink = TrackedWrite::new(self.group);
        let Scratch { compressor, page } = self.scratch;
        let (mut compressed_size, mut size) = (0, 0);
        for (first, end) in pages_of(rows, PAGE_SIZE / size_of::<T>()) {
            let levels = if self.column.max_def_level() > 0 { no_nulls(end - first) } else { vec![] };
            page.resize(page.len().max(levels.len()), 0);
            page[..levels.len()].copy_from_slice(&levels);
            write(&mut slices(parts, first, end), end - first, levels.len(), page);
            #[allow(clippy::cast_possible_truncation)] // values of a page
            let data = Page::DataPage {
                buf: compressor.compress(page)?.into(),
                num_values: (end - first) as u32,
                encoding,
                def_level_encoding: Encoding::RLE,
                rep_level_encoding: Encoding::RLE,
                statistics: None,
            };
            let written = SerializedPageWriter::new(&mut sink).write_page(CompressedPage::new(data, page.len()))?;
            compressed_size += written.compressed_size;
            size += written.uncompressed_size;
        }
        sink.into_inner()?;
        let mut metadata = ColumnChunkMetaData::builder(self.column.clone())
            .set_compression(Compression::ZSTD(ZstdLevel::try_new(LEVEL)?))
            .set_encodings(vec![Encoding::RLE, encoding])
            .set_num_values(signed(rows))
            .set_data_page_offset(0)
            .set_total_compressed_size(signed(compressed_size))
            .set_total_uncompressed_size(signed(size));
        if let Some(statistics) = self.statistics {
            metadata = metadata.set_statistics(statistics);
        }
        metadata.build()
    }
}

/// The least and the greatest value; `None` if a value is NaN. As for the crate, -0 is less than 0.
fn range_of_floats(parts: &[&[f64]]) -> Option<Statistics> {
    // The order of these integers is that of the floats: the other bits of a negative one count backwards.
    let key = |bits: i64| bits ^ ((bits >> 63) & i64::MAX);
    let ordered = |value: &f64| key(value.to_bits().cast_signed());
    let float = |at: i64| f64::from_bits(key(at).cast_unsigned());
    let is_nan = parts.iter().any(|part| part.iter().fold(false, |any, value| any | value.is_nan()));
    let least = parts.iter().filter_map(|part| part.iter().map(ordered).min()).min().map(float);
    let greatest = parts.iter().filter_map(|part| part.iter().map(ordered).max()).max().map(float);
    let statistics = ValueStatistics::new(least, greatest, None, Some(0), false).with_nan_count(Some(0));
    (!is_nan).then(|| statistics.with_backwards_compatible_min_max(true).into())
}

/// The least and the greatest value.
fn range_of_integers(parts: &[&[i64]]) -> Statistics {
    let least = parts.iter().filter_map(|part| part.iter().min()).min().copied();
    let greatest = parts.iter().filter_map(|part| part.iter().max()).max().copied();
    ValueStatistics::new(least, greatest, None, Some(0), false).with_backwards_compatible_min_max(true).into()
}

/// Where each page begins and ends.
fn pages_of(rows: usize, most: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..rows).step_by(most).map(move |first| (first, rows.min(first + most)))
}

/// What the parts have from row `first` to `end` of the whole.
fn slices<'a, T>(parts: &'a [&'a [T]], first: usize, end: usize) -> impl Iterator<Item = &'a [T]> {
    let mut at = 0;
    parts.iter().map(move |part| {
        let within = |row: usize| row.clamp(at, at + part.len()) - at;
        let slice = &part[within(first)..within(end)];
        at += part.len();
        slice
    })
}

/// The definition levels of a page of a nullable column without nulls: a run of ones, and the size of it before.
fn no_nulls(rows: usize) -> Vec<u8> {
    let mut run = vec![];
    delta::varint(&mut run, (rows as u64) << 1);
    run.push(1);
    let mut levels = vec![run.len().to_le_bytes()[0], 0, 0, 0];
    levels.extend(run);
    levels
}

/// `BYTE_STREAM_SPLIT`: the first byte of every value, then the second one of every value, and so on.
fn split<'a, T: Copy + 'a>(
    slices: impl Iterator<Item = &'a [T]>,
    rows: usize,
    byte_of: impl Fn(T, usize) -> u8,
    streams: &mut [u8],
) {
    /// Values that stay in the first-level cache until all of their bytes are copied.
    const BLOCK: usize = 1 << 10;
    let mut at = 0;
    for block in slices.flat_map(|slice| slice.chunks(BLOCK)) {
        for byte in 0..size_of::<T>() {
            let stream = &mut streams[byte * rows + at..][..block.len()];
            stream.iter_mut().zip(block).for_each(|(out, value)| *out = byte_of(*value, byte));
        }
        at += block.len();
    }
}
