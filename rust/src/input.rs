//! Buffers for input that is read or pushed in pieces. Each hands a [`Window`] to a scanner and keeps the bytes that the
//! scanner has not decided yet.

use std::error::Error;
use std::fmt;
use std::fs::File;
use std::io::{self, Read};
use std::ops::Range;
use std::path::{Path, PathBuf};

use crate::huge_pages;
use crate::scan::Window;

/// Most bytes to read at a time: enough to make system calls cheap, few enough to stay in the second-level cache. Each
/// reader clears a new buffer of this size, which takes time in a part of a megabyte.
const PIECE: usize = 1 << 18;
/// Fewest bytes to ask for, so that parts of a few bytes do not cost a system call each.
const LEAST: usize = 1 << 12;

/// An input that is read piece by piece into one buffer, which is used again for every piece.
///
/// Files are read and not mapped: if another program truncates a file, a mapping of it kills the process that reads it,
/// whereas a read just ends.
#[derive(Debug)]
pub struct Stream<R> {
    input: R,
    buffer: Vec<u8>,
    /// The part of the buffer with bytes that are read and not dropped.
    held: Range<usize>,
    /// Position of the first of them in the input.
    offset: u64,
    ended: bool,
}

impl<R: Read> Stream<R> {
    /// A stream at the beginning of `input`.
    #[must_use]
    pub fn new(input: R) -> Self {
        Self { input, buffer: vec![], held: 0..0, offset: 0, ended: false }
    }

    /// A stream that begins at this position of an input.
    #[must_use]
    pub fn at(input: R, position: u64) -> Self {
        Self { offset: position, ..Self::new(input) }
    }

    /// Drops the bytes before `position` and reads more, at least one byte unless the input has ended. It asks for what is
    /// missing up to `until`, within limits. One read suffices: a pipe returns what it holds.
    ///
    /// # Errors
    /// Any error of the input but [`io::ErrorKind::Interrupted`], which is retried.
    pub fn fill(&mut self, position: u64, until: u64) -> io::Result<()> {
        #[allow(clippy::cast_possible_truncation)] // a position in the buffer
        (self.held.start += (position - self.offset) as usize);
        self.offset = position;
        // Every byte that moves is paid for by one that was dropped, so the cost is linear even if each read returns one byte.
        if self.held.len() <= self.held.start {
            self.buffer.copy_within(self.held.clone(), 0);
            self.held = 0..self.held.len();
        }
        let missing = until.saturating_sub(position + self.held.len() as u64);
        let wanted = usize::try_from(missing).unwrap_or(PIECE).clamp(LEAST, PIECE);
        // A shorter read is cheaper than a larger buffer: a buffer that grows is copied.
        let room = self.buffer.len() - self.held.end;
        let end = self.held.end + if room < PIECE / 2 { wanted } else { wanted.min(room) };
        if self.buffer.len() < end {
            let more = end - self.buffer.len();
            huge_pages::reserve_or_end(&mut self.buffer, more);
            self.buffer.resize(end, 0);
        }
        loop {
            match self.input.read(&mut self.buffer[self.held.end..end]) {
                Ok(more) => {
                    self.held.end += more;
                    self.ended = more == 0;
                    return Ok(());
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
    }

    /// The bytes in the buffer.
    #[must_use]
    pub fn window(&self) -> Window<'_> {
        Window { bytes: &self.buffer[self.held.clone()], offset: self.offset, last: self.ended }
    }
}

/// Bytes of known size that several threads can read, each where it wants.
pub trait ReadAt: Send + Sync {
    /// Number of bytes at this moment: a file can grow and shrink.
    ///
    /// # Errors
    /// If the system does not know it.
    fn size(&self) -> io::Result<u64>;

    /// Reads bytes at a position, at most as many as fit into the buffer; returns how many, 0 only at the end.
    ///
    /// # Errors
    /// If they cannot be read.
    fn read_at(&self, buffer: &mut [u8], position: u64) -> io::Result<usize>;
}

impl ReadAt for File {
    fn size(&self) -> io::Result<u64> {
        Ok(self.metadata()?.len())
    }

    fn read_at(&self, buffer: &mut [u8], position: u64) -> io::Result<usize> {
        #[cfg(unix)]
        return std::os::unix::fs::FileExt::read_at(self, buffer, position);
        #[cfg(windows)]
        return std::os::windows::fs::FileExt::seek_read(self, buffer, position);
    }
}

/// An error of a file, and the path of the file. It is the inner error of the [`io::Error`] of a [`NamedFile`].
#[derive(Debug)]
pub struct FileError {
    /// The file.
    pub path: PathBuf,
    /// What is wrong.
    pub error: io::Error,
}

impl fmt::Display for FileError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.path.display(), self.error)
    }
}

impl Error for FileError {
    fn source(&self) -> Option<&(dyn Error + 'static)> {
        Some(&self.error)
    }
}

