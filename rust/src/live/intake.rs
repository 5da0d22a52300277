//! The scan of a live stream. Everything that is known about the stream is found here, once.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use super::lanes::{Event, Lanes, Sample, Text};
use super::recorder::{Mark, Recorder};
use super::{Counts, Piece};
use crate::clock::{Change, Clocks, Stamps};
use crate::frame::{Frame, MASTER, device_of, field};
use crate::input::PushBuffer;
use crate::log::can::{CanEvent, CanSample};
use crate::mtdata::{self, MessageLayout, Output, Outputs};
use crate::packet::{is_well_formed, packets};
use crate::scan::{Damage, Scanner, Step};
use crate::table::{self, LONGEST_PAYLOAD};

/// Scans a stream that is received in pieces, counts what it finds, and gives each sample its device time.
#[derive(Debug)]
pub struct Intake {
    /// Bus identifier of the device whose frames go to the lanes; [`MASTER`] for those of all devices.
    bid: u8,
    scanner: Scanner,
    undecided: PushBuffer,
    /// The pieces of the undecided bytes.
    pieces: VecDeque<Piece>,
    clocks: Clocks,
    counts: Counts,
    /// The settings of `MTData` in force, and the layouts that follow from them, by bus identifier.
    outputs: Outputs,
    mtdata: BTreeMap<u8, Option<Arc<MessageLayout>>>,
    /// Where the messages begin that were handed out before they were decided: positions among the undecided bytes.
    early: BTreeSet<u64>,
    /// Frames and strings of the present piece, for the recorder.
    marks: Vec<Mark>,
}

impl Intake {
    /// An intake at the beginning of a stream. `rate` is as for [`Clocks::new`].
    #[must_use]
    pub fn new(bid: u8, rate: Option<f64>) -> Self {
        Self {
            bid,
            scanner: Scanner::new(LONGEST_PAYLOAD),
            undecided: PushBuffer::default(),
            pieces: VecDeque::new(),
            clocks: Clocks::new(rate),
            counts: Counts::default(),
            outputs: Outputs::default(),
            mtdata: BTreeMap::new(),
            early: BTreeSet::new(),
            marks: vec![],
        }
    }

    /// The counts so far. Damage that no frame or string has followed yet is not in them: see [`Self::skipped_bytes`].
    #[must_use]
    pub const fn counts(&self) -> &Counts {
        &self.counts
    }

    /// Bytes that belong to neither frame nor string, including those that no frame or string has followed yet.
    #[must_use]
    pub fn skipped_bytes(&self) -> u64 {
        self.counts.skipped_bytes + self.scanner.refused()
    }

    /// The strings that the scanner expects: see [`Scanner::expected`].
    #[must_use]
    pub const fn expected(&self) -> u32 {
        self.scanner.expected()
    }

    /// Looks also for these strings: see [`Scanner::expect`].
    pub fn expect(&mut self, strings: u32) {
        self.scanner.expect(strings);
    }

    /// Decodes `MTData` with settings that the caller knows: see [`Outputs::give`].
    pub fn give(&mut self, given: Vec<Output>) {
        self.outputs.give(given);
        self.mtdata.clear();
    }

    /// Handles a request of the host, whose acknowledgement puts settings of `MTData` into force.
    pub fn note_request(&mut self, request: Frame<'_>) {
        self.learn(request);
    }

    fn learn(&mut self, frame: Frame<'_>) {
        if self.outputs.learn(frame) {
            self.mtdata.clear();
        }
    }

    /// Adds a piece that arrives now.
    pub(super) fn feed(&mut self, piece: &[u8], arrival: i64, lanes: &mut Lanes, recorder: Option<&Recorder>) {
        self.counts.bytes += piece.len() as u64;
        self.undecided.push(piece);
        self.pieces.push_back(Piece { end: self.counts.bytes, arrival });
        self.decide(false, lanes, recorder);
    }

    /// Decides the last bytes: the stream has ended or was interrupted.
    pub(super) fn finish(&mut self, lanes: &mut Lanes, recorder: Option<&Recorder>) {
        self.decide(true, lanes, recorder);
    }

