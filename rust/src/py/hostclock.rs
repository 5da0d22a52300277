//! The clock of the host.

use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1};
use pyo3::prelude::*;

use crate::hostclock;

type Array<'py, T> = Bound<'py, PyArray1<T>>;

/// Maps device time to host time.
#[pyclass(module = "xbus._core")]
#[derive(Clone)]
pub struct HostClock(hostclock::HostClock);

#[pymethods]
#[allow(clippy::needless_pass_by_value)] // arrays are lent by value
impl HostClock {
    /// A clock that has not seen a sample.
    #[new]
    fn new() -> Self {
        Self(hostclock::HostClock::default())
    }

    /// The same clock, which goes on by itself.
    fn copy(&self) -> Self {
        self.clone()
    }

    /// Takes in a sample; its host time.
    fn update(&mut self, time: f64, arrival: i64, leads: bool) -> f64 {
        self.0.update(time, arrival, leads)
    }

    /// Takes in samples; their host times. The arrays are of one length.
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
        Ok(host.into_pyarray(py))
    }

    /// Host times of device times.
    fn host_time<'py>(&self, py: Python<'py>, time: PyReadonlyArray1<'py, f64>) -> PyResult<Array<'py, f64>> {
        let time = time.as_slice()?;
        let host: Vec<f64> = py.detach(|| time.iter().map(|it| self.0.host_time(*it)).collect());
        Ok(host.into_pyarray(py))
    }

    /// Seconds by which the line is later than device time, at the newest sample.
    #[getter]
    fn offset(&self) -> f64 {
        self.0.offset()
    }

    /// Seconds per second that the host's clock gains.
    #[getter]
    fn drift(&self) -> f64 {
        self.0.drift()
    }

    /// Mean seconds by which samples arrive later than the line.
    #[getter]
    fn residual(&self) -> f64 {
        self.0.residual()
    }

    /// Device time at which the fit began.
    #[getter]
    fn since(&self) -> f64 {
        self.0.since()
    }

    /// How many fits there were.
    #[getter]
    fn fits(&self) -> u64 {
        self.0.fits()
    }

    /// The last steps: device time, arrival, reason.
    #[getter]
    fn steps(&self) -> Vec<(f64, i64, &'static str)> {
        self.0.steps().map(|it| (it.time, it.arrival, it.reason.text())).collect()
    }
}
