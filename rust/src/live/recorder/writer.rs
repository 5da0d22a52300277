//! The files of a recording, one after another.

use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::file::LogFile;
use super::{Batch, Recording, Report};
use crate::frame::{Frame, field};
use crate::strings::enabled_strings;
use crate::table::{BARE_STRINGS, STRING_OUTPUT_TYPE};

/// Writes the files of a recording.
#[derive(Debug)]
pub struct Writer {
    recording: Recording,
    epoch: i64,
    output: LogFile,
    /// Whether the next bytes belong into another file.
    full: bool,
    /// Number of the last file.
    number: usize,
    /// Whether strings without a checksum were enabled before the recording.
    had_strings: bool,
    /// The last `StringOutputType` frame that was received, if it matters: every file repeats which strings without a
    /// checksum are enabled.
    strings: Vec<u8>,
    /// The files, and what is in them.
    report: Report,
}

impl Writer {
    /// Creates the first file. Arguments as for [`Recorder::start`](super::Recorder::start).
    pub fn new(recording: Recording, epoch: i64, strings: u32) -> io::Result<Self> {
        let output = LogFile::new(&recording, &[], recording.path.clone(), epoch)?;
        Ok(Self {
            report: Report { files: vec![recording.path.clone()], ..Report::default() },
            recording,
            epoch,
            output,
            full: false,
            number: 0,
            had_strings: strings != 0,
            strings: vec![],
        })
    }

    /// Keeps a `StringOutputType` frame, if strings without a checksum are or were enabled.
    fn learn(&mut self, frame: &[u8]) {
        if frame[field::MID] != STRING_OUTPUT_TYPE {
            return;
        }
        let were_enabled = self.had_strings || !self.strings.is_empty();
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
        self.report.clone()
    }

    /// Writes a batch. If it fails, the file may end inside a frame: see [`Self::truncate`].
    pub fn write(&mut self, batch: &Batch) -> io::Result<()> {
        let mut from = 0;
        for mark in &batch.marks {
            let end = mark.end as u64;
            let began = self.prepare(batch, from)?;
            if self.is_full(end - from, batch.arrival(end).saturating_sub(began)) {
                self.write_up_to(batch, &mut from, end)?;
                self.flush(true)?;
                self.full = true;
            }
            if mark.mid.is_some() {
                self.learn(&batch.bytes[mark.end - mark.length..mark.end]);
            }
        }
        self.write_up_to(batch, &mut from, batch.bytes.len() as u64)
    }

    /// Writes the times, and makes the disk store everything if that is wanted; `ends` is whether the file is complete.
    pub fn flush(&mut self, ends: bool) -> io::Result<()> {
        self.output.flush(ends, self.recording.fsync).map_err(of_file(&self.output.path))
    }

    /// Whether the file is to end after this number of bytes more, with which it lasts this number of nanoseconds.
    fn is_full(&self, more: u64, lasted: i64) -> bool {
        let length = self.output.length + more;
        let lasted = u64::try_from(lasted).map_or(Duration::ZERO, Duration::from_nanos);
        self.recording.rotate_bytes.is_some_and(|limit| length >= limit)
            || self.recording.rotate_after.is_some_and(|limit| lasted >= limit)
    }

    /// Prepares the file for the bytes from this position of the batch on: starts another one if the current one is full.
    /// Returns when the first bytes of the file arrived.
    fn prepare(&mut self, batch: &Batch, from: u64) -> io::Result<i64> {
        if self.full {
            self.start_file()?;
        }
        Ok(*self.output.began.get_or_insert(batch.arrival(from + 1)))
    }

    fn start_file(&mut self) -> io::Result<()> {
        let (path, output) = loop {
            self.number += 1;
            let path = numbered(&self.recording.path, self.number);
            match LogFile::new(&self.recording, &self.strings, path.clone(), self.epoch) {
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                output => break (path.clone(), output.map_err(of_file(&path))?),
            }
        };
        self.output = output;
        self.report.files.push(path);
        self.full = false;
        Ok(())
    }

    /// Writes the batch from one position up to another.
    fn write_up_to(&mut self, batch: &Batch, from: &mut u64, to: u64) -> io::Result<()> {
        if *from == to {
            return Ok(());
        }
        self.prepare(batch, *from)?;
        let (begin, length) = (*from, self.output.length);
        #[allow(clippy::cast_possible_truncation)] // positions in a buffer
        let result = self.output.write(&batch.bytes[begin as usize..to as usize]);
        let taken = begin + (self.output.length - length);
        *from = taken;
        self.report.bytes += taken - begin;
        let place = |position: u64| length + (position - begin);
        // The frames and strings that the file has now, up to the last whole one.
        let (first, done) = (batch.mark_after(begin), batch.mark_after(taken));
        if let Some(last) = batch.marks[first..done].last() {
            self.output.whole = place(last.end as u64);
        }
        for mark in &batch.marks[first..done] {
            self.report.count(mark);
        }
        result.map_err(of_file(&self.output.path))?;
        for piece in batch.pieces.iter().skip_while(|piece| piece.end <= begin) {
            self.output.add_time(place(piece.end.min(to)), piece.arrival.saturating_add(self.epoch));
            if piece.end >= to {
                break;
            }
        }
        Ok(())
    }

    /// Truncates the file after its last whole frame; a file without any is removed.
    pub fn truncate(&mut self) {
        self.report.bytes -= self.output.truncate();
    }
}

/// Adds the path to an error.
fn of_file(path: &Path) -> impl Fn(io::Error) -> io::Error {
    move |error| io::Error::new(error.kind(), format!("{}: {error}", path.display()))
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
