//! Tables, handed over by the Arrow C stream interface.

use std::collections::HashMap;
use std::ffi::CStr;
use std::sync::{Arc, Mutex, PoisonError};

use arrow_array::ffi_stream::FFI_ArrowArrayStream;
use arrow_array::types::{
    ArrowPrimitiveType, Date32Type, Float32Type, Float64Type, Int8Type, Int16Type, Int32Type, Int64Type,
    Time64MicrosecondType, TimestampNanosecondType, UInt8Type, UInt16Type, UInt32Type, UInt64Type,
};
use arrow_array::{
    Array as _, ArrayRef, PrimitiveArray, RecordBatch, RecordBatchIterator, RecordBatchOptions, RecordBatchReader,
    StringArray,
};
use arrow_buffer::NullBuffer;
use arrow_schema::{ArrowError, Field, Metadata, Schema, SchemaRef};
use numpy::{Element, PyArray1, PyArrayMethods, PyReadonlyArray1, PyReadwriteArray1};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyCapsule;

use super::column::Column;
use super::convert::{arrow_error, detached};
use super::log::Part;
use crate::arrow::{Batches, Numbers, Table, with_numbers};
use crate::catch::{Caught, catch};

/// The name that the Arrow PyCapsule interface asks for.
const CAPSULE: &CStr = c"arrow_array_stream";

/// A table; its batches are made when a consumer asks for them.
#[pyclass(module = "xbus._core", frozen)]
pub struct ArrowStream(Source);

enum Source {
    /// Columns of a log.
    Log(Table),
    /// Arrays that are made already.
    Arrays(RecordBatch),
}

#[pymethods]
impl ArrowStream {
    #[staticmethod]
    #[pyo3(signature = (part, columns=None, host=None, raw=false))]
    fn wide(
        part: &Part,
        columns: Option<Vec<PyRef<'_, Column>>>,
        host: Option<PyReadonlyArray1<'_, f64>>,
        raw: bool,
    ) -> PyResult<Self> {
        let chosen = match columns {
            Some(columns) if columns.iter().any(|column| !Arc::ptr_eq(&column.part, &part.0)) => {
                return Err(PyValueError::new_err("the columns of a table must come from one log"));
            }
            Some(columns) => columns.iter().map(|column| column.index).collect(),
            None => (0..part.0.part.columns.len()).collect(),
        };
        Self::of(Table::wide(part.0.clone(), chosen), host, raw)
    }

    #[staticmethod]
    #[pyo3(signature = (column, host=None, raw=false))]
    fn rows(column: &Column, host: Option<PyReadonlyArray1<'_, f64>>, raw: bool) -> PyResult<Self> {
        Self::of(Table::rows(column.part.clone(), column.index), host, raw)
    }

    #[staticmethod]
    fn arrays(columns: Vec<ArrayColumn<'_>>) -> PyResult<Self> {
        let mut fields = vec![];
        let mut arrays = vec![];
        for column in columns {
            let array = column.array()?;
            let field = Field::new(column.name, array.data_type().clone(), true);
            fields.push(field.with_metadata(column.metadata.into_iter().collect::<Metadata>()));
            arrays.push(array);
        }
        let rows = arrays.first().map_or(0, |array: &ArrayRef| array.len());
        let options = RecordBatchOptions::new().with_row_count(Some(rows));
        let schema = Arc::new(Schema::new(fields));
        let batch = RecordBatch::try_new_with_options(schema, arrays, &options).map_err(arrow_error)?;
        Ok(Self(Source::Arrays(batch)))
    }

    /// The interface lets a producer ignore the schema that is requested.
    #[pyo3(signature = (requested_schema=None))]
    fn __arrow_c_stream__<'py>(
        &self,
        py: Python<'py>,
        requested_schema: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyCapsule>> {
        let _ = requested_schema;
        let batches = caught(detached(py, || self.made())?);
        PyCapsule::new_with_value(py, FFI_ArrowArrayStream::new(Box::new(batches)), CAPSULE)
    }

    fn select(&self, py: Python<'_>, names: Vec<String>) -> PyResult<Self> {
        match &self.0 {
            Source::Log(table) => {
                Ok(Self(Source::Log(detached(py, move || table.select(&names))?.map_err(arrow_error)?)))
            }
            Source::Arrays(_) => Err(PyTypeError::new_err("columns can be selected from the table of a log")),
        }
    }

    fn write(&self, py: Python<'_>, mut arrays: Vec<WritableArray<'_>>) -> PyResult<()> {
        let Source::Log(table) = &self.0 else {
            return Err(PyTypeError::new_err("only the table of a log can be written to arrays"));
        };
        let mut columns = arrays.iter_mut().map(WritableArray::numbers).collect::<PyResult<Vec<_>>>()?;
        detached(py, || table.write(&mut columns))?.map_err(arrow_error)
    }

    #[getter]
    fn row_count(&self, py: Python<'_>) -> PyResult<usize> {
        detached(py, || match &self.0 {
            Source::Log(table) => table.row_count(),
            Source::Arrays(batch) => batch.num_rows(),
        })
    }

    #[getter]
    fn columns(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        Ok(detached(py, || self.schema())?.fields().iter().map(|field| field.name().clone()).collect())
    }

    fn batches(&self, py: Python<'_>) -> PyResult<BatchIterator> {
        Ok(BatchIterator(Mutex::new(detached(py, || self.made())?)))
    }
}

impl ArrowStream {
    fn of(table: Table, host: Option<PyReadonlyArray1<'_, f64>>, raw: bool) -> PyResult<Self> {
        let table = if raw { table.raw() } else { table };
        match host {
            Some(host) => Ok(Self(Source::Log(table.with_host_times(host.as_array().to_vec())?))),
            None => Ok(Self(Source::Log(table))),
        }
    }

