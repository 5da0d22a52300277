//! Acquisition: receives a stream of bytes without delay, even while the program is busy.

use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Duration;

use super::recorder::{Recorder, Recording, Report};
use super::tally::{Counts, Tally};
use super::time::{epoch, monotonic};
use super::{PIECE, Piece, lock, most_pieces};

/// Default for the most bytes in the queue: 60 seconds at 4 Mbaud.
pub const QUEUE: usize = 24_000_000;

/// If pieces arrive closer together than this, in ns, and no reader waits for the next one, the thread lets bytes
/// accumulate before it reads again. A read costs the same for one frame as for ten.
#[cfg(unix)]
const SHORT_INTERVAL: i64 = 2_000_000;
/// How long it lets them accumulate.
#[cfg(unix)]
const REST: Duration = Duration::from_millis(1);

const CLOSED: &str = "it was closed";

/// A stream that a thread reads from a descriptor, or that is pushed.
///
/// Received bytes wait in a queue. When it is full the oldest pieces are dropped and counted, so a program that was busy for
/// long gets the newest bytes. Counts and recordings are complete in any case.
#[derive(Debug)]
pub struct Acquisition {
    shared: Arc<Shared>,
    #[cfg(unix)]
    thread: Mutex<Option<Thread>>,
    /// The process that the threads belong to.
    process: u32,
}

/// The thread that reads a port.
#[cfg(unix)]
#[derive(Debug)]
struct Thread {
    /// The thread owns the port. An open descriptor would keep the device's name in use after it was unplugged.
    port: std::sync::Weak<super::port::Port>,
    handle: std::thread::JoinHandle<()>,
}

#[derive(Debug)]
struct Shared {
    state: Mutex<State>,
    arrived: Condvar,
    bound: usize,
    epoch: i64,
}

#[derive(Debug, Default)]
struct State {
    bytes: VecDeque<u8>,
    pieces: VecDeque<Piece>,
    /// Bytes that the reader waits for; 0 if none waits.
    wanted: usize,
    /// Whether a reader has waited for the very next piece since the last one.
    hurry: bool,
    tally: Tally,
    most_queued: usize,
    dropped: u64,
    last_arrival: Option<i64>,
    /// Overruns since the ports were opened.
    overruns: Option<u64>,
    /// The counter of the current port when it was last read.
    #[cfg(unix)]
    overruns_seen: Option<u64>,
    recorder: Option<Arc<Recorder>>,
    ended: Option<String>,
}

/// What was taken from the queue.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Taken {
    /// Position of the first byte in the stream. Greater than the end of the bytes taken before if the queue was full.
    pub offset: u64,
    /// The bytes.
    pub bytes: VecDeque<u8>,
    /// The pieces in which they arrived; the last one ends with the last byte.
    pub pieces: VecDeque<Piece>,
}

/// Counts of the stream, and the state of the queue.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Stats {
    /// Counts of all that was received.
    pub counts: Counts,
    /// Bytes in the queue.
    pub queued: usize,
    /// The most bytes that were in the queue.
    pub most_queued: usize,
    /// Bytes dropped because the queue was full.
    pub dropped: u64,
    /// When the last bytes arrived, on the clock of [`monotonic`].
    pub last_arrival: Option<i64>,
    /// How often the driver or its chip had no room for a byte; `None` if the system does not count that.
    pub overruns: Option<u64>,
}

impl Acquisition {
    /// A stream whose queue holds `bound` bytes, and always the last piece. Pieces shorter than 16 bytes count as 16.
    #[must_use]
    pub fn new(bound: usize) -> Self {
        let shared = Shared { state: Mutex::default(), arrived: Condvar::new(), bound, epoch: epoch() };
        Self {
            shared: Arc::new(shared),
            #[cfg(unix)]
            thread: Mutex::new(None),
            process: std::process::id(),
        }
    }

    /// What to add to arrivals for nanoseconds since 1970; constant for a stream.
    #[must_use]
    pub fn epoch(&self) -> i64 {
        self.shared.epoch
    }

    /// Starts to read a duplicate of a descriptor. The original stays unchanged and belongs to the caller, but must not be
    /// read. After an end the stream continues with the new descriptor.
    ///
    /// # Errors
    /// Those of the system; [`io::ErrorKind::AlreadyExists`] if a descriptor is being read.
    #[cfg(unix)]
    pub fn open(&self, fd: std::os::fd::RawFd) -> io::Result<()> {
        let mut thread = lock(&self.thread);
        if thread.is_some() && self.ended().is_none() {
            return Err(io::Error::new(io::ErrorKind::AlreadyExists, "a port is being read"));
        }
        if let Some(thread) = thread.take() {
            thread.stop();
        }
        let port = Arc::new(super::port::Port::of(fd)?);
        {
            let mut state = lock(&self.shared.state);
            state.ended = None;
            state.overruns_seen = port.overruns();
        }
        let (weak, shared) = (Arc::downgrade(&port), self.shared.clone());
        let handle = std::thread::Builder::new().name("xbus-reader".into()).spawn(move || shared.drain(port))?;
        *thread = Some(Thread { port: weak, handle });
        Ok(())
    }

