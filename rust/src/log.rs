//! Logs: frames to samples, samples to columns; other messages, strings and damage beside them.
//!
//! [`Reader`] takes the input in windows of any size and returns what it has decoded as [`Part`]s. The parts of a log, joined,
//! are the log: a part depends on the input before it, never on the input after it.

pub mod can;
mod device;
mod join;
mod parallel;
mod shape;
mod timed;
mod track;
mod unwrap;

use std::io::Read;
use std::sync::Arc;

use rustc_hash::FxHashMap;

use crate::clock::Change;
use crate::column::{Column, Packets, Pieces, Progress};
use crate::error::{Fault, ReadError};
use crate::frame::{EXTENDED, Frame, Header, MAX_PAYLOAD, device_of, field};
use crate::huge_pages;
use crate::input::Stream;
use crate::layout::{Batch, Layout, Layouts, Slot};
use crate::mtdata::{MessageLayout, Output, Outputs};
use crate::packet::{Coordinates, PACKET_HEADER, Packet, Reading, packets};
use crate::scan::{Damage, Scanner, Seam, Step, Window, is_bid};
use crate::table::{self, Quantity};

use shape::Whole;
use track::Track;

pub use parallel::{Blocks, Input};
pub use shape::Shape;
pub use timed::{Span, TimedPart, Times};

/// Quantities to keep, each in one coordinate system or in any.
pub type Wanted = Vec<(&'static Quantity, Option<Coordinates>)>;

/// Options of a reader.
#[derive(Clone, Debug)]
pub struct Options {
    /// Longest payload of a frame, in bytes.
    pub limit: usize,
    /// Stop at the first damage.
    pub strict: bool,
    /// Strings to look for, as bits of `SetStringOutputType`: see [`Scanner::expect`].
    pub strings: u32,
    /// Quantities to keep; `None` for all. Those that clocks and counters need are kept in any case.
    pub wanted: Option<Wanted>,
    /// Whether to keep values. Otherwise rows are only counted, except those that clocks and counters need: see [`Shape`].
    pub values: bool,
    /// Whether to use the fast path. Without it every message takes the plain path, which is the reference of the tests.
    pub fast: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self { limit: MAX_PAYLOAD, strict: false, strings: 0, wanted: None, values: true, fast: true }
    }
}

/// Messages that are not samples, in order.
#[derive(Clone, Debug, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Messages {
    /// Message identifier of each.
    pub mid: Vec<u8>,
    /// Bus identifier of each.
    pub bid: Vec<u8>,
    /// Where its frame begins in the input.
    pub offset: Vec<u64>,
    /// Index of the next sample.
    pub sample: Vec<u64>,
    /// Its payload.
    pub payload: Pieces,
}

/// String outputs, in order.
#[derive(Clone, Debug, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Strings {
    /// Place of each in [`table::STRINGS`], or [`Strings::UNKNOWN`] if the manual does not list it.
    pub place: Vec<u8>,
    /// Where it begins in the input.
    pub offset: Vec<u64>,
    /// Index of the next sample.
    pub sample: Vec<u64>,
    /// Its bytes, including the end of its line.
    pub bytes: Pieces,
}

impl Strings {
    /// The place of a string that the manual does not list.
    pub const UNKNOWN: u8 = u8::MAX;
}

/// Counts of a part.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Stats {
    /// Bytes of input.
    pub bytes: u64,
    /// Accepted frames.
    pub frames: u64,
    /// Samples: MTData2 messages, and MTData messages, of which one has a sample of each tracker of an Xbus Master.
    pub samples: u64,
    /// Other messages, including malformed ones.
    pub messages: u64,
    /// MTData2 messages that are empty or that their packets do not fill.
    pub malformed: u64,
    /// MTData messages whose length does not fit the settings in force, or whose settings are not known.
    pub unfit: u64,
    /// String outputs.
    pub strings: u64,
    /// Bytes that belong to neither frame nor string.
    pub skipped_bytes: u64,
    /// Candidates refused by their checksum where a frame was due.
    pub checksum_errors: u64,
}

