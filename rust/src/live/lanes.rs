//! What was received and waits to be taken: samples, strings and messages, each in order.
//!
//! They wait apart from each other, so a program that waits for the answer to a command leaves the samples for those who
//! read them. Each lane is bounded: the oldest entries are dropped, and counted.

use std::collections::{BTreeMap, VecDeque};

use super::{most_entries, time};
use crate::clock::Moment;
use crate::frame::{Frame, device_of};
use crate::hostclock::HostClock;
use crate::mtdata::Output;
use crate::scan::{self, Damage};

/// A sample, without its bytes.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// Where its frame begins in the stream.
    pub offset: u64,
    /// Bytes of its frame.
    pub length: u32,
    /// Bus identifier of its frame.
    pub bid: u8,
    /// Whether it arrived when it was measured: see [`Stamps::lead`](crate::clock::Stamps::lead).
    pub leads: bool,
    /// The settings of `MTData`; `None` for `MTData2`.
    pub output: Option<Output>,
    /// When its last byte arrived, in ns on the clock of the stream.
    pub arrival: i64,
    /// When it was measured, on the clock of the device, and what is missing before it.
    pub moment: Moment,
    /// When it was measured, in seconds since 1970 on the clock of the host; NaN if that is not known, and in the lane.
    pub host_time: f64,
}

/// A string output.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Text {
    /// Where it begins in the stream.
    pub offset: u64,
    /// When its last byte arrived, in ns on the clock of the stream.
    pub arrival: i64,
    /// Its place in [`table::STRINGS`](crate::table::STRINGS), if the manual lists it.
    pub place: Option<u8>,
    /// Its bytes.
    pub bytes: Box<[u8]>,
}

/// An entry of the lane of messages.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Event {
    /// A message that is no sample.
    Message {
        /// Where its frame begins in the stream.
        offset: u64,
        /// Its frame.
        bytes: Box<[u8]>,
    },
    /// A stretch of bytes that is neither frame nor string.
    Damage(Damage),
    /// The first sample or string after a message or a call of [`mark_data`](super::Acquisition::mark_data): the device
    /// measures.
    Data,
}

impl Event {
    fn size(&self) -> usize {
        match self {
            Self::Message { bytes, .. } => bytes.len(),
            Self::Damage(_) | Self::Data => 0,
        }
    }

    fn offset(&self) -> u64 {
        match self {
            Self::Message { offset, .. } | Self::Damage(Damage { offset, .. }) => *offset,
            Self::Data => 0,
        }
    }

    /// The item that the event stands for, if it stands for bytes.
    #[must_use]
    pub fn item(&self) -> Option<scan::Item<'_>> {
        match self {
            Self::Message { offset, bytes } => Some(scan::Item::Frame { offset: *offset, frame: Frame::of(bytes) }),
            Self::Damage(damage) => Some(scan::Item::Damage(*damage)),
            Self::Data => None,
        }
    }
}

/// An entry of any lane, with its bytes.
#[derive(Clone, Debug)]
pub enum Item {
    /// A sample, and its frame.
    Sample(Sample, Vec<u8>),
    /// A string.
    Text(Text),
    /// A message or a stretch of damage.
    Event(Event),
}

impl Item {
    fn offset(&self) -> u64 {
        match self {
            Self::Sample(sample, _) => sample.offset,
            Self::Text(text) => text.offset,
            Self::Event(event) => event.offset(),
        }
    }
}

/// Samples, and the strings between them.
#[derive(Debug, Default)]
pub struct Block {
    /// The frames of the samples, one after another.
    pub frames: Vec<u8>,
    /// The samples.
    pub samples: Vec<Sample>,
    /// The strings.
    pub strings: Vec<Text>,
    /// The host clocks of the devices, by bus identifier.
    pub clocks: Vec<(u8, HostClock)>,
}

/// Number of entries dropped unread.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "python", derive(pyo3::IntoPyObject))]
pub struct Dropped {
    /// Samples.
    pub samples: u64,
    /// Strings.
    pub strings: u64,
    /// Messages. Damage is not among them: its bytes are counted as skipped.
    pub messages: u64,
}

