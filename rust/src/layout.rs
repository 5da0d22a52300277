//! The fast path: messages whose layout is known.
//!
//! A device repeats a handful of layouts: the same identifiers and sizes in the same order. Each is learned once, from a
//! message that the plain path has decoded. From then on a frame is recognised by comparing its fixed bytes under a mask
//! while it is summed, and its position is put on a list. Once the list is long enough, each column takes its packets
//! from all those frames in one loop. What is recognised is exactly what the scanner would accept as plausible, and what
//! the plain path would decode; the tests hold the two against each other.
//!
//! Three things make it fast. The next frame is expected right behind, with the same length, so that nothing waits for a
//! length to be loaded. Frames of one length are told apart by one byte, without a branch. And a column's loop knows its
//! type and its row length.

use rustc_hash::FxHashMap;

use crate::column::{Column, Packets, Progress};
use crate::frame::{self, Frame, PREAMBLE};
use crate::packet::{Form, PACKET_HEADER, packets};
use crate::simd::widest;

/// Frames gathered before the columns take their packets: enough to make the loops worth it, few enough for the frames
/// to stay in the second-level cache.
const BATCH: usize = 1024;
/// Layouts that are learned in all, and those in use at a time. Damage and hostile input breed bogus ones; past this many
/// the plain path does the work.
const MOST_LAYOUTS: usize = 255;
const MOST_IN_USE: usize = 32;
/// Layouts that wait to be seen again.
const MOST_CANDIDATES: usize = 8;
/// How often a layout is seen before it is learned: bogus ones hardly come twice.
const SIGHTINGS: usize = 4;
/// How often one is seen before it replaces others that it disagrees with.
const SIGHTINGS_TO_REPLACE: usize = 64;

/// Bytes that are compared at a time.
const BLOCK: usize = 32;

/// A stretch of a layout.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Block {
    /// The fixed bytes.
    want: [u8; BLOCK],
    /// FF where a byte is fixed.
    mask: [u8; BLOCK],
    /// FF where a byte belongs to the frame at all.
    inside: [u8; BLOCK],
}

/// One packet of a layout: which column takes it, and from where.
#[derive(Clone, Copy, Debug)]
pub struct Move {
    /// Index of the column.
    pub column: usize,
    /// Where the packet's data begin, from the frame's first byte.
    pub offset: usize,
    /// Data identifier as received.
    pub id: u16,
    /// How the data lie; `None` for a packet that is kept as it is.
    pub form: Option<Form>,
}

/// One layout.
#[derive(Clone, Debug)]
pub struct Layout {
    /// Bytes of the frame.
    pub frame: usize,
    /// Bus identifier.
    pub bid: u8,
    /// Those of its packets that columns take.
    pub moves: Vec<Move>,
    blocks: Vec<Block>,
}

impl Layout {
    /// The layout of a frame in standard form that its packets tile.
    fn of(bytes: &[u8], moves: &[Move]) -> Self {
        let mut blocks = vec![Block::default(); bytes.len().div_ceil(BLOCK)];
        let mut fix = |from: usize, length: usize| {
            for at in from..from + length {
                blocks[at / BLOCK].want[at % BLOCK] = bytes[at];
                blocks[at / BLOCK].mask[at % BLOCK] = 0xFF;
            }
        };
        let header = 4;
        fix(0, header);
        for packet in packets(Frame::of(bytes).payload).flatten() {
            let at = header + packet.at;
            fix(at, PACKET_HEADER);
            if let Some(Form::List(head, _)) = packet.reading().map(|it| it.form) {
                fix(at + PACKET_HEADER + head[0].wire.size(), 1); // the count goes with the size
            }
        }
        (0..bytes.len()).for_each(|at| blocks[at / BLOCK].inside[at % BLOCK] = 0xFF);
        Self { frame: bytes.len(), bid: bytes[1], moves: moves.to_vec(), blocks }
    }

