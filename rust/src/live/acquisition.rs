//! Acquisition: a stream of bytes that is taken in as it comes, whoever is busy.

use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Duration;

use super::recorder::{Recorder, Recording, Report};
use super::tally::{Counts, Tally};
use super::time::{epoch, monotonic};
use super::{PIECE, Piece, lock, most_pieces};

/// How many bytes are kept for the program unless it says otherwise: 60 seconds at 4 Mbaud.
pub const QUEUE: usize = 24_000_000;

/// Pieces that follow each other so fast, in ns, and that nobody waits for, are taken together: once in so long. A read
/// costs the same for one frame as for ten.
#[cfg(unix)]
const OFTEN: i64 = 2_000_000;
#[cfg(unix)]
const REST: Duration = Duration::from_millis(1);

const CLOSED: &str = "it was closed";

/// A stream that comes from a descriptor, by a thread of its own, or is pushed.
///
/// What came waits in a queue until somebody takes it. When that is full the oldest pieces go, and are counted: a program
/// that has slept for long gets what is new. Counts and a recording miss nothing in either case.
#[derive(Debug)]
pub struct Acquisition {
    shared: Arc<Shared>,
    #[cfg(unix)]
    thread: Mutex<Option<Thread>>,
    /// The process that has the threads.
    process: u32,
}

/// The thread that reads a port.
#[cfg(unix)]
#[derive(Debug)]
struct Thread {
    /// The thread owns the port: a descriptor that is kept keeps the device's name taken after it was unplugged.
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
    /// The reader waits for so many bytes; 0 if nobody waits.
    wanted: usize,
    /// Since the last piece somebody has waited for the very next one.
    hurry: bool,
    tally: Tally,
    most_queued: usize,
    dropped: u64,
    last_arrival: Option<i64>,
    /// What the drivers have counted since their ports were opened, and the present one's counter when it was last read.
    overruns: Option<u64>,
    #[cfg(unix)]
    overruns_seen: Option<u64>,
    recorder: Option<Arc<Recorder>>,
    ended: Option<String>,
}

/// What was taken from the queue.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Taken {
    /// Position of the first byte in the stream. More than the end of what was taken before if the queue was full.
    pub offset: u64,
    /// The bytes.
    pub bytes: VecDeque<u8>,
    /// The pieces in which they came; the last ends with the last byte.
    pub pieces: VecDeque<Piece>,
}

/// How it goes.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Stats {
    /// What was counted of all that came.
    pub counts: Counts,
    /// Bytes in the queue.
    pub queued: usize,
    /// The most that there were.
    pub most_queued: usize,
    /// Bytes that went because the queue was full.
    pub dropped: u64,
    /// When the last bytes came, on the clock of [`monotonic`].
    pub last_arrival: Option<i64>,
    /// Bytes, or runs of them, that the driver or its chip had no room for; `None` where nobody counts.
    pub overruns: Option<u64>,
}

impl Acquisition {
    /// Keeps up to `bound` bytes, and always the last piece. Pieces shorter than 16 bytes count as so many.
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

    /// What leads from arrivals to nanoseconds since 1970, for all of this stream.
    #[must_use]
    pub fn epoch(&self) -> i64 {
        self.shared.epoch
    }

    /// Reads this descriptor from now on, by a duplicate: the caller keeps the original, and nothing about it is changed,
    /// but nobody else may read it. After an end the stream goes on with the new one.
    ///
    /// # Errors
    /// What the system says; [`io::ErrorKind::AlreadyExists`] if one is being read.
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

    /// Looks also for these strings in what comes: see [`Scanner::expect`](crate::scan::Scanner::expect).
    pub fn expect(&self, strings: u32) {
        lock(&self.shared.state).tally.expect(strings);
    }

    /// Goes on after an end with what is pushed from now on: queue, counts and recording are the same.
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

    /// Takes in what has come by other ways; whether it was taken, and not after the end.
    #[allow(clippy::must_use_candidate)] // whoever knows that it has not ended need not look
    pub fn push(&self, bytes: &[u8]) -> bool {
        let arrival = monotonic();
        bytes.chunks(PIECE).all(|piece| self.shared.take_in(piece, arrival))
    }

    /// The stream has ended, and why. What is queued can still be taken.
    pub fn end(&self, reason: &str) {
        self.shared.end(reason);
    }

    /// Why it has ended, if it has.
    #[must_use]
    pub fn ended(&self) -> Option<String> {
        lock(&self.shared.state).ended.clone()
    }

