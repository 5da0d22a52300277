//! Recording: every byte to disk, written by a thread, so that a slow disk delays nothing else.
//!
//! A file starts with the head that the caller gives (Configuration and the like, so that other programs can open it),
//! followed by the received bytes, unaltered, from the start of a frame on. They are written at a fixed interval at least,
//! and what is written is a valid log whatever happens next. If the disk is full or fails, the file is truncated after its
//! last whole frame, and the recording ends with an error; if the disk is too slow for longer than the queue can hold, the
//! recording ends with all that was queued, never with a gap.
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

use std::io;
use std::path::PathBuf;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

pub use self::times::{TIMES_HEADER, TIMES_MAGIC, TIMES_VERSION};
use self::writer::Writer;
use super::{Piece, lock, most_pieces};

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
    /// Bytes that wait for the disk.
    pub queued_bytes: usize,
    /// Whether it is in progress.
    pub active: bool,
    /// Why it failed.
    pub error: Option<String>,
}

/// Bytes that wait for the disk, and the state of the recording.
#[derive(Debug, Default)]
struct Queue {
    bytes: Vec<u8>,
    pieces: Vec<Piece>,
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
}

impl Recorder {
    /// Creates the first file and writes its head. `epoch` is what to add to arrivals for nanoseconds since 1970; `strings`
    /// are those that the scanner [expects](crate::scan::Scanner::expect).
    ///
    /// # Errors
    /// Those of the system: no such folder, no permission, no space left.
    pub fn start(recording: Recording, epoch: i64, strings: u32) -> io::Result<Self> {
        let Recording { flush, bound, .. } = recording;
        let writer = Writer::new(recording, epoch, strings)?;
        let shared = Arc::new(Shared::default());
        lock(&shared.queue).report = Report { active: true, ..writer.report() };
        let of_thread = shared.clone();
        let thread =
            thread::Builder::new().name("xbus-recorder".into()).spawn(move || of_thread.work(writer, flush))?;
        Ok(Self { shared, bound, thread: Mutex::new(Some(thread)) })
    }

    /// Queues bytes, whose last one arrived at `arrival`; never waits for the disk.
    pub fn offer(&self, bytes: &[u8], arrival: i64) {
        let mut queue = lock(&self.shared.queue);
        if queue.closed {
            return;
        }
        let waiting = queue.bytes.len();
        let is_full = waiting + bytes.len() > self.bound || queue.pieces.len() >= most_pieces(self.bound);
        if is_full && waiting > 0 {
            (queue.closed, queue.overflow) = (true, true);
            self.shared.due.notify_one();
            return;
        }
        queue.bytes.extend_from_slice(bytes);
        let end = queue.bytes.len();
        queue.pieces.push(Piece { end: end as u64, arrival });
        if waiting == 0 || (waiting < PLENTY && end >= PLENTY) {
            self.shared.due.notify_one();
        }
    }

    /// The state of the recording.
    pub fn report(&self) -> Report {
        let queue = lock(&self.shared.queue);
        Report { queued_bytes: queue.bytes.len(), ..queue.report.clone() }
    }

    /// Accepts no more bytes; those in the queue will be written.
    pub fn close(&self) {
        lock(&self.shared.queue).closed = true;
        self.shared.due.notify_one();
    }

    /// Waits until all is written, at most for `timeout`; returns whether it is.
    pub fn wait(&self, timeout: Duration) -> bool {
        let queue = lock(&self.shared.queue);
        let waited = self.shared.done.wait_timeout_while(queue, timeout, |queue| queue.report.active);
        let (queue, _) = waited.unwrap_or_else(PoisonError::into_inner);
        !queue.report.active
    }

    /// Accepts no more bytes, and waits until all is written.
    pub fn stop(&self) {
        self.close();
        if let Some(thread) = lock(&self.thread).take() {
            let _ = thread.join();
        }
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        self.stop();
    }
}

impl Shared {
    /// The thread: waits for bytes, and writes them.
    fn work(&self, mut writer: Writer, flush: Duration) {
        let _end = ReportEnd(self);
        let (mut bytes, mut pieces) = (vec![], vec![]);
        loop {
            let queue = lock(&self.queue);
            let queue = self.due.wait_while(queue, |queue| !queue.closed && queue.bytes.is_empty());
            let queue = queue.unwrap_or_else(PoisonError::into_inner);
            let is_early = |queue: &mut Queue| !queue.closed && queue.bytes.len() < PLENTY;
            let queue = self.due.wait_timeout_while(queue, flush, is_early);
            let (mut queue, _) = queue.unwrap_or_else(PoisonError::into_inner);
            std::mem::swap(&mut bytes, &mut queue.bytes);
            std::mem::swap(&mut pieces, &mut queue.pieces);
            let (closed, overflow) = (queue.closed, queue.overflow);
            drop(queue);

            let written = writer.write(&bytes, &pieces).and_then(|()| writer.flush(closed));
            bytes.clear();
            pieces.clear();
            // Memory that a burst took is given back.
            bytes.shrink_to(PLENTY);
            pieces.shrink_to(PLENTY / size_of::<Piece>());

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
        (queue.bytes, queue.pieces) = (vec![], vec![]);
        drop(queue);
        self.0.done.notify_all();
    }
}
