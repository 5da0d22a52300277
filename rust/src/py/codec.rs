//! Single frames, messages and packets.

use numpy::{IntoPyArray, PyArray1, PyReadonlyArrayDyn, PyUntypedArray, PyUntypedArrayMethods};
use pyo3::IntoPyObjectExt;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};

use super::Row;
use crate::device;
use crate::error::EncodeError;
use crate::frame::Frame;
use crate::packet::{Coordinates, Form, Precision};
use crate::scan::{Damage, Step, Window};
use crate::table;
use crate::value::{self, Number};

impl From<EncodeError> for PyErr {
    fn from(error: EncodeError) -> Self {
        PyValueError::new_err(error.to_string())
    }
}

/// The frame that carries this message.
#[pyfunction]
pub fn encode_frame<'py>(py: Python<'py>, bid: u8, mid: u8, payload: &[u8]) -> PyResult<Bound<'py, PyBytes>> {
    Ok(PyBytes::new(py, &Frame { bid, mid, payload }.encode()?))
}

/// The MTData2 packet that carries these numbers.
#[pyfunction]
#[pyo3(signature = (name, precision, coordinates, numbers))]
pub fn encode_packet<'py>(
    py: Python<'py>,
    name: &str,
    precision: Option<&str>,
    coordinates: Option<&str>,
    numbers: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyBytes>> {
    let quantity = table::quantity_named(name)
        .ok_or_else(|| PyValueError::new_err(format!("no quantity is called {name:?}; xbus items lists them")))?;
    let precision = precision.map(named(&Precision::ALL, Precision::name)).transpose()?;
    let coordinates = coordinates.map(named(&Coordinates::ALL, Coordinates::name)).transpose()?;
    let mut packet = vec![];
    value::write_packet(&mut packet, quantity, precision, coordinates, &numbers_of(numbers)?)?;
    Ok(PyBytes::new(py, &packet))
}

/// The frames of MTData2 messages that have the same packets, and where each ends.
#[pyfunction]
pub fn encode_samples<'py>(
    py: Python<'py>,
    packets: Vec<(u16, Bound<'py, PyUntypedArray>)>,
    bid: u8,
) -> PyResult<(Bound<'py, PyBytes>, Bound<'py, PyArray1<u64>>)> {
    let rows: Vec<_> = packets.iter().map(|(_, array)| array.shape().first().copied()).collect();
    let count = rows.first().copied().flatten().unwrap_or(0);
    if rows.iter().any(|it| *it != Some(count)) {
        return Err(PyValueError::new_err("the arrays must have one row for each message, all as many"));
    }
    let packets = packets.into_iter().map(|(id, array)| Ok((id, numbers_of(&array)?))).collect::<PyResult<Vec<_>>>()?;
    let (frames, ends) = py.detach(|| value::write_samples(bid, count, &packets))?;
    Ok((PyBytes::new(py, &frames), ends.into_pyarray(py)))
}

/// Finds one of a few things by its name.
pub fn named<T: Copy>(all: &'static [T], name: fn(T) -> &'static str) -> impl Fn(&str) -> PyResult<T> {
    move |wanted| {
        all.iter().copied().find(|it| name(*it) == wanted).ok_or_else(|| {
            let known: Vec<_> = all.iter().map(|it| name(*it)).collect();
            PyValueError::new_err(format!("{wanted:?} is none of {}", known.join(", ")))
        })
    }
}

/// The numbers of an array of one of the four types that lose nothing, row by row.
fn numbers_of(array: &Bound<'_, PyAny>) -> PyResult<Vec<Number>> {
    fn list<'py, T: numpy::Element + Copy>(array: &Bound<'py, PyAny>, number: fn(T) -> Number) -> Option<Vec<Number>> {
        let array: PyReadonlyArrayDyn<'py, T> = array.extract().ok()?;
        Some(array.as_array().iter().copied().map(number).collect())
    }
    list(array, Number::Single)
        .or_else(|| list(array, Number::Double))
        .or_else(|| list(array, Number::Integer))
        .or_else(|| list(array, Number::Wide))
        .ok_or_else(|| PyTypeError::new_err("numbers must be an array of float32, float64, int64 or uint64"))
}

