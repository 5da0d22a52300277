//! Live: a port is drained, counted, queued and recorded by threads that wait for nobody.
//!
//! ```text
//!                  ┌─ tally      what came: samples, gaps, damage, errors
//! port ─ thread ─ ─┼─ queue      bytes and when they came, until the program takes them     bounded, oldest go
//!        or push   └─ recorder   every byte to disk, in a thread of its own                 bounded, or it ends
//! ```
//!
//! Nothing here knows of Python: a program that is busy for seconds finds what came meanwhile in the queue.

mod acquisition;
#[cfg(unix)]
mod port;
mod recorder;
mod tally;
pub mod time;

pub use acquisition::{Acquisition, QUEUE, Stats, Taken};
pub use recorder::{Recording, Report, TIMES_HEADER, TIMES_MAGIC, TIMES_VERSION};
pub use tally::{Counts, Tally};

/// Bytes that came together, and when.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Piece {
    /// Where they end, in bytes from the beginning of the stream.
    pub end: u64,
    /// When they had come: nanoseconds on the clock of [`time::monotonic`].
    pub arrival: i64,
}

/// Most bytes that are taken as one piece.
const PIECE: usize = 64 << 10;

/// How many pieces a queue holds at most, so that short ones do not take more room than the bytes may.
const fn most_pieces(bound: usize) -> usize {
    bound / size_of::<Piece>()
}

/// A mutex whose holder may have panicked: what it guards here is whole between any two statements.
fn lock<T>(mutex: &std::sync::Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}
