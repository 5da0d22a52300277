//! Reads a log on several threads. The result is that of one thread.
//!
//! The input is cut into blocks at arbitrary bytes. A thread that takes a block
//!
//! 1. finds the first frame from the block's first byte on. Where it ends is the block's *seam*;
//! 2. decodes from its seam to the seam of the next block, into columns that are small enough for the cache;
//! 3. waits until it is the block's turn, and appends the columns to those of the [`Reader`].
//!
//! ```text
//! block        |---- 0 ----|---- 1 ----|---- 2 ----|     cut at any byte
//! frames     [====][====][====][====][====][====][==
//! decoded      0------------------>1--------->2------    from seam to seam
//! ```
//!
//! A seam is a guess: a scanner that has read everything before may see the bytes around it in another way. So, when it is
//! the block's turn, its seam is compared with that of the reader, which has all blocks before it. Equal seams have equal
//! continuations (see [`Seam`]), and the block is appended. Otherwise the reader reads the block itself, on the thread whose
//! turn it is. Damaged and hostile input therefore costs time, at most twice that of one thread, and nothing else.
//!
//! # What makes it fast
//!
//! The first touch of fresh memory is a quarter of the cost of decoding (see [`crate::layout`]). Blocks are decoded into
//! memory that malloc hands out again and again, so only the copy to the reader's columns touches fresh memory, and only
//! that copy is made in turns. All columns end up contiguous.

use std::fs::File;
use std::io;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, OnceLock, PoisonError};

use super::{Options, Part, Place, Reader};
use crate::error::ReadError;
use crate::frame::MAX_PAYLOAD;
use crate::input::{FileFrom, Stream};
use crate::scan::{Scanner, Seam, Step, Window};

/// An input that several threads can read at several positions.
#[derive(Clone, Copy, Debug)]
pub enum Input<'a> {
    /// All bytes of it.
    Memory(&'a [u8]),
    /// A regular file.
    File(&'a File),
}

/// How an input is cut into blocks, and how many threads read them.
#[derive(Clone, Copy, Debug)]
pub struct Blocks {
    /// Bytes of a block.
    pub size: u64,
    /// Number of threads.
    pub threads: usize,
}

impl Blocks {
    /// Blocks that are small enough for their columns to stay in the cache, and large enough for the work between two blocks
    /// not to matter.
    #[must_use]
    pub const fn of(threads: usize) -> Self {
        Self { size: 2 << 20, threads }
    }
}

/// An input, read from a position on.
enum Cursor<'a> {
    Memory(&'a [u8]),
    File(Stream<FileFrom<&'a File>>),
}

impl<'a> Input<'a> {
    fn end(self) -> io::Result<u64> {
        match self {
            Self::Memory(bytes) => Ok(bytes.len() as u64),
            Self::File(file) => Ok(file.metadata()?.len()),
        }
    }

    fn from(self, position: u64) -> Cursor<'a> {
        match self {
            Self::Memory(bytes) => Cursor::Memory(bytes),
            Self::File(file) => Cursor::File(Stream::at(FileFrom::new(file, position), position)),
        }
    }

    /// The seam at the end of the first frame or string that begins between two positions, by a guess.
    fn guess_seam(self, options: &Options, known: Seam, from: u64, to: u64) -> io::Result<Option<Seam>> {
        /// Bytes that decide any candidate for a plausible frame.
        const REACH: usize = MAX_PAYLOAD + 16;
        let mut scanner = known.scanner_at(options.limit, from);
        scanner.expect(options.strings);
        let step = match self.from(from) {
            Cursor::Memory(bytes) if bytes.len() as u64 <= from => return Ok(None),
            Cursor::Memory(bytes) => {
                let end = bytes.len().min(usize::try_from(to).unwrap_or(usize::MAX).saturating_add(REACH));
                scanner.step(Window { bytes: &bytes[..end], offset: 0, last: end == bytes.len() })
            }
            Cursor::File(mut stream) => loop {
                stream.fill(scanner.at())?;
                let step = scanner.step(stream.window());
                if step != Step::More || scanner.at() >= to {
                    break step;
                }
            },
        };
        let (Step::Frame { length, .. } | Step::String { length, .. }) = step else { return Ok(None) };
        Ok(scanner.seam().filter(|seam| seam.at - (length as u64) < to))
    }
}

impl Cursor<'_> {
    fn read(&mut self, reader: &mut Reader, until: u64) -> Result<(), ReadError> {
        match self {
            Self::Memory(bytes) => Ok(reader.read(Window { bytes, offset: 0, last: true }, until)?),
            Self::File(stream) => reader.read_stream(stream, until),
        }
    }
}

/// A block that a thread has decoded.
struct Decoded {
    part: Part,
    scanner: Scanner,
    finished: bool,
}

/// What the threads share.
struct Work<'a> {
    input: Input<'a>,
    options: Options,
    blocks: Blocks,
    from: u64,
    until: u64,
    /// The seam of each block; `None` for a block without one.
    seams: Vec<OnceLock<Option<Seam>>>,
    next: AtomicUsize,
    turn: Mutex<Turn<'a>>,
    turned: Condvar,
}

