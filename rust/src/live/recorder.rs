//! Recording: every byte to disk, by a thread of its own, so that a slow disk holds up nobody.
//!
//! A file begins with the head that the caller gives (Configuration and the like, so that other programs can open it);
//! behind it stands what came, unaltered, from the beginning of a frame on. It is written at least every so often, and
//! what is written is a good log whatever happens next. If the disk is full or fails, the file is cut behind its last
//! whole frame and the recording ends with an error; if the disk is too slow for longer than the queue is deep, it ends
//! with all that was queued, never with a hole.
//!
//! # Files
//!
//! `NAME.mtb`, and when that is full `NAME-0001.mtb`, `NAME-0002.mtb`, and so on. A file is full at the first end of a
//! frame where it has as many bytes, or lasts as long, as was asked for; no frame is in two files, none in neither.
//!
//! # Times
//!
//! Beside each file there can be one, called the same with `.times` behind it, that tells when the bytes came. All its
//! numbers are little-endian:
//!
//! ```text
//! header   8 bytes  "XBUSTIME"
//!          u32      version: 1
//!          u32      bytes of a record: 16
//!          i64      epoch: the record's times less this are on the host's steady clock, in ns
//! record   u64      position: so many bytes of the log, its head included, had come by then
//!          i64      arrival: nanoseconds since 1970
//! ```
//!
//! Positions and arrivals never step back. A piece that comes within 10 ms of the last one that was noted is left out
//! (unless it is the last of the file), so the records take at most 1.6 kB/s. After a crash the last records may be
//! missing, or, where the log was cut, lie behind its end.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use super::time::monotonic;
use super::{Piece, lock, most_pieces};
use crate::frame::Frame;
use crate::scan::{Scanner, Step, Window};
use crate::strings::types_told;
use crate::table::{BARE_STRINGS, LONGEST_PAYLOAD, STRING_OUTPUT_TYPE};

/// What a file of times begins with.
pub const TIMES_MAGIC: [u8; 8] = *b"XBUSTIME";
/// The version of its format.
pub const TIMES_VERSION: u32 = 1;
/// Bytes before the first record.
pub const TIMES_HEADER: usize = 24;
/// Bytes of a record.
const TIMES_RECORD: u32 = 16;
/// Arrivals nearer than this to the last one noted are not noted, in ns.
const TIMES_APART: i64 = 10_000_000;
/// With so many bytes waiting the thread does not wait for its time.
const PLENTY: usize = 256 << 10;

/// How to record.
#[derive(Clone, Debug)]
pub struct Recording {
    /// The first file.
    pub path: PathBuf,
    /// Whether what is there may be overwritten. If not, a first file that is there and not empty is an error, and for the
    /// following ones a number is taken that is free.
    pub overwrite: bool,
    /// What each file begins with: whole frames.
    pub head: Vec<u8>,
    /// How long bytes may wait before they are written.
    pub flush: Duration,
    /// Whether the disk is made to have them each time: then they survive a power cut, not just a crash.
    pub fsync: bool,
    /// Begin another file when one has so many bytes.
    pub rotate_bytes: Option<u64>,
    /// Begin another file when one has lasted so long.
    pub rotate_after: Option<Duration>,
    /// Whether to note when bytes came.
    pub times: bool,
    /// Most bytes that may wait for the disk. Pieces shorter than 16 bytes count as so many.
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

/// How a recording goes, or went.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Report {
    /// The files, in order.
    pub files: Vec<PathBuf>,
    /// Bytes received that are in them; their heads do not count.
    pub bytes: u64,
    /// Frames in them.
    pub frames: u64,
    /// Bytes that wait for the disk.
    pub queued: usize,
    /// Whether it goes on.
    pub active: bool,
    /// Why it ended, if not because it was told to.
    pub error: Option<String>,
}

/// What waits for the disk, and what has become of the rest.
#[derive(Debug, Default)]
struct Queue {
    bytes: Vec<u8>,
    pieces: Vec<Piece>,
    /// Nothing is taken any more; the thread writes what is here and ends.
    closed: bool,
    overflow: bool,
    report: Report,
}

#[derive(Debug, Default)]
struct Desk {
    queue: Mutex<Queue>,
    /// There is something to do at once.
    due: Condvar,
    /// The thread has ended.
    done: Condvar,
}

