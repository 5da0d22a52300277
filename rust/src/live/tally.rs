//! What has come, counted as it comes. Nothing is decoded but what the counts need.

use std::collections::BTreeMap;

use crate::clock::{Clocks, Losses, Stamps};
use crate::frame::Frame;
use crate::packet::packets;
use crate::scan::{Damage, Scanner, Step, Window};
use crate::table::{self, data_id};

/// What was counted.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Bytes that came.
    pub bytes: u64,
    /// Accepted frames.
    pub frames: u64,
    /// MTData2 messages.
    pub samples: u64,
    /// Other messages, malformed ones included.
    pub messages: u64,
    /// MTData2 messages that their packets do not tile, and empty ones.
    pub malformed: u64,
    /// String outputs by name; one that the manual does not list has none.
    pub strings: BTreeMap<&'static str, u64>,
    /// Packets by data identifier, its format bits zero.
    pub quantities: BTreeMap<u16, u64>,
    /// What the packet counters say was lost.
    pub losses: Losses,
    /// Candidates refused by their checksum where a frame was due.
    pub checksum_errors: u64,
    /// Bytes that belong to neither frame nor string.
    pub skipped_bytes: u64,
    /// Error messages (0x42), those that answer a command included.
    pub errors: u64,
    /// Warnings (0x43).
    pub warnings: u64,
    /// The last error or warning, in words.
    pub last_error: Option<String>,
}

/// Counts what comes in pieces.
#[derive(Debug)]
pub struct Tally {
    scanner: Scanner,
    /// The bytes that are not decided yet.
    undecided: Vec<u8>,
    clocks: Clocks,
    counts: Counts,
}

const PACKET_COUNTER: u16 = data_id("packet_counter");

impl Default for Tally {
    fn default() -> Self {
        Self {
            scanner: Scanner::new(table::LONGEST_PAYLOAD),
            undecided: vec![],
            clocks: Clocks::default(),
            counts: Counts::default(),
        }
    }
}

impl Tally {
    /// What was counted so far.
    #[must_use]
    pub const fn counts(&self) -> &Counts {
        &self.counts
    }

    /// Bytes that belong to neither frame nor string, those included that nothing has followed yet.
    #[must_use]
    pub fn skipped_bytes(&self) -> u64 {
        self.counts.skipped_bytes + self.scanner.refused()
    }

    /// The bytes that came last and are not decided yet: they begin with the frame that is under way.
    #[must_use]
    pub fn undecided(&self) -> &[u8] {
        &self.undecided
    }

    /// The strings that are looked for though nothing but their length tells them from noise.
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
        self.undecided.extend_from_slice(piece);
        self.decide(false);
    }

    /// Nothing follows, or nothing that these bytes are part of.
    pub fn finish(&mut self) {
        self.decide(true);
    }

    fn decide(&mut self, last: bool) {
        let offset = self.scanner.at();
        loop {
            let window = Window { bytes: &self.undecided, offset, last };
            match self.scanner.step(window) {
                Step::More => break,
                Step::End(damage) => {
                    self.counts.skip(damage);
                    break;
                }
                Step::String { place, damage, .. } => {
                    self.counts.skip(damage);
                    let name = place.map_or("", |it| table::STRINGS[usize::from(it)].name);
                    *self.counts.strings.entry(name).or_default() += 1;
                }
                Step::Frame { at, length, damage } => {
                    self.counts.skip(damage);
                    self.counts.frame(Frame::of(&self.undecided[at..at + length]), &mut self.clocks);
                }
            }
        }
        self.counts.checksum_errors = self.scanner.checksum_errors;
        #[allow(clippy::cast_possible_truncation)] // a position in what is undecided
        self.undecided.drain(..(self.scanner.at() - offset) as usize);
    }
}

impl Counts {
    fn skip(&mut self, damage: Option<Damage>) {
        self.skipped_bytes += damage.map_or(0, |it| it.length);
    }

    fn frame(&mut self, frame: Frame<'_>, clocks: &mut Clocks) {
        self.frames += 1;
        if frame.mid == table::MTDATA2 {
            if !frame.payload.is_empty() && packets(frame.payload).all(|it| it.is_ok()) {
                return self.sample(frame, clocks);
            }
            self.malformed += 1;
        }
        self.messages += 1;
        if table::restarts(frame.mid) {
            clocks.of(frame.bid).restart();
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
        for packet in packets(frame.payload).flatten() {
            let id = packet.id & !0xF;
            *self.quantities.entry(id).or_default() += 1;
            if let (PACKET_COUNTER, &[high, low]) = (id, packet.data) {
                stamps.counter = Some(u16::from_be_bytes([high, low]));
            }
        }
        clocks.of(frame.bid).sample(stamps, &mut self.losses);
    }
}

fn in_words(message: &str, code: u32) -> String {
    format!("{message} {code}: {}", table::result_text(code).unwrap_or("a code that no source explains"))
}
