//! Tables, handed over by the Arrow C stream interface.

use std::ffi::CStr;
use std::sync::Arc;

use arrow_array::ffi_stream::FFI_ArrowArrayStream;
use numpy::PyReadonlyArray1;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyCapsule;

use super::column::Column;
use super::log::Part;
use crate::arrow::Table;

/// The name that the Arrow PyCapsule interface asks for.
const CAPSULE: &CStr = c"arrow_array_stream";

/// A table; its batches are made when a consumer asks for them.
#[pyclass(module = "xbus._core", frozen)]
pub struct ArrowStream(Table);

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

    /// The interface lets a producer ignore the schema that is requested.
    #[pyo3(signature = (requested_schema=None))]
    fn __arrow_c_stream__<'py>(
        &self,
        py: Python<'py>,
        requested_schema: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyCapsule>> {
        let _ = requested_schema;
        let batches = py.detach(|| self.0.batches());
        PyCapsule::new_with_value(py, FFI_ArrowArrayStream::new(Box::new(batches)), CAPSULE)
    }
}

impl ArrowStream {
    fn of(table: Table, host: Option<PyReadonlyArray1<'_, f64>>, raw: bool) -> PyResult<Self> {
        let table = if raw { table.raw() } else { table };
        match host {
            Some(host) => Ok(Self(table.with_host_times(host.as_array().to_vec())?)),
            None => Ok(Self(table)),
        }
    }
}
