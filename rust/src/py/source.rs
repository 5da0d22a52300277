//! Sources of the bytes of a log.

use std::fs;
use std::io::{self, Read};
use std::ops::Range;
use std::path::PathBuf;

use numpy::{PyArray1, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use super::convert::io_error;
use super::shared::SharedBytes;
use crate::input::{Files, NamedFile, ReadAt, ReadFrom, Stream};

pyo3::import_exception!(io, UnsupportedOperation);

/// Bytes that never change, which are not copied; bytes that may change and that several threads read; or a stream.
pub enum Source {
    Bytes(Py<PyBytes>, Range<usize>),
    Copied(Box<dyn ReadAt>),
    Stream(Stream<Box<dyn Read + Send + Sync>>),
}

impl Source {
    /// Opens bytes, a uint8 array, a path, a list of paths of regular files, or an object with a method `read`, with its
    /// length in bytes if that is known. It is read from position `at` on, where the object stands already, by this number of
    /// threads. `check` is called with the first bytes of what is no regular file.
    pub fn open(
        source: &Bound<'_, PyAny>,
        at: u64,
        threads: usize,
        check: Option<Py<PyAny>>,
    ) -> PyResult<(Self, Option<u64>)> {
        if let Ok(bytes) = source.cast::<PyBytes>() {
            let length = bytes.as_bytes().len();
            return Ok((Self::Bytes(bytes.clone().unbind(), 0..length), Some(length as u64)));
        }
        if let Ok(array) = source.cast::<PyArray1<u8>>() {
            let shared = SharedBytes::of(array)?;
            let length = shared.size()?;
            if let Some((bytes, range)) = bytes_under(array) {
                return Ok((Self::Bytes(bytes, range), Some(length)));
            }
            return Ok((Self::of(shared, at, threads), Some(length)));
        }
        if let Ok(paths) = source.extract::<Vec<PathBuf>>() {
            let open = || Files::of(paths.into_iter().map(NamedFile::open).collect::<io::Result<_>>()?);
            let files = open().map_err(io_error)?;
            let length = files.size().map_err(io_error)?;
            return Ok((Self::of(files, at, threads), Some(length)));
        }
        let Ok(path) = source.extract::<PathBuf>() else {
            return Ok((Self::stream(PyInput::of(source, false, check), at), None));
        };
        match fs::metadata(&path) {
            Ok(metadata) if metadata.is_file() => {
                let file = NamedFile::open(path).map_err(io_error)?;
                Ok((Self::of(file, at, threads), Some(metadata.len())))
            }
            // Python's own file reacts to Ctrl-C while it waits for a pipe or a device, and names the path in its errors.
            _ => {
                let file = source.py().import("io")?.call_method1("open", (path, "rb", 0))?;
                Ok((Self::stream(PyInput::of(&file, true, check), at), None))
            }
        }
    }

    /// One thread keeps what it has read for its next step; of several, each begins at another place.
    fn of(bytes: impl ReadAt + 'static, at: u64, threads: usize) -> Self {
        if threads > 1 { Self::Copied(Box::new(bytes)) } else { Self::stream(ReadFrom::new(bytes, at), at) }
    }

    fn stream(input: impl Read + Send + Sync + 'static, at: u64) -> Self {
        Self::Stream(Stream::at(Box::new(input), at))
    }
}

/// The bytes object that a contiguous array is a view of, and the part of it, unless it is a view of something else.
fn bytes_under(array: &Bound<'_, PyArray1<u8>>) -> Option<(Py<PyBytes>, Range<usize>)> {
    let mut owner = array.clone().into_any();
    while !owner.is_instance_of::<PyBytes>() {
        owner = owner.getattr("base").or_else(|_| owner.getattr("obj")).ok()?; // of an array, of a memoryview
    }
    let bytes = owner.cast_into::<PyBytes>().ok()?;
    let from = array.data().addr().checked_sub(bytes.as_bytes().as_ptr().addr())?;
    let range = from..from + array.len();
    bytes.as_bytes().get(range.clone())?;
    Some((bytes.unbind(), range))
}

/// A Python object with a method `read`.
struct PyInput {
    object: Py<PyAny>,
    /// Whether to call `read1`, which returns what is there; `read` of a buffered file waits for all bytes.
    has_read1: bool,
    /// Whether it is closed at the end: a file that was opened here.
    is_owned: bool,
    /// What is called with the first bytes.
    check: Option<Py<PyAny>>,
}

impl PyInput {
    fn of(object: &Bound<'_, PyAny>, is_owned: bool, check: Option<Py<PyAny>>) -> Self {
        let has_read1 = object.hasattr("read1").unwrap_or(false);
        Self { object: object.clone().unbind(), has_read1, is_owned, check }
    }

    fn call<'py>(&mut self, py: Python<'py>, size: usize) -> PyResult<Bound<'py, PyAny>> {
        let object = self.object.bind(py);
        if self.has_read1 {
            let data = object.call_method1("read1", (size,));
            // A class derived from io.BufferedIOBase that defines only `read` has a `read1` that raises this.
            if !data.as_ref().is_err_and(|error| error.is_instance_of::<UnsupportedOperation>(py)) {
                return data;
            }
            self.has_read1 = false;
        }
        object.call_method1("read", (size,))
    }
}

impl Read for PyInput {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        Python::attach(|py| {
            let data = self.call(py, buffer.len())?;
            let bytes: &[u8] = data
                .extract()
                .map_err(|_| PyTypeError::new_err("read() must return bytes; open the file in binary mode"))?;
            if bytes.len() > buffer.len() {
                return Err(PyTypeError::new_err("read() returned more bytes than requested"));
            }
            if let Some(check) = self.check.take() {
                check.call1(py, (&data,))?;
            }
            buffer[..bytes.len()].copy_from_slice(bytes);
            Ok(bytes.len())
        })
        .map_err(|error: PyErr| io::Error::other(error))
    }
}

impl Drop for PyInput {
    fn drop(&mut self) {
        if self.is_owned {
            // A file that was only read has nothing to report when it is closed.
            let _ = Python::try_attach(|py| self.object.bind(py).call_method0("close").is_ok());
        }
    }
}