    fn made(&self) -> Batches {
        match &self.0 {
            Source::Log(table) => table.batches(),
            Source::Arrays(batch) => {
                RecordBatchIterator::new(Box::new(std::iter::once(Ok(batch.clone()))), batch.schema())
            }
        }
    }

    /// The columns of the table.
    pub fn schema(&self) -> SchemaRef {
        match &self.0 {
            Source::Log(table) => table.schema(),
            Source::Arrays(batch) => batch.schema(),
        }
    }
}

/// Batches for callers in C, where a panic would abort the process. A batch that cannot be made is an error.
fn caught(mut batches: Batches) -> impl RecordBatchReader + Send {
    let schema = batches.schema();
    let next = move || {
        catch(|| batches.next()).unwrap_or_else(|caught| {
            Some(Err(match caught {
                Caught::OutOfMemory => ArrowError::MemoryError(caught.to_string()),
                Caught::Panic(_) => ArrowError::ExternalError(Box::new(caught)),
            }))
        })
    };
    RecordBatchIterator::new(std::iter::from_fn(next), schema)
}

/// Rows of a table.
#[pyclass(module = "xbus._core", frozen)]
pub struct Batch(pub RecordBatch);

#[pymethods]
impl Batch {
    fn __len__(&self) -> usize {
        self.0.num_rows()
    }

    fn rows(&self, first: usize, end: usize) -> PyResult<Self> {
        if first > end || end > self.0.num_rows() {
            return Err(PyValueError::new_err(format!("rows {first} to {end} of {}", self.0.num_rows())));
        }
        Ok(Self(self.0.slice(first, end - first)))
    }
}

/// The batches of a table, one by one.
#[pyclass(module = "xbus._core", frozen)]
pub struct BatchIterator(Mutex<Batches>);

#[pymethods]
impl BatchIterator {
    fn __iter__(slf: PyRef<'_, Self>) -> PyRef<'_, Self> {
        slf
    }

    fn __next__(&self, py: Python<'_>) -> PyResult<Option<Batch>> {
        let next = detached(py, || self.0.lock().unwrap_or_else(PoisonError::into_inner).next())?;
        next.transpose().map(|batch| batch.map(Batch)).map_err(arrow_error)
    }
}

/// Arrays of Python that may be written, by their type.
macro_rules! writable_arrays {
    ($($variant:ident $number:ty),+ $(,)?) => {
        /// Memory for a column.
        enum WritableArray<'py> {
            $($variant(PyReadwriteArray1<'py, $number>),)+
        }

        impl<'py> FromPyObject<'_, 'py> for WritableArray<'py> {
            type Error = PyErr;

            // The derived implementation makes an exception for each type that does not fit.
            fn extract(array: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
                $(if let Ok(array) = array.cast::<PyArray1<$number>>() {
                    return Ok(Self::$variant(array.try_readwrite()?));
                })+
                Err(PyTypeError::new_err("no array of numbers with one dimension"))
            }
        }

        impl WritableArray<'_> {
            fn numbers(&mut self) -> PyResult<Numbers<'_>> {
                Ok(match self {
                    $(Self::$variant(array) => Numbers::$variant(array.as_slice_mut()?),)+
                })
            }
        }
    };
}

with_numbers!(writable_arrays);

/// A column of a table as Python has it.
#[derive(FromPyObject)]
struct ArrayColumn<'py> {
    #[pyo3(item)]
    name: String,
    /// What its numbers are: `"number"`, `"datetime"`, `"time"` or `"date"`; or `"text"`.
    #[pyo3(item)]
    kind: String,
    #[pyo3(item)]
    values: Bound<'py, PyAny>,
    /// Which rows are null.
    #[pyo3(item)]
    mask: Option<PyReadonlyArray1<'py, bool>>,
    #[pyo3(item)]
    metadata: HashMap<String, String>,
}

impl ArrayColumn<'_> {
    fn array(&self) -> PyResult<ArrayRef> {
        let array: ArrayRef = match self.kind.as_str() {
            "datetime" => Arc::new(self.numbers::<TimestampNanosecondType>()?.with_timezone("UTC")),
            "time" => Arc::new(self.numbers::<Time64MicrosecondType>()?),
            "date" => Arc::new(self.numbers::<Date32Type>()?),
            "text" => Arc::new(StringArray::from(self.values.extract::<Vec<Option<String>>>()?)),
            _ => self.number()?,
        };
        Ok(array)
    }

    fn number(&self) -> PyResult<ArrayRef> {
        macro_rules! try_each {
            ($($kind:ty),+) => {$(
                if let Ok(array) = self.numbers::<$kind>() {
                    return Ok(Arc::new(array));
                }
            )+};
        }
        try_each!(UInt8Type, UInt16Type, UInt32Type, UInt64Type, Int8Type, Int16Type, Int32Type, Int64Type);
        try_each!(Float32Type, Float64Type);
        Err(PyTypeError::new_err(format!("{} is no array of numbers", self.name)))
    }

    fn numbers<T: ArrowPrimitiveType<Native: Element>>(&self) -> PyResult<PrimitiveArray<T>> {
        let values: PyReadonlyArray1<'_, T::Native> = self.values.extract()?;
        let nulls =
            self.mask.as_ref().map(|mask| mask.as_array().iter().map(|is_null| !is_null).collect::<NullBuffer>());
        PrimitiveArray::try_new(values.as_array().to_vec().into(), nulls).map_err(arrow_error)
    }
}