    /// Looks also for these strings: see [`Scanner::expect`](crate::scan::Scanner::expect).
    pub fn expect(&self, strings: u32) {
        lock(&self.shared.state).tally.expect(strings);
    }

    /// Continues after an end with what is pushed from now on, in the same queue, counts and recording.
    ///
    /// # Errors
    /// [`io::ErrorKind::AlreadyExists`] if it has not ended.
    pub fn resume(&self) -> io::Result<()> {
        let mut state = lock(&self.shared.state);
        if state.ended.take().is_none() {
            return Err(io::Error::new(io::ErrorKind::AlreadyExists, "the stream has not ended"));
        }
        Ok(())
    }

    /// Adds bytes that were received by other means; returns false after the end of the stream.
    #[allow(clippy::must_use_candidate)] // a caller may know that the stream has not ended
    pub fn push(&self, bytes: &[u8]) -> bool {
        let arrival = monotonic();
        bytes.chunks(PIECE).all(|piece| self.shared.add(piece, arrival))
    }

    /// Ends the stream for a reason. What is queued can still be taken.
    pub fn end(&self, reason: &str) {
        self.shared.end(reason);
    }

    /// Why the stream has ended; `None` if it has not.
    #[must_use]
    pub fn ended(&self) -> Option<String> {
        lock(&self.shared.state).ended.clone()
    }

    /// Waits until the queue has `least` bytes or the stream has ended, at most for `timeout`; returns whether one of them is
    /// the case.
    ///
    /// It waits for half of the queue's bound at most. Only one thread may wait at a time. A caller that waits for more than
    /// one byte may get them a millisecond later, which costs less CPU time.
    #[must_use]
    pub fn wait(&self, least: usize, timeout: Duration) -> bool {
        let least = least.min(self.shared.bound / 2).max(1);
        let is_short = |state: &mut State| state.bytes.len() < least && state.ended.is_none();
        let mut state = lock(&self.shared.state);
        state.wanted = least;
        state.hurry |= least == 1;
        let waited = self.shared.arrived.wait_timeout_while(state, timeout, is_short);
        (state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        state.wanted = 0;
        !is_short(&mut state)
    }

    /// Takes all that is queued; `None` once the queue is empty and the stream has ended.
    #[must_use]
    pub fn take(&self) -> Option<Taken> {
        let mut state = lock(&self.shared.state);
        if state.bytes.is_empty() && state.ended.is_some() {
            return None;
        }
        let offset = state.first();
        Some(Taken { offset, bytes: std::mem::take(&mut state.bytes), pieces: std::mem::take(&mut state.pieces) })
    }

    /// Counts of the stream, and the state of the queue.
    #[must_use]
    pub fn stats(&self) -> Stats {
        #[cfg(unix)]
        if let Some(port) = lock(&self.thread).as_ref().and_then(|thread| thread.port.upgrade()) {
            lock(&self.shared.state).count_overruns(port.overruns());
        }
        let state = lock(&self.shared.state);
        Stats {
            counts: Counts { skipped_bytes: state.tally.skipped_bytes(), ..state.tally.counts().clone() },
            queued: state.bytes.len(),
            most_queued: state.most_queued,
            dropped: state.dropped,
            last_arrival: state.last_arrival,
            overruns: state.overruns,
        }
    }

    /// Records from now on, beginning with the frame that is incomplete now.
    ///
    /// # Errors
    /// Those of the system, about the first file; [`io::ErrorKind::AlreadyExists`] if a recording is in progress.
    pub fn record(&self, recording: Recording) -> io::Result<()> {
        let busy = || io::Error::new(io::ErrorKind::AlreadyExists, "a recording is in progress");
        if self.recording().is_some_and(|report| report.active) {
            return Err(busy());
        }
        let strings = lock(&self.shared.state).tally.expected();
        let recorder = Arc::new(Recorder::start(recording, self.shared.epoch, strings)?);
        let mut state = lock(&self.shared.state);
        if state.recorder.as_ref().is_some_and(|recorder| recorder.report().active) {
            return Err(busy());
        }
        if !state.tally.undecided().is_empty() {
            recorder.offer(state.tally.undecided(), state.last_arrival.unwrap_or_default());
        }
        state.recorder = Some(recorder);
        Ok(())
    }

    /// The state of the recording, also of one that failed and was not stopped.
    #[must_use]
    pub fn recording(&self) -> Option<Report> {
        lock(&self.shared.state).recorder.as_ref().map(|recorder| recorder.report())
    }

    /// Ends the recording: nothing received from now on is in it. Waits until all is written, at most for `timeout`. Returns
    /// the last state; `None` if it is not yet written, and if there is no recording.
    #[must_use]
    pub fn stop_recording(&self, timeout: Duration) -> Option<Report> {
        let recorder = lock(&self.shared.state).recorder.clone()?;
        recorder.close();
        if !recorder.wait(timeout) {
            return None;
        }
        lock(&self.shared.state).recorder.take_if(|current| Arc::ptr_eq(current, &recorder));
        Some(recorder.report())
    }

    /// Ends the stream, its thread and the recording. What is queued can still be taken, and so can the recording's state.
    pub fn close(&self) {
        if std::process::id() != self.process {
            return; // a forked process has no threads, and must not disturb those of its parent
        }
        #[cfg(unix)]
        if let Some(thread) = lock(&self.thread).take() {
            thread.stop();
        }
        self.shared.end(CLOSED);
        let recorder = lock(&self.shared.state).recorder.clone();
        if let Some(recorder) = recorder {
            recorder.stop();
        }
    }
}

#[cfg(unix)]
impl Thread {
    fn stop(self) {
        if let Some(port) = self.port.upgrade() {
            port.wake();
        }
        let _ = self.handle.join();
    }
}

impl Drop for Acquisition {
    fn drop(&mut self) {
        self.close();
    }
}

impl Shared {
    /// The thread: reads the port until it ends.
    #[cfg(unix)]
    fn drain(&self, port: Arc<super::port::Port>) {
        use super::port::Event;

        let _end = ReportEnd(self);
        let mut buffer = vec![0; PIECE];
        let mut last = i64::MIN;
        let reason = loop {
            match port.read(&mut buffer) {
                Ok(Event::Bytes(count)) => {
                    let arrival = monotonic();
                    if !self.add(&buffer[..count], arrival) {
                        break CLOSED.to_owned();
                    }
                    let hurry = std::mem::take(&mut lock(&self.state).hurry);
                    if arrival.saturating_sub(last) < SHORT_INTERVAL && !hurry {
                        port.rest(REST);
                    }
                    last = arrival;
                }
                Ok(Event::Wake) => break CLOSED.to_owned(),
                Ok(Event::End) => break "the port is gone: unplugged, or closed on the other side".to_owned(),
                Err(error) => break format!("the port cannot be read: {error}"),
            }
        };
        lock(&self.state).count_overruns(port.overruns());
        // A caller that learns of the end may open the port again, so the device's name must be free by then.
        drop(port);
        self.end(&reason);
    }

