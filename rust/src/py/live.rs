//! Acquisition and recording.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use numpy::PyArray1;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};

use super::Row;
use super::array::hand_over;
use super::convert::os_error;
use crate::live::{self, QUEUE, Recording, Report, Taken};

// The signatures below show this number.
const _: () = assert!(QUEUE == 24_000_000);

/// A wait is interrupted at this interval to check for signals.
const SLICE: Duration = Duration::from_millis(50);

/// Bytes that were received, and the pieces in which they arrived.
#[pyclass(module = "xbus._core", frozen, get_all)]
pub struct Received {
    offset: u64,
    data: Py<PyBytes>,
    ends: Py<PyArray1<i64>>,
    arrivals: Py<PyArray1<i64>>,
}

/// Receives a stream of bytes in a thread, or what is pushed.
#[pyclass(module = "xbus._core", frozen)]
pub struct Acquisition(live::Acquisition);

#[pymethods]
impl Acquisition {
    #[new]
    #[pyo3(signature = (fd, *, bound=24_000_000, strings=0))]
    fn new(fd: Option<i32>, bound: usize, strings: u32) -> PyResult<Self> {
        let acquisition = Self(live::Acquisition::new(bound));
        acquisition.0.expect(strings);
        if let Some(fd) = fd {
            acquisition.open(fd)?;
        }
        Ok(acquisition)
    }

    #[cfg(unix)]
    fn open(&self, fd: i32) -> PyResult<()> {
        self.0.open(fd).map_err(|error| os_error(&error, None))
    }

    #[cfg(not(unix))]
    #[allow(clippy::unused_self)]
    fn open(&self, _fd: i32) -> PyResult<()> {
        Err(pyo3::exceptions::PyOSError::new_err(
            "ports of this system have no descriptors; push what you read from them",
        ))
    }

    #[pyo3(signature = (timeout=None, *, least=1))]
    fn read(&self, py: Python<'_>, timeout: Option<f64>, least: usize) -> PyResult<Option<Received>> {
        let timeout = timeout.map(seconds("timeout")).transpose()?;
        wait(py, timeout, |slice| self.0.wait(least, slice).then_some(()))?;
        self.0.take().map(|taken| received(py, taken)).transpose()
    }

    fn push(&self, py: Python<'_>, data: &[u8]) -> bool {
        py.detach(|| self.0.push(data))
    }

    fn resume(&self) -> PyResult<()> {
        self.0.resume().map_err(|error| os_error(&error, None))
    }

    fn end(&self, reason: &str) {
        self.0.end(reason);
    }

    #[getter]
    fn ended(&self) -> Option<String> {
        self.0.ended()
    }

    #[getter]
    fn epoch(&self) -> i64 {
        self.0.epoch()
    }