    fn decide(&mut self, last: bool, lanes: &mut Lanes, recorder: Option<&Recorder>) {
        let undecided = std::mem::take(&mut self.undecided);
        let window = undecided.window(last);
        self.marks.clear();
        loop {
            let (at, length, damage, place) = match self.scanner.step(window) {
                Step::More => break,
                Step::End(damage) => {
                    self.damage(damage, lanes);
                    break;
                }
                Step::Frame { at, length, damage } => (at, length, damage, None),
                Step::String { at, length, place, damage } => (at, length, damage, Some(place)),
            };
            self.damage(damage, lanes);
            let (offset, bytes) = (window.offset + at as u64, &window.bytes[at..at + length]);
            let arrival = self.arrival(offset + length as u64);
            let is_sample = place.is_none() && self.frame(offset, bytes, arrival, lanes);
            let mid = if place.is_none() { Some(bytes[field::MID]) } else { None };
            self.marks.push(Mark { end: at + length, length, mid, is_sample });
            if let Some(place) = place {
                self.counts.string(place);
                lanes.add_string(Text { offset, arrival, place, bytes: bytes.into() });
            }
        }
        self.counts.checksum_errors = self.scanner.checksum_errors;
        let end = self.scanner.at();
        if let Some(recorder) = recorder {
            #[allow(clippy::cast_possible_truncation)] // a position in the window
            let decided = &window.bytes[..(end - window.offset) as usize];
            recorder.offer(decided, window.offset, &self.pieces, &self.marks);
        }
        self.pieces.drain(..self.pieces.partition_point(|piece| piece.end <= end));
        self.early = self.early.split_off(&end);
        self.undecided = undecided;
        self.undecided.release(end);
    }

    /// When the byte before this position arrived.
    fn arrival(&self, end: u64) -> i64 {
        let at = self.pieces.partition_point(|piece| piece.end < end);
        self.pieces.get(at).map_or(0, |piece| piece.arrival)
    }

    fn damage(&mut self, damage: Option<Damage>, lanes: &mut Lanes) {
        self.counts.damage(damage);
        if let Some(damage) = damage {
            lanes.add_event(Event::Damage(damage));
        }
    }

    /// Counts and hands out a frame; returns whether it is that of a sample.
    fn frame(&mut self, offset: u64, bytes: &[u8], arrival: i64, lanes: &mut Lanes) -> bool {
        let frame = Frame::of(bytes);
        let is_wanted = self.is_wanted(frame.bid);
        let layout = if frame.mid == table::MTDATA { self.mtdata_layout(frame) } else { None };
        let clock = self.clocks.of(frame.bid);
        let items = layout.as_ref().map(|layout| layout.samples[0].1.as_slice());
        if items.is_some() || (frame.mid == table::MTDATA2 && is_well_formed(frame.payload)) {
            let stamps = match items {
                Some(items) => Stamps::read(&mtdata::stamps(frame.payload, items)),
                None => Stamps::read(frame.payload),
            };
            let moment = clock.sample(stamps);
            match items {
                Some(items) => self.counts.sample(items.iter().map(|item| item.id), moment.lost),
                None => self.counts.sample(packets(frame.payload).flatten().map(|packet| packet.id), moment.lost),
            }
            if is_wanted {
                #[allow(clippy::cast_possible_truncation)] // at most 65535 and a header
                let length = bytes.len() as u32;
                let (bid, leads) = (frame.bid, stamps.lead());
                let output = if items.is_some() { self.outputs.of(bid) } else { None };
                let sample = Sample { offset, length, bid, leads, output, arrival, moment, host_time: f64::NAN };
                lanes.add_sample(sample, bytes);
            }
            return true;
        }
        if let Some(change) = Change::of(frame.mid, frame.payload) {
            clock.change(change);
        }
        self.learn(frame);
        self.counts.message(frame);
        if is_wanted && !self.early.contains(&offset) {
            lanes.add_event(Event::Message { offset, bytes: bytes.into() });
        }
        false
    }

