//! Live streams: a thread reads a port, and scans, counts, queues and records what it receives.
//!
//! ```text
//!                         ┌─ counts     samples, gaps, damage, errors
//! port ─ thread ─ intake ─┼─ lanes      samples, strings, messages, until the program takes them   bounded, drops the oldest
//!        or push          └─ recorder   every byte to disk, in a second thread                     bounded, ends when it is full
//! ```
//!
//! The intake scans the stream, once, and gives every sample its device time. All others use what it has found. The threads
//! do not need Python: a program that is busy for seconds finds in the lanes what was received meanwhile.

mod acquisition;
mod block;
mod counts;
mod intake;
mod lanes;
#[cfg(unix)]
mod port;
mod rates;
mod recorder;
pub mod time;

pub use acquisition::{Acquisition, Cancel, Need, QUEUE, Stats};
pub use block::{BlockDecoder, DecodedBlock};
pub use counts::Counts;
pub use lanes::{Block, Dropped, Event, Item, Sample, Text, Waiting};
pub use rates::Rates;
pub use recorder::{Recorder, Recording, Report, TIMES_HEADER, TIMES_MAGIC, TIMES_VERSION};

/// Bytes that arrived together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Piece {
    /// Where they end, in bytes from the start of the stream.
    pub end: u64,
    /// When they had arrived: nanoseconds on the clock of the stream.
    pub arrival: i64,
}

/// Most bytes of a piece.
const PIECE: usize = 64 << 10;

/// Most entries of a queue of `bound` bytes, so that short entries do not need much more memory than the bytes.
const fn most_entries(bound: usize) -> usize {
    bound / 16
}

/// Locks a mutex, even if a thread panicked while it held it: the states here are consistent between any two statements.
fn lock<T>(mutex: &std::sync::Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}
