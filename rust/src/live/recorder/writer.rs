//! The files of a recording, one after another.

use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::file::LogFile;
use super::{Recording, Report};
use crate::frame::{Frame, field};
use crate::input::PushBuffer;
use crate::live::Piece;
use crate::scan::{Scanner, Step};
use crate::strings::enabled_strings;
use crate::table::{BARE_STRINGS, LONGEST_PAYLOAD, STRING_OUTPUT_TYPE};

/// Writes the files of a recording.
#[derive(Debug)]
pub struct Writer {
    recording: Recording,
    epoch: i64,
    output: LogFile,
    /// Whether the next bytes belong into another file.
    full: bool,
    files: Vec<PathBuf>,
    /// Number of the last file.
    number: usize,
    /// The last `StringOutputType` frame that was received, if it matters: every file repeats which strings without a
    /// checksum are enabled.
    strings: Vec<u8>,
    /// Finds the ends of frames. Its positions, and all others here, count the bytes received.
    scanner: Scanner,
    undecided: PushBuffer,
    /// Bytes written, in all files.
    written: u64,
    frames: u64,
}

impl Writer {
    /// Creates the first file. Arguments as for [`Recorder::start`](super::Recorder::start).
    pub fn new(recording: Recording, epoch: i64, strings: u32) -> io::Result<Self> {
        let output = LogFile::new(&recording, &[], recording.path.clone(), epoch)?;
        let mut scanner = Scanner::new(LONGEST_PAYLOAD);
        scanner.expect(strings);
        Ok(Self {
            files: vec![recording.path.clone()],
            recording,
            epoch,
            output,
            full: false,
            number: 0,
            strings: vec![],
            scanner,
            undecided: PushBuffer::default(),
            written: 0,
            frames: 0,
        })
    }

    /// Keeps a `StringOutputType` frame, if strings without a checksum are or were enabled.
    fn learn(&mut self, frame: &[u8]) {
        if frame[field::MID] != STRING_OUTPUT_TYPE {
            return;
        }
        let were_enabled = self.scanner.expected() != 0 || !self.strings.is_empty();
        let is_relevant = |types: u32| were_enabled || types & BARE_STRINGS != 0;
        if enabled_strings(Frame::of(frame).payload).is_some_and(is_relevant) {
            self.strings = frame.to_vec();
        }
    }

    /// The path of the current file.
    pub fn path(&self) -> &Path {
        &self.output.path
    }

    /// The state of the recording, as far as the writer knows it.
    pub fn report(&self) -> Report {
        Report { files: self.files.clone(), bytes: self.written, frames: self.frames, ..Report::default() }
    }

    /// Writes bytes, which end with the last of the pieces; the ends of pieces count from the first of these bytes.
    pub fn write(&mut self, bytes: &[u8], pieces: &[Piece]) -> io::Result<()> {
        let mut batch = Batch { bytes, pieces, start: self.written, ends: vec![] };
        let result = self.write_batch(&mut batch);
        // The ends that are left were not written.
        self.frames -= batch.ends.iter().map(|(_, frames)| frames).sum::<u64>();
        result
    }

    fn write_batch(&mut self, batch: &mut Batch<'_>) -> io::Result<()> {
        let mut undecided = std::mem::take(&mut self.undecided);
        undecided.push(batch.bytes);
        let window = undecided.window(false);
        loop {
            let (at, length, frames) = match self.scanner.step(window) {
                Step::Frame { at, length, .. } => (at, length, 1),
                Step::String { at, length, .. } => (at, length, 0),
                Step::More | Step::End(_) => break,
            };
            self.frames += frames;
            let end = window.offset + (at + length) as u64;
            if end < self.written {
                // Some frames are accepted only when the next one has been received. Then this end may be written already.
                let place = self.output.length.saturating_sub(self.written - end);
                self.output.whole = self.output.whole.max(place);
            } else {
                batch.ends.push((end, frames));
                self.start_file_if_full(batch, end)?;
                if self.is_full(end, batch.arrival(end)) {
                    self.write_up_to(batch, end)?;
                    self.flush(true)?;
                    self.full = true;
                }
            }
            if frames > 0 {
                self.learn(&window.bytes[at..at + length]);
            }
        }
        undecided.release(self.scanner.at());
        self.undecided = undecided;
        self.write_up_to(batch, batch.start + batch.bytes.len() as u64)
    }

    /// Writes the times, and makes the disk store everything if that is wanted; `ends` is whether the file is complete.
    pub fn flush(&mut self, ends: bool) -> io::Result<()> {
        self.output.flush(ends, self.recording.fsync).map_err(of_file(&self.output.path))
    }

    /// Whether the file is to end with the frame that ends here.
    fn is_full(&self, end: u64, arrival: i64) -> bool {
        let length = self.output.length + (end - self.written);
        let lasted = u64::try_from(arrival - self.output.began).map_or(Duration::ZERO, Duration::from_nanos);
        self.recording.rotate_bytes.is_some_and(|limit| length >= limit)
            || self.recording.rotate_after.is_some_and(|limit| lasted >= limit)
    }

    /// Starts another file if the current one is full and something is to be written up to position `to`.
    fn start_file_if_full(&mut self, batch: &Batch<'_>, to: u64) -> io::Result<()> {
        if !self.full || to == self.written {
            return Ok(());
        }
        let (path, output) = loop {
            self.number += 1;
            let path = numbered(&self.recording.path, self.number);
            match LogFile::new(&self.recording, &self.strings, path.clone(), self.epoch) {
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

    /// Writes the batch up to position `to`.
    fn write_up_to(&mut self, batch: &mut Batch<'_>, to: u64) -> io::Result<()> {
        self.start_file_if_full(batch, to)?;
        let length = self.output.length;
        let result = self.output.write(batch.between(self.written, to));
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
                self.output.add_time(place(end.min(to)), piece.arrival + self.epoch);
            }
            if end >= to {
                break;
            }
        }
        Ok(())
    }

    /// Truncates the file after its last whole frame.
    pub fn truncate(&mut self) {
        self.written -= self.output.truncate();
    }
}

/// Adds the path to an error.
fn of_file(path: &Path) -> impl Fn(io::Error) -> io::Error {
    move |error| io::Error::new(error.kind(), format!("{}: {error}", path.display()))
}

/// Bytes to write.
struct Batch<'a> {
    bytes: &'a [u8],
    pieces: &'a [Piece],
    /// Position of the first of them.
    start: u64,
    /// Where the frames and strings that are not written yet end, with the number of frames: 1 for a frame, 0 for a string.
    ends: Vec<(u64, u64)>,
}

impl<'a> Batch<'a> {
    #[allow(clippy::cast_possible_truncation)] // positions in these bytes
    fn between(&self, from: u64, to: u64) -> &'a [u8] {
        &self.bytes[(from - self.start) as usize..(to - self.start) as usize]
    }

    /// When the byte before this position arrived.
    fn arrival(&self, end: u64) -> i64 {
        let at = self.pieces.partition_point(|piece| self.start + piece.end < end);
        self.pieces.get(at).map_or(0, |piece| piece.arrival)
    }
}

/// `NAME.mtb` with a number: `NAME-0001.mtb`.
fn numbered(path: &Path, number: usize) -> PathBuf {
    let mut name = path.file_stem().unwrap_or_default().to_owned();
    name.push(format!("-{number:04}"));
    if let Some(suffix) = path.extension() {
        name.push(".");
        name.push(suffix);
    }
    path.with_file_name(name)
}
