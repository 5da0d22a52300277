//! Logs.

use std::fs::File;
use std::io::Read;
use std::sync::{Arc, OnceLock};

use numpy::ndarray::aview1;
use numpy::{Element, IntoPyArray, PyArray1, PyArrayMethods, PyReadonlyArray1};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::Row;
use super::codec::named;
use super::utc;
use crate::clock::{Clocks, Losses};
use crate::column::{Subject, Values};
use crate::error::Fault;
use crate::log::{self, Options, Stats};
use crate::packet::{Coordinates, Precision};
use crate::scan::{Damage, Window};
use crate::table;

pyo3::import_exception!(xbus.errors, DecodeError);

type Array<'py, T> = Bound<'py, PyArray1<T>>;

impl From<Fault> for PyErr {
    fn from(fault: Fault) -> Self {
        DecodeError::new_err((fault.to_string(), fault.offset(), fault.data_id()))
    }
}

/// Where the bytes come from.
enum Source {
    Array(Py<PyArray1<u8>>),
    Stream(Stream),
}

/// Input that is read piece by piece, into one buffer that is used again and again. A file is read like this and not
/// mapped: a mapped file that another program cuts short kills the process that reads it, and a read one just ends.
struct Stream {
    input: Box<dyn Read + Send + Sync>,
    buffer: Vec<u8>,
    /// Bytes of the buffer that are filled.
    filled: usize,
    /// Where in the input the buffer begins.
    offset: u64,
    ended: bool,
}

/// Large enough to make system calls cheap, small enough for the second-level cache.
const PIECE: usize = 1 << 19;

impl Stream {
    fn new(input: Box<dyn Read + Send + Sync>) -> Self {
        Self { input, buffer: vec![0; 2 * PIECE], filled: 0, offset: 0, ended: false }
    }

