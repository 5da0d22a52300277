//! The fast path: frames whose layout is known.
//!
//! # The idea
//!
//! A device repeats a handful of layouts: messages with the same identifiers and sizes in the same order. [`Layouts`] learns
//! each of them from a message that the plain path has decoded. From then on
//!
//! 1. a frame is *recognized*: its fixed bytes (header, identifiers, sizes) are compared under a mask in the same pass that
//!    sums it, and its position goes into a [`Batch`];
//! 2. when the batch is full, each column *gathers* its packets from all frames of the batch in one loop.
//!
//! One byte per sample, the number of its layout, replaces row indices and presence bitmaps: the samples of a column's rows
//! and the offsets of frames are derived from it on request (see `log::Part`).
//!
//! ```text
//! recognize(bytes, at):                                     gather(batch):
//!   family = by_length[LEN]           layouts of a length     for each column that a layout in use feeds:
//!   while bytes remain, batch not full:                         starts = batch.starts + offset[layout of the frame]
//!     layout = first_guess[bytes[at + discriminator]]           column.gather(starts)    a loop that knows type and width
//!     if fixed bytes differ or sum != 0:
//!       try the other layouts of the family, or stop
//!     batch.push(at, layout)
//!     at += family.frame_length       the next frame is expected to follow, with the same length
//! ```
//!
//! # Invariants
//!
//! - *Fast is plain.* A recognized frame is one that the scanner accepts as plausible, and its columns get exactly what the
//!   plain path would give them. Only intact, plausible MTData2 frames in standard form, whose packets all have sound sizes,
//!   and MTData frames that fit the settings in force are learned; so equal fixed bytes and a good sum imply the rest. When
//!   the settings change, no layout is in use any more. Fuzz targets and property tests compare both.
//! - *The answer does not depend on history.* What is not recognized, for whatever reason (not learned yet, caps reached,
//!   cut by the end of the window), goes through the plain path with the same result. All caps concern speed only.
//! - *A layout feeds a column at most once* (one that would feed it twice is never learned), *and the layouts in use agree on
//!   the [`Form`] in which each column is fed*. So one loop per column and batch suffices. When the device was reconfigured,
//!   the new layouts replace all others once they have been seen often enough.
//! - *Layout numbers are stable*: `known` only grows during a part, because samples refer to it. What is in use can change.
//! - *Frames of a batch lie in one window*, in order. The caller gathers before it moves the window, before it decodes a
//!   frame by itself, and before it takes a part.
//! - *No read outside the window.* A frame is compared in whole blocks, so the plain path decodes a frame at the end of the
//!   window whose last block is not complete.
//!
//! # What makes it fast
//!
//! Figures are from a 2-core x86-64 VM, as ratios to `memcpy` of the input or as changes of the total.
//!
//! - No wait for LEN. To load LEN, compute the next address and load LEN again is a chain of latencies; to expect the previous
//!   length and verify it is not. With the prefetch, scan and checksum alone went from .55 to 1.21.
//! - The tight loop for a family of one layout: 12.6 instead of 18.2 ns a frame.
//! - The prefetch of the input: 30 to 60 %.
//! - The same source compiled a second time for AVX2 and MOVBE (`simd.rs`): 17 % less time.
//! - Rows of three numbers read four at a time (`column.rs`), because registers hold four.
//! - Feeds computed when a layout is learned and not for each batch: 8 % on logs with a rare long message.
//! - Huge pages for large columns (`huge_pages.rs`): first touch at 8 instead of 3 GB/s. It is still a quarter of all time.
//!
//! # What was tried and dropped
//!
//! | what | result |
//! |---|---|
//! | `set_len` instead of `resize` (no zeroing) | 0 to 13 %, but unsafe |
//! | reads without bounds checks | 5 %, but unsafe |
//! | intrinsics: 16-byte shuffles per layout instead of typed loops | .40 in a prototype, .34 to .40 here |
//! | AVX-512; AVX2 intrinsics; non-temporal stores; `prefetchw` | nothing, or a loss |
//! | batches of 256; of 4096 | a loss; 2 to 9 % more in one prototype, nothing here |
//! | other prefetch distances; huge-page alignment of columns; page colouring | nothing, or at most 5 % |
//! | `MADV_POPULATE_WRITE`, a thread that touches output ahead | nothing, or a loss |
//! | x, y and z split while decoding | 5 times slower; Arrow's flat columns are made on request |
//! | two passes, count then fill | .64 to .75 of one pass |
//! | growth by doubling | 35 % slower than one reservation from the pace of the input |
//!
//! `cargo bench --bench decode` measures, and asserts that both paths agree. Measure both versions in turns on one machine:
//! differences between machines are larger than most of these figures.

