//! Live streams: threads read a port, and count, queue and record what they receive.
//!
//! ```text
//!                  ┌─ tally      counts: samples, gaps, damage, errors
//! port ─ thread ─ ─┼─ queue      bytes and arrivals, until the program takes them      bounded, drops the oldest
//!        or push   └─ recorder   every byte to disk, in a second thread                bounded, ends when it is full
//! ```
//!
//! The threads do not need Python: a program that is busy for seconds finds in the queue what was received meanwhile.

mod acquisition;
#[cfg(unix)]
mod port;
mod recorder;
mod tally;
pub mod time;

pub use acquisition::{Acquisition, QUEUE, Stats, Taken};
pub use recorder::{Recording, Report, TIMES_HEADER, TIMES_MAGIC, TIMES_VERSION};
pub use tally::{Counts, Tally};

/// Bytes that arrived together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Piece {
    /// Where they end, in bytes from the start of the stream.
    pub end: u64,
    /// When they had arrived: nanoseconds on the clock of [`time::monotonic`].
    pub arrival: i64,
}

/// Most bytes of a piece.
const PIECE: usize = 64 << 10;

/// Most pieces in a queue of `bound` bytes, so that short pieces do not need more memory than the bytes.
const fn most_pieces(bound: usize) -> usize {
    bound / size_of::<Piece>()
}

/// Locks a mutex, even if a thread panicked while it held it: the states here are consistent between any two statements.
fn lock<T>(mutex: &std::sync::Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}
