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
//! type, its row length and mostly also where in the frame its packets lie.

use crate::column::{Column, Packets, Progress};
use crate::frame::{self, PREAMBLE};
use crate::packet::{Form, PACKET_HEADER, Reading};

/// Frames gathered before the columns take their packets: enough to make the loops worth it, few enough for the frames
/// to stay in the first-level cache.
const BATCH: usize = 256;
/// Layouts that are learned. Damage and hostile input breed bogus ones; past this many the plain path does the work.
const MOST_LAYOUTS: usize = 255;

/// Sixteen bytes of a layout.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Block {
    /// The fixed bytes.
    want: [u8; 16],
    /// FF where a byte is fixed.
    mask: [u8; 16],
    /// FF where a byte belongs to the frame at all.
    inside: [u8; 16],
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
    /// How the data are read; `None` for a packet that is kept as it is.
    pub reading: Option<Reading>,
}

impl Move {
    fn form(&self) -> Option<Form> {
        self.reading.map(|reading| reading.form)
    }
}

/// One layout.
#[derive(Clone, Debug)]
pub struct Layout {
    /// Bytes of the frame.
    pub frame: usize,
    /// Bus identifier.
    pub bid: u8,
    /// Its packets.
    pub moves: Vec<Move>,
    blocks: Vec<Block>,
}

impl Layout {
    fn of(bytes: &[u8], moves: Vec<Move>) -> Self {
        let mut blocks = vec![Block::default(); bytes.len().div_ceil(16)];
        let mut fix = |at: usize, byte: u8| {
            blocks[at / 16].want[at % 16] = byte;
            blocks[at / 16].mask[at % 16] = 0xFF;
        };
        bytes[..4].iter().enumerate().for_each(|(at, byte)| fix(at, *byte));
        for packet in &moves {
            for at in packet.offset - PACKET_HEADER..packet.offset {
                fix(at, bytes[at]);
            }
            if let Some(Form::List(head, _)) = packet.form() {
                let count = packet.offset + head[0].wire.size(); // it goes with the size
                fix(count, bytes[count]);
            }
        }
        (0..bytes.len()).for_each(|at| blocks[at / 16].inside[at % 16] = 0xFF);
        Self { frame: bytes.len(), bid: bytes[1], moves, blocks }
    }

    /// Whether `bytes`, rounded up to whole blocks, begin with an intact frame of this layout.
    #[inline]
    fn matches(&self, bytes: &[u8]) -> bool {
        let (mut off, mut sum) = ([0u8; 16], [0u8; 16]);
        for (bytes, block) in bytes.as_chunks::<16>().0.iter().zip(&self.blocks) {
            for i in 0..16 {
                off[i] |= (bytes[i] ^ block.want[i]) & block.mask[i];
                sum[i] = sum[i].wrapping_add(bytes[i] & block.inside[i]);
            }
        }
        // The preamble is in this sum and the checksum makes up for all the rest.
        off == [0; 16] && frame::sum(&sum) == PREAMBLE
    }
}

/// The layouts of one frame length.
#[derive(Clone, Debug)]
struct Family {
    frame: usize,
    /// The frame length in whole blocks: what must be readable.
    padded: usize,
    /// Position of the byte that tells the members apart.
    tell: usize,
    /// The member to try first, by that byte.
    pick: Box<[u8; 256]>,
    members: Vec<u8>,
}

/// All layouts that have been learned.
#[derive(Debug, Default)]
pub struct Layouts {
    known: Vec<Layout>,
    /// Those in use, by frame length.
    families: Vec<Family>,
    /// Family by LEN byte, plus one.
    by_length: Vec<u8>,
}

/// Frames of known layouts that wait to be gathered: their positions in the window, and their layouts.
#[derive(Debug, Default)]
pub struct Batch {
    starts: Vec<usize>,
    layouts: Vec<u8>,
}

impl Batch {
    /// Frames on the list.
    #[must_use]
    pub fn len(&self) -> usize {
        self.starts.len()
    }

    /// Whether the list is empty.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.starts.is_empty()
    }

    /// Whether it is time to gather.
    #[must_use]
    pub fn is_full(&self) -> bool {
        self.starts.len() >= BATCH
    }

    /// The layout of each frame.
    #[must_use]
    pub fn layouts(&self) -> &[u8] {
        &self.layouts
    }

    /// Empties the list.
    pub fn clear(&mut self) {
        self.starts.clear();
        self.layouts.clear();
    }
}

impl Layouts {
    /// All layouts, by the number that stands for them.
    #[must_use]
    pub fn known(&self) -> &[Layout] {
        &self.known
    }