use rustc_hash::FxHashMap;

use crate::column::{Column, Packets, Progress};
use crate::frame::{self, Frame, HEADER_SIZE, PREAMBLE, field};
use crate::packet::{Form, PACKET_HEADER, packets};
use crate::simd::widest;
use crate::table::MTDATA2;

/// Frames in a batch: enough for long loops, few enough for the frames to stay in the second-level cache.
const BATCH: usize = 1024;
/// Most layouts that a part learns. Damaged and hostile input contains bogus layouts; beyond these limits the plain path
/// decodes.
const MAX_LAYOUTS: usize = 255;
/// Most layouts in use at a time.
const MAX_IN_USE: usize = 32;
/// Most layouts that have been seen, but not often enough.
const MAX_CANDIDATES: usize = 8;
/// Sightings after which a layout is learned. Bogus layouts rarely repeat.
const SIGHTINGS_TO_LEARN: usize = 4;
/// Sightings after which a layout replaces those in use, if it feeds a column in another form.
const SIGHTINGS_TO_REPLACE: usize = 64;

/// Bytes compared at a time.
const BLOCK: usize = 32;
/// How far ahead of the current frame the input is prefetched, in bytes.
const PREFETCH_DISTANCE: usize = 16384;

/// One block of a layout.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Block {
    /// The fixed bytes; the others are 0.
    fixed: [u8; BLOCK],
    /// FF for each fixed byte.
    mask: [u8; BLOCK],
    /// FF for each byte of the frame: the last block is longer than what is left of it.
    inside: [u8; BLOCK],
}

/// One packet of a layout: the column that it feeds, and where its data are.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Slot {
    /// Index of the column.
    pub column: usize,
    /// Where the packet's data begin, in bytes from the start of the frame.
    pub offset: usize,
    /// Data identifier as received.
    pub id: u16,
    /// Form of the data; `None` for a packet that is kept raw.
    #[cfg_attr(feature = "serde", serde(skip))] // only gathering needs it
    pub form: Option<Form>,
}

/// A layout: the fixed bytes of a frame, and its packets.
#[derive(Clone, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Layout {
    /// Bytes of the frame.
    pub frame_length: usize,
    /// Bus identifier.
    pub bid: u8,
    /// The packets that columns keep.
    pub slots: Vec<Slot>,
    #[cfg_attr(feature = "serde", serde(skip))] // only recognition needs them
    blocks: Vec<Block>,
}