    /// Waits until there are `least` bytes, or the stream has ended, but no longer than this; whether there is something
    /// to take, or nothing more to wait for.
    ///
    /// More bytes than half of what the queue holds are not waited for. One thread waits at a time. Who waits for more than
    /// one byte may get them a millisecond later, for less of the processor.
    #[must_use]
    pub fn wait(&self, least: usize, timeout: Duration) -> bool {
        let least = least.min(self.shared.bound / 2).max(1);
        let is_short = |it: &mut State| it.bytes.len() < least && it.ended.is_none();
        let mut state = lock(&self.shared.state);
        state.wanted = least;
        state.hurry |= least == 1;
        let waited = self.shared.arrived.wait_timeout_while(state, timeout, is_short);
        (state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        state.wanted = 0;
        !is_short(&mut state)
    }

    /// What is queued, all of it; `None` if nothing is and nothing will be.
    #[must_use]
    pub fn take(&self) -> Option<Taken> {
        let mut state = lock(&self.shared.state);
        if state.bytes.is_empty() && state.ended.is_some() {
            return None;
        }
        let offset = state.first();
        Some(Taken { offset, bytes: std::mem::take(&mut state.bytes), pieces: std::mem::take(&mut state.pieces) })
    }

    /// How it goes.
    #[must_use]
    pub fn stats(&self) -> Stats {
        #[cfg(unix)]
        if let Some(port) = lock(&self.thread).as_ref().and_then(|it| it.port.upgrade()) {
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

    /// Records from now on, beginning with the frame that is under way.
    ///
    /// # Errors
    /// What the system says of the first file; [`io::ErrorKind::AlreadyExists`] if a recording is under way.
    pub fn record(&self, recording: Recording) -> io::Result<()> {
        let busy = || io::Error::new(io::ErrorKind::AlreadyExists, "a recording is under way");
        if self.recording().is_some_and(|it| it.active) {
            return Err(busy());
        }
        let strings = lock(&self.shared.state).tally.expected();
        let recorder = Arc::new(Recorder::start(recording, self.shared.epoch, strings)?);
        let mut state = lock(&self.shared.state);
        if state.recorder.as_ref().is_some_and(|it| it.report().active) {
            return Err(busy());
        }
        if !state.tally.undecided().is_empty() {
            recorder.offer(state.tally.undecided(), state.last_arrival.unwrap_or_default());
        }
        state.recorder = Some(recorder);
        Ok(())
    }

    /// How the recording goes, or how the last one went that has not been stopped.
    #[must_use]
    pub fn recording(&self) -> Option<Report> {
        lock(&self.shared.state).recorder.as_ref().map(|it| it.report())
    }

    /// Ends the recording: nothing that comes from now on is in it. Waits until all is written, but no longer than this;
    /// gives its report then, and `None` before, or if there is none.
    #[must_use]
    pub fn stop_recording(&self, timeout: Duration) -> Option<Report> {
        let recorder = lock(&self.shared.state).recorder.clone()?;
        recorder.close();
        if !recorder.wait(timeout) {
            return None;
        }
        lock(&self.shared.state).recorder.take_if(|it| Arc::ptr_eq(it, &recorder));
        Some(recorder.report())
    }

    /// Ends everything: the thread, the recording. What is queued can still be taken, and the recording's report too.
    pub fn close(&self) {
        if std::process::id() != self.process {
            return; // a fork has none of the threads, and must not disturb those of its parent
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
    /// What the thread does.
    #[cfg(unix)]
    fn drain(&self, port: Arc<super::port::Port>) {
        use super::port::Came;

        let _last = LastWords(self);
        let mut buffer = vec![0; PIECE];
        let mut last = i64::MIN;
        let reason = loop {
            match port.read(&mut buffer) {
                Ok(Came::Bytes(count)) => {
                    let arrival = monotonic();
                    if !self.take_in(&buffer[..count], arrival) {
                        break CLOSED.to_owned();
                    }
                    let hurry = std::mem::take(&mut lock(&self.state).hurry);
                    if arrival.saturating_sub(last) < OFTEN && !hurry {
                        port.rest(REST);
                    }
                    last = arrival;
                }
                Ok(Came::Wake) => break CLOSED.to_owned(),
                Ok(Came::End) => break "the port is gone: unplugged, or closed on the other side".to_owned(),
                Err(error) => break format!("the port cannot be read: {error}"),
            }
        };
        lock(&self.state).count_overruns(port.overruns());
        // Whoever hears of the end may open the port again: the device's name must be free by then.
        drop(port);
        self.end(&reason);
    }

    fn take_in(&self, piece: &[u8], arrival: i64) -> bool {
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

/// Tells those who wait that the thread has ended, whatever ended it.
#[cfg(unix)]
struct LastWords<'a>(&'a Shared);

#[cfg(unix)]
impl Drop for LastWords<'_> {
    fn drop(&mut self) {
        self.0.end("the reader failed; this is a mistake in xbus");
    }
}
