//! Recording: every byte to disk, written by a thread, so that a slow disk delays nothing else.
//!
//! A file starts with the head that the caller gives (Configuration and the like, so that other programs can open it),
//! followed by the received bytes, unaltered, from the start of a frame on, to the end of one or to the end of the stream.
//! They are written at a fixed interval at least, and what is written is a valid log whatever happens next. If the disk is
//! full or fails, the file is truncated after its last whole frame, and the recording ends with an error; if the disk is too
//! slow for longer than the queue can hold, the recording ends with all that was queued, never with a gap.
//!
//! # Files
//!
//! `NAME.mtb`, then `NAME-0001.mtb`, `NAME-0002.mtb`, and so on. A file is full at the first end of a frame at which it has
//! the requested size or duration. Every frame is in exactly one file.
//!
//! # Times
//!
//! Beside each file there can be one with `.times` appended to its name: when the bytes arrived. All numbers are
//! little-endian:
//!
//! ```text
//! header   8 bytes  "XBUSTIME"
//!          u32      version: 1
//!          u32      bytes of a record: 16
//!          i64      epoch: times of records minus this are on the host's steady clock, in ns
//! record   u64      position: the number of bytes of the log, including its head, that had arrived
//!          i64      arrival: nanoseconds since 1970
//! ```
//!
//! Positions and arrivals never decrease. A piece that arrives less than 10 ms after the last record is left out (unless it
//! is the last piece of the file), so records take at most 1.6 kB/s. After a crash the last records may be missing, or, if
//! the log was truncated, be beyond its end.

mod file;
mod times;
mod writer;

use std::collections::BTreeMap;
use std::io;
use std::path::PathBuf;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

pub use self::times::{TIMES_HEADER, TIMES_MAGIC, TIMES_VERSION};
use self::writer::Writer;
use super::{Piece, lock, most_entries};

/// With this many bytes in the queue the thread writes before the interval is over.
const PLENTY: usize = 256 << 10;

/// Options of a recording.
#[derive(Clone, Debug)]
pub struct Recording {
    /// The first file.
    pub path: PathBuf,
    /// Whether existing files may be overwritten. If not, a first file that exists and is not empty is an error, and the
    /// following files skip the numbers that exist.
    pub overwrite: bool,
    /// What each file starts with: whole frames.
    pub head: Vec<u8>,
    /// How long bytes may wait before they are written.
    pub flush: Duration,
    /// Whether to make the disk store the bytes each time, so that they survive a power cut and not just a crash.
    pub fsync: bool,
    /// Start another file when one has this many bytes.
    pub rotate_bytes: Option<u64>,
    /// Start another file when one has lasted this long.
    pub rotate_after: Option<Duration>,
    /// Whether to write the times of arrival.
    pub times: bool,
    /// Most bytes that wait for the disk. Pieces shorter than 16 bytes count as 16.
    pub bound: usize,
}

impl Recording {
    /// To one file, written every half second, with times.
    #[must_use]
    pub fn to(path: impl Into<PathBuf>) -> Self {
        Self {
            path: path.into(),
            overwrite: false,
            head: vec![],
            flush: Duration::from_millis(500),
            fsync: false,
            rotate_bytes: None,
            rotate_after: None,
            times: true,
            bound: super::QUEUE,
        }
    }
}

/// The state of a recording.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "python", derive(pyo3::IntoPyObject))]
pub struct Report {
    /// The files, in order.
    pub files: Vec<PathBuf>,
    /// Received bytes in the files, without heads.
    pub bytes: u64,
    /// Frames in the files.
    pub frames: u64,
    /// Samples among them.
    pub samples: u64,
    /// Other messages among them, by message identifier.
    pub message_counts: BTreeMap<u8, u64>,
    /// Strings in the files.
    pub strings: u64,
    /// Bytes that wait for the disk.
    pub queued_bytes: usize,
    /// Whether it is in progress.
    pub active: bool,
    /// Why it failed.
    pub error: Option<String>,
}

impl Report {
    /// Counts what is in a file.
    fn count(&mut self, mark: &Mark) {
        let Some(mid) = mark.mid else {
            self.strings += 1;
            return;
        };
        self.frames += 1;
        if mark.is_sample {
            self.samples += 1;
        } else {
            *self.message_counts.entry(mid).or_default() += 1;
        }
    }
}