impl Layout {
    /// The layout of a frame in standard form: of MTData2, filled by its packets, or of MTData, which has none.
    fn of(bytes: &[u8], slots: &[Slot]) -> Self {
        let mut blocks = vec![Block::default(); bytes.len().div_ceil(BLOCK)];
        let mut fix = |from: usize, length: usize| {
            for at in from..from + length {
                blocks[at / BLOCK].fixed[at % BLOCK] = bytes[at];
                blocks[at / BLOCK].mask[at % BLOCK] = 0xFF;
            }
        };
        fix(0, HEADER_SIZE);
        let frame = Frame::of(bytes);
        let payload = if frame.mid == MTDATA2 { frame.payload } else { &[] };
        for packet in packets(payload).flatten() {
            let at = HEADER_SIZE + packet.at;
            fix(at, PACKET_HEADER);
            if let Some(Form::List(head, _)) = packet.reading().map(|reading| reading.form) {
                fix(at + PACKET_HEADER + head[0].wire.size(), 1); // the size is right for this count of entries only
            }
        }
        (0..bytes.len()).for_each(|at| blocks[at / BLOCK].inside[at % BLOCK] = 0xFF);
        Self { frame_length: bytes.len(), bid: bytes[field::BID], slots: slots.to_vec(), blocks }
    }

    /// Whether `bytes` begin with an intact frame of this layout.
    #[inline(always)]
    fn matches<const N: usize>(&self, bytes: &[[u8; BLOCK]; N]) -> bool {
        let Some(blocks) = self.blocks.first_chunk::<N>() else { return false };
        let (mut difference, mut sum) = ([0u8; BLOCK], [0u8; BLOCK]);
        for (bytes, block) in bytes.iter().zip(blocks) {
            for i in 0..BLOCK {
                difference[i] |= (bytes[i] ^ block.fixed[i]) & block.mask[i];
                sum[i] = sum[i].wrapping_add(bytes[i] & block.inside[i]);
            }
        }
        // All bytes but the preamble sum to 0 in an intact frame.
        difference.iter().fold(0, |all, byte| all | byte) == 0 && frame::sum(&sum) == PREAMBLE
    }
}

/// The layouts in use that have the same frame length.
#[derive(Clone, Debug)]
struct Family {
    frame_length: usize,
    /// The frame length in blocks, rounded up.
    blocks: usize,
    /// Position of the byte in which most members differ.
    discriminator: usize,
    /// The member to try first, by the value of that byte.
    first_guess: Box<[u8; 256]>,
    members: Vec<u8>,
}

/// How the layouts in use feed one column.
#[derive(Clone, Debug)]
struct Feed {
    form: Option<Form>,
    /// Where the packet's data begin, by layout; 0 for layouts without the packet.
    offsets: Box<[u16; 256]>,
    /// The offset, if it is the same in all layouts in use.
    common_offset: Option<usize>,
}

/// A layout that has not been seen often enough to be learned.
#[derive(Debug)]
struct Candidate {
    frame_length: usize,
    slots: Vec<Slot>,
    sightings: usize,
}

impl Candidate {
    fn is(&self, bytes: &[u8], slots: &[Slot]) -> bool {
        self.frame_length == bytes.len() && are_same(&self.slots, slots)
    }
}

/// Whether two layouts of the same length have the same packets.
fn are_same(own: &[Slot], others: &[Slot]) -> bool {
    let key = |slot: &Slot| (slot.id, slot.offset);
    own.iter().map(key).eq(others.iter().map(key))
}

/// All layouts that have been learned.
#[derive(Debug, Default)]
pub struct Layouts {
    known: Vec<Layout>,
    candidates: Vec<Candidate>,
    /// Those in use.
    families: Vec<Family>,
    /// By LEN byte: index of the family plus one, or 0.
    by_length: Vec<u8>,
    /// By column: how the layouts in use feed it.
    feeds: FxHashMap<usize, Feed>,
}

/// Recognized frames that wait to be gathered: their positions in the window, and their layouts.
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
    /// Number of frames.
    #[must_use]
    pub fn len(&self) -> usize {
        self.length
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.length == 0
    }

    /// Whether the frames must be gathered before more are added.
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

    /// Keeps the first `length` frames.
    pub fn truncate(&mut self, length: usize) {
        self.length = length;
    }
}

impl Layouts {
    /// All layouts that have been learned, by their number.
    #[must_use]
    pub fn into_known(self) -> Vec<Layout> {
        self.known
    }

