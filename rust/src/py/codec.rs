//! Frames, messages and packets.

use numpy::{PyArray1, PyReadonlyArrayDyn, PyUntypedArray, PyUntypedArrayMethods};
use pyo3::IntoPyObjectExt;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use super::array::hand_over;
use super::convert::{quantity, variant};
use crate::device;
use crate::frame::{Frame, Header};
use crate::input::PushBuffer;
use crate::packet::{Coordinates, Form, Precision};
use crate::requests::Requests;
use crate::scan::{self, Item};
use crate::value::{self, Number};

#[pyfunction]
pub fn encode_frame<'py>(py: Python<'py>, bid: u8, mid: u8, payload: &[u8]) -> PyResult<Bound<'py, PyBytes>> {
    Ok(PyBytes::new(py, &Frame { bid, mid, payload }.encode()?))
}

#[pyfunction]
#[pyo3(signature = (name, precision, coordinates, numbers))]
pub fn encode_packet<'py>(
    py: Python<'py>,
    name: &str,
    precision: Option<&str>,
    coordinates: Option<&str>,
    numbers: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyBytes>> {
    let precision = precision.map(|wanted| variant(&Precision::ALL, Precision::name, wanted)).transpose()?;
    let coordinates = coordinates.map(|wanted| variant(&Coordinates::ALL, Coordinates::name, wanted)).transpose()?;
    let mut packet = vec![];
    value::write_packet(&mut packet, quantity(name)?, precision, coordinates, &numbers_of(numbers)?)?;
    Ok(PyBytes::new(py, &packet))
}

/// Frames in one piece, and where each ends.
#[pyclass(module = "xbus._core", frozen, get_all)]
pub struct EncodedFrames {
    data: Py<PyBytes>,
    ends: Py<PyArray1<u64>>,
}

#[pyfunction]
pub fn encode_samples(
    py: Python<'_>,
    packets: Vec<(u16, Bound<'_, PyUntypedArray>)>,
    bid: u8,
) -> PyResult<EncodedFrames> {
    let rows: Vec<_> = packets.iter().map(|(_, array)| array.shape().first().copied()).collect();
    let count = rows.first().copied().flatten().unwrap_or(0);
    if rows.iter().any(|rows| *rows != Some(count)) {
        return Err(PyValueError::new_err("the arrays must have one row for each message, all the same number"));
    }
    let packets = packets.into_iter().map(|(id, array)| Ok((id, numbers_of(&array)?))).collect::<PyResult<Vec<_>>>()?;
    let (frames, ends) = py.detach(|| value::write_samples(bid, count, &packets))?;
    Ok(EncodedFrames { data: PyBytes::new(py, &frames).unbind(), ends: hand_over(py, ends).unbind() })
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

/// One packet of an MTData2 message.
#[pyclass(module = "xbus._core", frozen, get_all)]
pub struct Packet {
    data_id: u16,
    name: Option<&'static str>,
    precision: Option<&'static str>,
    coordinates: Option<&'static str>,
    numbers: Py<PyAny>,
}

#[pyfunction]
pub fn packets(py: Python<'_>, payload: &[u8]) -> PyResult<Vec<Packet>> {
    let packet = |packet: crate::packet::Packet<'_>| {
        let data_id = packet.id;
        let Some(reading) = packet.reading() else {
            let numbers = PyBytes::new(py, packet.data).into_py_any(py)?;
            return Ok(Packet { data_id, name: None, precision: None, coordinates: None, numbers });
        };
        let precision = match reading.form {
            Form::Real(precision, _) => Some(precision.name()),
            _ => None,
        };
        let numbers = value::numbers(&reading, packet.data)
            .into_iter()
            .map(|number| object_of_number(py, number))
            .collect::<PyResult<Vec<_>>>()?;
        Ok(Packet {
            data_id,
            name: Some(reading.quantity.name),
            precision,
            coordinates: reading.coordinates.map(Coordinates::name),
            numbers: numbers.into_py_any(py)?,
        })
    };
    crate::packet::packets(payload).map_while(Result::ok).map(packet).collect()
}

#[pyfunction]
pub fn packet_headers<'py>(py: Python<'py>, payload: &[u8]) -> Bound<'py, PyBytes> {
    let mut headers = vec![];
    for packet in crate::packet::packets(payload).map_while(Result::ok) {
        let ([high, low], is_known) = (packet.id.to_be_bytes(), packet.reading().is_some());
        #[allow(clippy::cast_possible_truncation)] // the size field is one byte
        headers.extend([high, low, packet.data.len() as u8, u8::from(is_known)]);
    }
    PyBytes::new(py, &headers)
}