    /// Whether `bytes` begin with an intact frame of this layout.
    #[inline(always)]
    fn matches<const N: usize>(&self, bytes: &[[u8; BLOCK]; N]) -> bool {
        let Some(blocks) = self.blocks.first_chunk::<N>() else { return false };
        let (mut off, mut sum) = ([0u8; BLOCK], [0u8; BLOCK]);
        for (bytes, block) in bytes.iter().zip(blocks) {
            for i in 0..BLOCK {
                off[i] |= (bytes[i] ^ block.want[i]) & block.mask[i];
                sum[i] = sum[i].wrapping_add(bytes[i] & block.inside[i]);
            }
        }
        // The preamble is in this sum and the checksum makes up for all the rest.
        off.iter().fold(0, |all, off| all | off) == 0 && frame::sum(&sum) == PREAMBLE
    }
}

/// The layouts of one frame length.
#[derive(Clone, Debug)]
struct Family {
    frame: usize,
    /// The frame length in blocks: so much must be readable.
    blocks: usize,
    /// Position of the byte that tells the members apart.
    tell: usize,
    /// The member to try first, by that byte.
    pick: Box<[u8; 256]>,
    members: Vec<u8>,
}

/// How the layouts in use feed one column.
#[derive(Clone, Debug)]
struct Feed {
    form: Option<Form>,
    /// Where the packet's data begin, by layout; 0 in layouts that lack it.
    offsets: Box<[u16; 256]>,
    /// The same for all layouts in use, if it is.
    common: Option<usize>,
}

/// A layout that has not been seen often enough to be learned.
#[derive(Debug)]
struct Candidate {
    frame: usize,
    moves: Vec<Move>,
    sightings: usize,
}

impl Candidate {
    fn is(&self, bytes: &[u8], moves: &[Move]) -> bool {
        let place = |it: &Move| (it.id, it.offset);
        self.frame == bytes.len() && self.moves.iter().map(place).eq(moves.iter().map(place))
    }
}

/// All layouts that have been learned.
#[derive(Debug, Default)]
pub struct Layouts {
    known: Vec<Layout>,
    candidates: Vec<Candidate>,
    /// Those in use, by frame length.
    families: Vec<Family>,
    /// Family by LEN byte, plus one.
    by_length: Vec<u8>,
    /// The columns that the layouts in use feed.
    feeds: FxHashMap<usize, Feed>,
}

/// Frames of known layouts that wait to be gathered: their positions in the window, and their layouts.
#[derive(Debug)]
pub struct Batch {
    length: usize,
    starts: [usize; BATCH],
    layouts: [u8; BATCH],
}

impl Default for Batch {
    fn default() -> Self {
        Self { length: 0, starts: [0; BATCH], layouts: [0; BATCH] }
    }
}

impl Batch {
    /// Frames on the list.
    #[must_use]
    pub fn len(&self) -> usize {
        self.length
    }

    /// Whether the list is empty.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.length == 0
    }

    /// Whether it is time to gather.
    #[must_use]
    pub fn is_full(&self) -> bool {
        self.length == BATCH
    }

    /// Where each frame begins.
    #[must_use]
    pub fn starts(&self) -> &[usize] {
        &self.starts[..self.length]
    }

    /// The layout of each frame.
    #[must_use]
    pub fn layouts(&self) -> &[u8] {
        &self.layouts[..self.length]
    }

    #[inline(always)]
    fn push(&mut self, start: usize, layout: u8) {
        self.starts[self.length] = start;
        self.layouts[self.length] = layout;
        self.length += 1;
    }

    /// Takes all but the first so many frames off the list.
    pub fn truncate(&mut self, length: usize) {
        self.length = length;
    }
}

impl Layouts {
    /// All layouts, by the number that stands for them.
    #[must_use]
    pub fn into_known(self) -> Vec<Layout> {
        self.known
    }

