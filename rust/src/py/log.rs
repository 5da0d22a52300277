//! Logs: readers and the parts that they return.

use std::sync::Arc;

use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::{IntoPyDict, PyBytes, PyType};

use super::Row;
use super::array::{Array, hand_over, hand_over_all, hand_over_signed, lend};
use super::column::Column;
use super::convert::detached;
use super::source::Source;
use crate::catch::expect_memory;
use crate::clock::Clocks;
use crate::log::{self, Blocks, Input, Options, Place, TimedPart, Times, Wanted};
use crate::mtdata::{Output, Outputs};
use crate::{state, utc};

/// Reads a log.
#[pyclass(module = "xbus._core")]
pub struct Reader {
    reader: log::Reader,
    clocks: Clocks,
    source: Source,
    blocks: Blocks,
    #[pyo3(get)]
    total: Option<u64>,
}

#[pymethods]
impl Reader {
    #[new]
    #[pyo3(signature = (source, *, limit, strict, wanted, strings=0, part_bytes=None, rate=None, threads=1, values=true, fast=true, legacy=vec![], state=None, check=None))]
    #[allow(clippy::too_many_arguments)] // by keyword
    fn new(
        source: &Bound<'_, PyAny>,
        limit: usize,
        strict: bool,
        wanted: Option<Wanted>,
        strings: u32,
        part_bytes: Option<u64>,
        rate: Option<f64>,
        threads: usize,
        values: bool,
        fast: bool,
        legacy: Vec<(u16, u32)>,
        state: Option<&[u8]>,
        check: Option<Py<PyAny>>,
    ) -> PyResult<Self> {
        let options = Options { limit, strict, strings, wanted, values, fast };
        let (place, clocks) = if let Some(state) = state {
            state::from_bytes(state)?
        } else {
            let given = legacy.into_iter().map(|(mode, settings)| Output { mode, settings }).collect();
            (Place { outputs: Outputs::given(given), ..Place::default() }, Clocks::new(rate))
        };
        let (source, total) = Source::open(source, place.seam.at, threads, check)?;
        let part_bytes = part_bytes.into_iter().chain(total).min().unwrap_or(0);
        let reader = log::Reader::resume(options, place, part_bytes);
        Ok(Self { reader, clocks, source, blocks: Blocks::of(threads), total })
    }

    #[getter]
    fn can_split(&self) -> bool {
        self.reader.place().is_some()
    }

    #[getter]
    fn state<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyBytes>> {
        let place = self.reader.place()?;
        Some(PyBytes::new(py, &state::to_bytes(&(place, &self.clocks))))
    }

    #[getter]
    fn position(&self) -> u64 {
        self.reader.at()
    }

    fn advance(&mut self, py: Python<'_>, size: u64) -> PyResult<bool> {
        let Self { reader, source, blocks, .. } = self;
        let until = reader.at().saturating_add(size);
        detached(py, || expect_memory(0))?;
        match source {
            Source::Bytes(bytes, range) => {
                let bytes = &bytes.bind(py).as_bytes()[range.clone()];
                detached(py, || reader.read_parallel(Input::Memory(bytes), until, *blocks))??;
            }
            Source::Copied(bytes) => {
                detached(py, || reader.read_parallel(Input::Copied(&**bytes), until, *blocks))??;
            }
            Source::Stream(stream) => detached(py, || reader.read_stream(stream, until))??,
        }
        Ok(!reader.is_finished())
    }

    fn take(&mut self, py: Python<'_>) -> PyResult<Part> {
        let Self { reader, clocks, .. } = self;
        detached(py, || Part(Arc::new(TimedPart::take(reader, clocks))))
    }

    #[pyo3(signature = (shape=None))]
    fn take_last(&mut self, py: Python<'_>, shape: Option<&Shape>) -> PyResult<Part> {
        let Self { reader, clocks, .. } = self;
        detached(py, || Part::of(TimedPart::take_last(reader, std::mem::take(clocks)), shape))?
    }
}

/// The shape of a log.
#[pyclass(module = "xbus._core")]
#[derive(Default)]
pub struct Shape(log::Shape);

#[pymethods]
impl Shape {
    #[new]
    #[pyo3(signature = (state=None))]
    fn new(state: Option<&[u8]>) -> PyResult<Self> {
        Ok(Self(state.map(state::from_bytes).transpose()?.unwrap_or_default()))
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> (Bound<'py, PyType>, (Bound<'py, PyBytes>,)) {
        (slf.get_type(), (PyBytes::new(slf.py(), &state::to_bytes(&slf.borrow().0)),))
    }

    fn __eq__(&self, other: &Self) -> bool {
        state::to_bytes(&self.0) == state::to_bytes(&other.0)
    }