/// The lanes.
#[derive(Debug)]
pub struct Lanes {
    /// Most bytes of each lane.
    bound: usize,
    epoch: i64,
    /// Whether a sample without device time was measured when it arrived: see [`Self::with_stamped_arrivals`].
    has_stamped_arrivals: bool,
    /// The clocks of the host for the devices, as of the last sample that left its lane.
    clocks: BTreeMap<u8, HostClock>,
    samples: VecDeque<Sample>,
    /// The frames of the samples.
    frames: VecDeque<u8>,
    strings: VecDeque<Text>,
    string_bytes: usize,
    events: VecDeque<Event>,
    event_bytes: usize,
    /// Events that were ever added.
    added: u64,
    is_data_marked: bool,
    /// When the newest sample arrived.
    last_sample: Option<i64>,
    dropped: Dropped,
}

/// What waits to be taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Waiting {
    /// Samples.
    pub samples: usize,
    /// Strings.
    pub strings: usize,
    /// Events that were ever added.
    pub events_added: u64,
    /// When the newest sample arrived, taken or not, in ns on the clock of the stream.
    pub last_sample: Option<i64>,
    /// When the newest bytes arrived, likewise.
    pub last_arrival: Option<i64>,
    /// Samples dropped unread.
    pub dropped_samples: u64,
}

impl Lanes {
    /// Lanes of `bound` bytes each. `epoch` is what to add to arrivals for nanoseconds since 1970.
    pub fn new(bound: usize, epoch: i64) -> Self {
        Self {
            bound,
            epoch,
            has_stamped_arrivals: false,
            clocks: BTreeMap::new(),
            samples: VecDeque::new(),
            frames: VecDeque::new(),
            strings: VecDeque::new(),
            string_bytes: 0,
            events: VecDeque::new(),
            event_bytes: 0,
            added: 0,
            is_data_marked: false,
            last_sample: None,
            dropped: Dropped::default(),
        }
    }

    /// Takes the arrival of a sample without device time for its host time: of CAN frames, which an adapter stamps.
    pub fn with_stamped_arrivals(self) -> Self {
        Self { has_stamped_arrivals: true, ..self }
    }

    pub fn add_sample(&mut self, sample: Sample, frame: &[u8]) {
        self.mark();
        self.last_sample = Some(sample.arrival);
        self.frames.extend(frame);
        self.samples.push_back(sample);
        while self.samples.len() > 1 && self.is_over(self.frames.len(), self.samples.len()) {
            self.pop_sample();
            self.dropped.samples += 1;
        }
    }

    pub fn add_string(&mut self, text: Text) {
        self.mark();
        self.string_bytes += text.bytes.len();
        self.strings.push_back(text);
        while self.strings.len() > 1 && self.is_over(self.string_bytes, self.strings.len()) {
            self.pop_string();
            self.dropped.strings += 1;
        }
    }

    pub fn add_event(&mut self, event: Event) {
        if let Event::Message { .. } = event {
            self.is_data_marked = false;
        }
        self.event_bytes += event.size();
        self.added += 1;
        self.events.push_back(event);
        while self.events.len() > 1 && self.is_over(self.event_bytes, self.events.len()) {
            let Some(event) = self.events.pop_front() else { break };
            self.event_bytes -= event.size();
            self.dropped.messages += u64::from(matches!(event, Event::Message { .. }));
        }
    }

    const fn is_over(&self, bytes: usize, entries: usize) -> bool {
        bytes > self.bound || entries > most_entries(self.bound)
    }

    fn mark(&mut self) {
        if !std::mem::replace(&mut self.is_data_marked, true) {
            self.add_event(Event::Data);
        }
    }

    /// Adds [`Event::Data`] before the next sample or string.
    pub const fn mark_data(&mut self) {
        self.is_data_marked = false;
    }

    /// Number of samples that wait.
    pub fn samples(&self) -> usize {
        self.samples.len()
    }

    /// Number of strings that wait.
    pub fn strings(&self) -> usize {
        self.strings.len()
    }

    /// What waits to be taken; the newest bytes arrived at `last_arrival`.
    pub fn waiting(&self, last_arrival: Option<i64>) -> Waiting {
        Waiting {
            samples: self.samples.len(),
            strings: self.strings.len(),
            events_added: self.added,
            last_sample: self.last_sample,
            last_arrival,
            dropped_samples: self.dropped.samples,
        }
    }