/// Whose turn it is, and what only that thread may touch.
struct Turn<'a> {
    block: usize,
    reader: &'a mut Reader,
    result: Result<(), ReadError>,
    /// Whether a thread has panicked; the others must not wait for it.
    is_abandoned: bool,
}

impl Reader {
    /// Reads on as [`Self::read`] does until the position reaches `until` or the input ends, on several threads.
    ///
    /// # Errors
    /// [`ReadError::Fault`] as [`Self::read`]; [`ReadError::Io`] if the input cannot be read.
    pub fn read_parallel(&mut self, input: Input<'_>, until: u64, blocks: Blocks) -> Result<(), ReadError> {
        let from = self.at();
        let length = until.min(input.end()?).saturating_sub(from);
        let count = usize::try_from(length.div_ceil(blocks.size)).unwrap_or(usize::MAX);
        let Some(seam) = self.scanner.seam().filter(|_| blocks.threads > 1 && count > 1) else {
            return input.from(from).read(self, until);
        };
        let mut seams = vec![OnceLock::from(Some(seam))];
        seams.resize_with(count, OnceLock::new);
        let work = Work {
            input,
            options: self.options.clone(),
            blocks,
            from,
            until,
            seams,
            next: AtomicUsize::new(0),
            turn: Turn { block: 0, reader: self, result: Ok(()), is_abandoned: false }.into(),
            turned: Condvar::new(),
        };
        std::thread::scope(|scope| {
            for _ in 1..blocks.threads.min(count) {
                scope.spawn(|| work.run());
            }
            work.run();
        });
        work.turn.into_inner().unwrap_or_else(PoisonError::into_inner).result
    }
}

impl<'a> Work<'a> {
    /// Takes blocks and reads them, until there are none left.
    fn run(&self) {
        let guard = AbandonOnPanic(self);
        loop {
            let block = self.next.fetch_add(1, Ordering::Relaxed);
            if block >= self.seams.len() {
                break;
            }
            let Some(seam) = self.seam(block) else {
                let Some(turn) = self.wait(block) else { break };
                self.end_turn(turn);
                continue;
            };
            let until = self.end_of(block, seam);
            // Whatever goes wrong goes wrong again when the reader reads the block, which then reports it.
            let decoded = self.decode(seam, until).ok();
            let Some(mut turn) = self.wait(block) else { break };
            turn.result = match decoded {
                _ if turn.reader.is_finished() || turn.reader.at() >= until => Ok(()),
                Some(Decoded { part, scanner, finished }) if turn.reader.scanner.seam() == Some(seam) => {
                    turn.reader.append(part, &scanner, finished);
                    Ok(())
                }
                _ => self.input.from(turn.reader.at()).read(turn.reader, until),
            };
            self.end_turn(turn);
        }
        std::mem::forget(guard);
    }

    /// Where a block ends: at the next seam, or where the work ends.
    fn end_of(&self, block: usize, seam: Seam) -> u64 {
        let mut seams = (block + 1..self.seams.len()).filter_map(|next| self.seam(next).map(|seam| seam.at));
        seams.find(|next| *next > seam.at).unwrap_or(u64::MAX).min(self.until)
    }

    fn decode(&self, seam: Seam, until: u64) -> Result<Decoded, ReadError> {
        let mut reader = Reader::resume(self.options.clone(), Place { seam, sample: 0 }, until.saturating_sub(seam.at));
        self.input.from(seam.at).read(&mut reader, until)?;
        let part = reader.take_untrimmed();
        Ok(Decoded { part, finished: reader.finished, scanner: reader.scanner })
    }

    /// The seam of a block, found by the first thread that needs it.
    fn seam(&self, block: usize) -> Option<Seam> {
        *self.seams[block].get_or_init(|| {
            let known = self.seams[0].get().copied().flatten()?;
            let from = self.from + block as u64 * self.blocks.size;
            let to = self.until.min(from + self.blocks.size);
            self.input.guess_seam(&self.options, known, from, to).ok().flatten()
        })
    }

    /// Waits for the turn of a block; `None` if the work has ended before.
    fn wait(&self, block: usize) -> Option<MutexGuard<'_, Turn<'a>>> {
        let turn = self.turn.lock().unwrap_or_else(PoisonError::into_inner);
        let is_early = |turn: &mut Turn<'_>| turn.block < block && turn.result.is_ok() && !turn.is_abandoned;
        let turn = self.turned.wait_while(turn, is_early).unwrap_or_else(PoisonError::into_inner);
        (turn.result.is_ok() && !turn.is_abandoned).then_some(turn)
    }

    fn end_turn(&self, mut turn: MutexGuard<'_, Turn<'a>>) {
        turn.block += 1;
        drop(turn);
        self.turned.notify_all();
    }
}

/// Ends the work of the other threads if its own panics.
struct AbandonOnPanic<'a, 'b>(&'a Work<'b>);

impl Drop for AbandonOnPanic<'_, '_> {
    fn drop(&mut self) {
        self.0.turn.lock().unwrap_or_else(PoisonError::into_inner).is_abandoned = true;
        self.0.turned.notify_all();
    }
}