    fn stats<'py>(&self, py: Python<'py>) -> PyResult<Row<'py>> {
        let stats = self.0.stats();
        let row = PyDict::new(py);
        row.set_item("bytes", stats.counts.bytes)?;
        row.set_item("frames", stats.counts.frames)?;
        row.set_item("samples", stats.counts.samples)?;
        row.set_item("messages", stats.counts.messages)?;
        row.set_item("malformed", stats.counts.malformed)?;
        row.set_item("strings", stats.counts.strings)?;
        row.set_item("quantities", stats.counts.quantities)?;
        row.set_item("lost_samples", stats.counts.losses.samples)?;
        row.set_item("gaps", stats.counts.losses.gaps)?;
        row.set_item("checksum_errors", stats.counts.checksum_errors)?;
        row.set_item("skipped_bytes", stats.counts.skipped_bytes)?;
        row.set_item("errors", stats.counts.errors)?;
        row.set_item("warnings", stats.counts.warnings)?;
        row.set_item("last_error", stats.counts.last_error)?;
        row.set_item("queued_bytes", stats.queued)?;
        row.set_item("most_queued_bytes", stats.most_queued)?;
        row.set_item("dropped_bytes", stats.dropped)?;
        row.set_item("overruns", stats.overruns)?;
        row.set_item("last_arrival", stats.last_arrival)?;
        Ok(row)
    }

    #[pyo3(signature = (
        path, head=b"".as_slice(), flush=0.5, fsync=false, rotate_bytes=None, rotate_seconds=None, times=true, *, overwrite=false, bound=24_000_000
    ))]
    #[allow(clippy::too_many_arguments)] // by keyword
    fn record(
        &self,
        py: Python<'_>,
        path: PathBuf,
        head: &[u8],
        flush: f64,
        fsync: bool,
        rotate_bytes: Option<u64>,
        rotate_seconds: Option<f64>,
        times: bool,
        overwrite: bool,
        bound: usize,
    ) -> PyResult<()> {
        let rotate_after = rotate_seconds.map(seconds("rotate_seconds")).transpose()?;
        if rotate_bytes == Some(0) || rotate_after.is_some_and(|duration| duration.is_zero()) {
            return Err(PyValueError::new_err("rotate_bytes and rotate_seconds must be greater than 0"));
        }
        let flush = seconds("flush")(flush)?;
        let head = head.to_vec();
        let recording = Recording { path, overwrite, head, flush, fsync, rotate_bytes, rotate_after, times, bound };
        let name = recording.path.clone();
        py.detach(|| self.0.record(recording)).map_err(|error| os_error(&error, Some(name)))
    }

    #[getter]
    fn recording(&self) -> Option<Report> {
        self.0.recording()
    }

    fn stop_recording(&self, py: Python<'_>) -> PyResult<Option<Report>> {
        // If another thread stops it at the same time, that thread gets the report.
        let stopped = |slice| match self.0.stop_recording(slice) {
            None if self.0.recording().is_some() => None,
            report => Some(report),
        };
        Ok(wait(py, None, stopped)?.flatten())
    }

    fn close(&self, py: Python<'_>) {
        py.detach(|| self.0.close());
    }
}

impl Drop for Acquisition {
    fn drop(&mut self) {
        // The threads end without the GIL, but the disk may be slow.
        Python::try_attach(|py| py.detach(|| self.0.close()));
    }
}

/// Calls `ask` without the GIL until it answers or the time is up. Between calls it checks for signals.
fn wait<T: Send>(
    py: Python<'_>,
    timeout: Option<Duration>,
    ask: impl Fn(Duration) -> Option<T> + Sync,
) -> PyResult<Option<T>> {
    let began = Instant::now();
    loop {
        let left = timeout.map(|timeout| timeout.saturating_sub(began.elapsed()));
        let slice = left.map_or(SLICE, |left| left.min(SLICE));
        let answer = py.detach(|| ask(slice));
        if answer.is_some() || left.is_some_and(|left| left <= slice) {
            return Ok(answer);
        }
        py.check_signals()?;
    }
}

#[allow(clippy::cast_possible_wrap)] // positions in a buffer
fn received(py: Python<'_>, taken: Taken) -> PyResult<Received> {
    let Taken { offset, bytes, pieces } = taken;
    let (head, tail) = bytes.as_slices();
    let data = PyBytes::new_with(py, bytes.len(), |room| {
        room[..head.len()].copy_from_slice(head);
        room[head.len()..].copy_from_slice(tail);
        Ok(())
    })?;
    let ends = pieces.iter().map(|piece| (piece.end - offset) as i64).collect();
    let arrivals = pieces.iter().map(|piece| piece.arrival).collect();
    Ok(Received {
        offset,
        data: data.unbind(),
        ends: hand_over(py, ends).unbind(),
        arrivals: hand_over(py, arrivals).unbind(),
    })
}

/// Seconds from Python.
fn seconds(name: &'static str) -> impl Fn(f64) -> PyResult<Duration> {
    move |value| {
        Duration::try_from_secs_f64(value)
            .map_err(|_| PyValueError::new_err(format!("{name} must be a number of seconds, not {value}")))
    }
}