    /// Number of events that were ever added.
    pub const fn events_added(&self) -> u64 {
        self.added
    }

    /// Bytes that wait.
    pub fn bytes(&self) -> usize {
        self.frames.len() + self.string_bytes + self.event_bytes
    }

    /// Number of entries dropped unread.
    pub const fn dropped(&self) -> Dropped {
        self.dropped
    }

    /// Removes the oldest sample, and gives it its host time. All samples pass here, in order, so that host times equal those
    /// of a log. They are not computed earlier, because a recording without a reader does not need them.
    fn leave(&mut self) -> Option<Sample> {
        let mut sample = self.samples.pop_front()?;
        let arrival = sample.arrival.saturating_add(self.epoch);
        if sample.moment.seconds.is_nan() {
            if self.has_stamped_arrivals {
                sample.host_time = time::in_seconds(arrival);
            }
        } else {
            let clock = self.clocks.entry(device_of(sample.bid)).or_default();
            sample.host_time = clock.update(sample.moment.seconds, arrival, sample.leads);
        }
        Some(sample)
    }

    fn pop_sample(&mut self) {
        if let Some(sample) = self.leave() {
            self.frames.drain(..sample.length as usize);
        }
    }

    /// Takes the oldest sample, and its frame.
    pub fn take_sample(&mut self) -> Option<(Sample, Vec<u8>)> {
        let sample = self.leave()?;
        Some((sample, self.frames.drain(..sample.length as usize).collect()))
    }

    fn pop_string(&mut self) -> Option<Text> {
        let text = self.strings.pop_front()?;
        self.string_bytes -= text.bytes.len();
        Some(text)
    }

    /// Takes the oldest string.
    pub fn take_string(&mut self) -> Option<Text> {
        self.pop_string()
    }

    /// Takes all events.
    pub fn take_events(&mut self) -> VecDeque<Event> {
        self.event_bytes = 0;
        std::mem::take(&mut self.events)
    }

    /// Takes this number of samples, and the strings before the last of them; or all samples and strings.
    pub fn take_block(&mut self, samples: Option<usize>) -> Block {
        let count = samples.unwrap_or(usize::MAX).min(self.samples.len());
        let taken: Vec<_> = std::iter::from_fn(|| self.leave()).take(count).collect();
        let bytes = taken.iter().map(|sample| sample.length as usize).sum();
        let frames = copied(&self.frames, bytes);
        self.frames.drain(..bytes);
        let end = if samples.is_none() { u64::MAX } else { taken.last().map_or(0, |sample| sample.offset) };
        let before = self.strings.partition_point(|text| text.offset < end);
        let strings: Vec<_> = self.strings.drain(..before).collect();
        self.string_bytes -= strings.iter().map(|text| text.bytes.len()).sum::<usize>();
        let clocks = self.clocks.iter().map(|(bid, clock)| (*bid, clock.clone())).collect();
        Block { frames, samples: taken, strings, clocks }
    }

    /// Takes everything, in the order in which it was received.
    pub fn take_all(&mut self) -> Vec<Item> {
        let mut items = Vec::with_capacity(self.samples.len() + self.strings.len() + self.events.len());
        while let Some((sample, frame)) = self.take_sample() {
            items.push(Item::Sample(sample, frame));
        }
        items.extend(self.strings.drain(..).map(Item::Text));
        self.string_bytes = 0;
        items.extend(self.take_events().into_iter().filter(|event| *event != Event::Data).map(Item::Event));
        items.sort_by_key(Item::offset); // three ascending runs
        items
    }

    /// Removes the samples and strings that wait, and returns how many there were.
    pub fn clear_data(&mut self) -> usize {
        let count = self.samples.len() + self.strings.len();
        while self.leave().is_some() {}
        self.frames.clear();
        self.strings.clear();
        self.string_bytes = 0;
        count
    }
}

/// The first bytes of a queue.
fn copied(bytes: &VecDeque<u8>, count: usize) -> Vec<u8> {
    let (head, tail) = bytes.as_slices();
    let cut = count.min(head.len());
    [&head[..cut], &tail[..count - cut]].concat()
}