    fn add(&self, piece: &[u8], arrival: i64) -> bool {
        let mut state = lock(&self.state);
        if state.ended.is_some() {
            return false;
        }
        state.tally.feed(piece);
        if let Some(recorder) = &state.recorder {
            recorder.offer(piece, arrival);
        }
        state.last_arrival = Some(arrival);
        let end = state.tally.counts().bytes;
        state.bytes.extend(piece);
        state.pieces.push_back(Piece { end, arrival });
        state.most_queued = state.most_queued.max(state.bytes.len().min(self.bound));
        let most = most_pieces(self.bound);
        while state.pieces.len() > 1 && (state.bytes.len() > self.bound || state.pieces.len() > most) {
            state.drop_oldest();
        }
        let is_awaited = state.wanted > 0 && state.bytes.len() >= state.wanted;
        drop(state);
        if is_awaited {
            self.arrived.notify_one();
        }
        true
    }

    fn end(&self, reason: &str) {
        let mut state = lock(&self.state);
        if state.ended.is_none() {
            state.tally.finish();
            state.ended = Some(reason.to_owned());
        }
        drop(state);
        self.arrived.notify_all();
    }
}

impl State {
    /// Position of the first byte in the queue.
    fn first(&self) -> u64 {
        self.tally.counts().bytes - self.bytes.len() as u64
    }

    #[cfg(unix)]
    fn count_overruns(&mut self, now: Option<u64>) {
        if let (Some(seen), Some(now)) = (&mut self.overruns_seen, now) {
            let more = now.saturating_sub(std::mem::replace(seen, now));
            self.overruns = Some(self.overruns.unwrap_or_default() + more);
        }
    }

    fn drop_oldest(&mut self) {
        let first = self.first();
        let Some(piece) = self.pieces.pop_front() else { return };
        #[allow(clippy::cast_possible_truncation)] // bytes in the queue
        self.bytes.drain(..(piece.end - first) as usize);
        self.dropped += piece.end - first;
    }
}

/// Ends the stream, for whatever reason the thread ends, when it is dropped.
#[cfg(unix)]
struct ReportEnd<'a>(&'a Shared);

#[cfg(unix)]
impl Drop for ReportEnd<'_> {
    fn drop(&mut self) {
        self.0.end("the reader failed; this is a bug in xbus");
    }
}