    /// Learns the layout of an intact, plausible MTData2 frame in standard form, once it has been seen often enough; not
    /// of one that feeds a column twice.
    ///
    /// The layouts in use agree on how each column is fed. One that does not, because the device was configured anew,
    /// replaces them all in the end.
    pub fn learn(&mut self, bytes: &[u8], moves: &[Move]) {
        let is_twice = |(at, it): (usize, &Move)| moves[..at].iter().any(|before| before.column == it.column);
        if moves.iter().enumerate().any(is_twice) {
            return;
        }
        let place = self.candidates.iter().position(|it| it.is(bytes, moves)).unwrap_or_else(|| {
            self.candidates.truncate(MOST_CANDIDATES - 1);
            self.candidates.push(Candidate { frame: bytes.len(), moves: moves.to_vec(), sightings: 0 });
            self.candidates.len() - 1
        });
        self.candidates[..=place].rotate_right(1); // what was seen last goes first
        let candidate = &mut self.candidates[0];
        candidate.sightings += 1;
        let agrees = |it: &Move| self.feeds.get(&it.column).is_none_or(|feed| feed.form == it.form);
        let enough = if moves.iter().all(agrees) { SIGHTINGS } else { SIGHTINGS_TO_REPLACE };
        if candidate.sightings < enough {
            return;
        }
        self.candidates.remove(0);
        if enough == SIGHTINGS_TO_REPLACE {
            self.families.clear();
            self.by_length.clear();
            self.feeds.clear();
        }
        if self.in_use() == MOST_IN_USE {
            return;
        }
        let layout = Layout::of(bytes, moves);
        let number = self.known.iter().position(|known| known.blocks == layout.blocks).unwrap_or(self.known.len());
        if number == MOST_LAYOUTS {
            return;
        }
        if number == self.known.len() {
            self.known.push(layout);
        }
        #[allow(clippy::cast_possible_truncation)] // at most MOST_LAYOUTS
        self.use_layout(number as u8);
    }

    fn use_layout(&mut self, number: u8) {
        self.by_length.resize(256, 0);
        let layout = &self.known[usize::from(number)];
        let length = &mut self.by_length[usize::from(layout.blocks[0].want[3])];
        if *length == 0 {
            self.families.push(Family {
                frame: layout.frame,
                blocks: layout.blocks.len(),
                tell: 0,
                pick: Box::new([number; 256]),
                members: vec![],
            });
            #[allow(clippy::cast_possible_truncation)] // no more families than layouts
            (*length = self.families.len() as u8);
        }
        let family = &mut self.families[usize::from(*length) - 1];
        if !family.members.contains(&number) {
            family.members.push(number);
            family.tell_apart(&self.known);
            self.feed(number);
        }
    }

    /// Notes how a layout that is in use from now on feeds the columns.
    fn feed(&mut self, number: u8) {
        let is_first = self.in_use() == 1;
        for it in &self.known[usize::from(number)].moves {
            let feed = self.feeds.entry(it.column).or_insert_with(|| {
                let common = is_first.then_some(it.offset);
                Feed { form: it.form, offsets: Box::new([0; 256]), common }
            });
            #[allow(clippy::cast_possible_truncation)] // inside a frame in standard form
            (feed.offsets[usize::from(number)] = it.offset as u16);
        }
        for feed in self.feeds.values_mut() {
            let offset = usize::from(feed.offsets[usize::from(number)]);
            feed.common = feed.common.filter(|common| *common == offset);
        }
    }

    /// How many layouts are in use.
    fn in_use(&self) -> usize {
        self.families.iter().map(|it| it.members.len()).sum()
    }

    /// Puts the frames from position `at` on the list, as far as each follows the one before, is intact and has a known
    /// layout; stops at `until` and when the list is full. Returns where it stopped.
    #[inline]
    pub fn run(&self, bytes: &[u8], at: usize, until: usize, batch: &mut Batch) -> usize {
        if self.family(bytes, at).is_none() {
            return at;
        }
        widest!(self: &Layouts, run_here(bytes: &[u8], at: usize, until: usize, batch: &mut Batch) -> usize)
    }

    #[inline(always)]
    fn run_here(&self, bytes: &[u8], mut at: usize, until: usize, batch: &mut Batch) -> usize {
        let mut refused = usize::MAX;
        while let Some(family) = self.family(bytes, at).filter(|it| it.frame != refused) {
            at = match family.blocks {
                1 => self.run_family::<1>(family, bytes, at, until, batch),
                2 => self.run_family::<2>(family, bytes, at, until, batch),
                3 => self.run_family::<3>(family, bytes, at, until, batch),
                4 => self.run_family::<4>(family, bytes, at, until, batch),
                5 => self.run_family::<5>(family, bytes, at, until, batch),
                6 => self.run_family::<6>(family, bytes, at, until, batch),
                7 => self.run_family::<7>(family, bytes, at, until, batch),
                8 => self.run_family::<8>(family, bytes, at, until, batch),
                _ => self.run_family::<9>(family, bytes, at, until, batch),
            };
            refused = family.frame;
            if at >= until || batch.is_full() {
                break;
            }
        }
        at
    }