/// A recording under way.
#[derive(Debug)]
pub struct Recorder {
    desk: Arc<Desk>,
    bound: usize,
    thread: Mutex<Option<JoinHandle<()>>>,
}

impl Recorder {
    /// Makes the first file and writes its head. `epoch` leads from arrivals to nanoseconds since 1970; `strings` are those
    /// that the scanner is to [expect](Scanner::expect).
    ///
    /// # Errors
    /// What the system says: no such folder, no permission, no space left.
    pub fn start(recording: Recording, epoch: i64, strings: u32) -> io::Result<Self> {
        let Recording { flush, bound, .. } = recording;
        let mut writer = Writer::new(recording, epoch)?;
        writer.scanner.expect(strings);
        let desk = Arc::new(Desk::default());
        lock(&desk.queue).report = Report { active: true, ..writer.report() };
        let at = desk.clone();
        let thread = thread::Builder::new().name("xbus-recorder".into()).spawn(move || at.work(writer, flush))?;
        Ok(Self { desk, bound, thread: Mutex::new(Some(thread)) })
    }

    /// Takes bytes, whose last one came at `arrival`; never waits for the disk.
    pub fn offer(&self, bytes: &[u8], arrival: i64) {
        let mut queue = lock(&self.desk.queue);
        if queue.closed {
            return;
        }
        let waiting = queue.bytes.len();
        let is_full = waiting + bytes.len() > self.bound || queue.pieces.len() >= most_pieces(self.bound);
        if is_full && waiting > 0 {
            (queue.closed, queue.overflow) = (true, true);
            self.desk.due.notify_one();
            return;
        }
        queue.bytes.extend_from_slice(bytes);
        let end = queue.bytes.len();
        queue.pieces.push(Piece { end: end as u64, arrival });
        if waiting == 0 || (waiting < PLENTY && end >= PLENTY) {
            self.desk.due.notify_one();
        }
    }

    /// How it goes.
    pub fn report(&self) -> Report {
        let queue = lock(&self.desk.queue);
        Report { queued: queue.bytes.len(), ..queue.report.clone() }
    }

    /// Takes no more; what is here will be written.
    pub fn close(&self) {
        lock(&self.desk.queue).closed = true;
        self.desk.due.notify_one();
    }

    /// Waits until all is written, but no longer than this; whether it is.
    pub fn wait(&self, timeout: Duration) -> bool {
        let queue = lock(&self.desk.queue);
        let waited = self.desk.done.wait_timeout_while(queue, timeout, |it| it.report.active);
        let (queue, _) = waited.unwrap_or_else(PoisonError::into_inner);
        !queue.report.active
    }

