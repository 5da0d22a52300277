//! Reads a log on several threads. The result is that of one thread.
//!
//! The input is cut into blocks at arbitrary bytes. A thread that takes a block
//!
//! 1. finds the first frame from the block's first byte on. Where it ends is the block's *seam*;
//! 2. decodes from its seam to the seam of the next block, into columns that are small enough for the cache;
//! 3. appends the columns to those of the [`Reader`] when all blocks before are there, or leaves that to the thread that
//!    reads the missing one.
//!
//! ```text
//! block        |---- 0 ----|---- 1 ----|---- 2 ----|     cut at any byte
//! frames     [====][====][====][====][====][====][==
//! decoded      0------------------>1--------->2------    from seam to seam
//! ```
//!
//! A seam is a guess: a scanner that has read everything before may see the bytes around it in another way. So, before a
//! block is appended, its seam is compared with that of the reader, which has all blocks before it. Equal seams have equal
//! continuations (see [`Seam`]). Otherwise the reader reads the block itself. Damaged and hostile input therefore costs
//! time, at most twice that of one thread, and nothing else.
//!
//! # What makes it fast
//!
//! The first touch of fresh memory is a quarter of the cost of decoding (see [`crate::layout`]). Blocks are decoded into
//! memory that malloc hands out again and again, so only the copy to the reader's columns touches fresh memory, and only
//! that copy is made by one thread at a time. All columns end up contiguous.

use std::collections::BTreeMap;
use std::fmt;
use std::io;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread;

use super::{Options, Part, Place, Reader};
use crate::error::ReadError;
use crate::frame::MAX_PAYLOAD;
use crate::input::{ReadAt, ReadFrom, Stream};
use crate::mtdata::Outputs;
use crate::scan::{Scanner, Seam, Step, Window};

/// An input that several threads can read at several positions.
#[derive(Clone, Copy)]
pub enum Input<'a> {
    /// All bytes of it. They are read in place.
    Memory(&'a [u8]),
    /// Bytes that may change: a regular file, or memory that others write. Each thread copies what it reads into a
    /// private buffer, and looks at nothing but this copy.
    Copied(&'a dyn ReadAt),
}

impl fmt::Debug for Input<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Memory(_) => "Memory",
            Self::Copied(_) => "Copied",
        })
    }
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
    Copied(Stream<ReadFrom<&'a dyn ReadAt>>),
}

impl<'a> Input<'a> {
    fn end(self) -> io::Result<u64> {
        match self {
            Self::Memory(bytes) => Ok(bytes.len() as u64),
            Self::Copied(bytes) => bytes.size(),
        }
    }

    fn from(self, position: u64) -> Cursor<'a> {
        match self {
            Self::Memory(bytes) => Cursor::Memory(bytes),
            Self::Copied(bytes) => Cursor::Copied(Stream::at(ReadFrom::new(bytes, position), position)),
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
            Cursor::Copied(mut stream) => loop {
                let step = scanner.step(stream.window());
                if step != Step::More || scanner.at() >= to {
                    break step;
                }
                stream.fill(scanner.at(), from)?;
            },
        };
        let (Step::Frame { length, .. } | Step::String { length, .. }) = step else { return Ok(None) };
        Ok(scanner.seam().filter(|seam| seam.at - (length as u64) < to))
    }
}

impl Cursor<'_> {
    fn go_to(&mut self, position: u64) {
        if let Self::Copied(stream) = self {
            stream.go_to(position);
        }
    }

    fn read(&mut self, reader: &mut Reader, until: u64) -> Result<(), ReadError> {
        match self {
            Self::Memory(bytes) => Ok(reader.read(Window { bytes, offset: 0, last: true }, until)?),
            Self::Copied(stream) => reader.read_stream(stream, until),
        }
    }
}

/// A block that a thread has decoded.
struct Decoded {
    seam: Seam,
    /// The settings of `MTData` that were taken to be in force at its beginning.
    outputs: Outputs,
    /// Where it should end.
    until: u64,
    /// What was read; `None` after an error, which the reader finds again.
    read: Option<(Part, Scanner, Outputs, bool)>,
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
    /// The settings of `MTData` in force where the blocks are joined. Most often they are those of the blocks that follow.
    outputs: Mutex<Outputs>,
    queue: Mutex<Queue>,
    moved: Condvar,
    joint: Mutex<Joint<'a>>,
}

/// Decoded blocks that wait for those before them.
#[derive(Default)]
struct Queue {
    /// The next block to be joined.
    next: usize,
    decoded: BTreeMap<usize, Decoded>,
    /// Whether no more blocks are wanted: after an error, or after a thread has panicked.
    is_over: bool,
}

/// Where the blocks are joined, by one thread at a time.
struct Joint<'a> {
    reader: &'a mut Reader,
    result: Result<(), ReadError>,
}

