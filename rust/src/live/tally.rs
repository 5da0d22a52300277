//! Counts of what has been received. Only what the counts need is decoded.

use std::collections::BTreeMap;

use crate::clock::{Change, Clocks, Losses, Stamps};
use crate::frame::Frame;
use crate::input::PushBuffer;
use crate::packet::is_well_formed;
use crate::scan::{Damage, Scanner, Step};
use crate::table::{self, data_id};

/// The counts.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Bytes received.
    pub bytes: u64,
    /// Accepted frames.
    pub frames: u64,
    /// MTData2 messages.
    pub samples: u64,
    /// Other messages, malformed ones included.
    pub messages: u64,
    /// MTData2 messages that are empty or that their packets do not fill.
    pub malformed: u64,
    /// String outputs by name; the name of those that the manual does not list is empty.
    pub strings: BTreeMap<&'static str, u64>,
    /// Packets by data identifier without format bits.
    pub quantities: BTreeMap<u16, u64>,
    /// Losses according to the packet counters.
    pub losses: Losses,
    /// Candidates refused by their checksum where a frame was due.
    pub checksum_errors: u64,
    /// Bytes that belong to neither frame nor string.
    pub skipped_bytes: u64,
    /// Error messages (0x42), including replies to commands.
    pub errors: u64,
    /// Warnings (0x43).
    pub warnings: u64,
    /// The last error or warning, in words.
    pub last_error: Option<String>,
}

/// Counts a stream that is received in pieces.
#[derive(Debug)]
pub struct Tally {
    scanner: Scanner,
    undecided: PushBuffer,
    clocks: Clocks,
    counts: Counts,
}

const PACKET_COUNTER: u16 = data_id("packet_counter");

impl Default for Tally {
    fn default() -> Self {
        Self {
            scanner: Scanner::new(table::LONGEST_PAYLOAD),
            undecided: PushBuffer::default(),
            clocks: Clocks::default(),
            counts: Counts::default(),
        }
    }
}

impl Tally {
    /// The counts so far.
    #[must_use]
    pub const fn counts(&self) -> &Counts {
        &self.counts
    }

    /// Bytes that belong to neither frame nor string, including those that no frame or string has followed yet.
    #[must_use]
    pub fn skipped_bytes(&self) -> u64 {
        self.counts.skipped_bytes + self.scanner.refused()
    }

    /// The last bytes, which are not decided yet. They begin with the frame that is incomplete.
    #[must_use]
    pub fn undecided(&self) -> &[u8] {
        self.undecided.window(false).bytes
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

    /// Counts a piece.
    pub fn feed(&mut self, piece: &[u8]) {
        self.counts.bytes += piece.len() as u64;
        self.undecided.push(piece);
        self.decide(false);
    }

    /// Decides the last bytes: the stream has ended or was interrupted.
    pub fn finish(&mut self) {
        self.decide(true);
    }

    fn decide(&mut self, last: bool) {
        let window = self.undecided.window(last);
        loop {
            match self.scanner.step(window) {
                Step::More => break,
                Step::End(damage) => {
                    self.counts.skip(damage);
                    break;
                }
                Step::String { place, damage, .. } => {
                    self.counts.skip(damage);
                    let name = place.map_or("", |place| table::STRINGS[usize::from(place)].name);
                    *self.counts.strings.entry(name).or_default() += 1;
                }
                Step::Frame { at, length, damage } => {
                    self.counts.skip(damage);
                    self.counts.frame(Frame::of(&window.bytes[at..at + length]), &mut self.clocks);
                }
            }
        }
        self.counts.checksum_errors = self.scanner.checksum_errors;
        self.undecided.release(self.scanner.at());
    }
}

impl Counts {
    fn skip(&mut self, damage: Option<Damage>) {
        self.skipped_bytes += damage.map_or(0, |damage| damage.length);
    }

    fn frame(&mut self, frame: Frame<'_>, clocks: &mut Clocks) {
        self.frames += 1;
        if frame.mid == table::MTDATA2 {
            if is_well_formed(frame.payload) {
                return self.sample(frame, clocks);
            }
            self.malformed += 1;
        }
        self.messages += 1;
        if table::restarts(frame.mid) {
            clocks.of(frame.bid).change(Change::Restart);
        }
        match (frame.mid, frame.payload) {
            (table::ERROR, [code, ..]) => {
                self.errors += 1;
                self.last_error = Some(in_words("Error", (*code).into()));
            }
            (table::WARNING, [a, b, c, d, ..]) => {
                self.warnings += 1;
                self.last_error = Some(in_words("Warning", u32::from_be_bytes([*a, *b, *c, *d])));
            }
            _ => {}
        }
    }

    fn sample(&mut self, frame: Frame<'_>, clocks: &mut Clocks) {
        self.samples += 1;
        let mut stamps = Stamps::default();
        for packet in frame.packets().flatten() {
            let id = packet.id & !0xF;
            *self.quantities.entry(id).or_default() += 1;
            if let (PACKET_COUNTER, &[high, low]) = (id, packet.data) {
                stamps.counter = Some(u16::from_be_bytes([high, low]));
            }
        }
        self.losses.add(clocks.of(frame.bid).sample(stamps).lost);
    }
}

fn in_words(message: &str, code: u32) -> String {
    format!("{message} {code}: {}", table::result_text(code).unwrap_or("an undocumented code"))
}