/// A frame or string, in bytes to record.
#[derive(Clone, Copy, Debug)]
pub struct Mark {
    /// Where it ends.
    pub end: usize,
    /// Its bytes.
    pub length: usize,
    /// Message identifier of a frame; `None` for a string.
    pub mid: Option<u8>,
    /// Whether it is the frame of a sample.
    pub is_sample: bool,
}

/// What waits for the disk.
#[derive(Debug, Default)]
struct Batch {
    bytes: Vec<u8>,
    /// The pieces in which the bytes arrived; they end as counted from the first byte.
    pieces: Vec<Piece>,
    /// The frames and strings in the bytes, likewise.
    marks: Vec<Mark>,
}

impl Batch {
    /// Removes all, and gives back the memory that a burst took.
    fn clear(&mut self) {
        self.bytes.clear();
        self.pieces.clear();
        self.marks.clear();
        self.bytes.shrink_to(PLENTY);
        self.pieces.shrink_to(PLENTY / size_of::<Piece>());
        self.marks.shrink_to(PLENTY / size_of::<Mark>());
    }

    /// Index of the first mark that ends after this position.
    fn mark_after(&self, position: u64) -> usize {
        self.marks.partition_point(|mark| mark.end as u64 <= position)
    }

    /// When the byte before this position arrived.
    fn arrival(&self, end: u64) -> i64 {
        let at = self.pieces.partition_point(|piece| piece.end < end);
        self.pieces.get(at).map_or(0, |piece| piece.arrival)
    }
}

/// What waits for the disk, and the state of the recording.
#[derive(Debug, Default)]
struct Queue {
    batch: Batch,
    /// No more bytes are accepted; the thread writes those that are here and ends.
    closed: bool,
    overflow: bool,
    report: Report,
}

/// What a recorder shares with its thread.
#[derive(Debug, Default)]
struct Shared {
    queue: Mutex<Queue>,
    /// The thread has something to do before the interval is over.
    due: Condvar,
    /// The thread has ended.
    done: Condvar,
}

/// A recording in progress.
#[derive(Debug)]
pub struct Recorder {
    shared: Arc<Shared>,
    bound: usize,
    thread: Mutex<Option<JoinHandle<()>>>,
    /// The process that the thread belongs to.
    process: u32,
}

impl Recorder {
    /// Creates the first file and writes its head. `epoch` is what to add to arrivals for nanoseconds since 1970; `strings`
    /// are those that the scanner [expects](crate::scan::Scanner::expect).
    ///
    /// # Errors
    /// Those of the system: no such folder, no permission, no space left.
    pub(super) fn start(recording: Recording, epoch: i64, strings: u32) -> io::Result<Self> {
        let Recording { flush, bound, .. } = recording;
        let writer = Writer::new(recording, epoch, strings)?;
        let shared = Arc::new(Shared::default());
        lock(&shared.queue).report = Report { active: true, ..writer.report() };
        let of_thread = shared.clone();
        let thread =
            thread::Builder::new().name("xbus-recorder".into()).spawn(move || of_thread.work(writer, flush))?;
        Ok(Self { shared, bound, thread: Mutex::new(Some(thread)), process: std::process::id() })
    }

