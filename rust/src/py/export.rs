//! Files of tables.

use std::sync::{Mutex, PoisonError};

use arrow_array::{Array as _, ArrayRef, RecordBatch};
use numpy::PyArray1;
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;

use super::array::hand_over;
use super::arrow::{ArrowStream, Batch};
use super::convert::{arrow_error, detached};
use crate::catch::expect_memory;
use crate::export::{self, Format};

/// Rows that are encoded for a file.
#[pyclass(module = "xbus._core", frozen)]
pub struct Chunk {
    chunk: Mutex<Option<export::Chunk>>,
    rows: usize,
}

#[pymethods]
impl Chunk {
    fn __len__(&self) -> usize {
        self.rows
    }
}

/// More than the memory that a compressor needs, in bytes.
const COMPRESSOR_SIZE: usize = 16 << 20;

/// Bytes of the numbers of a batch. Its columns can belong to memory that is much larger.
fn size_of_rows(batch: &RecordBatch) -> usize {
    let size = |column: &ArrayRef| column.to_data().get_slice_memory_size().unwrap_or_default();
    batch.columns().iter().map(size).sum()
}

/// Bytes of a file: a read-only array.
type Bytes<'py> = Bound<'py, PyArray1<u8>>;

/// Makes a file of a table; the caller writes its bytes.
#[pyclass(module = "xbus._core", frozen)]
pub struct TableFile {
    encoder: export::Encoder,
    writer: Mutex<export::Writer>,
    #[pyo3(get)]
    chunk_rows: usize,
}

#[pymethods]
impl TableFile {
    #[new]
    fn new(py: Python<'_>, file_format: Format, table: &ArrowStream) -> PyResult<Self> {
        let schema = detached(py, || table.schema())?;
        Ok(Self {
            encoder: export::Encoder::new(file_format, schema.clone()).map_err(arrow_error)?,
            writer: Mutex::new(export::Writer::new(file_format, schema.clone()).map_err(arrow_error)?),
            chunk_rows: export::chunk_rows(file_format, &schema),
        })
    }

    fn start<'py>(&self, py: Python<'py>) -> PyResult<Bytes<'py>> {
        self.bytes(py, export::Writer::start)
    }

    #[allow(clippy::needless_pass_by_value)] // from a list
    fn encode(&self, py: Python<'_>, batches: Vec<PyRef<'_, Batch>>) -> PyResult<Chunk> {
        let batches: Vec<RecordBatch> = batches.iter().map(|batch| batch.0.clone()).collect();
        let rows = batches.iter().map(RecordBatch::num_rows).sum();
        let chunk = detached(py, || {
            expect_memory(batches.iter().map(size_of_rows).sum::<usize>() + COMPRESSOR_SIZE);
            self.encoder.encode(&batches)
        })?;
        let chunk = chunk.map_err(arrow_error)?;
        Ok(Chunk { chunk: Mutex::new(Some(chunk)), rows })
    }

    fn append<'py>(&self, py: Python<'py>, chunk: &Chunk) -> PyResult<Bytes<'py>> {
        let chunk = chunk.chunk.lock().unwrap_or_else(PoisonError::into_inner).take();
        let chunk = chunk.ok_or_else(|| PyValueError::new_err("the chunk was appended already"))?;
        self.bytes(py, |writer| writer.append(chunk))
    }

    fn finish<'py>(&self, py: Python<'py>) -> PyResult<Bytes<'py>> {
        self.bytes(py, export::Writer::finish)
    }
}

impl TableFile {
    fn bytes<'py>(
        &self,
        py: Python<'py>,
        write: impl FnOnce(&mut export::Writer) -> Result<Vec<u8>, arrow_schema::ArrowError> + Send,
    ) -> PyResult<Bytes<'py>> {
        let bytes = detached(py, || {
            let mut writer = self.writer.lock().map_err(|_| PyRuntimeError::new_err("writing has failed before"))?;
            write(&mut writer).map_err(arrow_error)
        })??;
        Ok(hand_over(py, bytes))
    }
}
