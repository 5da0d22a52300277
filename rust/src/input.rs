//! Buffers for input that is read or pushed in pieces. Each hands a [`Window`] to a scanner and keeps the bytes that the
//! scanner has not decided yet.

use std::borrow::Borrow;
use std::fs::File;
use std::io::{self, Read};

use crate::scan::Window;

/// Bytes to read at a time: enough to make system calls cheap, few enough for the second-level cache.
const PIECE: usize = 1 << 19;

/// An input that is read piece by piece into one buffer, which is used again for every piece.
///
/// Files are read and not mapped: if another program truncates a file, a mapping of it kills the process that reads it,
/// whereas a read just ends.
#[derive(Debug)]
pub struct Stream<R> {
    input: R,
    buffer: Vec<u8>,
    /// Bytes of the buffer that are filled.
    filled: usize,
    /// Position of the buffer's first byte in the input.
    offset: u64,
    ended: bool,
}

impl<R: Read> Stream<R> {
    /// A stream at the beginning of `input`.
    #[must_use]
    pub fn new(input: R) -> Self {
        Self { input, buffer: vec![0; 2 * PIECE], filled: 0, offset: 0, ended: false }
    }

    /// A stream that begins at this position of an input.
    #[must_use]
    pub fn at(input: R, position: u64) -> Self {
        Self { offset: position, ..Self::new(input) }
    }

    /// Drops the bytes before `position` and reads one piece more, or up to the end of the input.
    ///
    /// # Errors
    /// Any error of the input but [`io::ErrorKind::Interrupted`], which is retried.
    pub fn fill(&mut self, position: u64) -> io::Result<()> {
        #[allow(clippy::cast_possible_truncation)] // a position in the buffer
        let done = (position - self.offset) as usize;
        self.buffer.copy_within(done..self.filled, 0);
        (self.filled, self.offset) = (self.filled - done, position);
        if self.buffer.len() - self.filled < PIECE {
            self.buffer.resize(self.filled + PIECE, 0);
        }
        let wanted = self.filled + PIECE;
        while self.filled < wanted && !self.ended {
            match self.input.read(&mut self.buffer[self.filled..wanted]) {
                Ok(0) => self.ended = true,
                Ok(more) => self.filled += more,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// The bytes in the buffer.
    #[must_use]
    pub fn window(&self) -> Window<'_> {
        Window { bytes: &self.buffer[..self.filled], offset: self.offset, last: self.ended }
    }
}

/// A file, read from a position on. Several of these can read one file at the same time.
#[derive(Debug)]
pub struct FileFrom<F> {
    file: F,
    position: u64,
}

impl<F: Borrow<File>> FileFrom<F> {
    /// A reader of `file` that begins at `position`.
    #[must_use]
    pub const fn new(file: F, position: u64) -> Self {
        Self { file, position }
    }
}

impl<F: Borrow<File>> Read for FileFrom<F> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        #[cfg(unix)]
        let read = std::os::unix::fs::FileExt::read_at(self.file.borrow(), buffer, self.position)?;
        #[cfg(windows)]
        let read = std::os::windows::fs::FileExt::seek_read(self.file.borrow(), buffer, self.position)?;
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

    /// Returns at most 1000 bytes a call, and is interrupted before each.
    struct Slow<'a> {
        bytes: &'a [u8],
        interrupted: bool,
    }

    impl Read for Slow<'_> {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            self.interrupted = !self.interrupted;
            if self.interrupted {
                return Err(io::ErrorKind::Interrupted.into());
            }
            let most = buffer.len().min(1000);
            self.bytes.read(&mut buffer[..most])
        }
    }

    #[test]
    fn a_stream_keeps_what_is_not_released() {
        let bytes: Vec<u8> = (0..=250).cycle().take(3 * PIECE + 7).collect();
        let mut stream = Stream::new(Slow { bytes: &bytes, interrupted: false });
        let mut position = 0;
        loop {
            stream.fill(position as u64).unwrap();
            let window = stream.window();
            assert_eq!(window.offset, position as u64);
            assert_eq!(window.bytes, &bytes[position..position + window.bytes.len()]);
            if window.last {
                assert_eq!(position + window.bytes.len(), bytes.len());
                break;
            }
            assert!(window.bytes.len() >= PIECE);
            position += PIECE / 3;
        }
    }

    #[test]
    fn a_stream_reports_errors_of_its_input() {
        struct Broken;
        impl Read for Broken {
            fn read(&mut self, _: &mut [u8]) -> io::Result<usize> {
                Err(io::ErrorKind::UnexpectedEof.into())
            }
        }
        assert_eq!(Stream::new(Broken).fill(0).unwrap_err().kind(), io::ErrorKind::UnexpectedEof);
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