/// The packets of an MTData2 payload, each as (identifier, name or None, precision, coordinates, numbers or bytes).
#[pyfunction]
pub fn packets<'py>(py: Python<'py>, payload: &[u8]) -> PyResult<Vec<Bound<'py, PyAny>>> {
    let mut list = vec![];
    for packet in crate::packet::packets(payload) {
        let Ok(packet) = packet else { break };
        let item = match packet.reading() {
            None => (packet.id, py.None(), py.None(), py.None(), PyBytes::new(py, packet.data).into_py_any(py)?),
            Some(reading) => {
                let precision = match reading.form {
                    Form::Real(precision, _) => precision.name().into_py_any(py)?,
                    _ => py.None(),
                };
                let numbers = value::numbers(&reading, packet.data)
                    .into_iter()
                    .map(|number| match number {
                        Number::Integer(it) => it.into_py_any(py),
                        Number::Wide(it) => it.into_py_any(py),
                        Number::Single(it) => it.into_py_any(py),
                        Number::Double(it) => it.into_py_any(py),
                    })
                    .collect::<PyResult<Vec<_>>>()?;
                (
                    packet.id,
                    reading.quantity.name.into_py_any(py)?,
                    precision,
                    reading.coordinates.map(Coordinates::name).into_py_any(py)?,
                    numbers.into_py_any(py)?,
                )
            }
        };
        list.push(item.into_bound_py_any(py)?);
    }
    Ok(list)
}

/// The fields of a Configuration payload, or None if it is none.
#[pyfunction]
pub fn configuration<'py>(py: Python<'py>, payload: &[u8]) -> PyResult<Option<Row<'py>>> {
    let Some(it) = device::Configuration::read(payload) else { return Ok(None) };
    let row = PyDict::new(py);
    row.set_item("device_id", it.device_id)?;
    row.set_item("product_code", it.product_code)?;
    row.set_item("sampling_period", it.sampling_period)?;
    row.set_item("output_skip_factor", it.output_skip_factor)?;
    row.set_item("date", it.date)?;
    row.set_item("time", it.time)?;
    row.set_item("devices", it.devices)?;
    row.set_item("filter_profile", it.filter_profile)?;
    let [major, minor, revision] = it.firmware;
    row.set_item("firmware", (major, minor, revision))?;
    row.set_item("output_mode", it.output_mode)?;
    row.set_item("output_settings", it.output_settings)?;
    row.set_item("filter_type", it.filter_type)?;
    let [major, minor] = it.filter_version;
    row.set_item("filter_version", (major, minor))?;
    Ok(Some(row))
}

/// The device identifier of a DeviceID payload, or None if it is none.
#[pyfunction]
pub fn device_id(payload: &[u8]) -> Option<u64> {
    device::device_id(payload)
}

/// The text of a ProductCode payload, or None if it is empty.
#[pyfunction]
pub fn product_code(payload: &[u8]) -> Option<String> {
    device::product_code(payload)
}

/// Bytes to messages, for input that comes in pieces.
#[pyclass(module = "xbus._core")]
pub struct Scanner {
    scanner: crate::scan::Scanner,
    /// The bytes that are not decided yet.
    kept: Vec<u8>,
}

/// Messages as (offset, bid, mid, payload) and strings as (offset, place or None, bytes), in order; damage as (offset, length,
/// reason).
type Found<'py> = (Vec<Bound<'py, PyAny>>, Vec<(u64, u64, &'static str)>);

#[pymethods]
impl Scanner {
    #[new]
    #[pyo3(signature = (limit, strings=0))]
    fn new(limit: usize, strings: u32) -> Self {
        let mut scanner = crate::scan::Scanner::new(limit);
        scanner.expect(strings);
        Self { scanner, kept: vec![] }
    }

    /// The messages, strings and damage that can be told with these bytes; `last` says that none follow.
    fn feed<'py>(&mut self, py: Python<'py>, data: &[u8], last: bool) -> PyResult<Found<'py>> {
        let offset = self.scanner.at();
        self.kept.extend_from_slice(data);
        let window = Window { bytes: &self.kept, offset, last };
        let (mut found, mut stretches) = (vec![], vec![]);
        let mut report = |damage: Option<Damage>| {
            stretches.extend(damage.map(|it| (it.offset, it.length, it.reason.name())));
        };
        loop {
            match self.scanner.step(window) {
                Step::More => break,
                Step::End(damage) => {
                    report(damage);
                    break;
                }
                Step::Frame { at, length, damage } => {
                    report(damage);
                    let frame = Frame::of(&self.kept[at..at + length]);
                    let message = (offset + at as u64, frame.bid, frame.mid, PyBytes::new(py, frame.payload));
                    found.push(message.into_bound_py_any(py)?);
                }
                Step::String { at, length, place, damage } => {
                    report(damage);
                    let bytes = PyBytes::new(py, &self.kept[at..at + length]);
                    found.push((offset + at as u64, place, bytes).into_bound_py_any(py)?);
                }
            }
        }
        #[allow(clippy::cast_possible_truncation)] // a position in what was kept
        self.kept.drain(..(self.scanner.at() - offset) as usize);
        Ok((found, stretches))
    }
}