    fn add(&mut self, py: Python<'_>, part: &Part) -> PyResult<()> {
        detached(py, || self.0.add(&part.0.part))
    }

    #[allow(clippy::needless_pass_by_value)] // what PyO3 extracts
    fn of_wanted(&self, wanted: Wanted) -> Self {
        Self(self.0.of_wanted(&wanted))
    }

    fn of_device(&self, device: &Self) -> Self {
        Self(self.0.of_device(&device.0))
    }

    fn empty(&self) -> Part {
        Part(Arc::new(TimedPart::empty(&self.0)))
    }
}

/// A part of a log.
#[pyclass(module = "xbus._core", frozen)]
pub struct Part(pub Arc<TimedPart>);

impl Part {
    fn of(part: TimedPart, shape: Option<&Shape>) -> PyResult<Self> {
        let part = if let Some(shape) = shape { part.shaped(&shape.0)? } else { part };
        Ok(Self(Arc::new(part)))
    }

    fn times(&self, py: Python<'_>) -> PyResult<&Times> {
        detached(py, || self.0.times())
    }
}

#[pymethods]
impl Part {
    #[new]
    fn new(py: Python<'_>, state: &[u8]) -> PyResult<Self> {
        let (part, times) = detached(py, || state::from_bytes(state))??;
        Ok(Self(Arc::new(TimedPart::of(part, times))))
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyType>, (Bound<'py, PyBytes>,))> {
        let timed = &slf.get().0;
        let bytes = detached(slf.py(), || state::to_bytes(&(&timed.part, timed.times())))?;
        Ok((slf.get_type(), (PyBytes::new(slf.py(), &bytes),)))
    }

    fn only(&self, column: &Column) -> Self {
        Self(Arc::new(self.0.only(column.index)))
    }

    #[pyo3(signature = (bid, first, shape=None))]
    fn of_device(&self, py: Python<'_>, bid: u8, first: u64, shape: Option<&Shape>) -> PyResult<Self> {
        detached(py, || Self::of(self.0.of_device(bid, first), shape))?
    }

    fn shaped(&self, py: Python<'_>, shape: &Shape) -> PyResult<Self> {
        detached(py, || Self::of(TimedPart::of(self.0.part.clone(), self.0.times().clone()), Some(shape)))?
    }

    fn __len__(&self) -> usize {
        self.0.part.len()
    }

    #[getter]
    fn first(&self) -> u64 {
        self.0.part.first
    }

    #[getter]
    fn columns(&self) -> Vec<Column> {
        (0..self.0.part.columns.len()).map(|index| Column { part: self.0.clone(), index }).collect()
    }

    #[getter]
    fn stats<'py>(&self, py: Python<'py>) -> PyResult<Row<'py>> {
        let (stats, losses) = (&self.0.part.stats, self.times(py)?.losses());
        let counts = [
            ("bytes", stats.bytes),
            ("frames", stats.frames),
            ("samples", stats.samples),
            ("messages", stats.messages),
            ("malformed", stats.malformed),
            ("unfit", stats.unfit),
            ("strings", stats.strings),
            ("skipped_bytes", stats.skipped_bytes),
            ("checksum_errors", stats.checksum_errors),
            ("lost_samples", losses.samples),
            ("gaps", losses.gaps),
        ];
        counts.into_py_dict(py)
    }

    #[getter]
    fn damage(&self, py: Python<'_>) -> PyResult<DamageArrays> {
        let damage = &self.0.part.damage;
        Ok(DamageArrays {
            offset: hand_over_signed(py, damage.iter().map(|stretch| stretch.offset))?.unbind(),
            length: hand_over_signed(py, damage.iter().map(|stretch| stretch.length))?.unbind(),
            reason: hand_over_all(py, damage.iter().map(|stretch| stretch.reason as u8))?.unbind(),
        })
    }

    #[getter]
    fn messages(slf: &Bound<'_, Self>) -> PyResult<MessageArrays> {
        let messages = &slf.get().0.part.messages;
        Ok(MessageArrays {
            mid: lend(&messages.mid, slf).unbind(),
            bid: lend(&messages.bid, slf).unbind(),
            offset: hand_over_signed(slf.py(), messages.offset.iter().copied())?.unbind(),
            sample: hand_over_signed(slf.py(), messages.sample.iter().copied())?.unbind(),
            ends: lend(&messages.payload.ends, slf).unbind(),
            payloads: lend(&messages.payload.bytes, slf).unbind(),
        })
    }

    #[getter]
    fn strings(slf: &Bound<'_, Self>) -> PyResult<StringArrays> {
        let strings = &slf.get().0.part.strings;
        Ok(StringArrays {
            place: lend(&strings.place, slf).unbind(),
            offset: hand_over_signed(slf.py(), strings.offset.iter().copied())?.unbind(),
            sample: hand_over_signed(slf.py(), strings.sample.iter().copied())?.unbind(),
            ends: lend(&strings.bytes.ends, slf).unbind(),
            data: lend(&strings.bytes.bytes, slf).unbind(),
        })
    }

    #[getter]
    fn time<'py>(slf: &Bound<'py, Self>) -> PyResult<Array<'py, f64>> {
        Ok(lend(&slf.get().times(slf.py())?.time, slf))
    }

    #[getter]
    fn time_span(&self, py: Python<'_>) -> PyResult<(f64, f64, usize, bool)> {
        let times = self.times(py)?;
        let span = detached(py, || times.span())?;
        Ok((span.earliest, span.latest, span.known, span.is_ascending))
    }

    #[getter]
    fn packet_counter<'py>(slf: &Bound<'py, Self>) -> PyResult<Array<'py, i64>> {
        Ok(lend(&slf.get().times(slf.py())?.counter, slf))
    }

    #[getter]
    fn has_counter(&self, py: Python<'_>) -> PyResult<bool> {
        Ok(self.times(py)?.has_counter)
    }

    #[getter]
    fn gaps(&self, py: Python<'_>) -> PyResult<GapArrays> {
        let gaps = &self.times(py)?.gaps;
        Ok(GapArrays {
            sample: hand_over_signed(py, gaps.iter().map(|gap| gap.sample))?.unbind(),
            lost: hand_over_signed(py, gaps.iter().map(|gap| gap.lost))?.unbind(),
            bid: hand_over_all(py, gaps.iter().map(|gap| gap.bid))?.unbind(),
        })
    }

    #[getter]
    fn restarts(&self, py: Python<'_>) -> PyResult<RestartArrays> {
        let restarts = &self.times(py)?.restarts;
        Ok(RestartArrays {
            sample: hand_over_signed(py, restarts.iter().map(|restart| restart.sample))?.unbind(),
            bid: hand_over_all(py, restarts.iter().map(|restart| restart.bid))?.unbind(),
        })
    }

    #[getter]
    fn offset<'py>(&self, py: Python<'py>) -> PyResult<Array<'py, i64>> {
        Ok(hand_over(py, detached(py, || self.0.part.offsets())?))
    }

    #[getter]
    fn end<'py>(&self, py: Python<'py>) -> PyResult<Array<'py, i64>> {
        Ok(hand_over(py, detached(py, || self.0.part.ends())?))
    }

    #[getter]
    fn utc<'py>(&self, py: Python<'py>) -> PyResult<Option<Array<'py, i64>>> {
        let part = &self.0.part;
        let columns: Vec<_> = part.columns.iter().collect();
        let stamps = detached(py, || utc::nanoseconds_of_samples(part, &columns))?;
        Ok(stamps.map(|stamps| hand_over(py, stamps)))
    }

    #[getter]
    fn devices(&self, py: Python<'_>) -> PyResult<Vec<(u8, usize)>> {
        detached(py, || self.0.part.devices())
    }

    #[getter]
    fn bid<'py>(&self, py: Python<'py>) -> PyResult<Array<'py, u8>> {
        Ok(hand_over(py, detached(py, || self.0.part.bids())?))
    }
}