/// A sample that the plain path decoded.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Single {
    offset: u64,
    length: u32,
    bid: u8,
}

/// A part of a log, or all of it.
#[derive(Clone, Debug, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Part {
    /// Index of its first sample.
    pub first: u64,
    /// Its columns, in the order in which they were first seen.
    pub columns: Vec<Arc<Column>>,
    /// Its other messages.
    pub messages: Messages,
    /// Its string outputs.
    pub strings: Strings,
    /// The damage that ends in it.
    pub damage: Vec<Damage>,
    /// What was counted.
    pub stats: Stats,
    /// For each sample its layout plus one, or 0 if the plain path decoded it. This byte determines which columns have a
    /// row for the sample, and, together with `jumps`, where its frame is.
    layout: Vec<u8>,
    layouts: Vec<Layout>,
    /// Samples of known layout that do not begin where the sample before ends, and where they begin.
    jumps: Vec<(u64, u64)>,
    singles: Vec<Single>,
    /// Number of samples that have a frame in common with the sample before.
    sharing: u64,
    changes: Vec<(u64, u8, Change)>,
    /// What it knows of its log; `None` for a part that is a log by itself.
    whole: Option<Whole>,
}

impl Part {
    /// Number of samples.
    #[must_use]
    pub fn len(&self) -> usize {
        self.layout.len()
    }