/// An open file whose errors name it: each has a [`FileError`].
#[derive(Debug)]
pub struct NamedFile<F = File> {
    file: F,
    path: PathBuf,
}

impl NamedFile {
    /// Opens a regular file to read it.
    ///
    /// # Errors
    /// If it cannot be opened, or is no regular file.
    pub fn open(path: PathBuf) -> io::Result<Self> {
        match open_regular(&path) {
            Ok(file) => Ok(Self { file, path }),
            Err(error) => Err(named(error, &path)),
        }
    }
}

fn open_regular(path: &Path) -> io::Result<File> {
    let mut options = File::options();
    // Without this, to open a pipe waits for its writer.
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::custom_flags(&mut options, libc::O_NONBLOCK);
    let file = options.read(true).open(path)?;
    if file.metadata()?.is_file() { Ok(file) } else { Err(io::Error::other("not a regular file")) }
}

fn named(error: io::Error, path: &Path) -> io::Error {
    io::Error::new(error.kind(), FileError { path: path.to_owned(), error })
}

impl<F: ReadAt> ReadAt for NamedFile<F> {
    fn size(&self) -> io::Result<u64> {
        self.file.size().map_err(|error| named(error, &self.path))
    }

    fn read_at(&self, buffer: &mut [u8], position: u64) -> io::Result<usize> {
        self.file.read_at(buffer, position).map_err(|error| named(error, &self.path))
    }
}

/// Files, one behind the other.
#[derive(Debug)]
pub struct Files<F = File> {
    /// Each with the position at which it ends.
    files: Vec<(NamedFile<F>, u64)>,
}

impl<F: ReadAt> Files<F> {
    /// These files, with the sizes that they have now.
    ///
    /// # Errors
    /// If the system does not know a size.
    pub fn of(files: Vec<NamedFile<F>>) -> io::Result<Self> {
        let mut end = 0;
        let with_end = |file: NamedFile<F>| {
            end += file.size()?;
            Ok((file, end))
        };
        Ok(Self { files: files.into_iter().map(with_end).collect::<io::Result<_>>()? })
    }
}

impl<F: ReadAt> ReadAt for Files<F> {
    fn size(&self) -> io::Result<u64> {
        Ok(self.files.last().map_or(0, |(_, end)| *end))
    }

    fn read_at(&self, buffer: &mut [u8], position: u64) -> io::Result<usize> {
        let at = self.files.partition_point(|(_, end)| *end <= position);
        let Some((file, end)) = self.files.get(at) else { return Ok(0) };
        let start = if at == 0 { 0 } else { self.files[at - 1].1 };
        let most = usize::try_from(end - position).unwrap_or(usize::MAX).min(buffer.len());
        let read = file.read_at(&mut buffer[..most], position - start)?;
        if read == 0 && most > 0 {
            return Err(named(io::Error::other("the file has become shorter while it was read"), &file.path));
        }
        Ok(read)
    }
}

impl<R: ReadAt + ?Sized> ReadAt for &R {
    fn size(&self) -> io::Result<u64> {
        (**self).size()
    }

    fn read_at(&self, buffer: &mut [u8], position: u64) -> io::Result<usize> {
        (**self).read_at(buffer, position)
    }
}

/// A reader of bytes from a position on.
#[derive(Debug)]
pub struct ReadFrom<R> {
    bytes: R,
    position: u64,
}

impl<R: ReadAt> ReadFrom<R> {
    /// A reader of `bytes` that begins at `position`.
    #[must_use]
    pub const fn new(bytes: R, position: u64) -> Self {
        Self { bytes, position }
    }
}

impl<R: ReadAt> Stream<ReadFrom<R>> {
    /// Drops all bytes, and goes on at `position`.
    pub fn go_to(&mut self, position: u64) {
        self.input.position = position;
        (self.held, self.offset, self.ended) = (0..0, position, false);
    }
}

impl<R: ReadAt> Read for ReadFrom<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.bytes.read_at(buffer, self.position)?;
        self.position += read as u64;
        Ok(read)
    }
}

/// Bytes that a caller pushes and that are not decided yet.
#[derive(Debug, Default)]
pub struct PushBuffer {
    bytes: Vec<u8>,
    /// Position of the first byte in the input.
    offset: u64,
}

impl PushBuffer {
    /// Appends bytes.
    pub fn push(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    /// The bytes in the buffer. `last` is whether the input ends with them.
    #[must_use]
    pub fn window(&self, last: bool) -> Window<'_> {
        Window { bytes: &self.bytes, offset: self.offset, last }
    }

    /// Drops the bytes before `position`.
    pub fn release(&mut self, position: u64) {
        #[allow(clippy::cast_possible_truncation)] // a position in the buffer
        self.bytes.drain(..(position - self.offset) as usize);
        self.offset = position;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns at most `most` bytes a call, and is interrupted before each.
    struct Slow<'a> {
        bytes: &'a [u8],
        most: usize,
        interrupted: bool,
    }

