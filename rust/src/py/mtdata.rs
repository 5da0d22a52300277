//! `MTData` messages.

use numpy::PyUntypedArray;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::codec::{EncodedFrames, Packet, numbers_of, rows_of};
use crate::mtdata::{self, Item, Output};
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
