//! Bytes to frames.
//!
//! The checksum has 8 bits: one candidate in 256 passes it by chance. So a frame is accepted if its checksum holds and
//!
//! - it is **plausible**: its bus identifier is FF or 1 to 31; a device sends this message, with a length that its row of
//!   the table allows; an MTData2 payload is filled exactly by packets with sizes that their identifiers allow; or
//! - it is **in step on both sides**: it begins where an accepted frame ended (or where the input begins), and another
//!   frame with a good checksum follows (or the input ends). So messages that the manual does not list are kept.
//!
//! A refused candidate costs one byte: the search continues after its preamble. How the input is cut into pieces does not
//! matter, because an incomplete candidate waits for more bytes. [`plain`] implements the same rules without any
//! optimization.
//!
//! Between frames there may be strings: see [`strings`]. What begins where a string ends is in step, too.
//!
//! The cost is linear for any input, for four reasons: frames in standard form are short; longer stretches are summed as
//! differences of one running sum; the packets of extended candidates are walked on credit, which each byte that the
//! scanner passes pays in; and strings are short and contain no byte that begins another string.

pub mod plain;
mod seam;

pub use seam::Seam;

use crate::frame::{self, EXTENDED, EXTENDED_FROM, Frame, HEADER_SIZE, Header, MAX_PAYLOAD, PREAMBLE, field};
use crate::packet::{PACKET_HEADER, Packet};
use crate::strings::{self, Found};
use crate::table::{self, BARE_STRINGS};

/// Why bytes were refused where a frame was due.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[repr(u8)]
pub enum Reason {
    /// No preamble.
    NoPreamble,
    /// The length in the header exceeds the limit.
    TooLong,
    /// The length in the header exceeds the input.
    Truncated,
    /// The checksum does not hold.
    Checksum,
    /// The checksum holds, but the frame is neither plausible nor in step on both sides.
    Implausible,
}

impl Reason {
    /// All of them, in the order of their numbers.
    pub const ALL: [Self; 5] = [Self::NoPreamble, Self::TooLong, Self::Truncated, Self::Checksum, Self::Implausible];

    /// Its name in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        ["no preamble", "too long", "truncated", "checksum", "implausible"][self as usize]
    }
}

/// A stretch of bytes that is neither frame nor string.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "python", pyo3::pyclass(module = "xbus._core", name = "ScannedDamage", frozen, get_all))]
pub struct Damage {
    /// Where it begins in the input.
    pub offset: u64,
    /// Its bytes.
    pub length: u64,
    /// What was wrong where it begins.
    pub reason: Reason,
}

/// The part of the input that is in memory.
#[derive(Clone, Copy, Debug)]
pub struct Window<'a> {
    /// The bytes.
    pub bytes: &'a [u8],
    /// Where in the input they begin.
    pub offset: u64,
    /// Whether the input ends with them.
    pub last: bool,
}

/// What one step of the scanner found. Positions are those in the window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// A frame, and the damage before it.
    Frame {
        /// Where it begins.
        at: usize,
        /// Its bytes.
        length: usize,
        /// The damage before it.
        damage: Option<Damage>,
    },
    /// A string output, and the damage before it.
    String {
        /// Where it begins.
        at: usize,
        /// Its bytes.
        length: usize,
        /// Its place in [`table::STRINGS`], if the manual lists it.
        place: Option<u8>,
        /// The damage before it.
        damage: Option<Damage>,
    },
    /// More bytes are needed.
    More,
    /// The input has ended, with the damage at its end.
    End(Option<Damage>),
}

/// What a scan finds. Positions are those in the input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Item<'a> {
    /// A frame.
    Frame {
        /// Where it begins.
        offset: u64,
        /// Its fields.
        frame: Frame<'a>,
    },
    /// A string output.
    String {
        /// Where it begins.
        offset: u64,
        /// Its place in [`table::STRINGS`], if the manual lists it.
        place: Option<u8>,
        /// Its bytes, including the end of its line.
        bytes: &'a [u8],
    },
    /// A stretch of bytes that is neither.
    Damage(Damage),
}

/// The frames of an input that is in memory: see [`frames`].
#[derive(Debug)]
pub struct Frames<'a> {
    scanner: Scanner,
    bytes: &'a [u8],
}

