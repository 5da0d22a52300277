//! Acquisition and recording.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use numpy::{PyArray1, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyList};

use super::array::hand_over;
use super::can::{frames_of, ids_of};
use super::codec::Scanned;
use super::convert::{detached, os_error};
use super::hostclock::HostClock;
use super::log::Part;
use crate::error::CanError;
use crate::frame::Frame;
use crate::live::time::{in_seconds, nanoseconds};
use crate::live::{self, Item, Need, QUEUE, Recording, Report, Stats, Text};
use crate::log::Wanted;
use crate::mtdata::Output;
use crate::scan;

// The signatures below show this number.
const _: () = assert!(QUEUE == 24_000_000);

/// A wait is interrupted at this interval to check for signals.
const SLICE: Duration = Duration::from_millis(50);

/// Ends waits.
#[pyclass(module = "xbus._core", frozen)]
#[derive(Default)]
pub struct Cancel(live::Cancel);

#[pymethods]
impl Cancel {
    #[new]
    fn new() -> Self {
        Self::default()
    }

    #[getter]
    fn is_set(&self) -> bool {
        self.0.is_set()
    }
}

/// Decodes the blocks of an acquisition.
#[pyclass(module = "xbus._core")]
pub struct BlockDecoder(live::BlockDecoder);

/// A block of live samples.
#[pyclass(module = "xbus._core", frozen, get_all)]
pub struct Block {
    part: Py<Part>,
    host_time: Py<PyArray1<f64>>,
    string_time: Py<PyArray1<f64>>,
    clocks: Vec<(u8, Py<HostClock>)>,
}

/// Events that were taken.
#[pyclass(module = "xbus._core", frozen, get_all)]
pub struct Events {
    items: Py<PyList>,
    added: u64,
}

/// A sample, and when it was measured and arrived.
#[pyclass(module = "xbus._core", frozen, get_all)]
pub struct ReceivedSample {
    offset: u64,
    bid: u8,
    payload: Py<PyBytes>,
    /// `OutputMode` and `OutputSettings` of `MTData`.
    output: Option<(u16, u32)>,
    time: f64,
    leads: bool,
    arrival: f64,
    host_time: f64,
}

/// A string, and when it arrived.
#[pyclass(module = "xbus._core", frozen, get_all)]
pub struct ReceivedString {
    offset: u64,
    place: Option<u8>,
    data: Py<PyBytes>,
    arrival: f64,
}

/// What waits to be taken.
#[pyclass(module = "xbus._core", frozen, get_all)]
pub struct Waiting {
    samples: usize,
    strings: usize,
    events_added: u64,
    last_sample: Option<f64>,
    last_arrival: Option<f64>,
    dropped_samples: u64,
}

/// A recording, also after it has ended.
#[pyclass(module = "xbus._core", frozen)]
pub struct Recorder(Arc<live::Recorder>);

#[pymethods]
impl Recorder {
    #[getter]
    fn state(&self) -> Report {
        self.0.report()
    }

    fn stop(&self, py: Python<'_>) -> PyResult<Report> {
        self.0.close();
        wait(py, None, |slice| self.0.wait(slice).then_some(()))?;
        Ok(self.0.report())
    }
}

/// Receives a stream of bytes in a thread, or what is pushed.
#[pyclass(module = "xbus._core", frozen)]
pub struct Acquisition(live::Acquisition);

#[pymethods]
impl Acquisition {
    #[new]
    #[pyo3(signature = (fd, *, bid=255, bound=24_000_000, strings=0, epoch=None))]
    fn new(fd: Option<i32>, bid: u8, bound: usize, strings: u32, epoch: Option<i64>) -> PyResult<Self> {
        let acquisition = Self(live::Acquisition::new(bound, bid, epoch));
        acquisition.0.expect(strings);
        if let Some(fd) = fd {
            acquisition.open(fd)?;
        }
        Ok(acquisition)
    }