    /// Takes no more, and waits until all is written.
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

impl Desk {
    /// What the thread does.
    fn work(&self, mut writer: Writer, flush: Duration) {
        let _last = LastWords(self);
        let (mut bytes, mut pieces) = (vec![], vec![]);
        loop {
            let queue = lock(&self.queue);
            let queue = self.due.wait_while(queue, |it| !it.closed && it.bytes.is_empty());
            let queue = queue.unwrap_or_else(PoisonError::into_inner);
            let queue = self.due.wait_timeout_while(queue, flush, |it| !it.closed && it.bytes.len() < PLENTY);
            let (mut queue, _) = queue.unwrap_or_else(PoisonError::into_inner);
            std::mem::swap(&mut bytes, &mut queue.bytes);
            std::mem::swap(&mut pieces, &mut queue.pieces);
            let (closed, overflow) = (queue.closed, queue.overflow);
            drop(queue);

            let written = writer.write(&bytes, &pieces).and_then(|()| writer.flush(closed));
            bytes.clear();
            pieces.clear();
            // After a burst its room is given back.
            bytes.shrink_to(PLENTY);
            pieces.shrink_to(PLENTY / size_of::<Piece>());

            let error = match written {
                Err(fault) => {
                    writer.cut();
                    Some(format!("{fault}; the recording ends with the last whole frame"))
                }
                Ok(()) if overflow => {
                    let path = writer.output.path.display();
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

/// Tells those who wait for the thread that it has ended, whatever ended it.
struct LastWords<'a>(&'a Desk);

impl Drop for LastWords<'_> {
    fn drop(&mut self) {
        let mut queue = lock(&self.0.queue);
        if queue.report.active {
            queue.report.error = Some("the recorder failed; this is a mistake in xbus".to_owned());
        }
        queue.report.active = false;
        queue.closed = true;
        (queue.bytes, queue.pieces) = (vec![], vec![]);
        drop(queue);
        self.0.done.notify_all();
    }
}

/// Writes the files.
#[derive(Debug)]
struct Writer {
    recording: Recording,
    epoch: i64,
    output: Output,
    /// What comes next belongs into another file.
    full: bool,
    files: Vec<PathBuf>,
    /// The last file's number.
    number: usize,
    /// The last `StringOutputType` that came, if it matters: each file says whether strings are on that nothing else tells
    /// from noise.
    strings: Vec<u8>,
    /// Finds the ends of frames. Its positions, and all others here, count the bytes received.
    scanner: Scanner,
    undecided: Vec<u8>,
    /// Bytes written, in all files.
    written: u64,
    frames: u64,
}

impl Writer {
    fn new(recording: Recording, epoch: i64) -> io::Result<Self> {
        let output = Output::new(&recording, &[], recording.path.clone(), epoch)?;
        Ok(Self {
            files: vec![recording.path.clone()],
            recording,
            epoch,
            output,
            full: false,
            number: 0,
            strings: vec![],
            scanner: Scanner::new(LONGEST_PAYLOAD),
            undecided: vec![],
            written: 0,
            frames: 0,
        })
    }

    /// Takes note of the strings that are on.
    fn learn(&mut self, frame: &[u8]) {
        if frame[2] != STRING_OUTPUT_TYPE {
            return;
        }
        let was_on = self.scanner.expected() != 0 || !self.strings.is_empty();
        if types_told(Frame::of(frame).payload).is_some_and(|types| was_on || types & BARE_STRINGS != 0) {
            self.strings = frame.to_vec();
        }
    }

    fn report(&self) -> Report {
        Report { files: self.files.clone(), bytes: self.written, frames: self.frames, ..Report::default() }
    }

    /// Writes bytes, which end with the last of the pieces; the pieces' ends count from the first of these bytes.
    fn write(&mut self, bytes: &[u8], pieces: &[Piece]) -> io::Result<()> {
        let mut batch = Batch { bytes, pieces, start: self.written, ends: vec![] };
        let result = self.write_batch(&mut batch);
        // What is left there did not reach the disk.
        self.frames -= batch.ends.iter().map(|it| it.1).sum::<u64>();
        result
    }

    fn write_batch(&mut self, batch: &mut Batch<'_>) -> io::Result<()> {
        let offset = self.scanner.at();
        let mut undecided = std::mem::take(&mut self.undecided);
        undecided.extend_from_slice(batch.bytes);
        loop {
            let (at, length, frames) = match self.scanner.step(Window { bytes: &undecided, offset, last: false }) {
                Step::Frame { at, length, .. } => (at, length, 1),
                Step::String { at, length, .. } => (at, length, 0),
                Step::More | Step::End(_) => break,
            };
            self.frames += frames;
            let end = offset + (at + length) as u64;
            if end < self.written {
                // Some frames are known only by what follows them. Then this end may be written already.
                let place = self.output.length.saturating_sub(self.written - end);
                self.output.whole = self.output.whole.max(place);
            } else {
                batch.ends.push((end, frames));
                self.turn_over(batch, end)?;
                if self.is_full(end, batch.arrival(end)) {
                    self.put(batch, end)?;
                    self.flush(true)?;
                    self.full = true;
                }
            }
            if frames > 0 {
                self.learn(&undecided[at..at + length]);
            }
        }
        #[allow(clippy::cast_possible_truncation)] // a position in what is undecided
        undecided.drain(..(self.scanner.at() - offset) as usize);
        self.undecided = undecided;
        self.put(batch, batch.start + batch.bytes.len() as u64)
    }

    /// Writes the times, and makes the disk have it all if that was asked for; `last` is for a file that ends.
    fn flush(&mut self, last: bool) -> io::Result<()> {
        self.output.flush(last, self.recording.fsync).map_err(of_file(&self.output.path))
    }

    /// Whether the file is to end with the frame that ends here.
    fn is_full(&self, end: u64, arrival: i64) -> bool {
        let length = self.output.length + (end - self.written);
        let lasted = u64::try_from(arrival - self.output.began).map_or(Duration::ZERO, Duration::from_nanos);
        self.recording.rotate_bytes.is_some_and(|it| length >= it)
            || self.recording.rotate_after.is_some_and(|it| lasted >= it)
    }

    /// Begins another file if the present one is full and something is to be written up to this position.
    fn turn_over(&mut self, batch: &Batch<'_>, to: u64) -> io::Result<()> {
        if !self.full || to == self.written {
            return Ok(());
        }
        let (path, output) = loop {
            self.number += 1;
            let path = numbered(&self.recording.path, self.number);
            match Output::new(&self.recording, &self.strings, path.clone(), self.epoch) {
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                output => break (path.clone(), output.map_err(of_file(&path))?),
            }
        };
        self.output = output;
        self.output.began = batch.arrival(self.written + 1);
        self.files.push(path);
        self.full = false;
        Ok(())
    }

    /// Writes the batch up to this position.
    fn put(&mut self, batch: &mut Batch<'_>, to: u64) -> io::Result<()> {
        self.turn_over(batch, to)?;
        let length = self.output.length;
        let result = self.output.put(batch.between(self.written, to));
        let begin = self.written;
        self.written += self.output.length - length;
        let place = |position: u64| length + (position - begin);
        // The last whole frame that the file has now.
        let done = batch.ends.partition_point(|(end, _)| *end <= self.written);
        if let Some((end, _)) = batch.ends[..done].last() {
            self.output.whole = place(*end);
        }
        batch.ends.drain(..done);
        result.map_err(of_file(&self.output.path))?;
        for piece in batch.pieces {
            let end = batch.start + piece.end;
            if end > begin {
                self.output.note(place(end.min(to)), piece.arrival, self.epoch);
            }
            if end >= to {
                break;
            }
        }
        Ok(())
    }

    /// Cuts the file behind its last whole frame.
    fn cut(&mut self) {
        self.written -= self.output.cut();
    }
}

/// Says which file it was.
fn of_file(path: &Path) -> impl Fn(io::Error) -> io::Error {
    move |error| io::Error::new(error.kind(), format!("{}: {error}", path.display()))
}

/// Bytes to be written.
struct Batch<'a> {
    bytes: &'a [u8],
    pieces: &'a [Piece],
    /// Position of the first of them.
    start: u64,
    /// Where frames and strings end that are not written yet, and how many frames that is: one or none.
    ends: Vec<(u64, u64)>,
}

impl<'a> Batch<'a> {
    #[allow(clippy::cast_possible_truncation)] // positions in these bytes
    fn between(&self, from: u64, to: u64) -> &'a [u8] {
        &self.bytes[(from - self.start) as usize..(to - self.start) as usize]
    }

    /// When the byte before this position came.
    fn arrival(&self, end: u64) -> i64 {
        let at = self.pieces.partition_point(|it| self.start + it.end < end);
        self.pieces.get(at).map_or(0, |it| it.arrival)
    }
}

/// The file that is being written.
#[derive(Debug)]
struct Output {
    path: PathBuf,
    file: File,
    /// Bytes in the file; up to the end of the last whole frame; when its first ones came.
    length: u64,
    whole: u64,
    began: i64,
    times: Option<Times>,
}

#[derive(Debug)]
struct Times {
    file: File,
    /// Records to be written with the next flush.
    records: Vec<u8>,
    /// The arrival noted last, and one that was left out since.
    noted: Option<i64>,
    left_out: Option<(u64, i64)>,
}

impl Output {
    fn new(recording: &Recording, strings: &[u8], path: PathBuf, epoch: i64) -> io::Result<Self> {
        let is_new = fs::symlink_metadata(&path).is_err();
        let file = open(&path, recording.overwrite)?;
        let mut times_path = path.as_os_str().to_owned();
        times_path.push(".times");
        let is_file = file.metadata()?.is_file();
        let times = if recording.times && is_file {
            // Before anything is overwritten: it may fail.
            let times = Times::new(times_path.as_ref(), epoch);
            if times.is_err() && is_new {
                let _ = fs::remove_file(&path);
            }
            Some(times?)
        } else {
            None
        };
        if is_file {
            file.set_len(0)?;
            if times.is_none() {
                // Those of a log that has just been overwritten would be taken for its own.
                let _ = fs::remove_file(times_path);
            }
        }
        let mut output = Self { path, file, length: 0, whole: 0, began: monotonic(), times };
        if let Err(error) = output.put(&recording.head).and_then(|()| output.put(strings)) {
            output.cut();
            return Err(error);
        }
        output.whole = output.length;
        Ok(output)
    }