/// The frames of `bytes`, each with the position at which it begins. Strings and damaged bytes are skipped.
///
/// ```
/// // GoToConfig, a stray byte, and a sample with a packet counter.
/// let bytes = [0xFA, 0xFF, 0x30, 0x00, 0xD1, 0x00, 0xFA, 0xFF, 0x36, 0x05, 0x10, 0x20, 0x02, 0x00, 0x01, 0x93];
/// let frames: Vec<_> = xbus::frames(&bytes).map(|(offset, frame)| (offset, frame.mid)).collect();
/// assert_eq!(frames, [(6, 0x36)]);
/// ```
#[must_use]
pub fn frames(bytes: &[u8]) -> Frames<'_> {
    Frames { scanner: Scanner::new(MAX_PAYLOAD), bytes }
}

impl<'a> Iterator for Frames<'a> {
    type Item = (usize, Frame<'a>);

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            match self.scanner.step(Window { bytes: self.bytes, offset: 0, last: true }) {
                Step::Frame { at, length, .. } => return Some((at, Frame::of(&self.bytes[at..at + length]))),
                Step::String { .. } => {}
                Step::More | Step::End(_) => return None,
            }
        }
    }
}

/// Finds the frames of an input that is handed over in windows.
#[derive(Debug)]
pub struct Scanner {
    limit: usize,
    at: u64,
    damage: Option<(u64, Reason)>,
    /// Strings without a checksum to look for, as bits of `SetStringOutputType`: those that the caller names, and those
    /// that are enabled according to the device.
    named: u32,
    enabled: u32,
    walk: Walk,
    sums: Sums,
    /// Candidates refused by their checksum where a frame was due.
    pub checksum_errors: u64,
}

/// The decision about a candidate.
enum Verdict {
    Frame(usize),
    String(usize, Option<u8>),
    Refused(Reason),
    Wait,
}

impl Scanner {
    /// A scanner at the beginning of an input. No frame may carry more than `limit` bytes of payload.
    #[must_use]
    pub fn new(limit: usize) -> Self {
        Self {
            limit,
            at: 0,
            damage: None,
            named: 0,
            enabled: 0,
            walk: Walk::default(),
            sums: Sums::default(),
            checksum_errors: 0,
        }
    }

    /// Looks also for these strings, bits of `SetStringOutputType`. Only strings with neither checksum nor line end need
    /// this, and only if no `StringOutputType` of the device in the input says that they are enabled.
    pub fn expect(&mut self, strings: u32) {
        self.named |= strings & BARE_STRINGS;
    }

    /// The strings with neither checksum nor line end that the scanner looks for, as bits.
    #[must_use]
    pub const fn expected(&self) -> u32 {
        self.named | self.enabled
    }

    /// Position in the input of the next byte to judge. The bytes before it are not needed any more.
    #[must_use]
    pub const fn at(&self) -> u64 {
        self.at
    }

    /// Bytes refused since the last frame or string, which no step has reported yet.
    #[must_use]
    pub fn refused(&self) -> u64 {
        self.damage.map_or(0, |(offset, _)| self.at - offset)
    }

    /// A scanner that goes on from the same position with the same knowledge, and leaves this one as it is.
    #[must_use]
    pub fn lookahead(&self) -> Self {
        Self { sums: Sums::default(), ..*self }
    }

    /// Goes on behind this number of bytes, which are frames and strings that another scanner has accepted.
    pub fn pass(&mut self, length: u64) {
        self.go_to(self.at + length);
    }

    /// The next frame or string, if the bytes in the window suffice to find it.
    pub fn step(&mut self, window: Window<'_>) -> Step {
        self.step_with(window, |at| at)
    }

