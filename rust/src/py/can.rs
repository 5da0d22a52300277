//! Logs of CAN frames.

use std::sync::Arc;

use numpy::{PyArray1, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::array::hand_over;
use super::convert::detached;
use super::log::Part;
use crate::clock::Clocks;
use crate::log::TimedPart;
use crate::log::can::{self, CanId, CanLog};

/// A log of CAN frames, and what became of each frame.
#[pyclass(module = "xbus._core", frozen, get_all)]
pub struct CanFrames {
    part: Py<Part>,
    verdicts: Py<PyArray1<u8>>,
}

#[pyfunction]
#[pyo3(signature = (ids, sizes, data, entries, rate=None))]
#[allow(clippy::needless_pass_by_value)] // what PyO3 extracts
pub fn read_can(
    py: Python<'_>,
    ids: PyReadonlyArray1<'_, u32>,
    sizes: PyReadonlyArray1<'_, u8>,
    data: PyReadonlyArray2<'_, u8>,
    entries: Vec<(u32, u8, u8)>,
    rate: Option<f64>,
) -> PyResult<CanFrames> {
    let (ids, sizes) = (ids.as_slice()?, sizes.as_slice()?);
    let (data, rest) = data.as_slice()?.as_chunks();
    if !rest.is_empty() {
        return Err(PyValueError::new_err("the data must have eight bytes for each frame"));
    }
    let entries: Vec<_> = entries.into_iter().map(|(id, bid, code)| CanId { id, bid, code }).collect();
    let frames = can::CanFrames { ids, sizes, data };
    let CanLog { part, verdicts } = detached(py, || can::read_can(frames, &entries))??;
    let part = Part(Arc::new(TimedPart::whole(part, Clocks::new(rate))));
    Ok(CanFrames { part: Py::new(py, part)?, verdicts: hand_over(py, verdicts).unbind() })
}
