//! The clock of the host.

use numpy::PyReadonlyArray1;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyType};

use super::array::{Array, hand_over};
use crate::hostclock::{self, Step};
use crate::state;

/// Maps device time to host time.
#[pyclass(module = "xbus._core")]
#[derive(Clone)]
pub struct HostClock(pub hostclock::HostClock);

#[pymethods]
#[allow(clippy::needless_pass_by_value)] // arrays are lent by value
impl HostClock {
    #[new]
    #[pyo3(signature = (state=None))]
    fn new(state: Option<&[u8]>) -> PyResult<Self> {
        Ok(Self(state.map(state::from_bytes).transpose()?.unwrap_or_default()))
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> (Bound<'py, PyType>, (Bound<'py, PyBytes>,)) {
        (slf.get_type(), (PyBytes::new(slf.py(), &state::to_bytes(&slf.borrow().0)),))
    }

    fn copy(&self) -> Self {
        self.clone()
    }

    fn update(&mut self, time: f64, arrival: i64, leads: bool) -> f64 {
        self.0.update(time, arrival, leads)
    }

    fn update_many<'py>(
        &mut self,
        py: Python<'py>,
        time: PyReadonlyArray1<'py, f64>,
        arrival: PyReadonlyArray1<'py, i64>,
        leads: PyReadonlyArray1<'py, bool>,
    ) -> PyResult<Array<'py, f64>> {
        let samples = time.as_slice()?.iter().zip(arrival.as_slice()?).zip(leads.as_slice()?);
        let clock = &mut self.0;
        let host: Vec<f64> =
            py.detach(|| samples.map(|((time, arrival), leads)| clock.update(*time, *arrival, *leads)).collect());
        Ok(hand_over(py, host))
    }

    fn host_time<'py>(&self, py: Python<'py>, time: PyReadonlyArray1<'py, f64>) -> PyResult<Array<'py, f64>> {
        let time = time.as_slice()?;
        let host: Vec<f64> = py.detach(|| time.iter().map(|time| self.0.host_time(*time)).collect());
        Ok(hand_over(py, host))
    }

    #[getter]
    fn offset(&self) -> f64 {
        self.0.offset()
    }

    #[getter]
    fn drift(&self) -> f64 {
        self.0.drift()
    }

    #[getter]
    fn residual(&self) -> f64 {
        self.0.residual()
    }

    #[getter]
    fn since(&self) -> f64 {
        self.0.since()
    }

    #[getter]
    fn fits(&self) -> u64 {
        self.0.fits()
    }

    #[getter]
    fn steps(&self) -> Vec<Step> {
        self.0.steps().copied().collect()
    }
}