    /// Whether there are no samples.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.layout.is_empty()
    }

    /// The same samples with one of the columns, and without frames, messages, strings and damage.
    ///
    /// # Panics
    /// If there is no such column.
    #[must_use]
    pub fn only(&self, column: usize) -> Self {
        let mut layouts = self.layouts.clone();
        for layout in &mut layouts {
            layout.slots.retain(|slot| slot.column == column);
            layout.slots.iter_mut().for_each(|slot| slot.column = 0);
        }
        Self {
            first: self.first,
            columns: vec![self.columns[column].clone()],
            layout: self.layout.clone(),
            layouts,
            singles: self.singles.clone(),
            whole: self.whole.as_ref().map(|whole| Whole {
                is_dense: whole.is_dense.get(column).copied().into_iter().collect(),
                bids: whole.bids.clone(),
            }),
            ..Self::default()
        }
    }

    /// For each sample the number of rows that `column` has for it.
    pub fn rows<'a>(&'a self, column: &'a Column) -> impl Iterator<Item = usize> + 'a {
        let mut track = Track::new(self, Some(column));
        self.layout.iter().zip(self.first..).map(move |(&layout, sample)| track.rows(layout, sample))
    }

    /// Whether `column` has exactly one row for each sample.
    #[must_use]
    pub fn is_dense(&self, column: &Column) -> bool {
        // A sample of known layout has one row or none. So if those that the plain path decoded have one each, all have.
        let once = column.single.windows(2).all(|pair| pair[0] < pair[1]);
        column.rows == self.len() && column.single.len() == self.singles.len() && once
    }

    /// Whether the column with this index has exactly one row for each sample of the whole log.
    #[must_use]
    pub fn is_dense_in_log(&self, index: usize) -> bool {
        match &self.whole {
            Some(whole) => whole.is_dense.get(index).copied().unwrap_or(false),
            None => self.is_dense(&self.columns[index]),
        }
    }

    /// For each row of `column` its sample, counted from the beginning of the log.
    #[must_use]
    #[allow(clippy::cast_possible_wrap)]
    pub fn samples_of(&self, column: &Column) -> Vec<i64> {
        let mut samples = huge_pages::with_capacity(column.rows);
        if column.single.len() == column.rows {
            // A hostile log has thousands of such columns, for which all samples together would be read too often.
            samples.extend(column.single.iter().map(|sample| *sample as i64));
            return samples;
        }
        if self.is_dense(column) {
            samples.extend((self.first as i64..).take(column.rows));
            return samples;
        }
        for (rows, sample) in self.rows(column).zip(self.first as i64..) {
            for _ in 0..rows {
                samples.push(sample);
            }
        }
        samples
    }

    /// For each sample where its frame begins in the input.
    #[must_use]
    #[allow(clippy::cast_possible_wrap)]
    pub fn offsets(&self) -> Vec<i64> {
        self.per_sample(self.frames().map(|(offset, _)| offset as i64))
    }

    /// For each sample where its frame ends in the input.
    #[must_use]
    #[allow(clippy::cast_possible_wrap)]
    pub fn ends(&self) -> Vec<i64> {
        self.per_sample(self.frames().map(|(offset, length)| (offset + length) as i64))
    }

    fn per_sample<T>(&self, values: impl Iterator<Item = T>) -> Vec<T> {
        let mut all = huge_pages::with_capacity(self.len());
        all.extend(values);
        all
    }

    /// For each sample where its frame begins, and its length.
    fn frames(&self) -> impl Iterator<Item = (u64, u64)> {
        let mut jumps = self.jumps.iter().peekable();
        let mut singles = self.singles.iter();
        let mut next = 0;
        self.layout.iter().zip(self.first..).map(move |(&layout, sample)| {
            if layout == 0 {
                return singles.next().map_or((0, 0), |single| (single.offset, single.length.into()));
            }
            if let Some(&(_, offset)) = jumps.next_if(|&&(jump, _)| jump == sample) {
                next = offset;
            }
            let length = self.layouts[usize::from(layout) - 1].frame_length as u64;
            next += length;
            (next - length, length)
        })
    }

    /// For each sample the bus identifier of its frame.
    #[must_use]
    pub fn bids(&self) -> Vec<u8> {
        self.bid_of_each().collect()
    }

    fn bid_of_each(&self) -> impl Iterator<Item = u8> {
        let mut singles = self.singles.iter();
        self.layout.iter().map(move |layout| match layout {
            0 => singles.next().map_or(0, |single| single.bid),
            _ => self.layouts[usize::from(*layout) - 1].bid,
        })
    }

    /// The devices that sent samples, in the order of their first samples: the bus identifier of the first sample, and the
    /// number of samples.
    #[must_use]
    pub fn devices(&self) -> Vec<(u8, usize)> {
        let mut sent = self.sent_bids().map(device_of);
        let Some(device) = sent.next() else { return vec![] };
        if sent.all(|other| other == device) {
            return self.bid_of_each().next().map(|bid| (bid, self.len())).into_iter().collect();
        }
        let mut devices: Vec<(u8, usize)> = vec![];
        let mut places = [None; 256];
        for bid in self.bid_of_each() {
            let place = *places[usize::from(device_of(bid))].get_or_insert_with(|| {
                devices.push((bid, 0));
                devices.len() - 1
            });
            devices[place].1 += 1;
        }
        devices
    }

    /// The bus identifiers that occur, some more than once.
    fn sent_bids(&self) -> impl Iterator<Item = u8> {
        self.layouts.iter().map(|layout| layout.bid).chain(self.singles.iter().map(|single| single.bid))
    }

    /// For each sample the bus identifier of its device, if the samples of the log are of several devices. That of a device
    /// is the one of its first sample.
    #[must_use]
    pub fn bids_of_several(&self) -> Option<Vec<u8>> {
        let mut first = [None; 256];
        let is_of_one = if let Some(whole) = &self.whole {
            for &bid in &whole.bids {
                first[usize::from(device_of(bid))] = Some(bid);
            }
            whole.bids.len() < 2
        } else {
            let mut devices = self.sent_bids().map(device_of);
            let first = devices.next()?;
            devices.all(|device| device == first)
        };
        if is_of_one {
            return None;
        }
        let mut bids = self.bids();
        for bid in &mut bids {
            *bid = *first[usize::from(device_of(*bid))].get_or_insert(*bid);
        }
        Some(bids)
    }
}