    #[staticmethod]
    #[pyo3(signature = (entries, *, rate=None, bid=255, bound=24_000_000, epoch=None))]
    fn can(
        entries: Vec<(u32, u8, u8)>,
        rate: Option<f64>,
        bid: u8,
        bound: usize,
        epoch: Option<i64>,
    ) -> Result<Self, CanError> {
        Ok(Self(live::Acquisition::can(bound, bid, epoch, &ids_of(entries), rate)?))
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

    #[pyo3(signature = (data, arrival=None))]
    fn push(&self, py: Python<'_>, data: &[u8], arrival: Option<f64>) -> PyResult<bool> {
        let arrival = arrival.map(nanoseconds);
        detached(py, || self.0.push(data, arrival))
    }

    #[getter]
    const fn is_can(&self) -> bool {
        self.0.is_can()
    }

    #[pyo3(signature = (times, ids, sizes, data, now=None))]
    #[allow(clippy::needless_pass_by_value)] // what PyO3 extracts
    fn push_can(
        &self,
        py: Python<'_>,
        times: PyReadonlyArray1<'_, f64>,
        ids: PyReadonlyArray1<'_, u32>,
        sizes: PyReadonlyArray1<'_, u8>,
        data: PyReadonlyArray2<'_, u8>,
        now: Option<f64>,
    ) -> PyResult<Option<(Py<PyArray1<u8>>, u64)>> {
        let frames = frames_of(times.as_slice()?, ids.as_slice()?, sizes.as_slice()?, data.as_slice()?)?;
        let now = now.map(nanoseconds);
        let pushed = detached(py, || self.0.push_can(frames, now))??;
        Ok(pushed.map(|(verdicts, samples)| (hand_over(py, verdicts).unbind(), samples)))
    }

    fn give_outputs(&self, legacy: Vec<(u16, u32)>) {
        self.0.give_outputs(legacy.into_iter().map(|(mode, settings)| Output { mode, settings }).collect());
    }

    fn note_request(&self, bid: u8, mid: u8, payload: &[u8]) {
        self.0.note_request(Frame { bid, mid, payload });
    }

    fn resume(&self) -> PyResult<()> {
        self.0.resume().map_err(|error| os_error(&error, None))
    }

    #[pyo3(signature = (*, overruns=0, transfer_errors=0))]
    fn count_bus(&self, overruns: u64, transfer_errors: u64) {
        self.0.count_bus(overruns, transfer_errors);
    }

    fn interrupt(&self) {
        self.0.interrupt();
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

    #[pyo3(signature = (timeout, *, samples=None, strings=false, events=None, cancel=None))]
    fn wait(
        &self,
        py: Python<'_>,
        timeout: f64,
        samples: Option<usize>,
        strings: bool,
        events: Option<u64>,
        cancel: Option<Py<Cancel>>,
    ) -> PyResult<bool> {
        let timeout = seconds("timeout")(timeout)?;
        let cancel = cancel.map_or_else(|| Py::new(py, Cancel::default()), Ok)?;
        let need = Need { samples, strings, events };
        let waited = wait(py, Some(timeout), |slice| self.0.wait(need, slice, &cancel.get().0).then_some(()))?;
        Ok(waited.is_some())
    }

    fn cancel(&self, cancel: &Cancel) {
        self.0.cancel(&cancel.0);
    }

    fn take_sample(&self, py: Python<'_>) -> Option<ReceivedSample> {
        let (sample, frame) = self.0.take_sample()?;
        let payload = if self.0.is_can() { &frame } else { Frame::of(&frame).payload };
        Some(ReceivedSample {
            offset: sample.offset,
            bid: sample.bid,
            payload: PyBytes::new(py, payload).unbind(),
            output: sample.output.map(|Output { mode, settings }| (mode, settings)),
            time: sample.moment.seconds,
            leads: sample.leads,
            arrival: in_seconds(sample.arrival),
            host_time: sample.host_time,
        })
    }

    fn take_string(&self, py: Python<'_>) -> Option<ReceivedString> {
        let Text { offset, arrival, place, bytes } = self.0.take_string()?;
        Some(ReceivedString { offset, place, data: PyBytes::new(py, &bytes).unbind(), arrival: in_seconds(arrival) })
    }

    #[pyo3(signature = (*, early=false))]
    fn take_events(&self, py: Python<'_>, early: bool) -> PyResult<Events> {
        let (events, added) = self.0.take_events(early);
        let scanned = events.iter().map(|event| event.item().map(|item| Scanned::of(py, item)));
        Ok(Events { items: PyList::new(py, scanned)?.unbind(), added })
    }

    fn mark_data(&self) {
        self.0.mark_data();
    }

    #[pyo3(signature = (wanted=None))]
    fn block_decoder(&self, wanted: Option<Wanted>) -> BlockDecoder {
        let decoder = if self.0.is_can() { live::BlockDecoder::can } else { live::BlockDecoder::new };
        BlockDecoder(decoder(wanted, self.0.epoch()))
    }

    #[pyo3(signature = (decoder, samples=None))]
    fn take_block(
        &self,
        py: Python<'_>,
        decoder: &mut BlockDecoder,
        samples: Option<usize>,
    ) -> PyResult<Option<Block>> {
        let decode = || self.0.take_block(samples).map(|block| decoder.0.decode(block));
        let Some(block) = detached(py, decode)? else { return Ok(None) };
        let clock = |(bid, clock)| Ok((bid, Py::new(py, HostClock(clock))?));
        Ok(Some(Block {
            part: Py::new(py, Part(block.part.into()))?,
            host_time: hand_over(py, block.host_times).unbind(),
            string_time: hand_over(py, block.string_times).unbind(),
            clocks: block.clocks.into_iter().map(clock).collect::<PyResult<_>>()?,
        }))
    }

    fn take_all(&self, py: Python<'_>) -> Option<Vec<Scanned>> {
        let scanned = |item: &Item| {
            let item = match item {
                // A sample of a CAN bus is no frame.
                Item::Sample(..) if self.0.is_can() => None,
                Item::Sample(sample, frame) => {
                    Some(scan::Item::Frame { offset: sample.offset, frame: Frame::of(frame) })
                }
                Item::Text(text) => {
                    Some(scan::Item::String { offset: text.offset, place: text.place, bytes: &text.bytes })
                }
                Item::Event(event) => event.item(),
            };
            item.map(|item| Scanned::of(py, item))
        };
        Some(self.0.take_all()?.iter().filter_map(scanned).collect())
    }

    fn clear_data(&self) -> usize {
        self.0.clear_data()
    }

    #[getter]
    fn waiting(&self) -> Waiting {
        let waiting = self.0.waiting();
        Waiting {
            samples: waiting.samples,
            strings: waiting.strings,
            events_added: waiting.events_added,
            last_sample: waiting.last_sample.map(in_seconds),
            last_arrival: waiting.last_arrival.map(in_seconds),
            dropped_samples: waiting.dropped_samples,
        }
    }

    #[getter]
    fn bid(&self) -> u8 {
        self.0.bid()
    }

    fn stats(&self, now: f64) -> Stats {
        self.0.stats(nanoseconds(now))
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
    ) -> PyResult<Recorder> {
        let rotate_after = rotate_seconds.map(seconds("rotate_seconds")).transpose()?;
        if rotate_bytes == Some(0) || rotate_after.is_some_and(|duration| duration.is_zero()) {
            return Err(PyValueError::new_err("rotate_bytes and rotate_seconds must be greater than 0"));
        }
        let flush = seconds("flush")(flush)?;
        let head = head.to_vec();
        let recording = Recording { path, overwrite, head, flush, fsync, rotate_bytes, rotate_after, times, bound };
        let name = recording.path.clone();
        py.detach(|| self.0.record(recording)).map(Recorder).map_err(|error| os_error(&error, Some(name)))
    }

    #[getter]
    fn recording(&self) -> Option<Recorder> {
        self.0.recording().map(Recorder)
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

/// Seconds from Python.
fn seconds(name: &'static str) -> impl Fn(f64) -> PyResult<Duration> {
    move |value| {
        Duration::try_from_secs_f64(value)
            .map_err(|_| PyValueError::new_err(format!("{name} must be a number of seconds, not {value}")))
    }
}