/// Most blocks that a thread decodes ahead of the joined ones. Threads seldom wait for each other, and memory is bounded.
const AHEAD: usize = 2;

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
            outputs: self.outputs.clone().into(),
            queue: Mutex::default(),
            moved: Condvar::new(),
            joint: Joint { reader: self, result: Ok(()) }.into(),
        };
        thread::scope(|scope| {
            // Without memory for another thread, those that run read all blocks.
            let start = |_| thread::Builder::new().spawn_scoped(scope, || work.run()).ok();
            let threads: Vec<_> = (1..blocks.threads.min(count)).map_while(start).collect();
            work.run();
            // The first panic goes on in this thread as it is.
            threads.into_iter().for_each(|thread| thread.join().unwrap_or_else(|panic| resume_unwind(panic)));
        });
        work.joint.into_inner().unwrap_or_else(PoisonError::into_inner).result
    }
}

impl Work<'_> {
    /// Takes blocks, decodes them and joins what can be joined, until there are none left.
    fn run(&self) {
        let guard = EndOnPanic(self);
        let mut cursor = self.input.from(self.from);
        loop {
            let block = self.next.fetch_add(1, Ordering::Relaxed);
            if block >= self.seams.len() || !self.wait(block) {
                break;
            }
            let decoded = self.decode(block, &mut cursor);
            self.queue().decoded.insert(block, decoded);
            self.join();
        }
        std::mem::forget(guard);
    }

    /// Waits until not too many blocks before this one are missing. Returns whether the block is wanted.
    fn wait(&self, block: usize) -> bool {
        let is_early = |queue: &mut Queue| !queue.is_over && block >= queue.next + AHEAD * self.blocks.threads;
        let queue = self.moved.wait_while(self.queue(), is_early).unwrap_or_else(PoisonError::into_inner);
        !queue.is_over
    }

    /// Joins the blocks that are next, unless another thread does.
    fn join(&self) {
        while let Ok(mut joint) = self.joint.try_lock() {
            while let Some(decoded) = self.pop() {
                joint.result = self.append(joint.reader, decoded);
                self.queue().is_over |= joint.result.is_err();
                self.moved.notify_all();
            }
            drop(joint);
            // Another thread may have added the next block before it found the joint locked.
            let queue = self.queue();
            if queue.is_over || !queue.decoded.contains_key(&queue.next) {
                break;
            }
        }
    }

    fn pop(&self) -> Option<Decoded> {
        let mut queue = self.queue();
        let next = queue.next;
        let decoded = queue.decoded.remove(&next).filter(|_| !queue.is_over)?;
        queue.next += 1;
        Some(decoded)
    }

    fn queue(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Appends a block whose seam is that of the reader. The reader reads any other block itself.
    fn append(&self, reader: &mut Reader, decoded: Decoded) -> Result<(), ReadError> {
        let Decoded { seam, outputs, until, read } = decoded;
        if reader.is_finished() || reader.at() >= until {
            return Ok(());
        }
        let result = match read {
            Some((part, scanner, after, finished))
                if reader.scanner.seam() == Some(seam) && reader.outputs == outputs =>
            {
                reader.append(part, &scanner, finished);
                reader.go_on_with(after);
                Ok(())
            }
            _ => self.input.from(reader.at()).read(reader, until),
        };
        if reader.outputs != outputs {
            self.outputs().clone_from(&reader.outputs);
        }
        result
    }

    fn outputs(&self) -> MutexGuard<'_, Outputs> {
        self.outputs.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn decode(&self, block: usize, cursor: &mut Cursor<'_>) -> Decoded {
        let Some(seam) = self.seam(block) else {
            // The blocks before reach further.
            return Decoded { seam: Seam::default(), outputs: Outputs::default(), until: 0, read: None };
        };
        let until = self.end_of(block, seam);
        let outputs = self.outputs().clone();
        let place = Place { seam, sample: 0, outputs: outputs.clone() };
        let mut reader = Reader::resume(self.options.clone(), place, until.saturating_sub(seam.at));
        cursor.go_to(seam.at);
        let read = cursor.read(&mut reader, until).ok().map(|()| {
            let part = reader.take_untrimmed();
            (part, reader.scanner, reader.outputs, reader.finished)
        });
        Decoded { seam, outputs, until, read }
    }

    /// Where a block ends: at the next seam, or where the work ends.
    fn end_of(&self, block: usize, seam: Seam) -> u64 {
        let mut seams = (block + 1..self.seams.len()).filter_map(|next| self.seam(next).map(|seam| seam.at));
        seams.find(|next| *next > seam.at).unwrap_or(u64::MAX).min(self.until)
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
}

/// Ends the work of the other threads if its own panics.
struct EndOnPanic<'a, 'b>(&'a Work<'b>);

impl Drop for EndOnPanic<'_, '_> {
    fn drop(&mut self) {
        self.0.queue().is_over = true;
        self.0.moved.notify_all();
    }
}