    /// Forgets what lies before `at` and reads a piece more.
    fn fill(&mut self, at: u64) -> std::io::Result<()> {
        #[allow(clippy::cast_possible_truncation)] // a position in the buffer
        let done = (at - self.offset) as usize;
        self.buffer.copy_within(done..self.filled, 0);
        (self.filled, self.offset) = (self.filled - done, at);
        if self.buffer.len() - self.filled < PIECE {
            self.buffer.resize(self.filled + PIECE, 0);
        }
        let wanted = self.filled + PIECE;
        while self.filled < wanted && !self.ended {
            match self.input.read(&mut self.buffer[self.filled..wanted]) {
                Ok(0) => self.ended = true,
                Ok(more) => self.filled += more,
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}

/// A Python object with a method `read`.
struct PyInput(Py<PyAny>);

impl Read for PyInput {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        Python::attach(|py| {
            let data = self.0.bind(py).call_method1("read", (buffer.len(),))?;
            let bytes: &[u8] = data
                .extract()
                .map_err(|_| PyTypeError::new_err("read() must return bytes; open the file in binary mode"))?;
            if bytes.len() > buffer.len() {
                return Err(PyTypeError::new_err("read() returned more bytes than were asked for"));
            }
            buffer[..bytes.len()].copy_from_slice(bytes);
            Ok(bytes.len())
        })
        .map_err(|error: PyErr| std::io::Error::other(error))
    }
}

/// Reads a log.
#[pyclass(module = "xbus._core")]
pub struct Reader {
    reader: log::Reader,
    source: Source,
    clocks: Clocks,
    #[pyo3(get)]
    total: Option<u64>,
}

#[pymethods]
impl Reader {
    /// `source` is a uint8 array, a path, or an object with a method `read`.
    #[new]
    #[pyo3(signature = (source, *, limit, strict, wanted, strings=0, part_bytes=None, fast=true))]
    #[allow(clippy::too_many_arguments)] // each has its name
    fn new(
        source: &Bound<'_, PyAny>,
        limit: usize,
        strict: bool,
        wanted: Option<Vec<(String, Option<String>)>>,
        strings: u32,
        part_bytes: Option<u64>,
        fast: bool,
    ) -> PyResult<Self> {
        let wanted = wanted.map(|list| list.iter().map(wish).collect::<PyResult<_>>()).transpose()?;
        let (source, total) = if let Ok(array) = source.cast::<PyArray1<u8>>() {
            (Source::Array(array.clone().unbind()), Some(array.readonly().as_slice()?.len() as u64))
        } else if let Ok(path) = source.extract::<std::path::PathBuf>() {
            let file = File::open(path)?;
            let total = file.metadata()?.is_file().then_some(file.metadata()?.len());
            (Source::Stream(Stream::new(Box::new(file))), total)
        } else {
            (Source::Stream(Stream::new(Box::new(PyInput(source.clone().unbind())))), None)
        };
        let options = Options { limit, strict, strings, wanted, fast };
        let part_bytes = part_bytes.into_iter().chain(total).min().unwrap_or(0);
        Ok(Self { reader: log::Reader::new(options, part_bytes), source, clocks: Clocks::default(), total })
    }

    /// Position in the input.
    #[getter]
    fn position(&self) -> u64 {
        self.reader.at()
    }

    /// Reads about `size` bytes more; whether there is anything left.
    fn advance(&mut self, py: Python<'_>, size: u64) -> PyResult<bool> {
        let Self { reader, source, .. } = self;
        let until = reader.at().saturating_add(size);
        match source {
            Source::Array(array) => {
                let array: PyReadonlyArray1<'_, u8> = array.bind(py).try_readonly()?;
                let bytes = array.as_slice()?;
                py.detach(|| reader.read(Window { bytes, offset: 0, last: true }, until))?;
            }
            Source::Stream(stream) => py.detach(|| -> PyResult<()> {
                while reader.at() < until && !reader.is_finished() {
                    stream.fill(reader.at())?;
                    let bytes = &stream.buffer[..stream.filled];
                    reader.read(Window { bytes, offset: stream.offset, last: stream.ended }, until)?;
                }
                Ok(())
            })?,
        }
        Ok(!reader.is_finished())
    }

    /// What has been read since the last time.
    fn take(&mut self, py: Python<'_>) -> Part {
        let Self { reader, clocks, .. } = self;
        py.detach(|| Part::taken(reader, clocks))
    }
}

/// Decodes a log that is handed over piece by piece.
#[pyclass(module = "xbus._core")]
pub struct Decoder {
    reader: log::Reader,
    clocks: Clocks,
    /// The bytes that are not decided yet.
    kept: Vec<u8>,
}

#[pymethods]
impl Decoder {
    /// No frame may carry more than `limit` bytes of payload; `strings` are those to look for: see `Scanner::expect`.
    #[new]
    #[pyo3(signature = (limit, wanted, strings=0))]
    fn new(limit: usize, wanted: Option<Vec<(String, Option<String>)>>, strings: u32) -> PyResult<Self> {
        let wanted = wanted.map(|list| list.iter().map(wish).collect::<PyResult<_>>()).transpose()?;
        let reader = log::Reader::new(Options { limit, strings, wanted, ..Options::default() }, 0);
        Ok(Self { reader, clocks: Clocks::default(), kept: vec![] })
    }

    /// Decodes what can be told with these bytes.
    fn feed(&mut self, py: Python<'_>, data: &[u8]) -> PyResult<()> {
        let Self { reader, kept, .. } = self;
        py.detach(|| {
            let offset = reader.at();
            kept.extend_from_slice(data);
            reader.read(Window { bytes: kept, offset, last: false }, u64::MAX)?;
            #[allow(clippy::cast_possible_truncation)] // a position in what was kept
            kept.drain(..(reader.at() - offset) as usize);
            Ok(())
        })
    }

    /// What has been decoded since the last time.
    fn take(&mut self, py: Python<'_>) -> Part {
        let Self { reader, clocks, .. } = self;
        py.detach(|| Part::taken(reader, clocks))
    }
}

fn wish((name, coordinates): &(String, Option<String>)) -> PyResult<(&'static table::Quantity, Option<Coordinates>)> {
    let quantity = table::quantity_named(name).ok_or_else(|| {
        pyo3::exceptions::PyValueError::new_err(format!("no quantity is called {name:?}; xbus items lists them"))
    })?;
    let coordinates = coordinates.as_deref().map(named(&Coordinates::ALL, Coordinates::name)).transpose()?;
    Ok((quantity, coordinates))
}

/// Times and counters of the samples.
pub struct Times {
    pub time: Vec<f64>,
    pub counter: Vec<i64>,
    pub losses: Losses,
}

/// A part of a log, with the clocks at its beginning.
pub struct Shared {
    pub part: log::Part,
    start: Clocks,
    times: OnceLock<Times>,
}

impl Shared {
    /// Times and counters, worked out when they are first asked for.
    pub fn times(&self) -> &Times {
        self.times.get_or_init(|| {
            let (time, counter, losses) = self.part.unwrap(&mut self.start.clone());
            Times { time, counter, losses }
        })
    }
}

/// A part of a log.
#[pyclass(module = "xbus._core", frozen)]
pub struct Part(pub Arc<Shared>);

/// A read-only array over numbers that `owner` keeps alive.
fn lend<'py, T: Element, O>(numbers: &[T], owner: &Bound<'py, O>) -> Array<'py, T> {
    // SAFETY: `owner` is the base object of the array, so it lives as long as the array. The numbers belong to it, are
    // never moved or changed after it was made, and the array does not let anybody write to them.
    #[allow(unsafe_code)]
    let array = unsafe { PyArray1::borrow_from_array(&aview1(numbers), owner.clone().into_any()) };
    array.readwrite().make_nonwriteable();
    array
}