    /// The layout of an `MTData` message of one device; `None` if its settings are not known or do not fit, and for an Xbus
    /// Master, which sends for several.
    fn mtdata_layout(&mut self, frame: Frame<'_>) -> Option<Arc<MessageLayout>> {
        let outputs = &self.outputs;
        let layout = self.mtdata.entry(frame.bid).or_insert_with(|| outputs.layout(frame.bid)).clone()?;
        (layout.samples.len() == 1 && layout.fits(frame.payload)).then_some(layout)
    }

    /// The messages in the undecided bytes, as if the stream ended with them. They are not handed out again. The bytes stay
    /// undecided: they may be part of a longer frame.
    pub(super) fn early_messages(&mut self) -> Vec<Event> {
        let undecided = self.undecided.window(true);
        let mut scanner = self.scanner.lookahead();
        let mut found = vec![];
        loop {
            let (at, length) = match scanner.step(undecided) {
                Step::Frame { at, length, .. } => (at, length),
                Step::String { .. } => continue,
                Step::More | Step::End(_) => return found,
            };
            let (offset, bytes) = (undecided.offset + at as u64, &undecided.bytes[at..at + length]);
            let frame = Frame::of(bytes);
            if ![table::MTDATA, table::MTDATA2].contains(&frame.mid)
                && self.is_wanted(frame.bid)
                && self.early.insert(offset)
            {
                found.push(Event::Message { offset, bytes: bytes.into() });
            }
        }
    }

    /// Makes a change to the clock of a device.
    pub(super) fn change(&mut self, bid: u8, change: Change) {
        self.clocks.of(bid).change(change);
    }

    /// Counts frames that arrived on a CAN bus: their bytes, the number of those of devices, and the events among them.
    pub(super) fn can_frames(&mut self, bytes: u64, decoded: u64, events: &[CanEvent]) {
        self.counts.bytes += bytes;
        self.counts.frames += decoded;
        events.iter().for_each(|event| self.counts.can_event(*event));
    }

    /// Counts and hands out a sample of CAN frames, of which the first arrived at `arrival`.
    pub(super) fn can_sample(&mut self, sample: &CanSample<'_>, arrival: i64, lanes: &mut Lanes) {
        let &CanSample { offset, bid, stamps, frames, .. } = sample;
        let moment = self.clocks.of(bid).sample(stamps);
        self.counts.can_sample(frames, moment.lost);
        if self.is_wanted(bid) {
            #[allow(clippy::cast_possible_truncation)] // each message once
            let length = frames.len() as u32;
            let leads = stamps.lead();
            let sample = Sample { offset, length, bid, leads, output: None, arrival, moment, host_time: f64::NAN };
            lanes.add_sample(sample, frames);
        }
    }

    /// Whether frames with this bus identifier are handed out.
    const fn is_wanted(&self, bid: u8) -> bool {
        self.bid == MASTER || bid == MASTER || device_of(bid) == device_of(self.bid)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn early_messages_are_forgotten_when_their_bytes_are_decided() {
        let frame = |mid, payload: &[u8]| Frame { bid: MASTER, mid, payload }.encode().unwrap();
        let (mut intake, mut lanes) = (Intake::new(MASTER, None), Lanes::new(1000, 0));
        // A sample with a packet of an unlisted quantity that holds a message.
        let inside = frame(table::ERROR, &[0]);
        let sample = frame(table::MTDATA2, &[&[0xF0, 0x10, 100][..], &inside, &[0; 94]].concat());
        for piece in [&sample[..50], &sample[50..80]] {
            intake.feed(piece, 0, &mut lanes, None);
            intake.early_messages();
            assert_eq!(intake.early.len(), 1);
        }
        intake.feed(&sample[80..], 0, &mut lanes, None);
        assert!(intake.early.is_empty() && intake.pieces.is_empty() && intake.undecided.window(false).bytes.is_empty());
        assert_eq!((intake.counts().samples, intake.counts().messages), (1, 0));
    }
}