    /// Queues bytes that the intake has decided, the first of which is at `start` in the stream; never waits for the disk.
    /// The pieces may begin before and end after them.
    pub(super) fn offer<'a>(
        &self,
        bytes: &[u8],
        start: u64,
        pieces: impl IntoIterator<Item = &'a Piece>,
        marks: &[Mark],
    ) {
        if bytes.is_empty() {
            return;
        }
        let mut queue = lock(&self.shared.queue);
        if queue.closed {
            return;
        }
        let Queue { batch, .. } = &mut *queue;
        let waiting = batch.bytes.len();
        let is_full = waiting + bytes.len() > self.bound || batch.pieces.len() >= most_entries(self.bound);
        if is_full && waiting > 0 {
            (queue.closed, queue.overflow) = (true, true);
            self.shared.due.notify_one();
            return;
        }
        batch.bytes.extend_from_slice(bytes);
        batch.marks.extend(marks.iter().map(|mark| Mark { end: waiting + mark.end, ..*mark }));
        let end = start + bytes.len() as u64;
        for piece in pieces {
            batch.pieces.push(Piece { end: waiting as u64 + (piece.end.min(end) - start), ..*piece });
            if piece.end >= end {
                break;
            }
        }
        let total = batch.bytes.len();
        if waiting == 0 || (waiting < PLENTY && total >= PLENTY) {
            self.shared.due.notify_one();
        }
    }

    /// Whether this process has forked from the one that the thread belongs to. A lock may be held there forever.
    fn is_forked(&self) -> bool {
        std::process::id() != self.process
    }

    /// The state of the recording; in a forked process that of none.
    #[must_use]
    pub fn report(&self) -> Report {
        if self.is_forked() {
            return Report::default();
        }
        let queue = lock(&self.shared.queue);
        Report { queued_bytes: queue.batch.bytes.len(), ..queue.report.clone() }
    }

    /// Ends the recording with the last whole frame: nothing that is incomplete now is in it. The bytes in the queue will be
    /// written.
    pub fn close(&self) {
        if self.is_forked() {
            return;
        }
        lock(&self.shared.queue).closed = true;
        self.shared.due.notify_one();
    }

    /// Waits until all is written, at most for `timeout`; returns whether it is.
    #[must_use]
    pub fn wait(&self, timeout: Duration) -> bool {
        if self.is_forked() {
            return true;
        }
        let queue = lock(&self.shared.queue);
        let waited = self.shared.done.wait_timeout_while(queue, timeout, |queue| queue.report.active);
        let (queue, _) = waited.unwrap_or_else(PoisonError::into_inner);
        !queue.report.active
    }

    /// Accepts no more bytes, and waits until all is written.
    pub(super) fn stop(&self) {
        self.close();
        if let Some(thread) = lock(&self.thread).take() {
            let _ = thread.join();
        }
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        // A forked process does not have the thread, and would wait for it forever.
        if !self.is_forked() {
            self.stop();
        }
    }
}

impl Shared {
    /// The thread: waits for bytes, and writes them.
    fn work(&self, mut writer: Writer, flush: Duration) {
        let _end = ReportEnd(self);
        let mut batch = Batch::default();
        loop {
            let queue = lock(&self.queue);
            let queue = self.due.wait_while(queue, |queue| !queue.closed && queue.batch.bytes.is_empty());
            let queue = queue.unwrap_or_else(PoisonError::into_inner);
            let is_early = |queue: &mut Queue| !queue.closed && queue.batch.bytes.len() < PLENTY;
            let queue = self.due.wait_timeout_while(queue, flush, is_early);
            let (mut queue, _) = queue.unwrap_or_else(PoisonError::into_inner);
            std::mem::swap(&mut batch, &mut queue.batch);
            let (closed, overflow) = (queue.closed, queue.overflow);
            drop(queue);

            let written = writer.write(&batch).and_then(|()| writer.flush(closed));
            batch.clear();

            let error = match written {
                Err(error) => {
                    writer.truncate();
                    Some(format!("{error}; the recording ends with the last whole frame"))
                }
                Ok(()) if overflow => {
                    let path = writer.path().display();
                    Some(format!("{path}: the disk is too slow; the recording ends where the queue was full"))
                }
                Ok(()) => None,
            };
            let mut queue = lock(&self.queue);
            let active = error.is_none() && !closed;
            queue.report = Report { active, error, ..writer.report() };
            if !active {
                return;
            }
        }
    }
}

/// Reports that the thread has ended, for whatever reason, when it is dropped.
struct ReportEnd<'a>(&'a Shared);

impl Drop for ReportEnd<'_> {
    fn drop(&mut self) {
        let mut queue = lock(&self.0.queue);
        if queue.report.active {
            queue.report.error = Some("the recorder failed; this is a bug in xbus".to_owned());
        }
        queue.report.active = false;
        queue.closed = true;
        queue.batch = Batch::default();
        drop(queue);
        self.0.done.notify_all();
    }
}
