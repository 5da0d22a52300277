//! MCAP files.

use std::collections::BTreeMap;
use std::sync::Mutex;

use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;

use super::array::hand_over;
use super::convert::detached;
use crate::message_file::{self, Bodies, Compression, Rows, Topic};

/// Messages of a topic: the topic, their samples, the head, the place of the time stamp in it, the bodies and their ends.
type PyRows<'py> = (
    usize,
    PyReadonlyArray1<'py, i64>,
    Vec<u8>,
    Option<usize>,
    PyReadonlyArray1<'py, u8>,
    Option<PyReadonlyArray1<'py, u64>>,
);

/// Bytes of a file: a read-only array.
type Bytes<'py> = Bound<'py, PyArray1<u8>>;

/// Makes an MCAP file of messages; the caller writes its bytes.
#[pyclass(module = "xbus._core", frozen)]
pub struct MessageFile(Mutex<message_file::MessageFile>);

#[pymethods]
#[allow(clippy::needless_pass_by_value)] // what PyO3 extracts
impl MessageFile {
    #[new]
    fn new(
        py: Python<'_>,
        compression: Compression,
        metadata: Vec<(String, BTreeMap<String, String>)>,
    ) -> PyResult<Self> {
        let library = concat!("xbus ", env!("CARGO_PKG_VERSION"));
        let file = detached(py, || message_file::MessageFile::new(compression, library, &metadata))??;
        Ok(Self(Mutex::new(file)))
    }

    fn declare(
        &self,
        py: Python<'_>,
        name: String,
        schema: String,
        definition: String,
        metadata: BTreeMap<String, String>,
    ) -> PyResult<usize> {
        self.with(py, |file| file.declare(Topic { name, schema, definition, metadata }))
    }

    #[getter]
    fn counts(&self, py: Python<'_>) -> PyResult<Vec<u64>> {
        self.with(py, |file| file.counts())
    }

    fn write<'py>(
        &self,
        py: Python<'py>,
        first: i64,
        stamps: PyReadonlyArray1<'py, i64>,
        log_times: PyReadonlyArray1<'py, u64>,
        rows: Vec<PyRows<'py>>,
    ) -> PyResult<Bytes<'py>> {
        let rows = rows.iter().map(of_python).collect::<PyResult<Vec<_>>>()?;
        let (stamps, log_times) = (stamps.as_slice()?, log_times.as_slice()?);
        let bytes = self.with(py, |file| file.write(first, stamps, log_times, &rows).map(|()| file.take()))??;
        Ok(hand_over(py, bytes))
    }

    fn finish<'py>(&self, py: Python<'py>) -> PyResult<Bytes<'py>> {
        let bytes = self.with(py, message_file::MessageFile::finish)??;
        Ok(hand_over(py, bytes))
    }
}

impl MessageFile {
    fn with<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut message_file::MessageFile) -> T + Send,
    ) -> PyResult<T> {
        detached(py, || {
            let mut file = self.0.lock().map_err(|_| PyRuntimeError::new_err("writing has failed before"))?;
            Ok(work(&mut file))
        })?
    }
}

fn of_python<'a>((topic, sample, head, stamp, bytes, ends): &'a PyRows<'_>) -> PyResult<Rows<'a>> {
    let bytes = bytes.as_slice()?;
    let body = match ends {
        Some(ends) => Bodies::Ends(bytes, ends.as_slice()?),
        None => Bodies::Even(bytes),
    };
    Ok(Rows { topic: *topic, sample: sample.as_slice()?, head, stamp: *stamp, body })
}