/// Reads a log, window by window.
#[derive(Debug)]
pub struct Reader {
    options: Options,
    scanner: Scanner,
    layouts: Layouts,
    batch: Batch,
    columns: Vec<Column>,
    places: FxHashMap<Key, usize>,
    /// The settings of `MTData` in force, and the layouts that follow from them, by bus identifier.
    outputs: Outputs,
    mtdata: FxHashMap<u8, Option<Arc<MessageLayout>>>,
    /// The packets of the current sample. A field, so that its memory is used again.
    slots: Vec<Slot>,
    part: Part,
    /// Where the part begins in the input.
    began: u64,
    /// Expected bytes of input in the part; 0 if unknown.
    part_bytes: u64,
    checksum_errors: u64,
    /// End of the last frame that was recognized.
    end: u64,
    finished: bool,
}

/// A place between two parts of a log, at which a reader can start.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Place {
    /// What the scanner remembers.
    pub seam: Seam,
    /// Index of the next sample.
    pub sample: u64,
    /// The settings of `MTData` in force.
    pub outputs: Outputs,
}

/// What each column has one of: a quantity in a coordinate system, or an identifier that the tables do not explain.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
enum Key {
    Known(u16, Option<Coordinates>),
    Unknown(u16),
}

/// Whether a reader keeps a quantity of which these are wanted.
fn is_wanted(wanted: &Wanted, quantity: &Quantity, coordinates: Option<Coordinates>) -> bool {
    let includes = |(wanted, system): &(&Quantity, Option<Coordinates>)| {
        wanted.id == quantity.id && (system.is_none() || *system == coordinates)
    };
    quantity.clock.is_some() || wanted.iter().any(includes)
}

impl Reader {
    /// A reader at the beginning of an input. `part_bytes` is the expected size of a part, in bytes of input, or 0 if it is
    /// not known. It only decides how much memory columns reserve.
    #[must_use]
    pub fn new(options: Options, part_bytes: u64) -> Self {
        Self::resume(options, Place::default(), part_bytes)
    }

    /// A reader that goes on from a place in the input: see [`Self::new`].
    #[must_use]
    pub fn resume(options: Options, place: Place, part_bytes: u64) -> Self {
        let Place { seam, sample, outputs } = place;
        let mut scanner = seam.scanner(options.limit);
        scanner.expect(options.strings);
        Self {
            options,
            scanner,
            layouts: Layouts::default(),
            batch: Batch::default(),
            columns: vec![],
            places: FxHashMap::default(),
            outputs,
            mtdata: FxHashMap::default(),
            slots: vec![],
            part: Part { first: sample, ..Part::default() },
            began: seam.at,
            part_bytes,
            checksum_errors: 0,
            end: u64::MAX,
            finished: false,
        }
    }

    /// The present place, if another reader can go on from here: not while bytes are being refused.
    #[must_use]
    pub fn place(&self) -> Option<Place> {
        self.scanner.seam().map(|seam| Place { seam, sample: self.next_sample(), outputs: self.outputs.clone() })
    }

    /// Position in the input. The bytes before it are not needed any more.
    #[must_use]
    pub const fn at(&self) -> u64 {
        self.scanner.at()
    }

    /// Whether the whole input has been read.
    #[must_use]
    pub const fn is_finished(&self) -> bool {
        self.finished
    }

    /// Reads frames from the window, which begins no later than [`Self::at`], until the position reaches `until` or more
    /// bytes are needed.
    ///
    /// # Errors
    /// The first [`Fault`], in strict mode.
    pub fn read(&mut self, window: Window<'_>, until: u64) -> Result<(), Fault> {
        let result = self.read_frames(window, until);
        self.gather(window);
        result
    }

    /// Reads frames from a stream until the position reaches `until` or the stream ends. It returns as soon as the bytes
    /// for that have been received, and reads more only if the ones in the buffer do not suffice.
    ///
    /// # Errors
    /// [`ReadError::Fault`] as [`Self::read`]; [`ReadError::Io`] if the stream cannot be read.
    pub fn read_stream(&mut self, stream: &mut Stream<impl Read>, until: u64) -> Result<(), ReadError> {
        loop {
            self.read(stream.window(), until)?;
            if self.at() >= until || self.finished {
                return Ok(());
            }
            stream.fill(self.at(), until)?;
        }
    }

