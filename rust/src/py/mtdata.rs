//! `MTData` messages.

use numpy::PyUntypedArray;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use super::codec::{EncodedFrames, Packet, numbers_of, rows_of};
use crate::device::MtDataDevices;
use crate::frame::Frame;
use crate::mtdata::{self, Item, Output, Outputs};
use crate::packet::{Coordinates, Precision};

/// Where an item is in a payload.
#[pyclass(module = "xbus._core", frozen, get_all)]
pub struct MtDataPlace {
    data_id: u16,
    name: &'static str,
    precision: Option<Precision>,
    coordinates: Option<Coordinates>,
    start: usize,
    size: usize,
}

impl MtDataPlace {
    fn of(item: &Item) -> Self {
        let Item { id, at, size, reading } = item;
        Self {
            data_id: *id,
            name: reading.quantity.name,
            precision: reading.precision(),
            coordinates: reading.coordinates,
            start: *at,
            size: *size,
        }
    }
}

/// The settings in force in a stream of messages.
#[pyclass(module = "xbus._core")]
pub struct MtDataOutputs(Outputs);

/// A sample of an `MTData` message.
#[pyclass(module = "xbus._core", frozen, get_all)]
pub struct MtDataSample {
    bid: u8,
    packets: Vec<Py<Packet>>,
    stamps: Py<PyBytes>,
}

impl MtDataSample {
    fn of(py: Python<'_>, payload: &[u8], bid: u8, items: &[Item]) -> PyResult<Self> {
        let packet = |item: &Item| Py::new(py, Packet::of(py, &item.packet(payload), Some(item.reading))?);
        let packets = items.iter().map(packet).collect::<PyResult<_>>()?;
        Ok(Self { bid, packets, stamps: PyBytes::new(py, &mtdata::stamps(payload, items)).unbind() })
    }
}

#[pymethods]
impl MtDataOutputs {
    #[new]
    fn new(legacy: Vec<(u16, u32)>) -> Self {
        Self(Outputs::given(legacy.into_iter().map(|(mode, settings)| Output { mode, settings }).collect()))
    }

    fn message(&mut self, bid: u8, mid: u8, payload: &[u8]) -> bool {
        self.0.learn(Frame { bid, mid, payload })
    }

    fn output(&self, bid: u8) -> Option<(u16, u32)> {
        self.0.of(bid).map(|Output { mode, settings }| (mode, settings))
    }

    fn devices_of(&self, bid: u8) -> Vec<u8> {
        self.0.devices_of(bid).collect()
    }

    fn samples(&self, py: Python<'_>, bid: u8, payload: &[u8]) -> PyResult<Option<Vec<MtDataSample>>> {
        let Some(layout) = self.0.layout(bid).filter(|layout| layout.fits(payload)) else { return Ok(None) };
        let samples = layout.samples.iter().map(|(bid, items)| MtDataSample::of(py, payload, *bid, items));
        samples.collect::<PyResult<_>>().map(Some)
    }
}

/// The identifiers of the trackers of an Xbus Master, by its Configuration.
#[pyfunction]
pub fn tracker_ids(payload: &[u8]) -> Vec<u32> {
    let devices = MtDataDevices::read(payload).filter(MtDataDevices::are_trackers);
    devices.iter().flat_map(|devices| &devices.devices).map(|device| device.device_id).collect()
}

#[pyfunction]
pub fn mtdata_layout(mode: u16, settings: u32) -> PyResult<Vec<MtDataPlace>> {
    Ok(Output { mode, settings }.items()?.iter().map(MtDataPlace::of).collect())
}

#[pyfunction]
pub fn mtdata_packets(py: Python<'_>, payload: &[u8], mode: u16, settings: u32) -> PyResult<Vec<Packet>> {
    let output = Output { mode, settings };
    let size = output.size()?;
    if payload.len() != size {
        let found = payload.len();
        return Err(PyValueError::new_err(format!("MTData with {output} has {size} bytes, not {found}")));
    }
    output.items()?.iter().map(|item| Packet::of(py, &item.packet(payload), Some(item.reading))).collect()
}

#[pyfunction]
#[allow(clippy::needless_pass_by_value)] // what PyO3 extracts
pub fn encode_mtdata(
    py: Python<'_>,
    mode: u16,
    settings: u32,
    arrays: Vec<Bound<'_, PyUntypedArray>>,
    bid: u8,
) -> PyResult<EncodedFrames> {
    let count = rows_of(arrays.iter())?;
    let numbers = arrays.iter().map(|array| numbers_of(array)).collect::<PyResult<Vec<_>>>()?;
    let (frames, ends) = py.detach(|| mtdata::write_samples(bid, count, Output { mode, settings }, &numbers))?;
    Ok(EncodedFrames::of(py, &frames, ends))
}