    /// All that can be decided with the bytes of a window, in order.
    pub fn items<'a>(&mut self, window: Window<'a>) -> Vec<Item<'a>> {
        let mut items = vec![];
        loop {
            match self.step(window) {
                Step::More => return items,
                Step::End(damage) => {
                    items.extend(damage.map(Item::Damage));
                    return items;
                }
                Step::Frame { at, length, damage } => {
                    items.extend(damage.map(Item::Damage));
                    let frame = Frame::of(&window.bytes[at..at + length]);
                    items.push(Item::Frame { offset: window.offset + at as u64, frame });
                }
                Step::String { at, length, place, damage } => {
                    items.extend(damage.map(Item::Damage));
                    let bytes = &window.bytes[at..at + length];
                    items.push(Item::String { offset: window.offset + at as u64, place, bytes });
                }
            }
        }
    }

    /// Like [`Self::step`], with a faster way to recognize frames. `known` is called with the position of each preamble, and
    /// returns where the intact, plausible frames end that it recognizes from there on, or the position. The step returns
    /// them as one frame.
    pub fn step_with(&mut self, window: Window<'_>, mut known: impl FnMut(usize) -> usize) -> Step {
        loop {
            #[allow(clippy::cast_possible_truncation)] // a position inside the window
            let at = (self.at - window.offset) as usize;
            let rest = &window.bytes[at..];
            match rest.first() {
                None if window.last => return Step::End(self.end_damage()),
                None => return Step::More,
                Some(&first) => {
                    let verdict = match first {
                        PREAMBLE => match known(at) - at {
                            0 => self.judge(window, at),
                            length => Verdict::Frame(length),
                        },
                        _ => self.judge_string(rest, window.last),
                    };
                    match verdict {
                        Verdict::Wait => return Step::More,
                        Verdict::Refused(reason) => {
                            self.refuse(reason);
                            self.go_to(self.at + self.to_candidate(rest, 1) as u64);
                        }
                        Verdict::Frame(length) => {
                            let damage = self.end_damage();
                            self.learn(&rest[..length]);
                            self.go_to(self.at + length as u64);
                            return Step::Frame { at, length, damage };
                        }
                        Verdict::String(length, place) => {
                            let damage = self.end_damage();
                            self.go_to(self.at + length as u64);
                            return Step::String { at, length, place, damage };
                        }
                    }
                }
            }
        }
    }

    /// Learns from a `StringOutputType` frame which strings are enabled. Several frames, taken as one, are never of that
    /// kind.
    fn learn(&mut self, frame: &[u8]) {
        if frame[field::MID] == table::STRING_OUTPUT_TYPE
            && let Some(enabled) = strings::enabled_strings(Frame::of(frame).payload)
        {
            self.enabled = enabled & BARE_STRINGS;
        }
    }

    fn judge_string(&self, bytes: &[u8], last: bool) -> Verdict {
        if !strings::can_begin(bytes[0], self.expected()) {
            return Verdict::Refused(Reason::NoPreamble);
        }
        match strings::find(bytes, last, self.expected(), self.damage.is_none()) {
            Found::String(length, place) => Verdict::String(length, place),
            Found::Not(reason) => Verdict::Refused(reason),
            Found::Wait => Verdict::Wait,
        }
    }

    /// Where in `bytes`, which begin at the current position, the next candidate is, from `at` on, whose first bytes do not
    /// rule out that it is plausible. After damage only plausible frames are accepted.
    ///
    /// This loop only saves time: [`Self::judge`] would refuse what it skips. Hostile input spends most of its time here.
    fn to_candidate(&self, bytes: &[u8], mut at: usize) -> usize {
        const NEAR: usize = 8; // up to here a plain loop is faster than a search
        let expected = self.expected();
        let next = |bytes: &[u8]| match expected {
            0 => memchr::memchr3(PREAMBLE, b'$', b':', bytes),
            _ => bytes.iter().position(|byte| *byte == PREAMBLE || strings::can_begin(*byte, expected)),
        };
        while at < bytes.len() {
            let near = &bytes[at..bytes.len().min(at + NEAR)];
            let can_begin = |byte: &u8| *byte == PREAMBLE || strings::can_begin(*byte, expected);
            at += match near.iter().position(can_begin) {
                Some(found) => found,
                None => match next(&bytes[at..]) {
                    Some(found) => found,
                    None => break,
                },
            };
            let hopeless = match bytes[at..] {
                [PREAMBLE, bid, table::MTDATA2, EXTENDED, ..] => !is_bid(bid) || !self.walk.can_afford(at as u64),
                [PREAMBLE, bid, ..] => !is_bid(bid),
                [first, second, ..] => strings::is_hopeless(first, second),
                _ => false,
            };
            if !hopeless {
                return at;
            }
            at += 1;
        }
        bytes.len()
    }

    fn go_to(&mut self, to: u64) {
        self.walk.pay(to - self.at);
        self.at = to;
    }

    /// Notes a refusal. The first one after a frame or string starts a stretch of damage, and gives it its reason.
    fn refuse(&mut self, reason: Reason) {
        if self.damage.is_none() {
            self.damage = Some((self.at, reason));
            self.checksum_errors += u64::from(reason == Reason::Checksum);
        }
    }

    fn end_damage(&mut self) -> Option<Damage> {
        self.damage.take().map(|(offset, reason)| Damage { offset, length: self.at - offset, reason })
    }

    /// Judges the candidate at `at`. The decision is the same for any window that has the bytes to make it.
    fn judge(&mut self, window: Window<'_>, at: usize) -> Verdict {
        let bytes = &window.bytes[at..];
        let cut = if window.last { Verdict::Refused(Reason::Truncated) } else { Verdict::Wait };
        let Some(header) = Header::read(bytes) else { return cut };
        if header.payload > self.limit {
            return Verdict::Refused(Reason::TooLong);
        }
        let in_step = self.damage.is_none();
        let is_data = header.mid == table::MTDATA2;
        let mut plausible = is_plausible(&header);
        if !in_step {
            // It must be plausible, which is often ruled out before all of its bytes have been received.
            if !plausible {
                return Verdict::Refused(Reason::Implausible);
            }
            if is_data {
                match self.walk.tiles(self.at, bytes, &header) {
                    Tiling::Whole => {}
                    Tiling::Broken => return Verdict::Refused(Reason::Implausible),
                    Tiling::Cut => return cut,
                }
            }
        }
        let Some(candidate) = bytes.get(..header.frame()) else { return cut };
        if self.sum(window, at + field::BID, at + candidate.len()) != 0 {
            return Verdict::Refused(Reason::Checksum);
        }
        if in_step && plausible && is_data {
            plausible = matches!(self.walk.tiles(self.at, bytes, &header), Tiling::Whole);
        }
        if plausible {
            return Verdict::Frame(candidate.len());
        }
        match self.begins(window, at + candidate.len()) {
            Some(true) => Verdict::Frame(candidate.len()),
            Some(false) => Verdict::Refused(Reason::Implausible),
            None => Verdict::Wait,
        }
    }

    /// Whether a frame with a good checksum or a string begins at `at`, or the input ends there; `None` if more bytes are
    /// needed.
    fn begins(&mut self, window: Window<'_>, at: usize) -> Option<bool> {
        let bytes = &window.bytes[at..];
        let cut = if window.last { Some(bytes.is_empty()) } else { None };
        if bytes.first().is_some_and(|&byte| byte != PREAMBLE) {
            if !strings::can_begin(bytes[0], self.expected()) {
                return Some(false);
            }
            return match strings::find(bytes, window.last, self.expected(), true) {
                Found::String(..) => Some(true),
                Found::Not(_) => Some(false),
                Found::Wait => None,
            };
        }
        let Some(header) = Header::read(bytes) else { return cut };
        if header.payload > self.limit {
            return Some(false);
        }
        if bytes.len() < header.frame() {
            return cut;
        }
        Some(self.sum(window, at + field::BID, at + header.frame()) == 0)
    }

    fn sum(&mut self, window: Window<'_>, from: usize, to: usize) -> u8 {
        // A frame in standard form is short enough to be summed directly.
        const SHORT: usize = HEADER_SIZE + EXTENDED_FROM;
        if to - from <= SHORT { frame::sum(&window.bytes[from..to]) } else { self.sums.between(window, from, to) }
    }
}