/// Positions and counts as a new int64 array, the type that numpy counts with.
fn signed(py: Python<'_>, numbers: impl Iterator<Item = u64>) -> Array<'_, i64> {
    let numbers: Vec<i64> = numbers.map(u64::cast_signed).collect();
    numbers.into_pyarray(py)
}

impl Part {
    /// What a reader has read since the last time.
    fn taken(reader: &mut log::Reader, clocks: &mut Clocks) -> Self {
        let part = reader.take();
        let start = clocks.clone();
        let times = OnceLock::new();
        if !reader.is_finished() {
            // The next part goes on where the clocks of this one end.
            let (time, counter, losses) = part.unwrap(clocks);
            let _ = times.set(Times { time, counter, losses });
        }
        Self(Arc::new(Shared { part, start, times }))
    }
}

#[pymethods]
impl Part {
    /// Number of samples.
    fn __len__(&self) -> usize {
        self.0.part.len()
    }

    /// Index of the first sample.
    #[getter]
    fn first(&self) -> u64 {
        self.0.part.first
    }

    /// The columns.
    #[getter]
    fn columns(&self) -> Vec<Column> {
        (0..self.0.part.columns.len()).map(|index| Column { shared: self.0.clone(), index }).collect()
    }

    /// What was counted.
    #[getter]
    fn stats<'py>(&self, py: Python<'py>) -> PyResult<Row<'py>> {
        let Stats { bytes, frames, samples, messages, malformed, strings, skipped_bytes, checksum_errors } =
            self.0.part.stats;
        let losses = py.detach(|| self.0.times().losses);
        let row = PyDict::new(py);
        row.set_item("bytes", bytes)?;
        row.set_item("frames", frames)?;
        row.set_item("samples", samples)?;
        row.set_item("messages", messages)?;
        row.set_item("malformed", malformed)?;
        row.set_item("strings", strings)?;
        row.set_item("skipped_bytes", skipped_bytes)?;
        row.set_item("checksum_errors", checksum_errors)?;
        row.set_item("lost_samples", losses.samples)?;
        row.set_item("gaps", losses.gaps)?;
        Ok(row)
    }

    /// The damage: offset, length, and the reason's place in `damage_reasons`.
    #[getter]
    fn damage<'py>(&self, py: Python<'py>) -> (Array<'py, i64>, Array<'py, i64>, Array<'py, u8>) {
        let damage = &self.0.part.damage;
        let numbers = |number: fn(&Damage) -> u64| signed(py, damage.iter().map(number));
        let reasons: Vec<u8> = damage.iter().map(|it| it.reason as u8).collect();
        (numbers(|it| it.offset), numbers(|it| it.length), reasons.into_pyarray(py))
    }

    /// The other messages: mid, bid, offset, sample, end of each payload, and all payloads.
    #[getter]
    #[allow(clippy::type_complexity)]
    fn messages<'py>(
        slf: &Bound<'py, Self>,
    ) -> (Array<'py, u8>, Array<'py, u8>, Array<'py, i64>, Array<'py, i64>, Array<'py, u64>, Array<'py, u8>) {
        let messages = &slf.get().0.part.messages;
        (
            lend(&messages.mid, slf),
            lend(&messages.bid, slf),
            signed(slf.py(), messages.offset.iter().copied()),
            signed(slf.py(), messages.sample.iter().copied()),
            lend(&messages.payload.ends, slf),
            lend(&messages.payload.bytes, slf),
        )
    }

    /// The string outputs: place in `strings` or 255, offset, sample, end of each, and the bytes of all.
    #[getter]
    #[allow(clippy::type_complexity)]
    fn strings<'py>(
        slf: &Bound<'py, Self>,
    ) -> (Array<'py, u8>, Array<'py, i64>, Array<'py, i64>, Array<'py, u64>, Array<'py, u8>) {
        let strings = &slf.get().0.part.strings;
        (
            lend(&strings.place, slf),
            signed(slf.py(), strings.offset.iter().copied()),
            signed(slf.py(), strings.sample.iter().copied()),
            lend(&strings.bytes.ends, slf),
            lend(&strings.bytes.bytes, slf),
        )
    }

    /// Per sample: seconds on the device clock, unwrapped.
    #[getter]
    fn time<'py>(slf: &Bound<'py, Self>) -> Array<'py, f64> {
        let shared = &slf.get().0;
        let times = slf.py().detach(|| shared.times());
        lend(&times.time, slf)
    }

    /// Per sample: the packet counter, unwrapped.
    #[getter]
    fn packet_counter<'py>(slf: &Bound<'py, Self>) -> Array<'py, i64> {
        let shared = &slf.get().0;
        let times = slf.py().detach(|| shared.times());
        lend(&times.counter, slf)
    }

    /// Per sample: where its frame begins.
    #[getter]
    fn offset<'py>(&self, py: Python<'py>) -> Array<'py, i64> {
        py.detach(|| self.0.part.offsets()).into_pyarray(py)
    }

    /// Per sample: where its frame ends.
    #[getter]
    fn end<'py>(&self, py: Python<'py>) -> Array<'py, i64> {
        py.detach(|| self.0.part.ends()).into_pyarray(py)
    }

    /// Per sample: the bus identifier of its frame.
    #[getter]
    fn bid<'py>(&self, py: Python<'py>) -> Array<'py, u8> {
        py.detach(|| self.0.part.bids()).into_pyarray(py)
    }
}