    /// Takes all layouts out of use, because frames that look the same may have other contents from now on.
    pub fn stop_using_all(&mut self) {
        self.candidates.clear();
        self.families.clear();
        self.by_length.clear();
        self.feeds.clear();
    }

    /// The number of a layout, if it is known.
    fn number_of(&self, layout: &Layout) -> Option<usize> {
        let is_same = |known: &Layout| known.blocks == layout.blocks && are_same(&known.slots, &layout.slots);
        self.known.iter().position(is_same)
    }

    /// Counts a sighting of the layout of a frame, and learns the layout if that is enough. The frame must be an intact,
    /// plausible frame in standard form.
    pub fn learn(&mut self, bytes: &[u8], slots: &[Slot]) {
        let is_second = |(at, slot): (usize, &Slot)| slots[..at].iter().any(|before| before.column == slot.column);
        if slots.iter().enumerate().any(is_second) {
            return;
        }
        let place = self.candidates.iter().position(|candidate| candidate.is(bytes, slots)).unwrap_or_else(|| {
            self.candidates.truncate(MAX_CANDIDATES - 1);
            self.candidates.push(Candidate { frame_length: bytes.len(), slots: slots.to_vec(), sightings: 0 });
            self.candidates.len() - 1
        });
        self.candidates[..=place].rotate_right(1); // the most recent first
        let candidate = &mut self.candidates[0];
        candidate.sightings += 1;
        let agrees = |slot: &Slot| self.feeds.get(&slot.column).is_none_or(|feed| feed.form == slot.form);
        let enough = if slots.iter().all(agrees) { SIGHTINGS_TO_LEARN } else { SIGHTINGS_TO_REPLACE };
        if candidate.sightings < enough {
            return;
        }
        self.candidates.remove(0);
        if enough == SIGHTINGS_TO_REPLACE {
            self.families.clear();
            self.by_length.clear();
            self.feeds.clear();
        }
        if self.in_use() == MAX_IN_USE {
            return;
        }
        let layout = Layout::of(bytes, slots);
        let number = self.number_of(&layout).unwrap_or(self.known.len());
        if number == MAX_LAYOUTS {
            return;
        }
        if number == self.known.len() {
            self.known.push(layout);
        }
        #[allow(clippy::cast_possible_truncation)] // at most MAX_LAYOUTS
        self.start_to_use(number as u8);
    }

    /// The number of a layout that another part has learned. `columns` are the places here of that part's columns. `None` if
    /// there are too many layouts.
    pub fn adopt(&mut self, layout: &Layout, columns: &[usize]) -> Option<u8> {
        let number = self.number_of(layout).unwrap_or(self.known.len());
        if number == MAX_LAYOUTS {
            return None;
        }
        if number == self.known.len() {
            let slots = layout.slots.iter().map(|slot| Slot { column: columns[slot.column], ..*slot }).collect();
            self.known.push(Layout { slots, ..layout.clone() });
        }
        u8::try_from(number).ok()
    }

    fn start_to_use(&mut self, number: u8) {
        self.by_length.resize(256, 0);
        let layout = &self.known[usize::from(number)];
        let family = &mut self.by_length[usize::from(layout.blocks[0].fixed[field::LEN])];
        if *family == 0 {
            self.families.push(Family {
                frame_length: layout.frame_length,
                blocks: layout.blocks.len(),
                discriminator: 0,
                first_guess: Box::new([number; 256]),
                members: vec![],
            });
            #[allow(clippy::cast_possible_truncation)] // no more families than layouts
            (*family = self.families.len() as u8);
        }
        let family = &mut self.families[usize::from(*family) - 1];
        if !family.members.contains(&number) {
            family.members.push(number);
            family.choose_discriminator(&self.known);
            self.add_to_feeds(number);
        }
    }

