//! Frames, messages and packets.

use numpy::{PyArray1, PyReadonlyArrayDyn, PyUntypedArray, PyUntypedArrayMethods};
use pyo3::IntoPyObjectExt;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use super::array::hand_over;
use super::convert::detached;
use crate::device::Configuration;
use crate::frame::{Frame, Header};
use crate::input::PushBuffer;
use crate::packet::{Coordinates, Form, Precision, Reading};
use crate::requests::Requests;
use crate::scan::{self, Damage, Item};
use crate::table::Quantity;
use crate::value::{self, Number};

#[pyfunction]
pub fn encode_frame<'py>(py: Python<'py>, bid: u8, mid: u8, payload: &[u8]) -> PyResult<Bound<'py, PyBytes>> {
    Ok(PyBytes::new(py, &Frame { bid, mid, payload }.encode()?))
}

#[pyfunction]
#[pyo3(signature = (quantity, precision, coordinates, numbers))]
pub fn encode_packet<'py>(
    py: Python<'py>,
    quantity: &'static Quantity,
    precision: Option<Precision>,
    coordinates: Option<Coordinates>,
    numbers: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyBytes>> {
    let mut packet = vec![];
    value::write_packet(&mut packet, quantity, precision, coordinates, &numbers_of(numbers)?)?;
    Ok(PyBytes::new(py, &packet))
}

/// Frames in one piece, and where each ends.
#[pyclass(module = "xbus._core", frozen, get_all)]
pub struct EncodedFrames {
    data: Py<PyBytes>,
    ends: Py<PyArray1<u64>>,
}

impl EncodedFrames {
    pub fn of(py: Python<'_>, frames: &[u8], ends: Vec<u64>) -> Self {
        Self { data: PyBytes::new(py, frames).unbind(), ends: hand_over(py, ends).unbind() }
    }
}

/// The number of rows that all arrays have.
pub fn rows_of<'a, 'py: 'a>(arrays: impl Iterator<Item = &'a Bound<'py, PyUntypedArray>>) -> PyResult<usize> {
    let rows: Vec<_> = arrays.map(|array| array.shape().first().copied()).collect();
    let count = rows.first().copied().flatten().unwrap_or(0);
    if rows.iter().any(|rows| *rows != Some(count)) {
        return Err(PyValueError::new_err("the arrays must have one row for each message, all the same number"));
    }
    Ok(count)
}

#[pyfunction]
pub fn encode_samples(
    py: Python<'_>,
    packets: Vec<(u16, Bound<'_, PyUntypedArray>)>,
    bid: u8,
) -> PyResult<EncodedFrames> {
    let count = rows_of(packets.iter().map(|(_, array)| array))?;
    let packets = packets.into_iter().map(|(id, array)| Ok((id, numbers_of(&array)?))).collect::<PyResult<Vec<_>>>()?;
    let (frames, ends) = py.detach(|| value::write_samples(bid, count, &packets))?;
    Ok(EncodedFrames::of(py, &frames, ends))
}

/// The numbers of an array of one of the four types that lose nothing, row by row.
pub fn numbers_of(array: &Bound<'_, PyAny>) -> PyResult<Vec<Number>> {
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
    precision: Option<Precision>,
    coordinates: Option<Coordinates>,
    numbers: Py<PyAny>,
}

impl Packet {
    pub fn of(py: Python<'_>, packet: &crate::packet::Packet<'_>, reading: Option<Reading>) -> PyResult<Self> {
        let numbers = match &reading {
            Some(reading) => value::numbers(reading, packet.data).into_py_any(py),
            None => PyBytes::new(py, packet.data).into_py_any(py),
        };
        Ok(Self {
            data_id: packet.id,
            name: reading.map(|reading| reading.quantity.name),
            precision: reading.as_ref().and_then(Reading::precision),
            coordinates: reading.and_then(|reading| reading.coordinates),
            numbers: numbers?,
        })
    }
}

#[pyfunction]
pub fn packets(py: Python<'_>, payload: &[u8]) -> PyResult<Vec<Packet>> {
    let packets = crate::packet::packets(payload).map_while(Result::ok);
    packets.map(|packet| Packet::of(py, &packet, packet.reading())).collect()
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
    let numbers = value::numbers(&reading, data);
    match reading.form {
        Form::Real(_, 1) | Form::Fixed(..) | Form::Steps(_) | Form::Struct(_) | Form::List(..) => {
            numbers.into_bound_py_any(py)
        }
        Form::Real(Precision::Float32, _) => {
            let single = |number| if let Number::Single(value) = number { Some(value) } else { None };
            Ok(PyArray1::from_iter(py, numbers.into_iter().filter_map(single)).into_any())
        }
        Form::Real(..) => {
            let double = |number| if let Number::Double(value) = number { Some(value) } else { None };
            Ok(PyArray1::from_iter(py, numbers.into_iter().filter_map(double)).into_any())
        }
    }
}

#[pyfunction]
pub fn configuration(payload: &[u8]) -> Option<Configuration> {
    Configuration::read(payload)
}

#[pyfunction]
pub fn frame_size(head: &[u8]) -> Option<usize> {
    Header::read(head).map(|header| header.frame())
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

    fn feed(&mut self, py: Python<'_>, data: &[u8], last: bool) -> PyResult<Vec<Scanned>> {
        self.buffer.push(data);
        let Self { scanner, buffer } = self;
        let items = detached(py, || scanner.items(buffer.window(last)))?;
        let items = items.into_iter().map(|item| Scanned::of(py, item)).collect();
        self.buffer.release(self.scanner.at());
        Ok(items)
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

    fn feed(&mut self, py: Python<'_>, data: &[u8], last: bool) -> PyResult<Vec<ScannedFrame>> {
        self.buffer.push(data);
        let mut requests = Requests::new(self.buffer.window(last), self.limit);
        let found: Vec<_> = detached(py, || requests.by_ref().collect())?;
        let found = found.into_iter().map(|(offset, frame)| ScannedFrame::of(py, offset, &frame)).collect();
        let done = requests.at();
        self.buffer.release(done);
        Ok(found)
    }

    #[getter]
    fn is_waiting(&self) -> bool {
        !self.buffer.window(false).bytes.is_empty()
    }
}

/// What a scanner found.
#[derive(IntoPyObject)]
pub enum Scanned {
    Frame(ScannedFrame),
    String(ScannedString),
    Damage(Damage),
}

impl Scanned {
    pub fn of(py: Python<'_>, item: Item<'_>) -> Self {
        match item {
            Item::Frame { offset, frame } => Self::Frame(ScannedFrame::of(py, offset, &frame)),
            Item::String { offset, place, bytes } => {
                Self::String(ScannedString { offset, place, data: PyBytes::new(py, bytes).unbind() })
            }
            Item::Damage(damage) => Self::Damage(damage),
        }
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

impl ScannedFrame {
    fn of(py: Python<'_>, offset: u64, frame: &Frame<'_>) -> Self {
        Self { offset, bid: frame.bid, mid: frame.mid, payload: PyBytes::new(py, frame.payload).unbind() }
    }
}

/// A string that a scanner found.
#[pyclass(module = "xbus._core", frozen, get_all)]
pub struct ScannedString {
    offset: u64,
    place: Option<u8>,
    data: Py<PyBytes>,
}