    fn read_frames(&mut self, window: Window<'_>, until: u64) -> Result<(), Fault> {
        while self.at() < until && !self.finished {
            let waiting = self.batch.len();
            let stop = usize::try_from(until - window.offset).unwrap_or(usize::MAX);
            let known = |at| {
                // The recognized frames in the batch end here because the next one was not recognized.
                let is_refused = waiting > 0 && window.offset + at as u64 == self.end;
                if is_refused { at } else { self.layouts.recognize(window.bytes, at, stop, &mut self.batch) }
            };
            match self.scanner.step_with(window, known) {
                Step::More => break,
                Step::End(damage) => {
                    self.finished = true;
                    self.damage(damage)?;
                }
                Step::String { at, length, place, damage } => {
                    self.damage(damage)?;
                    self.string(place, window.offset + at as u64, &window.bytes[at..at + length]);
                }
                Step::Frame { at, length, damage } if self.batch.len() > waiting => {
                    if let Err(fault) = self.damage(damage) {
                        self.batch.truncate(waiting);
                        return Err(fault);
                    }
                    self.recognized(window, at, length, waiting);
                }
                Step::Frame { at, length, damage } => {
                    self.damage(damage)?;
                    self.gather(window);
                    self.frame(&window.bytes[at..at + length], window.offset + at as u64)?;
                }
            }
        }
        Ok(())
    }