/// Whether a device can have this bus identifier.
pub(crate) const fn is_bid(bid: u8) -> bool {
    matches!(bid, frame::MASTER | 1..=31)
}

/// Whether the header is that of a plausible frame.
fn is_plausible(header: &Header) -> bool {
    is_bid(header.bid) && table::device_sends(header.mid, header.payload)
}

enum Tiling {
    Whole,
    Broken,
    Cut,
}

/// Walks the packets of an MTData2 candidate; when more bytes have been received it continues where it stopped.
///
/// A candidate in extended form can have thousands of packets, and hostile input can have a candidate every six bytes. So
/// these packets are walked on credit: each costs 16, and each byte that the scanner passes pays 1, so a packet of a real
/// message pays about what it costs. Only an extended MTData2 right after a long stretch of such input can be refused for
/// lack of credit.
#[derive(Clone, Copy, Debug)]
struct Walk {
    candidate: u64,
    at: usize,
    credit: u64,
}

/// Cost of a packet of an extended candidate.
const PACKET_COST: u64 = 16;
/// Largest credit: enough for the packets of several messages.
const MAX_CREDIT: u64 = PACKET_COST << 16;

impl Default for Walk {
    fn default() -> Self {
        Self { candidate: 0, at: 0, credit: MAX_CREDIT }
    }
}

