//! The clocks of devices, for samples one at a time.

use numpy::{PyReadonlyArray1, PyUntypedArrayMethods};
use pyo3::IntoPyObjectExt;
use pyo3::prelude::*;

use super::array::hand_over;
use crate::clock::{Change, Clocks, Stamps};
use crate::frame;
use crate::packet::is_well_formed;

/// A bus identifier, or an array of them.
#[derive(FromPyObject)]
pub enum Bids<'py> {
    One(u8),
    Many(PyReadonlyArray1<'py, u8>),
}

#[pyfunction]
pub fn device_of<'py>(py: Python<'py>, bid: Bids<'py>) -> PyResult<Bound<'py, PyAny>> {
    match bid {
        Bids::One(bid) => frame::device_of(bid).into_bound_py_any(py),
        Bids::Many(bids) => {
            let mut devices = Vec::with_capacity(bids.len());
            devices.extend(bids.as_array().iter().map(|bid| frame::device_of(*bid)));
            Ok(hand_over(py, devices).into_any())
        }
    }
}

#[pyfunction]
pub fn is_sample(payload: &[u8]) -> bool {
    is_well_formed(payload)
}

/// The clocks of all devices, with the rules by which a log has its times.
#[pyclass(module = "xbus._core")]
pub struct SampleClock(Clocks);

#[pymethods]
impl SampleClock {
    #[new]
    #[pyo3(signature = (rate=None))]
    fn new(rate: Option<f64>) -> Self {
        Self(Clocks::new(rate))
    }

    fn message(&mut self, bid: u8, mid: u8, payload: &[u8]) {
        if let Some(change) = Change::of(mid, payload) {
            self.0.of(bid).change(change);
        }
    }

    fn sample(&mut self, bid: u8, payload: &[u8]) -> (f64, bool) {
        if !is_well_formed(payload) {
            return (f64::NAN, false);
        }
        let stamps = Stamps::read(payload);
        (self.0.of(bid).sample(stamps).seconds, stamps.lead())
    }
}