    #[inline(always)]
    fn run_family<const N: usize>(
        &self,
        family: &Family,
        bytes: &[u8],
        mut at: usize,
        until: usize,
        batch: &mut Batch,
    ) -> usize {
        if let [only] = family.members[..] {
            let layout = &self.known[usize::from(only)];
            while at < until && !batch.is_full() {
                let Some(frame) = bytes.get(at..at + N * BLOCK) else { break };
                (0..N * BLOCK).step_by(64).for_each(|line| prefetch(bytes, at + AHEAD + line));
                let Some(frame) = frame.as_chunks().0.first_chunk::<N>() else { break };
                if !layout.matches::<N>(frame) {
                    break;
                }
                batch.push(at, only);
                at += family.frame;
            }
            return at;
        }
        while at < until && !batch.is_full() {
            let Some(frame) = bytes.get(at..at + N * BLOCK) else { break };
            (0..N * BLOCK).step_by(64).for_each(|line| prefetch(bytes, at + AHEAD + line));
            let mut layout = family.pick[usize::from(frame[family.tell])];
            let Some(frame) = frame.as_chunks().0.first_chunk::<N>() else { break };
            if !self.known[usize::from(layout)].matches::<N>(frame) {
                let other = |member: &&u8| self.known[usize::from(**member)].matches::<N>(frame);
                let Some(&member) = family.members.iter().find(other) else { break };
                layout = member;
            }
            batch.push(at, layout);
            at += family.frame;
        }
        at
    }

    fn family(&self, bytes: &[u8], at: usize) -> Option<&Family> {
        let length = *bytes.get(at + 3)?;
        let number = *self.by_length.get(usize::from(length))?;
        self.families.get(usize::from(number).checked_sub(1)?)
    }

    /// Lets every column take its packets from the frames on the list, in their order.
    pub fn gather(&self, bytes: &[u8], batch: &Batch, columns: &mut [Column], progress: Progress) {
        widest!(self: &Layouts, gather_here(bytes: &[u8], batch: &Batch, columns: &mut [Column], progress: Progress) -> ());
    }

    #[inline(always)]
    fn gather_here(&self, bytes: &[u8], batch: &Batch, columns: &mut [Column], progress: Progress) {
        let (starts, layouts) = (batch.starts(), batch.layouts());
        let first = layouts[0];
        if layouts.iter().fold(true, |all, layout| all & (*layout == first)) {
            for it in &self.known[usize::from(first)].moves {
                columns[it.column].gather(it.form, Packets { bytes, starts, shift: it.offset }, progress);
            }
            return;
        }
        let mut own = [0; BATCH];
        for (&column, feed) in &self.feeds {
            let packets = feed.common.map_or_else(
                || {
                    // Some layouts lack the packet or have it elsewhere. Without a branch, which would be mispredicted.
                    let mut rows = 0;
                    for (start, layout) in starts.iter().zip(layouts) {
                        let offset = usize::from(feed.offsets[usize::from(*layout)]);
                        own[rows] = start + offset;
                        rows += usize::from(offset != 0);
                    }
                    Packets { bytes, starts: &own[..rows], shift: 0 }
                },
                |shift| Packets { bytes, starts, shift },
            );
            columns[column].gather(feed.form, packets, progress);
        }
    }
}