impl Walk {
    fn pay(&mut self, bytes: u64) {
        self.credit = (self.credit + bytes).min(MAX_CREDIT);
    }

    /// Whether there is credit for a packet after `more` bytes.
    fn can_afford(&self, more: u64) -> bool {
        self.credit + more >= PACKET_COST
    }

    fn tiles(&mut self, candidate: u64, bytes: &[u8], header: &Header) -> Tiling {
        let payload = &bytes[header.size..bytes.len().min(header.size + header.payload)];
        let cost = if header.size > HEADER_SIZE { PACKET_COST } else { 0 };
        // Bytes that others write may have another header now.
        let resumed = self.candidate == candidate && self.at <= header.payload;
        let mut at = if resumed { self.at } else { 0 };
        let tiling = loop {
            let left = header.payload - at;
            if left == 0 {
                break Tiling::Whole;
            }
            if left < PACKET_HEADER {
                break Tiling::Broken;
            }
            // A reader that goes on with a new buffer may have fewer bytes than before.
            let rest = payload.get(at..).unwrap_or_default();
            let Some(&[high, low, size]) = rest.first_chunk() else { break Tiling::Cut };
            let end = at + PACKET_HEADER + usize::from(size);
            if end > header.payload || self.credit < cost {
                break Tiling::Broken;
            }
            let Some(data) = payload.get(at + PACKET_HEADER..end) else { break Tiling::Cut };
            if !(Packet { id: u16::from_be_bytes([high, low]), at, data }).is_sound() {
                break Tiling::Broken;
            }
            self.credit -= cost;
            at = end;
        };
        (self.candidate, self.at) = (candidate, at);
        tiling
    }
}

/// The running sum of the input over the length of two of the longest frames. The sum of a stretch is the difference of two
/// entries, and no byte is added twice.
#[derive(Debug, Default)]
struct Sums {
    /// At `i % RING`: the sum of the bytes from `from` to `i`.
    ring: Vec<u8>,
    /// Position where the sum begins.
    from: u64,
    /// Position up to which it is known.
    upto: u64,
}

/// More than two frames of 65535 bytes of payload.
const RING: usize = 1 << 18;

impl Sums {
    fn between(&mut self, window: Window<'_>, from: usize, to: usize) -> u8 {
        #[allow(clippy::cast_possible_truncation)] // modulo a power of two
        let slot = |position: u64| position as usize % RING;
        let (first, end) = (window.offset + from as u64, window.offset + to as u64);
        if self.ring.is_empty() {
            self.ring = vec![0; RING];
        }
        if first < self.from || first > self.upto {
            (self.from, self.upto) = (first, first);
            self.ring[slot(first)] = 0;
        }
        if end > self.upto {
            #[allow(clippy::cast_possible_truncation)] // a position inside the window
            let known = (self.upto - window.offset) as usize;
            let mut sum = self.ring[slot(self.upto)];
            for (position, byte) in (self.upto + 1..).zip(&window.bytes[known..to]) {
                sum = sum.wrapping_add(*byte);
                self.ring[slot(position)] = sum;
            }
            self.upto = end;
        }
        debug_assert!(self.upto - first < RING as u64);
        self.ring[slot(end)].wrapping_sub(self.ring[slot(first)])
    }
}