    /// Decodes bytes that are nothing but frames, which a scanner has accepted already.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn read_accepted(&mut self, frames: &[u8]) -> Result<(), Fault> {
        let window = Window { bytes: frames, offset: self.at(), last: false };
        let mut at = 0;
        while at < frames.len() {
            let waiting = self.batch.len();
            let end = self.layouts.recognize(frames, at, frames.len(), &mut self.batch);
            if end > at {
                self.recognized(window, at, end - at, waiting);
                at = end;
                continue;
            }
            self.gather(window);
            let frame = &frames[at..];
            let length = Header::read(frame).map_or(frame.len(), |header| header.frame());
            self.frame(&frame[..length], window.offset + at as u64)?;
            at += length;
        }
        self.gather(window);
        self.scanner.pass(frames.len() as u64);
        Ok(())
    }

    /// The settings of `MTData` in force of a device.
    #[must_use]
    pub fn output(&self, bid: u8) -> Option<Output> {
        self.outputs.of(bid)
    }

    /// Decodes the next `MTData` of a device with these settings.
    pub fn use_output(&mut self, bid: u8, output: Output) {
        if self.outputs.set(bid, output) {
            self.mtdata.clear();
            self.layouts.stop_using_all();
        }
    }

    /// Adds a string that a scanner has accepted already.
    pub fn read_accepted_string(&mut self, place: Option<u8>, bytes: &[u8]) {
        self.string(place, self.at(), bytes);
        self.scanner.pass(bytes.len() as u64);
    }

    fn string(&mut self, place: Option<u8>, offset: u64, bytes: &[u8]) {
        let sample = self.next_sample() + self.batch.len() as u64;
        let strings = &mut self.part.strings;
        huge_pages::push(&mut strings.place, place.unwrap_or(Strings::UNKNOWN));
        huge_pages::push(&mut strings.offset, offset);
        huge_pages::push(&mut strings.sample, sample);
        strings.bytes.push(bytes);
    }

    /// Handles frames that were added to the batch, in which `waiting` frames waited before.
    fn recognized(&mut self, window: Window<'_>, at: usize, length: usize, waiting: usize) {
        let (from, sample) = (window.offset + at as u64, self.next_sample() + waiting as u64);
        if from != self.end {
            let progress = self.progress(from);
            huge_pages::reserve(&mut self.part.jumps, 1, progress);
            self.part.jumps.push((sample, from));
        }
        self.end = from + length as u64;
        if self.batch.is_full() {
            self.gather(window);
        }
    }

    /// Index of the next sample, not counting the frames in the batch.
    fn next_sample(&self) -> u64 {
        self.part.first + self.part.layout.len() as u64
    }

    /// Empties the batch into the columns.
    fn gather(&mut self, window: Window<'_>) {
        if self.batch.is_empty() {
            return;
        }
        let progress = self.progress(window.offset + self.batch.starts()[self.batch.len() - 1] as u64);
        self.layouts.gather(window.bytes, &self.batch, &mut self.columns, progress);
        huge_pages::reserve(&mut self.part.layout, self.batch.len(), progress);
        self.part.layout.extend(self.batch.layouts().iter().map(|layout| layout + 1));
        self.batch.truncate(0);
    }

    fn progress(&self, at: u64) -> Progress {
        Progress { done: at - self.began, total: self.part_bytes }
    }

    fn damage(&mut self, damage: Option<Damage>) -> Result<(), Fault> {
        let Some(damage) = damage else { return Ok(()) };
        let progress = self.progress(damage.offset + damage.length);
        huge_pages::reserve(&mut self.part.damage, 1, progress);
        self.part.damage.push(damage);
        self.part.stats.skipped_bytes += damage.length;
        if self.options.strict {
            return Err(Fault::Damage { offset: damage.offset, reason: damage.reason });
        }
        Ok(())
    }

    /// Decodes one frame on the plain path.
    fn frame(&mut self, bytes: &[u8], offset: u64) -> Result<(), Fault> {
        let frame = Frame::of(bytes);
        if frame.mid == table::MTDATA {
            return self.mtdata(bytes, frame, offset);
        }
        if frame.mid != table::MTDATA2 {
            self.message(frame, offset);
            return Ok(());
        }
        let overrun = packets(frame.payload).find_map(Result::err);
        if frame.payload.is_empty() || overrun.is_some() {
            self.part.stats.malformed += 1;
            self.message(frame, offset);
            if self.options.strict {
                return Err(Fault::Malformed { offset, id: overrun.and_then(|overrun| overrun.id) });
            }
            return Ok(());
        }
        let mut fault = Ok(());
        let mut is_sound = true;
        let packets = packets(frame.payload).flatten().map(|packet| {
            let reading = packet.reading();
            if reading.is_none() && !packet.is_sound() {
                is_sound = false;
                if fault.is_ok() {
                    fault = Err(Fault::Size { offset, id: packet.id, size: packet.data.len() });
                }
            }
            (packet, PACKET_HEADER, reading)
        });
        let slots = self.sample(bytes, frame, offset, packets);
        if is_sound {
            self.learn(bytes, &slots);
        }
        self.slots = slots;
        if self.options.strict { fault } else { Ok(()) }
    }

    /// Decodes an MTData message.
    fn mtdata(&mut self, bytes: &[u8], frame: Frame<'_>, offset: u64) -> Result<(), Fault> {
        let outputs = &self.outputs;
        let layout = self.mtdata.entry(frame.bid).or_insert_with(|| outputs.layout(frame.bid)).clone();
        let expected = layout.as_ref().map(|layout| layout.size);
        let length = frame.payload.len();
        let Some(layout) = layout.filter(|layout| layout.fits(frame.payload)) else {
            self.part.stats.unfit += 1;
            self.message(frame, offset);
            return if self.options.strict { Err(Fault::Unfit { offset, length, expected }) } else { Ok(()) };
        };
        for (bid, items) in &layout.samples {
            let packets = items.iter().map(|item| (item.packet(frame.payload), 0, Some(item.reading)));
            let slots = self.sample(bytes, Frame { bid: *bid, ..frame }, offset, packets);
            if layout.samples.len() == 1 {
                self.learn(bytes, &slots);
            }
            self.slots = slots;
        }
        self.part.sharing += layout.samples.len() as u64 - 1;
        Ok(())
    }

    /// Lets the fast path learn the layout of a sound sample.
    fn learn(&mut self, bytes: &[u8], slots: &[Slot]) {
        if self.options.fast && bytes[field::LEN] != EXTENDED && is_bid(bytes[field::BID]) {
            self.layouts.learn(bytes, slots);
        }
    }

    /// Adds a sample with these packets. With each of them come the bytes of its header, and how to read it. Returns where
    /// the packets are, in memory that is to be used again.
    fn sample<'a>(
        &mut self,
        bytes: &[u8],
        frame: Frame<'a>,
        offset: u64,
        packets: impl Iterator<Item = (Packet<'a>, usize, Option<Reading>)>,
    ) -> Vec<Slot> {
        let sample = self.next_sample();
        let header = bytes.len() - frame.payload.len() - 1;
        let mut slots = std::mem::take(&mut self.slots);
        slots.clear();
        let progress = self.progress(offset);
        for (packet, packet_header, reading) in packets {
            let key = match &reading {
                Some(reading) if !self.is_wanted(reading.quantity, reading.coordinates) => continue,
                Some(reading) => Key::Known(reading.quantity.id, reading.coordinates),
                None => Key::Unknown(packet.id),
            };
            let columns = &mut self.columns;
            let column = *self.places.entry(key).or_insert_with(|| {
                let is_clock = reading.as_ref().is_some_and(|reading| reading.quantity.clock.is_some());
                let counted = !self.options.values && !is_clock;
                huge_pages::leave_room_for(size_of::<Column>());
                columns.push(Column { counted, ..Column::new(packet.id, reading.as_ref()) });
                columns.len() - 1
            });
            let form = reading.as_ref().map(|reading| reading.form);
            slots.push(Slot { column, offset: header + packet.at + packet_header, id: packet.id, form });
            let column = &mut self.columns[column];
            column.admit(packet.id, reading.as_ref(), progress);
            let start = packet.at + packet_header;
            column.gather(form, Packets { bytes: frame.payload, starts: &[start], shift: 0 }, progress);
            huge_pages::push(&mut column.single, sample);
        }
        huge_pages::push(&mut self.part.layout, 0);
        #[allow(clippy::cast_possible_truncation)] // at most 65535 and a header
        huge_pages::push(&mut self.part.singles, Single { offset, length: bytes.len() as u32, bid: frame.bid });
        self.end = u64::MAX;
        slots
    }

    fn is_wanted(&self, quantity: &Quantity, coordinates: Option<Coordinates>) -> bool {
        self.options.wanted.as_ref().is_none_or(|wanted| is_wanted(wanted, quantity, coordinates))
    }

    fn message(&mut self, frame: Frame<'_>, offset: u64) {
        let sample = self.next_sample();
        let messages = &mut self.part.messages;
        huge_pages::push(&mut messages.mid, frame.mid);
        huge_pages::push(&mut messages.bid, frame.bid);
        huge_pages::push(&mut messages.offset, offset);
        huge_pages::push(&mut messages.sample, sample);
        messages.payload.push(frame.payload);
        if self.outputs.learn(frame) {
            self.mtdata.clear();
            self.layouts.stop_using_all();
        }
        if let Some(change) = Change::of(frame.mid, frame.payload) {
            for bid in self.outputs.devices_of(frame.bid) {
                huge_pages::push(&mut self.part.changes, (sample, bid, change));
            }
        }
    }

    /// Returns what has been read since the last call.
    pub fn take(&mut self) -> Part {
        self.columns.iter_mut().for_each(Column::trim);
        self.take_untrimmed()
    }

    /// Like [`Self::take`], for a part that is not kept.
    fn take_untrimmed(&mut self) -> Part {
        let next = Part { first: self.next_sample(), ..Part::default() };
        let mut part = std::mem::replace(&mut self.part, next);
        // Each part learns its layouts again, so that layouts from long ago do not slow down a long log.
        self.places.clear();
        part.columns = self.columns.drain(..).map(Column::shared).collect();
        part.layouts = std::mem::take(&mut self.layouts).into_known();
        part.stats.bytes = self.at() - self.began;
        part.stats.samples = part.layout.len() as u64;
        part.stats.messages = part.messages.mid.len() as u64;
        part.stats.strings = part.strings.place.len() as u64;
        part.stats.frames = part.stats.samples - part.sharing + part.stats.messages;
        part.stats.checksum_errors = self.scanner.checksum_errors - self.checksum_errors;
        self.checksum_errors = self.scanner.checksum_errors;
        self.began = self.at();
        self.end = u64::MAX;
        part
    }
}
