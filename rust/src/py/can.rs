//! CAN frames.

use std::sync::Arc;

use numpy::{PyArray1, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::array::hand_over;
use super::convert::detached;
use super::log::Part;
use crate::clock::Clocks;
use crate::error::CanError;
use crate::log::TimedPart;
use crate::log::can::{self, CanFrames, CanId};

/// Samples of CAN frames, and what became of each new frame.
#[pyclass(module = "xbus._core", frozen, get_all)]
pub struct CanPart {
    part: Py<Part>,
    verdicts: Py<PyArray1<u8>>,
    received: Py<PyArray1<f64>>,
}

/// Groups and decodes CAN frames.
#[pyclass(module = "xbus._core")]
pub struct CanReader {
    reader: can::CanReader,
    clocks: Clocks,
}

#[pymethods]
impl CanReader {
    #[new]
    #[pyo3(signature = (entries, rate=None))]
    fn new(entries: Vec<(u32, u8, u8)>, rate: Option<f64>) -> Result<Self, CanError> {
        Ok(Self { reader: can::CanReader::new(&ids_of(entries))?, clocks: Clocks::new(rate) })
    }

    #[pyo3(signature = (times, ids, sizes, data, *, end))]
    #[allow(clippy::needless_pass_by_value)] // what PyO3 extracts
    fn push(
        &mut self,
        py: Python<'_>,
        times: PyReadonlyArray1<'_, f64>,
        ids: PyReadonlyArray1<'_, u32>,
        sizes: PyReadonlyArray1<'_, u8>,
        data: PyReadonlyArray2<'_, u8>,
        end: bool,
    ) -> PyResult<CanPart> {
        let frames = frames_of(times.as_slice()?, ids.as_slice()?, sizes.as_slice()?, data.as_slice()?)?;
        let Self { reader, clocks } = self;
        let can::CanPart { part, verdicts, received } = detached(py, || reader.push(frames, end))??;
        let part = Part(Arc::new(detached(py, || TimedPart::next(part, clocks))?));
        Ok(CanPart {
            part: Py::new(py, part)?,
            verdicts: hand_over(py, verdicts).unbind(),
            received: hand_over(py, received).unbind(),
        })
    }
}

#[pyfunction]
pub fn can_sample(payload: &[u8], bid: u8, offset: u64) -> PyResult<Part> {
    if !payload.len().is_multiple_of(can::LIVE_SIZE) {
        return Err(PyValueError::new_err("the payload must have nine bytes for each frame"));
    }
    let part = can::part_of(0, [(bid, offset, payload)].into_iter(), None);
    Ok(Part(Arc::new(TimedPart::next(part, &mut Clocks::default()))))
}

/// The identifiers of devices: identifier, bus identifier, and code of the message.
pub fn ids_of(entries: Vec<(u32, u8, u8)>) -> Vec<CanId> {
    entries.into_iter().map(|(id, bid, code)| CanId { id, bid, code }).collect()
}

/// Frames as arrays.
pub fn frames_of<'a>(times: &'a [f64], ids: &'a [u32], sizes: &'a [u8], data: &'a [u8]) -> PyResult<CanFrames<'a>> {
    let (data, rest) = data.as_chunks();
    if !rest.is_empty() {
        return Err(PyValueError::new_err("the data must have eight bytes for each frame"));
    }
    Ok(CanFrames { times, ids, sizes, data })
}