    /// Learns the layout of an intact, plausible MTData2 frame in standard form that feeds no column twice.
    ///
    /// The layouts in use agree on how each column is fed. One that does not, because the device was configured anew,
    /// replaces them all.
    pub fn learn(&mut self, bytes: &[u8], moves: Vec<Move>) {
        let layout = Layout::of(bytes, moves);
        let number = self.known.iter().position(|known| known.blocks == layout.blocks).unwrap_or(self.known.len());
        if number == MOST_LAYOUTS {
            return;
        }
        if number == self.known.len() {
            self.known.push(layout);
        }
        let in_use: Vec<u8> = self.families.iter().flat_map(|family| family.members.iter().copied()).collect();
        #[allow(clippy::cast_possible_truncation)] // at most MOST_LAYOUTS
        let number = number as u8;
        if in_use.iter().any(|&other| self.disagree(number, other)) {
            self.families.clear();
            self.by_length.clear();
        }
        self.use_layout(number);
    }

    fn disagree(&self, one: u8, other: u8) -> bool {
        let [one, other] = [one, other].map(|number| &self.known[usize::from(number)]);
        one.moves.iter().any(|a| other.moves.iter().any(|b| a.column == b.column && a.form() != b.form()))
    }

    fn use_layout(&mut self, number: u8) {
        self.by_length.resize(256, 0);
        let layout = &self.known[usize::from(number)];
        let length = &mut self.by_length[usize::from(layout.blocks[0].want[3])];
        if *length == 0 {
            self.families.push(Family {
                frame: layout.frame,
                padded: layout.blocks.len() * 16,
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
        }
    }

    /// Puts the frames from position `at` on the list, as far as each follows the one before, is intact and has a known
    /// layout; stops at `until` and when the list is full. Returns where it stopped.
    pub fn run(&self, bytes: &[u8], mut at: usize, until: usize, batch: &mut Batch) -> usize {
        while let Some(family) = self.family(bytes, at) {
            let before = at;
            while at < until && !batch.is_full() {
                let Some(frame) = bytes.get(at..at + family.padded) else { break };
                prefetch(bytes, at + AHEAD);
                let mut layout = family.pick[usize::from(frame[family.tell])];
                if !self.known[usize::from(layout)].matches(frame) {
                    let other = |member: &&u8| self.known[usize::from(**member)].matches(frame);
                    let Some(&member) = family.members.iter().find(other) else { break };
                    layout = member;
                }
                batch.starts.push(at);
                batch.layouts.push(layout);
                at += family.frame;
            }
            if at == before {
                break;
            }
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
        let mut seen: Vec<u8> = Vec::new();
        for &layout in &batch.layouts {
            if seen.last() != Some(&layout) && !seen.contains(&layout) {
                seen.push(layout);
            }
        }
        let moves = || seen.iter().flat_map(|&layout| self.known[usize::from(layout)].moves.iter().map(move |it| (layout, it)));
        let mut starts = Vec::new();
        let mut fed = Vec::new();
        for (_, first) in moves() {
            if fed.contains(&first.column) {
                continue;
            }
            fed.push(first.column);
            let column = &mut columns[first.column];
            let mut offsets = [0usize; 256];
            let mut uniform = true;
            let mut feeders = 0;
            for (layout, it) in moves().filter(|(_, it)| it.column == first.column) {
                column.admit(it.id, it.reading.as_ref());
                offsets[usize::from(layout)] = it.offset;
                uniform &= it.offset == first.offset;
                feeders += 1;
            }
            let packets = if uniform && feeders == seen.len() {
                Packets { bytes, starts: &batch.starts, shift: first.offset }
            } else {
                // Some layouts lack the packet or have it elsewhere: make a list of its own, without a branch to mispredict.
                starts.clear();
                starts.resize(batch.len() + 1, 0);
                let mut rows = 0;
                for (start, layout) in batch.starts.iter().zip(&batch.layouts) {
                    let offset = offsets[usize::from(*layout)];
                    starts[rows] = start + offset;
                    rows += usize::from(offset != 0);
                }
                Packets { bytes, starts: &starts[..rows], shift: 0 }
            };
            column.gather(first.form(), packets, progress);
        }
    }
}

impl Family {
    /// Finds the byte that tells most members apart.
    fn tell_apart(&mut self, known: &[Layout]) {
        let byte = |member: u8, at: usize| {
            let block = &known[usize::from(member)].blocks[at / 16];
            (block.mask[at % 16] != 0).then_some(block.want[at % 16])
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
const AHEAD: usize = 4096;

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