impl Family {
    /// Finds the byte that tells most members apart.
    fn tell_apart(&mut self, known: &[Layout]) {
        let byte = |member: u8, at: usize| {
            let block = &known[usize::from(member)].blocks[at / BLOCK];
            (block.mask[at % BLOCK] != 0).then_some(block.want[at % BLOCK])
        };
        let apart = |at: usize| {
            let mut values: Vec<_> = self.members.iter().map(|&member| byte(member, at)).collect();
            values.sort_unstable();
            values.dedup();
            if values.first() == Some(&None) { 0 } else { values.len() }
        };
        self.tell = (0..self.frame).max_by_key(|&at| (apart(at), std::cmp::Reverse(at))).unwrap_or(0);
        for &member in self.members.iter().rev() {
            if let Some(value) = byte(member, self.tell) {
                self.pick[usize::from(value)] = member;
            }
        }
    }
}

/// How far ahead of the frame at hand the input is fetched.
const AHEAD: usize = 16384;

/// Asks for the cache line at `at`.
#[inline]
fn prefetch(bytes: &[u8], at: usize) {
    #[cfg(target_arch = "x86_64")]
    if let Some(byte) = bytes.get(at) {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: a prefetch reads nothing the program can see, and the address is that of a byte in the slice.
        #[allow(unsafe_code)]
        unsafe {
            _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(byte).cast());
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (bytes, at);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::column::Values;
    use crate::table::MTDATA2;

    /// The loops as they are compiled for every processor, against those for the best that this one has.
    #[test]
    fn both_copies_of_the_code_do_the_same() {
        // Acceleration in every message, the packet counter in every third, a damaged byte in every twentieth.
        let frames = |n: u8| {
            let frame = move |i: u8| {
                let counter: &[u8] = if i.is_multiple_of(3) { &[0x10, 0x20, 0x02, i, i] } else { &[] };
                let acceleration = [[0x40, 0x20, 0x0C].as_slice(), &[i; 12]].concat();
                let payload = [counter, &acceleration].concat();
                let mut bytes = Frame { bid: 0xFF, mid: MTDATA2, payload: &payload }.encode().unwrap();
                bytes[8] ^= u8::from(i % 20 == 19);
                bytes
            };
            (0..n).map(frame).collect::<Vec<_>>()
        };
        let (mut layouts, mut columns) = (Layouts::default(), Vec::new());
        for frame in frames(24) {
            let mut moves = Vec::new();
            for packet in packets(Frame::of(&frame).payload).flatten().collect::<Vec<_>>().iter().rev() {
                let reading = packet.reading();
                let column = usize::from(packet.id == 0x1020);
                columns.resize_with(columns.len().max(column + 1), || Column::new(packet.id, reading.as_ref()));
                let form = reading.map(|it| it.form);
                moves.push(Move { column, offset: 4 + packet.at + PACKET_HEADER, id: packet.id, form });
            }
            if frame::sum(&frame[1..]) == 0 {
                layouts.learn(&frame, &moves);
            }
        }
        assert_eq!(layouts.feeds.len(), 2);

        let bytes = frames(250).concat();
        let progress = Progress { done: 0, total: bytes.len() as u64 };
        let all = |here: bool| {
            let (mut columns, mut batch, mut at, mut ends) = (columns.clone(), Batch::default(), 0, Vec::new());
            while at < bytes.len() {
                at = if here {
                    layouts.run_here(&bytes, at, bytes.len(), &mut batch)
                } else {
                    layouts.run(&bytes, at, bytes.len(), &mut batch)
                };
                ends.push(at);
                at = (at + 1..bytes.len()).find(|&at| bytes[at..].starts_with(&[0xFA, 0xFF])).unwrap_or(bytes.len());
            }
            if here {
                layouts.gather_here(&bytes, &batch, &mut columns, progress);
            } else {
                layouts.gather(&bytes, &batch, &mut columns, progress);
            }
            let bits = columns.into_iter().map(|column| match column.values {
                Values::F32(values) => values.iter().map(|it| it.to_bits()).collect(),
                Values::U16(values) => values.iter().copied().map(u32::from).collect::<Vec<_>>(),
                other => panic!("{other:?}"),
            });
            (ends, batch.starts().to_vec(), batch.layouts().to_vec(), bits.collect::<Vec<_>>())
        };
        let (ends, starts, _, bits) = all(false);
        assert_eq!(all(true), all(false));
        assert!(ends.len() > 10 && starts.len() > 200 && bits[0].len() == 3 * starts.len(), "{ends:?} {starts:?}");
    }
}
