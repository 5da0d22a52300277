//! Acquisition: receives a stream of bytes without delay, even while the program is busy.

use std::collections::VecDeque;
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::intake::Intake;
use super::lanes::{Block, Dropped, Event, Item, Lanes, Sample, Text, Waiting};
use super::rates::{Meter, Rates};
use super::recorder::{Recorder, Recording};
use super::time::{self, monotonic};
use super::{Counts, PIECE, lock};
use crate::error::CanError;
use crate::frame::Frame;
use crate::log::can::{CanFrames, CanId, LiveFrames, LiveReader, Verdict};
use crate::mtdata::Output;

/// Default for the most bytes of samples that wait: 60 seconds at 4 Mbaud.
pub const QUEUE: usize = 24_000_000;

/// If pieces arrive closer together than this, in ns, and no reader waits for the next one, the thread lets bytes
/// accumulate before it reads again. A read costs the same for one frame as for ten.
#[cfg(unix)]
const SHORT_INTERVAL: i64 = 2_000_000;
/// How long it lets them accumulate.
#[cfg(unix)]
const REST: Duration = Duration::from_millis(1);

const CLOSED: &str = "it was closed";
const FORKED: &str = "this process is a fork; the connection belongs to its parent";

/// A stream that a thread reads from a descriptor, or that is pushed.
///
/// Samples, strings and messages wait in lanes until they are taken. When a lane is full its oldest entries are dropped and
/// counted, so a program that was busy for long gets the newest ones. Counts and recordings are complete in any case.
///
/// All methods may be called from any thread. In a forked process the stream has ended.
#[derive(Debug)]
pub struct Acquisition {
    shared: Arc<Shared>,
    #[cfg(unix)]
    thread: Mutex<Option<Thread>>,
    /// Held while a recording starts, so that two do not write to one file.
    starting: Mutex<()>,
    bid: u8,
    is_can: bool,
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
    /// What a waiter needs has arrived, or the stream has ended.
    arrived: Condvar,
    epoch: i64,
}

#[derive(Debug)]
struct State {
    intake: Intake,
    /// Groups the frames of a CAN bus; none for a stream of bytes.
    can: Option<LiveReader>,
    lanes: Lanes,
    meter: Meter,
    /// What the waiters need, together: if one of these arrives, all are woken.
    awaited: Awaited,
    /// Whether a waiter has needed the very next thing since the last piece.
    hurry: bool,
    last_arrival: Option<i64>,
    /// Overruns since the ports were opened.
    overruns: Option<u64>,
    /// Failed transfers, on a bus.
    transfer_errors: Option<u64>,
    /// The counter of the current port when it was last read.
    #[cfg(unix)]
    overruns_seen: Option<u64>,
    recorder: Option<Arc<Recorder>>,
    ended: Option<String>,
}

/// What a wait is for. It ends as soon as one of them is the case.
#[derive(Clone, Copy, Debug, Default)]
pub struct Need {
    /// This number of samples waits to be taken.
    pub samples: Option<usize>,
    /// A string waits to be taken.
    pub strings: bool,
    /// More events were added than this: see [`Acquisition::take_events`].
    pub events: Option<u64>,
}

/// What the waiters need, together.
#[derive(Clone, Copy, Debug)]
struct Awaited {
    samples: usize,
    strings: bool,
    events: u64,
}

impl Awaited {
    const NOTHING: Self = Self { samples: usize::MAX, strings: false, events: u64::MAX };

    fn add(&mut self, need: Need) {
        self.samples = self.samples.min(need.samples.unwrap_or(usize::MAX));
        self.strings |= need.strings;
        self.events = self.events.min(need.events.unwrap_or(u64::MAX));
    }
}

/// Ends waits: see [`Acquisition::cancel`].
#[derive(Debug, Default)]
pub struct Cancel(AtomicBool);