/// The damage of a part.
#[pyclass(module = "xbus._core", frozen, get_all)]
pub struct DamageArrays {
    offset: Py<PyArray1<i64>>,
    length: Py<PyArray1<i64>>,
    reason: Py<PyArray1<u8>>,
}

/// The places of a part where samples are missing.
#[pyclass(module = "xbus._core", frozen, get_all)]
pub struct GapArrays {
    sample: Py<PyArray1<i64>>,
    lost: Py<PyArray1<i64>>,
    bid: Py<PyArray1<u8>>,
}

/// The places of a part where runs start.
#[pyclass(module = "xbus._core", frozen, get_all)]
pub struct RestartArrays {
    sample: Py<PyArray1<i64>>,
    bid: Py<PyArray1<u8>>,
}

/// The messages of a part that are not samples.
#[pyclass(module = "xbus._core", frozen, get_all)]
pub struct MessageArrays {
    mid: Py<PyArray1<u8>>,
    bid: Py<PyArray1<u8>>,
    offset: Py<PyArray1<i64>>,
    sample: Py<PyArray1<i64>>,
    ends: Py<PyArray1<u64>>,
    payloads: Py<PyArray1<u8>>,
}

/// The string outputs of a part.
#[pyclass(module = "xbus._core", frozen, get_all)]
pub struct StringArrays {
    place: Py<PyArray1<u8>>,
    offset: Py<PyArray1<i64>>,
    sample: Py<PyArray1<i64>>,
    ends: Py<PyArray1<u64>>,
    data: Py<PyArray1<u8>>,
}