    fn add_to_feeds(&mut self, number: u8) {
        let is_first = self.in_use() == 1;
        for slot in &self.known[usize::from(number)].slots {
            let feed = self.feeds.entry(slot.column).or_insert_with(|| {
                let common_offset = is_first.then_some(slot.offset);
                Feed { form: slot.form, offsets: Box::new([0; 256]), common_offset }
            });
            #[allow(clippy::cast_possible_truncation)] // inside a frame in standard form
            (feed.offsets[usize::from(number)] = slot.offset as u16);
        }
        for feed in self.feeds.values_mut() {
            let offset = usize::from(feed.offsets[usize::from(number)]);
            feed.common_offset = feed.common_offset.filter(|common| *common == offset);
        }
    }

    /// Number of layouts in use.
    fn in_use(&self) -> usize {
        self.families.iter().map(|family| family.members.len()).sum()
    }

    /// Adds the frames from position `at` on to the batch, as long as each begins where the one before ends, is intact and
    /// has a layout in use; stops at `until` and when the batch is full. Returns where it stopped.
    #[inline]
    pub fn recognize(&self, bytes: &[u8], at: usize, until: usize, batch: &mut Batch) -> usize {
        if self.family(bytes, at).is_none() {
            return at;
        }
        widest!(self: &Layouts, recognize_here(bytes: &[u8], at: usize, until: usize, batch: &mut Batch) -> usize)
    }

    #[inline(always)]
    fn recognize_here(&self, bytes: &[u8], mut at: usize, until: usize, batch: &mut Batch) -> usize {
        let mut refused = usize::MAX;
        while let Some(family) = self.family(bytes, at).filter(|family| family.frame_length != refused) {
            at = match family.blocks {
                1 => self.recognize_family::<1>(family, bytes, at, until, batch),
                2 => self.recognize_family::<2>(family, bytes, at, until, batch),
                3 => self.recognize_family::<3>(family, bytes, at, until, batch),
                4 => self.recognize_family::<4>(family, bytes, at, until, batch),
                5 => self.recognize_family::<5>(family, bytes, at, until, batch),
                6 => self.recognize_family::<6>(family, bytes, at, until, batch),
                7 => self.recognize_family::<7>(family, bytes, at, until, batch),
                8 => self.recognize_family::<8>(family, bytes, at, until, batch),
                _ => self.recognize_family::<9>(family, bytes, at, until, batch),
            };
            refused = family.frame_length;
            if at >= until || batch.is_full() {
                break;
            }
        }
        at
    }