    impl Read for Slow<'_> {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            self.interrupted = !self.interrupted;
            if self.interrupted {
                return Err(io::ErrorKind::Interrupted.into());
            }
            let most = buffer.len().min(self.most);
            self.bytes.read(&mut buffer[..most])
        }
    }

    #[test]
    fn a_stream_keeps_what_is_not_dropped() {
        let bytes: Vec<u8> = (0..=250).cycle().take(3 * PIECE + 7).collect();
        for (most, until) in [(1000, 0), (PIECE, u64::MAX), (usize::MAX, 2 * PIECE as u64)] {
            let mut stream = Stream::new(Slow { bytes: &bytes, most, interrupted: false });
            let (mut position, mut end) = (0, 0);
            loop {
                stream.fill(position as u64, until).unwrap();
                let window = stream.window();
                assert_eq!(window.offset, position as u64);
                assert_eq!(window.bytes, &bytes[position..position + window.bytes.len()]);
                if window.last {
                    assert_eq!(position + window.bytes.len(), bytes.len());
                    break;
                }
                assert!(position + window.bytes.len() > end);
                end = position + window.bytes.len();
                position += window.bytes.len() / 3;
            }
            assert!(stream.buffer.len() <= 4 * PIECE);
        }
    }

    #[test]
    fn a_stream_reads_once_and_what_is_missing() {
        let bytes = vec![1; 4 * PIECE];
        let filled = |position, until| {
            let mut stream = Stream::new(&bytes[..]);
            stream.fill(0, LEAST as u64).unwrap();
            stream.fill(position, until).unwrap();
            position + stream.window().bytes.len() as u64
        };
        let [least, piece] = [LEAST as u64, PIECE as u64];
        assert_eq!(filled(100, 100_000), 100_000);
        assert_eq!(filled(100, 0), 2 * least);
        assert_eq!(filled(100, u64::MAX), least + piece);

        let mut stream = Stream::new(&bytes[..]);
        for position in [0, piece - 100, 2 * piece - 300] {
            stream.fill(position, u64::MAX).unwrap();
            assert_eq!(stream.buffer.len() as u64, piece, "the buffer does not grow for what was left over");
        }

        let mut slow = Stream::new(Slow { bytes: &bytes, most: 10, interrupted: false });
        slow.fill(0, u64::MAX).unwrap();
        assert_eq!(slow.window().bytes.len(), 10);
    }

    #[test]
    fn a_stream_reports_errors_of_its_input() {
        struct Broken;
        impl Read for Broken {
            fn read(&mut self, _: &mut [u8]) -> io::Result<usize> {
                Err(io::ErrorKind::UnexpectedEof.into())
            }
        }
        assert_eq!(Stream::new(Broken).fill(0, 1).unwrap_err().kind(), io::ErrorKind::UnexpectedEof);
    }

    /// Bytes of which the first half can be read.
    struct Faulty {
        size: u64,
        kind: io::ErrorKind,
    }

    impl ReadAt for Faulty {
        fn size(&self) -> io::Result<u64> {
            Ok(self.size)
        }

        fn read_at(&self, buffer: &mut [u8], position: u64) -> io::Result<usize> {
            let left = (self.size / 2).saturating_sub(position);
            if left == 0 {
                return if self.kind == io::ErrorKind::UnexpectedEof { Ok(0) } else { Err(self.kind.into()) };
            }
            Ok(usize::try_from(left).unwrap().min(buffer.len()))
        }
    }

    #[test]
    fn an_error_names_its_file() {
        for kind in [io::ErrorKind::PermissionDenied, io::ErrorKind::UnexpectedEof] {
            let named = |path: &str, kind| NamedFile { file: Faulty { size: 100, kind }, path: path.into() };
            let files = Files::of(vec![named("one", kind), named("other", kind)]).unwrap();
            for (position, path) in [(50, "one"), (150, "other")] {
                let mut stream = Stream::at(ReadFrom::new(&files, position - 10), position - 10);
                stream.fill(position - 10, 200).unwrap();
                let error = stream.fill(position - 10, 200).unwrap_err().downcast::<FileError>().unwrap();
                assert_eq!(error.path, Path::new(path));
                assert_eq!(error.error.kind() == kind, kind == io::ErrorKind::PermissionDenied);
            }
        }
        let interrupted = NamedFile { file: Faulty { size: 0, kind: io::ErrorKind::Interrupted }, path: "one".into() };
        assert_eq!(interrupted.read_at(&mut [0], 0).unwrap_err().kind(), io::ErrorKind::Interrupted);
    }

    #[test]
    fn a_push_buffer_keeps_what_is_not_released() {
        let mut buffer = PushBuffer::default();
        buffer.push(b"abc");
        buffer.release(2);
        buffer.push(b"def");
        let window = buffer.window(true);
        assert_eq!((window.bytes, window.offset, window.last), (&b"cdef"[..], 2, true));
        buffer.release(6);
        let window = buffer.window(false);
        assert_eq!((window.bytes, window.offset, window.last), (&b""[..], 6, false));
    }
}