impl Cancel {
    /// Whether it was used.
    #[must_use]
    pub fn is_set(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// Counts of the stream, and the state of the lanes.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "python", derive(pyo3::IntoPyObject))]
pub struct Stats {
    /// Counts of all that was received.
    pub counts: Counts,
    /// How often quantities and strings arrive.
    pub rates: Rates,
    /// Bytes of samples, strings and messages that wait to be taken.
    pub queued: usize,
    /// Samples that wait to be taken.
    pub unread: usize,
    /// What was dropped unread.
    pub dropped: Dropped,
    /// When the last bytes arrived, on the clock of the stream.
    pub last_arrival: Option<i64>,
    /// How often the driver or its chip had no room for a byte, or the device none for a message to a bus; `None` if that is
    /// not counted.
    pub overruns: Option<u64>,
    /// Transfers on a bus that failed; `None` for a port that is no bus.
    pub transfer_errors: Option<u64>,
}

impl Acquisition {
    /// A stream whose lanes hold `bound` bytes each, and always the last entry. Entries shorter than 16 bytes count as 16.
    ///
    /// `bid` is the bus identifier of the device whose frames go to the lanes; [`MASTER`](crate::frame::MASTER) for those of
    /// all devices. `epoch` is what to add to arrivals for nanoseconds since 1970; `None` if arrivals are on the clock of
    /// [`monotonic`].
    #[must_use]
    pub fn new(bound: usize, bid: u8, epoch: Option<i64>) -> Self {
        let epoch = epoch.unwrap_or_else(time::epoch);
        Self::of(Intake::new(bid, None), Lanes::new(bound, epoch), None, bid, epoch)
    }

    /// The frames of a CAN bus, which are pushed, instead of a stream of bytes: see [`Self::push_can`]. `ids` are those of the
    /// devices, and `rate` is that of their counters, for devices that send no time stamps; the rest is as for [`Self::new`].
    ///
    /// # Errors
    /// As [`LiveReader::new`].
    pub fn can(bound: usize, bid: u8, epoch: Option<i64>, ids: &[CanId], rate: Option<f64>) -> Result<Self, CanError> {
        let epoch = epoch.unwrap_or_else(time::epoch);
        let reader = LiveReader::new(ids)?;
        let mut intake = Intake::new(bid, rate);
        reader.changes().for_each(|(bid, change)| intake.change(bid, change));
        let lanes = Lanes::new(bound, epoch).with_stamped_arrivals();
        Ok(Self::of(intake, lanes, Some(reader), bid, epoch))
    }

    fn of(intake: Intake, lanes: Lanes, can: Option<LiveReader>, bid: u8, epoch: i64) -> Self {
        let is_can = can.is_some();
        let state = State {
            intake,
            can,
            lanes,
            meter: Meter::default(),
            awaited: Awaited::NOTHING,
            hurry: false,
            last_arrival: None,
            overruns: None,
            transfer_errors: None,
            #[cfg(unix)]
            overruns_seen: None,
            recorder: None,
            ended: None,
        };
        Self {
            shared: Arc::new(Shared { state: Mutex::new(state), arrived: Condvar::new(), epoch }),
            #[cfg(unix)]
            thread: Mutex::new(None),
            starting: Mutex::new(()),
            bid,
            is_can,
            process: std::process::id(),
        }
    }

    /// What to add to arrivals for nanoseconds since 1970; constant for a stream.
    #[must_use]
    pub fn epoch(&self) -> i64 {
        self.shared.epoch
    }

    /// Bus identifier of the device whose frames go to the lanes.
    #[must_use]
    pub fn bid(&self) -> u8 {
        self.bid
    }

    /// Whether this process has forked from the one that the threads belong to. A lock may be held there forever.
    fn is_forked(&self) -> bool {
        std::process::id() != self.process
    }

    /// The state, unless this process is a fork.
    fn state(&self) -> Option<MutexGuard<'_, State>> {
        (!self.is_forked()).then(|| lock(&self.shared.state))
    }

    /// Starts to read a duplicate of a descriptor. The original stays unchanged and belongs to the caller, but must not be
    /// read. After an end the stream continues with the new descriptor.
    ///
    /// # Errors
    /// Those of the system; [`io::ErrorKind::AlreadyExists`] if a descriptor is being read.
    #[cfg(unix)]
    pub fn open(&self, fd: std::os::fd::RawFd) -> io::Result<()> {
        if self.is_forked() {
            return Err(forked());
        }
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
        let handle = std::thread::Builder::new()
            .name("xbus-reader".into())
            .spawn(move || shared.drain(port))
            .inspect_err(|error| self.shared.end(&format!("the port cannot be read: {error}")))?;
        *thread = Some(Thread { port: weak, handle });
        Ok(())
    }

    /// Looks also for these strings: see [`Scanner::expect`](crate::scan::Scanner::expect).
    pub fn expect(&self, strings: u32) {
        if let Some(mut state) = self.state() {
            state.intake.expect(strings);
        }
    }

    /// Decodes `MTData` with settings that the caller knows, until the stream has others: see
    /// [`Outputs::give`](crate::mtdata::Outputs::give).
    pub fn give_outputs(&self, given: Vec<Output>) {
        if let Some(mut state) = self.state() {
            state.intake.give(given);
        }
    }

    /// Handles a request before it is sent: see [`Outputs::learn`](crate::mtdata::Outputs::learn).
    pub fn note_request(&self, request: Frame<'_>) {
        if let Some(mut state) = self.state() {
            state.intake.note_request(request);
        }
    }

    /// Continues after an end with what is pushed from now on, in the same lanes, counts and recording.
    ///
    /// # Errors
    /// [`io::ErrorKind::AlreadyExists`] if it has not ended.
    pub fn resume(&self) -> io::Result<()> {
        let mut state = self.state().ok_or_else(forked)?;
        if state.ended.take().is_none() {
            return Err(io::Error::new(io::ErrorKind::AlreadyExists, "the stream has not ended"));
        }
        Ok(())
    }

    /// Adds bytes that were received by other means, at `arrival` or now; returns false after the end of the stream. Arrivals
    /// never decrease: one that is earlier than the last one is taken for the last one.
    #[allow(clippy::must_use_candidate)] // a caller may know that the stream has not ended
    pub fn push(&self, bytes: &[u8], arrival: Option<i64>) -> bool {
        let arrival = arrival.unwrap_or_else(monotonic);
        !self.is_forked() && bytes.chunks(PIECE).all(|piece| self.shared.add(piece, arrival))
    }

    /// Whether it receives the frames of a CAN bus.
    #[must_use]
    pub const fn is_can(&self) -> bool {
        self.is_can
    }

    /// Adds frames of a CAN bus that arrive now, with the times at which they were received, in seconds since 1970. Returns
    /// the [`Verdict`] of each, and the number of samples that are complete with them; `None` after the end of the stream.
    ///
    /// # Errors
    /// As [`LiveReader::push`].
    pub fn push_can(&self, frames: CanFrames<'_>, now: Option<i64>) -> Result<Option<(Vec<u8>, u64)>, CanError> {
        if self.is_forked() {
            return Ok(None);
        }
        self.shared.add_frames(frames, now.unwrap_or_else(monotonic))
    }

    /// Adds to the counts of a bus: see [`Stats`]. The first call begins to count.
    pub fn count_bus(&self, overruns: u64, transfer_errors: u64) {
        if let Some(mut state) = self.state() {
            *state.overruns.get_or_insert_default() += overruns;
            *state.transfer_errors.get_or_insert_default() += transfer_errors;
        }
    }

    /// Decides the bytes that are part of an incomplete frame or string: no more of it will come.
    pub fn interrupt(&self) {
        if let Some(mut state) = self.state() {
            state.finish();
            self.shared.wake(&mut state, false);
        }
    }

    /// Ends the stream for a reason. What waits can still be taken.
    pub fn end(&self, reason: &str) {
        if !self.is_forked() {
            self.shared.end(reason);
        }
    }

    /// Why the stream has ended; `None` if it has not.
    #[must_use]
    pub fn ended(&self) -> Option<String> {
        self.state().map_or_else(|| Some(FORKED.to_owned()), |state| state.ended.clone())
    }

    /// Waits for what is needed, for the end of the stream or for a cancellation, at most for `timeout`; returns whether one
    /// of them is the case.
    ///
    /// Any number of threads may wait. A caller that needs more than one sample may get them a millisecond later, which
    /// costs less CPU time. A wait for more samples than the lane holds ends as soon as it is full.
    #[must_use]
    pub fn wait(&self, need: Need, timeout: Duration, cancel: &Cancel) -> bool {
        let Some(mut state) = self.state() else { return true };
        state.hurry |= need.samples == Some(1) || need.strings || need.events.is_some();
        let (began, dropped) = (Instant::now(), state.lanes.dropped().samples);
        loop {
            let is_full = need.samples.is_some() && state.lanes.dropped().samples > dropped;
            if state.has(need) || is_full || state.ended.is_some() || cancel.is_set() {
                return true;
            }
            let left = timeout.saturating_sub(began.elapsed());
            if left.is_zero() {
                return false;
            }
            state.awaited.add(need);
            (state, _) = self.shared.arrived.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Ends all waits with this cancellation, those to come included.
    pub fn cancel(&self, cancel: &Cancel) {
        cancel.0.store(true, Ordering::Relaxed);
        // A waiter that has just looked at it holds the lock until it waits.
        drop(self.state());
        self.shared.arrived.notify_all();
    }

    /// Takes the oldest sample, and its frame.
    #[must_use]
    pub fn take_sample(&self) -> Option<(Sample, Vec<u8>)> {
        self.state()?.lanes.take_sample()
    }

    /// Takes the oldest string.
    #[must_use]
    pub fn take_string(&self) -> Option<Text> {
        self.state()?.lanes.take_string()
    }

    /// Takes this number of samples, and the strings before the last of them; `None` if fewer wait. Without a number, takes
    /// all samples and strings.
    #[must_use]
    pub fn take_block(&self, samples: Option<usize>) -> Option<Block> {
        let mut state = self.state()?;
        if samples.is_some_and(|samples| state.lanes.samples() < samples) {
            return None;
        }
        Some(state.lanes.take_block(samples))
    }

    /// Takes all events, and returns the number of those that were ever added. If `early`, also the messages among the bytes
    /// that may still be part of a longer frame; each message is returned once.
    #[must_use]
    pub fn take_events(&self, early: bool) -> (VecDeque<Event>, u64) {
        let Some(mut state) = self.state() else { return (VecDeque::new(), 0) };
        let mut events = state.lanes.take_events();
        if early {
            events.extend(state.intake.early_messages());
        }
        (events, state.lanes.events_added())
    }

    /// Adds [`Event::Data`] before the next sample or string.
    pub fn mark_data(&self) {
        if let Some(mut state) = self.state() {
            state.lanes.mark_data();
        }
    }

    /// Takes everything that waits, in the order in which it was received; `None` once nothing waits and the stream has
    /// ended.
    #[must_use]
    pub fn take_all(&self) -> Option<Vec<Item>> {
        let mut state = self.state()?;
        let items = state.lanes.take_all();
        if items.is_empty() && state.ended.is_some() { None } else { Some(items) }
    }

    /// Removes the samples and strings that wait, and returns how many there were. They do not count as dropped.
    #[allow(clippy::must_use_candidate)] // the number may not matter
    pub fn clear_data(&self) -> usize {
        self.state().map_or(0, |mut state| state.lanes.clear_data())
    }

    /// What waits to be taken.
    #[must_use]
    pub fn waiting(&self) -> Waiting {
        self.state().map_or_else(Waiting::default, |state| state.lanes.waiting(state.last_arrival))
    }

    /// Counts of the stream, and the state of the lanes, `now` on the clock of the stream.
    #[must_use]
    pub fn stats(&self, now: i64) -> Stats {
        #[cfg(unix)]
        if !self.is_forked()
            && let Some(port) = lock(&self.thread).as_ref().and_then(|thread| thread.port.upgrade())
        {
            lock(&self.shared.state).count_overruns(port.overruns());
        }
        let Some(state) = self.state() else { return Stats::default() };
        let counts = Counts { skipped_bytes: state.intake.skipped_bytes(), ..state.intake.counts().clone() };
        Stats {
            rates: state.meter.rates(&counts, now),
            counts,
            queued: state.lanes.bytes(),
            unread: state.lanes.samples(),
            dropped: state.lanes.dropped(),
            last_arrival: state.last_arrival,
            overruns: state.overruns,
            transfer_errors: state.transfer_errors,
        }
    }

    /// Records from now on, beginning with the frame that is incomplete now. Bytes are written as soon as the frame or string
    /// to which they belong is complete.
    ///
    /// # Errors
    /// Those of the system, about the first file; [`io::ErrorKind::AlreadyExists`] if a recording is in progress.
    pub fn record(&self, recording: Recording) -> io::Result<Arc<Recorder>> {
        if self.is_forked() {
            return Err(forked());
        }
        let _starting = lock(&self.starting);
        if self.recording().is_some() {
            return Err(io::Error::new(io::ErrorKind::AlreadyExists, "a recording is in progress"));
        }
        let strings = self.state().ok_or_else(forked)?.intake.expected();
        let recorder = Arc::new(Recorder::start(recording, self.shared.epoch, strings)?);
        // The state is unlocked before the recorder of a failed recording is dropped, which closes its files.
        let failed = self.state().ok_or_else(forked)?.recorder.replace(recorder.clone());
        drop(failed);
        Ok(recorder)
    }

    /// The recording in progress.
    #[must_use]
    pub fn recording(&self) -> Option<Arc<Recorder>> {
        self.state()?.recorder.clone().filter(|recorder| recorder.report().active)
    }

    /// Ends the stream, its thread and the recording. What waits can still be taken.
    pub fn close(&self) {
        if self.is_forked() {
            return;
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

fn forked() -> io::Error {
    io::Error::new(io::ErrorKind::BrokenPipe, FORKED)
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
        let mut guard = lock(&self.state);
        let state = &mut *guard;
        if state.ended.is_some() {
            return false;
        }
        let arrival = state.last_arrival.map_or(arrival, |last| last.max(arrival));
        state.last_arrival = Some(arrival);
        let dropped = state.lanes.dropped().samples;
        state.intake.feed(piece, arrival, &mut state.lanes, state.recorder.as_deref());
        state.meter.note(state.intake.counts(), arrival);
        // A waiter that needs more than fits learns that it does not.
        let is_full = state.lanes.dropped().samples > dropped;
        self.wake(&mut guard, is_full);
        true
    }

    fn add_frames(&self, frames: CanFrames<'_>, now: i64) -> Result<Option<(Vec<u8>, u64)>, CanError> {
        let mut guard = lock(&self.state);
        let state = &mut *guard;
        if state.ended.is_some() {
            return Ok(None);
        }
        let now = state.last_arrival.map_or(now, |last| last.max(now));
        state.last_arrival = Some(now);
        let dropped = state.lanes.dropped().samples;
        let before = state.intake.counts().samples;
        let LiveFrames { verdicts, events } = state.add_frames(frames, false, self.epoch)?;
        let decoded = verdicts.iter().filter(|verdict| **verdict <= Verdict::Event as u8).count();
        let bytes = frames.sizes.iter().map(|size| u64::from(*size)).sum();
        let samples = state.intake.counts().samples - before;
        state.intake.can_frames(bytes, decoded as u64, &events);
        state.meter.note(state.intake.counts(), now);
        let is_full = state.lanes.dropped().samples > dropped;
        self.wake(&mut guard, is_full);
        Ok(Some((verdicts, samples)))
    }

    /// Wakes all waiters if one of them may have what it needs.
    fn wake(&self, state: &mut State, is_full: bool) {
        let Awaited { samples, strings, events } = state.awaited;
        let has_samples = state.lanes.samples() >= samples || (is_full && samples != usize::MAX);
        let has_strings = strings && state.lanes.strings() > 0;
        let has_events = state.lanes.events_added() > events;
        if has_samples || has_strings || has_events {
            state.awaited = Awaited::NOTHING;
            self.arrived.notify_all();
        }
    }

    fn end(&self, reason: &str) {
        let mut state = lock(&self.state);
        if state.ended.is_none() {
            state.finish();
            // All groups are complete. Without frames nothing can be wrong with them.
            let _ = state.add_frames(CanFrames::NONE, true, self.epoch);
            state.ended = Some(reason.to_owned());
        }
        drop(state);
        self.arrived.notify_all();
    }
}

impl State {
    fn has(&self, need: Need) -> bool {
        need.samples.is_some_and(|samples| self.lanes.samples() >= samples)
            || (need.strings && self.lanes.strings() > 0)
            || need.events.is_some_and(|events| self.lanes.events_added() > events)
    }

    fn add_frames(&mut self, frames: CanFrames<'_>, is_end: bool, epoch: i64) -> Result<LiveFrames, CanError> {
        let Self { can: Some(reader), intake, lanes, .. } = self else { return Ok(LiveFrames::default()) };
        reader.push(frames, is_end, |sample| {
            let arrival = time::nanoseconds(sample.received).saturating_sub(epoch);
            intake.can_sample(&sample, arrival, lanes);
        })
    }

    fn finish(&mut self) {
        self.intake.finish(&mut self.lanes, self.recorder.as_deref());
    }

    #[cfg(unix)]
    fn count_overruns(&mut self, now: Option<u64>) {
        if let (Some(seen), Some(now)) = (&mut self.overruns_seen, now) {
            let more = now.saturating_sub(std::mem::replace(seen, now));
            self.overruns = Some(self.overruns.unwrap_or_default() + more);
        }
    }
}

/// Ends the stream when it is dropped: a thread that panics leaves bytes that cannot be decided.
#[cfg(unix)]
struct ReportEnd<'a>(&'a Shared);

#[cfg(unix)]
impl Drop for ReportEnd<'_> {
    fn drop(&mut self) {
        lock(&self.0.state).ended.get_or_insert_with(|| "the reader failed; this is a bug in xbus".to_owned());
        self.0.arrived.notify_all();
    }
}
