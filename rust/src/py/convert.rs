//! Names and errors, from and to Python.

use std::io;
use std::path::PathBuf;

use pyo3::exceptions::{PyOSError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;

use crate::error::{EncodeError, Fault, HostTimesError, ReadError, StateError};
use crate::packet::Coordinates;
use crate::table::{self, Quantity};

pyo3::import_exception!(xbus.errors, DecodeError);

impl From<Fault> for PyErr {
    fn from(fault: Fault) -> Self {
        DecodeError::new_err((fault.to_string(), fault.offset(), fault.data_id()))
    }
}

impl From<ReadError> for PyErr {
    fn from(error: ReadError) -> Self {
        match error {
            ReadError::Io(error) => error.into(),
            ReadError::Fault(fault) => fault.into(),
        }
    }
}

impl From<EncodeError> for PyErr {
    fn from(error: EncodeError) -> Self {
        PyValueError::new_err(error.to_string())
    }
}

impl From<HostTimesError> for PyErr {
    fn from(error: HostTimesError) -> Self {
        PyValueError::new_err(error.to_string())
    }
}

impl From<StateError> for PyErr {
    fn from(error: StateError) -> Self {
        PyValueError::new_err(error.to_string())
    }
}

/// An error of the system as the exception that Python would raise: with its number and, if there is one, the file.
pub fn os_error(error: &io::Error, path: Option<PathBuf>) -> PyErr {
    let Some(number) = error.raw_os_error() else { return PyRuntimeError::new_err(error.to_string()) };
    let text = error.to_string();
    let text = text.split(" (os error").next().unwrap_or_default().to_owned();
    PyOSError::new_err((number, text, path.map(PathBuf::into_os_string)))
}

/// The quantity of this name.
pub fn quantity(name: &str) -> PyResult<&'static Quantity> {
    table::quantity_named(name)
        .ok_or_else(|| PyValueError::new_err(format!("no quantity is called {name:?}; xbus quantities lists them")))
}

/// Finds an enum's variant by its name.
pub fn variant<T: Copy>(all: &[T], name_of: fn(T) -> &'static str, wanted: &str) -> PyResult<T> {
    all.iter().copied().find(|variant| name_of(*variant) == wanted).ok_or_else(|| {
        let known: Vec<_> = all.iter().map(|variant| name_of(*variant)).collect();
        PyValueError::new_err(format!("{wanted:?} is none of {}", known.join(", ")))
    })
}

/// A quantity to keep: its name, and a coordinate system or None for all of them.
pub type Wish = (String, Option<String>);

/// The quantities to keep; `None` for all.
pub fn wanted(wishes: Option<Vec<Wish>>) -> PyResult<Option<crate::log::Wanted>> {
    let wish = |(name, coordinates): Wish| {
        let coordinates = coordinates.map(|wanted| variant(&Coordinates::ALL, Coordinates::name, &wanted));
        Ok((quantity(&name)?, coordinates.transpose()?))
    };
    wishes.map(|wishes| wishes.into_iter().map(wish).collect()).transpose()
}