    #[inline(always)]
    fn recognize_family<const N: usize>(
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
                (0..N * BLOCK).step_by(64).for_each(|line| prefetch(bytes, at + PREFETCH_DISTANCE + line));
                let Some(frame) = frame.as_chunks().0.first_chunk::<N>() else { break };
                if !layout.matches::<N>(frame) {
                    break;
                }
                batch.push(at, only);
                at += family.frame_length;
            }
            return at;
        }
        while at < until && !batch.is_full() {
            let Some(frame) = bytes.get(at..at + N * BLOCK) else { break };
            (0..N * BLOCK).step_by(64).for_each(|line| prefetch(bytes, at + PREFETCH_DISTANCE + line));
            let mut layout = family.first_guess[usize::from(frame[family.discriminator])];
            let Some(frame) = frame.as_chunks().0.first_chunk::<N>() else { break };
            if !self.known[usize::from(layout)].matches::<N>(frame) {
                let other = |member: &&u8| self.known[usize::from(**member)].matches::<N>(frame);
                let Some(&member) = family.members.iter().find(other) else { break };
                layout = member;
            }
            batch.push(at, layout);
            at += family.frame_length;
        }
        at
    }

    fn family(&self, bytes: &[u8], at: usize) -> Option<&Family> {
        let length = *bytes.get(at + field::LEN)?;
        let number = *self.by_length.get(usize::from(length))?;
        self.families.get(usize::from(number).checked_sub(1)?)
    }

    /// Appends the packets of the frames in the batch to their columns, in order.
    pub fn gather(&self, bytes: &[u8], batch: &Batch, columns: &mut [Column], progress: Progress) {
        widest!(self: &Layouts, gather_here(bytes: &[u8], batch: &Batch, columns: &mut [Column], progress: Progress) -> ());
    }

    #[inline(always)]
    fn gather_here(&self, bytes: &[u8], batch: &Batch, columns: &mut [Column], progress: Progress) {
        let (starts, layouts) = (batch.starts(), batch.layouts());
        let first = layouts[0];
        if layouts.iter().fold(true, |all, layout| all & (*layout == first)) {
            for slot in &self.known[usize::from(first)].slots {
                columns[slot.column].gather(slot.form, Packets { bytes, starts, shift: slot.offset }, progress);
            }
            return;
        }
        let mut data_starts = [0; BATCH];
        for (&column, feed) in &self.feeds {
            let packets = feed.common_offset.map_or_else(
                || {
                    // Some layouts lack the packet or have it elsewhere. A branch would be mispredicted.
                    let mut rows = 0;
                    for (start, layout) in starts.iter().zip(layouts) {
                        let offset = usize::from(feed.offsets[usize::from(*layout)]);
                        data_starts[rows] = start + offset;
                        rows += usize::from(offset != 0);
                    }
                    Packets { bytes, starts: &data_starts[..rows], shift: 0 }
                },
                |shift| Packets { bytes, starts, shift },
            );
            columns[column].gather(feed.form, packets, progress);
        }
    }
}

impl Family {
    /// Finds the byte in which most members differ.
    fn choose_discriminator(&mut self, known: &[Layout]) {
        let byte = |member: u8, at: usize| {
            let block = &known[usize::from(member)].blocks[at / BLOCK];
            (block.mask[at % BLOCK] != 0).then_some(block.fixed[at % BLOCK])
        };
        let distinct = |at: usize| {
            let mut values: Vec<_> = self.members.iter().map(|&member| byte(member, at)).collect();
            values.sort_unstable();
            values.dedup();
            if values.first() == Some(&None) { 0 } else { values.len() }
        };
        let best = (0..self.frame_length).max_by_key(|&at| (distinct(at), std::cmp::Reverse(at)));
        self.discriminator = best.unwrap_or(0);
        for &member in self.members.iter().rev() {
            if let Some(value) = byte(member, self.discriminator) {
                self.first_guess[usize::from(value)] = member;
            }
        }
    }
}

/// Prefetches the cache line at `at`.
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

    /// The loops compiled for every processor, against those compiled for AVX2, if this processor has it.
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
            let mut slots = Vec::new();
            for packet in packets(Frame::of(&frame).payload).flatten().collect::<Vec<_>>().iter().rev() {
                let reading = packet.reading();
                let column = usize::from(packet.id == 0x1020);
                columns.resize_with(columns.len().max(column + 1), || Column::new(packet.id, reading.as_ref()));
                let form = reading.map(|reading| reading.form);
                slots.push(Slot { column, offset: HEADER_SIZE + packet.at + PACKET_HEADER, id: packet.id, form });
            }
            if frame::sum(&frame[1..]) == 0 {
                layouts.learn(&frame, &slots);
            }
        }
        assert_eq!(layouts.feeds.len(), 2);

        let bytes = frames(250).concat();
        let progress = Progress { done: 0, total: bytes.len() as u64 };
        let all = |here: bool| {
            let (mut columns, mut batch, mut at, mut ends) = (columns.clone(), Batch::default(), 0, Vec::new());
            while at < bytes.len() {
                at = if here {
                    layouts.recognize_here(&bytes, at, bytes.len(), &mut batch)
                } else {
                    layouts.recognize(&bytes, at, bytes.len(), &mut batch)
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
                Values::F32(values) => values.iter().map(|value| value.to_bits()).collect(),
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
