//! Names and errors, from and to Python.

use std::convert::Infallible;
use std::io;
use std::path::PathBuf;

use arrow_schema::ArrowError;
use pyo3::exceptions::{PyMemoryError, PyOSError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyString;

use crate::catch::{Caught, catch};
use crate::error::{CanError, EncodeError, Fault, HostTimesError, OutputError, ReadError, ShapeError, StateError};
use crate::export::Format;
use crate::input::FileError;
use crate::message_file::{Compression, MessageError};
use crate::packet::{Coordinates, Precision};
use crate::table::{self, Axes, Class, ClockRole, Direction, Interpolation, Quantity, Series, Wire};
use crate::{hostclock, scan};

pyo3::import_exception!(xbus.errors, DecodeError);
pyo3::import_exception!(xbus.errors, XbusError);

/// Number of an error of input that the system did not report.
const EIO: i32 = 5;

/// Does work without the GIL. A panic or lack of memory becomes an exception: every function that looks at bytes of others
/// does so in here.
pub fn detached<T: Send>(py: Python<'_>, work: impl FnOnce() -> T + Send) -> PyResult<T> {
    Ok(py.detach(|| catch(work))?)
}

impl From<Caught> for PyErr {
    fn from(caught: Caught) -> Self {
        let text = caught.to_string();
        match caught {
            Caught::OutOfMemory => PyMemoryError::new_err(text),
            Caught::Panic(_) => XbusError::new_err(text),
        }
    }
}

impl From<Fault> for PyErr {
    fn from(fault: Fault) -> Self {
        DecodeError::new_err((fault.to_string(), fault.offset(), fault.data_id()))
    }
}

impl From<ReadError> for PyErr {
    fn from(error: ReadError) -> Self {
        match error {
            ReadError::Io(error) => io_error(error),
            ReadError::Fault(fault) => fault.into(),
        }
    }
}

macro_rules! value_errors {
    ($($error:ty),+) => {$(
        impl From<$error> for PyErr {
            fn from(error: $error) -> Self {
                PyValueError::new_err(error.to_string())
            }
        }
    )+};
}

value_errors!(CanError, EncodeError, HostTimesError, MessageError, OutputError, ShapeError, StateError);

/// An error of the system as the exception that Python would raise: with its number and, if there is one, the file.
pub fn os_error(error: &io::Error, path: Option<PathBuf>) -> PyErr {
    let Some(number) = error.raw_os_error() else { return PyRuntimeError::new_err(error.to_string()) };
    let text = error.to_string();
    let text = text.split(" (os error").next().unwrap_or_default().to_owned();
    PyOSError::new_err((number, text, path.map(PathBuf::into_os_string)))
}

/// An error of an input as an exception, with the file if the error names one. One that Python raised stays as it is.
pub fn io_error(error: io::Error) -> PyErr {
    match error.downcast::<FileError>() {
        Ok(FileError { path, error }) if error.raw_os_error().is_some() => os_error(&error, Some(path)),
        Ok(FileError { path, error }) => PyOSError::new_err((EIO, error.to_string(), path.into_os_string())),
        Err(error) => error.into(),
    }
}

/// An error of Arrow: a table that cannot be made or written.
#[allow(clippy::needless_pass_by_value)] // for map_err
pub fn arrow_error(error: ArrowError) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// Enums become their names in Python.
macro_rules! to_names {
    ($($name:path, of $enum:ty;)+) => {$(
        impl<'py> IntoPyObject<'py> for $enum {
            type Target = PyString;
            type Output = Bound<'py, PyString>;
            type Error = Infallible;

            fn into_pyobject(self, py: Python<'py>) -> Result<Self::Output, Infallible> {
                $name(self).into_pyobject(py)
            }
        }
    )+};
}

to_names! {
    Class::label, of Class;
    Axes::name, of Axes;
    ClockRole::name, of ClockRole;
    Interpolation::name, of Interpolation;
    Coordinates::name, of Coordinates;
    Direction::name, of Direction;
    Precision::name, of Precision;
    Series::label, of Series;
    Wire::numpy, of Wire;
    hostclock::Reason::text, of hostclock::Reason;
    scan::Reason::name, of scan::Reason;
}

/// Names from Python become enums.
macro_rules! from_names {
    ($($enum:ty),+) => {$(
        impl FromPyObject<'_, '_> for $enum {
            type Error = PyErr;

            fn extract(name: Borrowed<'_, '_, PyAny>) -> PyResult<Self> {
                let name: &str = name.extract()?;
                Self::ALL.into_iter().find(|variant| variant.name() == name).ok_or_else(|| {
                    PyValueError::new_err(format!("{name:?} is none of {}", Self::ALL.map(Self::name).join(", ")))
                })
            }
        }
    )+};
}

from_names!(Compression, Coordinates, Format, Precision);

/// The quantity of a name.
impl FromPyObject<'_, '_> for &'static Quantity {
    type Error = PyErr;

    fn extract(name: Borrowed<'_, '_, PyAny>) -> PyResult<Self> {
        let name: &str = name.extract()?;
        table::quantity_named(name)
            .ok_or_else(|| PyValueError::new_err(format!("no quantity is called {name:?}; xbus quantities lists them")))
    }
}