/// A column.
#[pyclass(module = "xbus._core", frozen)]
pub struct Column {
    pub shared: Arc<Shared>,
    pub index: usize,
}

/// Keeps the numbers of one column alive for its arrays, and nothing else of the log.
#[pyclass(module = "xbus._core", frozen)]
struct Owner(Arc<crate::column::Column>);

impl Column {
    pub fn column(&self) -> &Arc<crate::column::Column> {
        &self.shared.part.columns[self.index]
    }
}

#[pymethods]
impl Column {
    /// Number of rows.
    fn __len__(&self) -> usize {
        self.column().rows
    }

    /// Name of the quantity; None for an identifier that the tables cannot explain.
    #[getter]
    fn name(&self) -> Option<&'static str> {
        match self.column().subject {
            Subject::Known(quantity, _) => Some(quantity.name),
            Subject::Unknown(_) => None,
        }
    }

    /// Coordinate system.
    #[getter]
    fn coordinates(&self) -> Option<&'static str> {
        match self.column().subject {
            Subject::Known(_, coordinates) => coordinates.map(Coordinates::name),
            Subject::Unknown(_) => None,
        }
    }

    /// Data identifier as received, or the base identifier if several were.
    #[getter]
    fn data_id(&self) -> u16 {
        let column = self.column();
        match column.subject {
            Subject::Known(quantity, _) if column.mixed_ids => quantity.id,
            _ => column.id,
        }
    }

    /// Precision of the reals, if it is one.
    #[getter]
    fn precision(&self) -> Option<&'static str> {
        let column = self.column();
        match column.subject {
            Subject::Known(quantity, _) if matches!(quantity.kind, table::Kind::Real(_)) => {
                (!column.mixed_precisions).then(|| Precision::of(column.id).name())
            }
            _ => None,
        }
    }

    /// The numbers, in one dimension; records and raw packets as bytes.
    #[getter]
    fn values<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let owner = Bound::new(py, Owner(self.column().clone()))?;
        let array = match &owner.get().0.values {
            Values::U8(it) | Values::Records(it) => lend(it, &owner).into_any(),
            Values::U16(it) => lend(it, &owner).into_any(),
            Values::U32(it) => lend(it, &owner).into_any(),
            Values::U64(it) => lend(it, &owner).into_any(),
            Values::I8(it) => lend(it, &owner).into_any(),
            Values::I16(it) => lend(it, &owner).into_any(),
            Values::I32(it) => lend(it, &owner).into_any(),
            Values::F32(it) => lend(it, &owner).into_any(),
            Values::F64(it) => lend(it, &owner).into_any(),
            Values::Raw(it) => lend(&it.bytes, &owner).into_any(),
        };
        Ok(array)
    }

    /// The records of `UtcTime` and `GnssPvtData` as nanoseconds since 1970; the least integer where the date or time does
    /// not exist.
    #[getter]
    fn nanoseconds<'py>(&self, py: Python<'py>) -> Option<Array<'py, i64>> {
        let column = self.column();
        let Values::Records(bytes) = &column.values else { return None };
        let Subject::Known(quantity, _) = column.subject else { return None };
        let nanoseconds = match quantity.name {
            "utc_time" => utc::nanoseconds,
            "gnss_pvt_data" => utc::nanoseconds_of_fix,
            _ => return None,
        };
        let stamp = |record: &[u8]| nanoseconds(record).unwrap_or(i64::MIN);
        let stamps: Vec<i64> = py.detach(|| bytes.chunks_exact(column.width).map(stamp).collect());
        Some(stamps.into_pyarray(py))
    }

    /// The entries of a list quantity, all of them, as bytes.
    #[getter]
    fn entries<'py>(&self, py: Python<'py>) -> PyResult<Array<'py, u8>> {
        let owner = Bound::new(py, Owner(self.column().clone()))?;
        Ok(lend(&owner.get().0.entries, &owner))
    }

    /// Where each raw packet ends in `values`.
    #[getter]
    fn ends<'py>(&self, py: Python<'py>) -> PyResult<Option<Array<'py, u64>>> {
        let owner = Bound::new(py, Owner(self.column().clone()))?;
        match &owner.get().0.values {
            Values::Raw(it) => Ok(Some(lend(&it.ends, &owner))),
            _ => Ok(None),
        }
    }

    /// Which sample each row belongs to.
    #[getter]
    fn sample<'py>(&self, py: Python<'py>) -> Array<'py, i64> {
        py.detach(|| self.shared.part.samples_of(self.column())).into_pyarray(py)
    }
}