#[pyfunction]
pub fn packet_numbers<'py>(py: Python<'py>, data_id: u16, data: &[u8]) -> PyResult<Bound<'py, PyAny>> {
    let Some(reading) = (crate::packet::Packet { id: data_id, at: 0, data }).reading() else {
        return Err(PyValueError::new_err(format!("0x{data_id:04X} does not have {} bytes", data.len())));
    };
    let numbers = value::numbers(&reading, data).into_iter();
    match reading.form {
        Form::Real(_, 1) | Form::Fixed(..) | Form::Struct(_) | Form::List(..) => {
            numbers.map(|number| object_of_number(py, number)).collect::<PyResult<Vec<_>>>()?.into_bound_py_any(py)
        }
        Form::Real(Precision::Float32, _) => {
            let single = |number| if let Number::Single(value) = number { Some(value) } else { None };
            Ok(PyArray1::from_iter(py, numbers.filter_map(single)).into_any())
        }
        Form::Real(..) => {
            let double = |number| if let Number::Double(value) = number { Some(value) } else { None };
            Ok(PyArray1::from_iter(py, numbers.filter_map(double)).into_any())
        }
    }
}

fn object_of_number(py: Python<'_>, number: Number) -> PyResult<Py<PyAny>> {
    match number {
        Number::Integer(value) => value.into_py_any(py),
        Number::Wide(value) => value.into_py_any(py),
        Number::Single(value) => value.into_py_any(py),
        Number::Double(value) => value.into_py_any(py),
    }
}

#[pyfunction]
pub fn configuration(payload: &[u8]) -> Option<device::Configuration> {
    device::Configuration::read(payload)
}

#[pyfunction]
pub fn frame_size(head: &[u8]) -> Option<usize> {
    Header::read(head).map(|header| header.frame())
}

#[pyfunction]
pub fn device_id(payload: &[u8]) -> Option<u64> {
    device::device_id(payload)
}

#[pyfunction]
pub fn product_code(payload: &[u8]) -> Option<String> {
    device::product_code(payload)
}

/// Finds the frames and strings of an input that is pushed in pieces.
#[pyclass(module = "xbus._core")]
pub struct Scanner {
    scanner: scan::Scanner,
    buffer: PushBuffer,
}

#[pymethods]
impl Scanner {
    #[new]
    #[pyo3(signature = (limit, strings=0))]
    fn new(limit: usize, strings: u32) -> Self {
        let mut scanner = scan::Scanner::new(limit);
        scanner.expect(strings);
        Self { scanner, buffer: PushBuffer::default() }
    }

    fn feed<'py>(&mut self, py: Python<'py>, data: &[u8], last: bool) -> PyResult<Vec<Bound<'py, PyAny>>> {
        self.buffer.push(data);
        let items = self.scanner.items(self.buffer.window(last));
        let items = items.into_iter().map(|item| object_of(py, item)).collect();
        self.buffer.release(self.scanner.at());
        items
    }
}

pub fn object_of<'py>(py: Python<'py>, item: Item<'_>) -> PyResult<Bound<'py, PyAny>> {
    match item {
        Item::Frame { offset, frame: Frame { bid, mid, payload } } => {
            let payload = PyBytes::new(py, payload).unbind();
            ScannedFrame { offset, bid, mid, payload }.into_bound_py_any(py)
        }
        Item::String { offset, place, bytes } => {
            let data = PyBytes::new(py, bytes).unbind();
            ScannedString { offset, place, data }.into_bound_py_any(py)
        }
        Item::Damage(scan::Damage { offset, length, reason }) => {
            ScannedDamage { offset, length, reason: reason.name() }.into_bound_py_any(py)
        }
    }
}

/// Finds the requests in the bytes of a host.
#[pyclass(module = "xbus._core")]
pub struct RequestScanner {
    limit: usize,
    buffer: PushBuffer,
}

#[pymethods]
impl RequestScanner {
    #[new]
    fn new(limit: usize) -> Self {
        Self { limit, buffer: PushBuffer::default() }
    }

    fn feed(&mut self, py: Python<'_>, data: &[u8], last: bool) -> Vec<ScannedFrame> {
        self.buffer.push(data);
        let mut requests = Requests::new(self.buffer.window(last), self.limit);
        let scanned = |(offset, Frame { bid, mid, payload })| {
            let payload = PyBytes::new(py, payload).unbind();
            ScannedFrame { offset, bid, mid, payload }
        };
        let found = requests.by_ref().map(scanned).collect();
        let done = requests.at();
        self.buffer.release(done);
        found
    }

    #[getter]
    fn is_waiting(&self) -> bool {
        !self.buffer.window(false).bytes.is_empty()
    }
}

/// A frame that a scanner found.
#[pyclass(module = "xbus._core", frozen, get_all)]
pub struct ScannedFrame {
    offset: u64,
    bid: u8,
    mid: u8,
    payload: Py<PyBytes>,
}

/// A string that a scanner found.
#[pyclass(module = "xbus._core", frozen, get_all)]
pub struct ScannedString {
    offset: u64,
    place: Option<u8>,
    data: Py<PyBytes>,
}

/// A stretch of bytes that a scanner skipped.
#[pyclass(module = "xbus._core", frozen, get_all)]
pub struct ScannedDamage {
    offset: u64,
    length: u64,
    reason: &'static str,
}