    /// Writes, and counts what the file has taken even if it does not take all.
    fn put(&mut self, mut bytes: &[u8]) -> io::Result<()> {
        while !bytes.is_empty() {
            match self.file.write(bytes) {
                Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
                Ok(more) => {
                    self.length += more as u64;
                    bytes = &bytes[more..];
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// Cuts the file behind its last whole frame; how many bytes that takes away.
    fn cut(&mut self) -> u64 {
        // What cannot be cut, a device for one, stays as it is: a log may end anywhere.
        if self.file.set_len(self.whole).is_err() {
            return 0;
        }
        let length = std::mem::replace(&mut self.length, self.whole);
        length - self.whole
    }

    fn note(&mut self, position: u64, arrival: i64, epoch: i64) {
        if let Some(times) = &mut self.times {
            times.note(position, arrival + epoch);
        }
    }

    fn flush(&mut self, last: bool, fsync: bool) -> io::Result<()> {
        if fsync {
            self.file.sync_data()?;
        }
        // Times follow the bytes that they tell of.
        self.times.as_mut().map_or(Ok(()), |it| it.flush(last, fsync))
    }
}

impl Times {
    fn new(path: &Path, epoch: i64) -> io::Result<Self> {
        let mut file = File::create(path)?;
        let mut header = Vec::with_capacity(TIMES_HEADER);
        header.extend(TIMES_MAGIC);
        header.extend(TIMES_VERSION.to_le_bytes());
        header.extend(TIMES_RECORD.to_le_bytes());
        header.extend(epoch.to_le_bytes());
        file.write_all(&header)?;
        Ok(Self { file, records: vec![], noted: None, left_out: None })
    }

    fn note(&mut self, position: u64, arrival: i64) {
        if self.noted.is_some_and(|it| arrival - it < TIMES_APART) {
            self.left_out = Some((position, arrival));
            return;
        }
        self.noted = Some(arrival);
        self.left_out = None;
        self.push((position, arrival));
    }

    fn push(&mut self, (position, arrival): (u64, i64)) {
        self.records.extend(position.to_le_bytes());
        self.records.extend(arrival.to_le_bytes());
    }

    fn flush(&mut self, last: bool, fsync: bool) -> io::Result<()> {
        if let Some(left_out) = self.left_out.take_if(|_| last) {
            self.push(left_out);
        }
        self.file.write_all(&self.records)?;
        self.records.clear();
        if fsync { self.file.sync_data() } else { Ok(()) }
    }
}

/// `NAME.mtb`, `NAME-0001.mtb`, `NAME-0002.mtb`, ...
/// Opens a file to be written, as it is. One that is there and not empty is an error unless it may be overwritten, and so
/// is a pipe, which would hold up whoever opens it until somebody reads; what else is no file, `/dev/null`, will do.
fn open(path: &Path, overwrite: bool) -> io::Result<File> {
    if let Ok(there) = fs::metadata(path) {
        if there.is_file() && there.len() > 0 && !overwrite {
            #[cfg(unix)]
            return Err(io::Error::from_raw_os_error(libc::EEXIST));
            #[cfg(not(unix))]
            return Err(io::Error::from_raw_os_error(80)); // ERROR_FILE_EXISTS
        }
        #[cfg(unix)]
        if std::os::unix::fs::FileTypeExt::is_fifo(&there.file_type()) {
            return Err(io::Error::from_raw_os_error(libc::ESPIPE));
        }
    }
    fs::OpenOptions::new().write(true).create(true).truncate(false).open(path)
}

fn numbered(path: &Path, number: usize) -> PathBuf {
    let mut name = path.file_stem().unwrap_or_default().to_owned();
    name.push(format!("-{number:04}"));
    if let Some(suffix) = path.extension() {
        name.push(".");
        name.push(suffix);
    }
    path.with_file_name(name)
}
