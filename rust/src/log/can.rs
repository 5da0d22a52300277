//! Logs of CAN frames: the frames of one sample instant are a group, and a group is a sample.
//!
//! A device sends the frames of a group one after the other, and the bus orders them: the lowest identifier first. So a
//! group ends where an identifier does not rise. If a device sends its frames in another order, as frames that are
//! recorded behind a gateway may be, a group begins with `SampleTime` or `GroupCounter`. Which of the two holds is
//! counted in the first groups of each device. Where frames are lost, `GroupCounter` and receive times show what else is
//! not one group.
//!
//! Captures and live frames take the same path: see the module `groups`. Nothing of this is in the scanner's terms: the
//! offset of a sample is the index of its first frame, and a frame that is not decoded has a [`Verdict`].

mod columns;
mod groups;

use rustc_hash::FxHashMap;

use super::{Part, Single, Stats, Wanted};
use crate::clock::{Change, Stamps};
use crate::error::CanError;
use crate::table::{CAN_MESSAGES, CanContent, CanMessage, MAX_EXPONENT, Quantity};

use columns::{Columns, coordinates_of};
use groups::{GROUP_COUNTER, Grouper, NO_SAMPLE, Release, SAMPLE_TIME};

/// The bits of an identifier that mark a frame, as in `SocketCAN`.
pub mod flag {
    /// The identifier has 29 bits.
    pub const EXTENDED: u32 = 1 << 31;
    /// A remote frame, which asks for data.
    pub const REMOTE: u32 = 1 << 30;
    /// An error frame of the bus.
    pub const ERROR: u32 = 1 << 29;
}

/// Bytes of the data of a classic CAN frame.
pub const DATA_SIZE: usize = 8;

/// Frames in the order in which they were received.
#[derive(Clone, Copy, Debug)]
pub struct CanFrames<'a> {
    /// When each was received, in seconds.
    pub times: &'a [f64],
    /// The identifier of each, with its [`flag`]s.
    pub ids: &'a [u32],
    /// Bytes of data of each.
    pub sizes: &'a [u8],
    /// The data, padded.
    pub data: &'a [[u8; DATA_SIZE]],
}

impl CanFrames<'_> {
    /// No frames.
    pub const NONE: Self = Self { times: &[], ids: &[], sizes: &[], data: &[] };
}

/// What one identifier is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CanId {
    /// The identifier, with [`flag::EXTENDED`].
    pub id: u32,
    /// Bus identifier that the samples of the device get.
    pub bid: u8,
    /// Code of the message.
    pub code: u8,
}

/// What became of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Verdict {
    /// It is decoded.
    Decoded,
    /// It has more data than its message, which are ignored; the message is decoded.
    Long,
    /// An Error or Warning of a device.
    Event,
    /// No device has its identifier.
    Unknown,
    /// It has less data than its message.
    Short,
    /// Its exponent is out of range.
    Exponent,
    /// No source gives the layout of its message.
    Opaque,
    /// A remote frame.
    Remote,
    /// An error frame of the bus.
    Error,
}

/// A part of a log, and what became of each frame.
#[derive(Debug)]
pub struct CanPart {
    /// The samples.
    pub part: Part,
    /// For each new frame its [`Verdict`].
    pub verdicts: Vec<u8>,
    /// For each sample when its first frame was received, in seconds.
    pub received: Vec<f64>,
}

/// Groups and decodes frames that come in chunks of any size. The parts, joined, do not depend on the chunks.
#[derive(Debug)]
pub struct CanReader {
    grouper: Grouper,
    /// The bus identifiers of the devices, before the first part.
    bids: Vec<u8>,
    samples: u64,
}

impl CanReader {
    /// A reader of the frames of some devices.
    ///
    /// # Errors
    /// If an identifier stands for two messages or has too many bits, or a code does not exist.
    pub fn new(ids: &[CanId]) -> Result<Self, CanError> {
        Ok(Self { grouper: Grouper::new(Table::of(ids)?, Release::InOrder), bids: bids_of(ids), samples: 0 })
    }

    /// Adds frames, and returns the samples that are complete; all of them at the end.
    ///
    /// # Errors
    /// If the arrays differ in length, or there are 2^32 frames.
    pub fn push(&mut self, frames: CanFrames<'_>, is_end: bool) -> Result<CanPart, CanError> {
        let bytes = frames.sizes.iter().map(|size| u64::from(*size)).sum();
        let first = self.samples;
        let bids = std::mem::take(&mut self.bids);
        let (mut part, verdicts) = self.grouper.push(frames, is_end, |table, frames, groups| {
            let mut columns = Columns::default();
            let add = |frame: usize| {
                let (sample, entry) = (groups.samples[frame], table.entry(frames.ids[frame]));
                if let (Some(entry), true) = (entry, sample != NO_SAMPLE) {
                    columns.add(entry.place, first + u64::from(sample), frames.data[frame]);
                }
            };
            if groups.is_ordered {
                (0..groups.samples.len()).for_each(add);
            } else {
                groups.order().into_iter().for_each(add);
            }
            let part = Part {
                first,
                columns: columns.into_columns(),
                layout: vec![0; groups.spans.len()],
                singles: groups.spans.clone(),
                changes: bids.iter().map(|bid| (first, *bid, Change::Can)).collect(),
                ..Part::default()
            };
            CanPart { part, verdicts: vec![], received: groups.received.clone() }
        })?;
        let decoded = verdicts.iter().filter(|verdict| **verdict <= Verdict::Event as u8).count();
        let samples = part.part.len() as u64;
        self.samples += samples;
        part.part.stats = Stats { bytes, frames: decoded as u64, samples, ..Stats::default() };
        Ok(CanPart { verdicts, ..part })
    }
}

fn bids_of(ids: &[CanId]) -> Vec<u8> {
    let mut bids: Vec<u8> = ids.iter().map(|id| id.bid).collect();
    bids.sort_unstable();
    bids.dedup();
    bids
}

/// A message of a device.
#[derive(Clone, Copy, Debug)]
struct Entry {
    /// Place of the device.
    device: usize,
    bid: u8,
    /// Place of the message in the table.
    place: usize,
    /// The order in which the bus sends identifiers.
    priority: u32,
}

impl Entry {
    const fn message(self) -> &'static CanMessage {
        &CAN_MESSAGES[self.place]
    }

    const fn is_header(self) -> bool {
        matches!(self.message().code, SAMPLE_TIME | GROUP_COUNTER)
    }
}

/// The entries by identifier.
#[derive(Debug)]
struct Table {
    entries: Vec<Entry>,
    /// For each identifier of 11 bits the place of its entry plus one.
    standard: Vec<u16>,
    extended: FxHashMap<u32, usize>,
    devices: usize,
}

const STANDARD_IDS: u32 = 1 << 11;
const EXTENDED_IDS: u32 = 1 << 29;

impl Table {
    fn of(ids: &[CanId]) -> Result<Self, CanError> {
        let mut bids = vec![];
        let mut table = Self {
            entries: vec![],
            standard: vec![0; STANDARD_IDS as usize],
            extended: FxHashMap::default(),
            devices: 0,
        };
        for &CanId { id, bid, code } in ids {
            let place = CAN_MESSAGES.iter().position(|message| message.code == code).ok_or(CanError::Code(code))?;
            let device = bids.iter().position(|known| *known == bid).unwrap_or_else(|| {
                bids.push(bid);
                bids.len() - 1
            });
            let number = id & !flag::EXTENDED;
            let is_extended = id != number;
            if number >= if is_extended { EXTENDED_IDS } else { STANDARD_IDS } {
                return Err(CanError::Range(number));
            }
            if table.entry(id).is_some() {
                return Err(CanError::Twice(number));
            }
            // Arbitration compares the first eleven bits, then sends the shorter identifier first.
            let priority = if is_extended { number >> 18 << 19 | 1 << 18 | number & 0x3_FFFF } else { number << 19 };
            table.entries.push(Entry { device, bid, place, priority });
            let entry = table.entries.len();
            if is_extended {
                table.extended.insert(number, entry - 1);
            } else {
                table.standard[number as usize] = u16::try_from(entry).map_err(|_| CanError::TooMany)?;
            }
        }
        table.devices = bids.len();
        Ok(table)
    }

    /// The entry of the frames with this identifier, which are neither remote nor error frames.
    #[inline]
    fn entry(&self, id: u32) -> Option<Entry> {
        if id < STANDARD_IDS {
            let place = usize::from(self.standard[id as usize]);
            return place.checked_sub(1).map(|place| self.entries[place]);
        }
        if id & (flag::EXTENDED | flag::REMOTE | flag::ERROR) != flag::EXTENDED {
            return None;
        }
        self.extended.get(&(id & !flag::EXTENDED)).map(|place| self.entries[*place])
    }
}

fn judge(entry: Option<Entry>, id: u32, size: u8, data: [u8; DATA_SIZE]) -> Verdict {
    let Some(entry) = entry else {
        return match id {
            _ if id & flag::ERROR != 0 => Verdict::Error,
            _ if id & flag::REMOTE != 0 => Verdict::Remote,
            _ => Verdict::Unknown,
        };
    };
    let message = entry.message();
    let needed = message.size();
    match message.content {
        CanContent::Opaque => Verdict::Opaque,
        _ if usize::from(size) < needed => Verdict::Short,
        CanContent::Event => Verdict::Event,
        CanContent::Scaled(_) if data[needed - 1] > MAX_EXPONENT => Verdict::Exponent,
        _ if usize::from(size) > needed => Verdict::Long,
        _ => Verdict::Decoded,
    }
}

/// A sample of live frames.
#[derive(Debug)]
pub struct CanSample<'a> {
    /// Index of its first frame.
    pub offset: u64,
    /// Bus identifier of its device.
    pub bid: u8,
    /// When its first frame was received, in seconds.
    pub received: f64,
    /// Its time stamps.
    pub stamps: Stamps,
    /// Its frames, of [`LIVE_SIZE`] bytes each: the code of the message, and the data with its padding.
    pub frames: &'a [u8],
}

/// Bytes of a frame of a [`CanSample`].
pub const LIVE_SIZE: usize = 1 + DATA_SIZE;

/// Groups live frames. The samples of each device are those of a [`CanReader`]; those of several devices come in the order
/// in which they become complete.
#[derive(Debug)]
pub struct LiveReader {
    grouper: Grouper,
    bids: Vec<u8>,
}

impl LiveReader {
    /// A reader of the frames of some devices.
    ///
    /// # Errors
    /// As [`CanReader::new`].
    pub fn new(ids: &[CanId]) -> Result<Self, CanError> {
        Ok(Self { grouper: Grouper::new(Table::of(ids)?, Release::Complete), bids: bids_of(ids) })
    }

    /// What the clocks of the devices begin with, by bus identifier.
    pub fn changes(&self) -> impl Iterator<Item = (u8, Change)> {
        self.bids.iter().map(|bid| (*bid, Change::Can))
    }

    /// Adds frames, and calls `add` with each sample that is complete.
    ///
    /// # Errors
    /// As [`CanReader::push`].
    pub fn push(
        &mut self,
        frames: CanFrames<'_>,
        is_end: bool,
        mut add: impl FnMut(CanSample<'_>),
    ) -> Result<LiveFrames, CanError> {
        let ((), verdicts) = self.grouper.push(frames, is_end, |table, frames, groups| {
            let order = groups.order();
            let mut bytes = Vec::with_capacity(CAN_MESSAGES.len() * LIVE_SIZE);
            for own in order.chunk_by(|a, b| groups.samples[*a] == groups.samples[*b]) {
                bytes.clear();
                let mut stamps = Stamps::default();
                for &at in own {
                    let (Some(entry), data) = (table.entry(frames.ids[at]), frames.data[at]) else { continue };
                    let code = entry.message().code;
                    bytes.push(code);
                    bytes.extend_from_slice(&data);
                    match code {
                        SAMPLE_TIME => stamps.fine = Some(u32::from_be_bytes([data[0], data[1], data[2], data[3]])),
                        GROUP_COUNTER => stamps.counter = Some(u16::from_be_bytes([data[0], data[1]])),
                        _ => {}
                    }
                }
                let sample = groups.samples[own[0]] as usize;
                let Single { offset, bid, .. } = groups.spans[sample];
                add(CanSample { offset, bid, received: groups.received[sample], stamps, frames: &bytes });
            }
        })?;
        let event = |(at, _): (usize, &u8)| {
            let code = self.grouper.table().entry(frames.ids[at])?.message().code;
            Some(CanEvent { is_error: code == ERROR, code: frames.data[at][0] })
        };
        let is_event = |(_, verdict): &(usize, &u8)| **verdict == Verdict::Event as u8;
        let events = verdicts.iter().enumerate().filter(is_event).filter_map(event).collect();
        Ok(LiveFrames { verdicts, events })
    }
}

/// What became of live frames.
#[derive(Debug, Default)]
pub struct LiveFrames {
    /// The [`Verdict`] of each.
    pub verdicts: Vec<u8>,
    /// The events of devices among them.
    pub events: Vec<CanEvent>,
}

/// An Error or a Warning of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CanEvent {
    /// Whether it is an Error.
    pub is_error: bool,
    /// Its code.
    pub code: u8,
}

impl CanEvent {
    /// The code of an Error: the output buffer overflowed. It is the only documented code.
    pub const OVERFLOW: u8 = 1;
}

/// Code of `Error`.
const ERROR: u8 = 0x01;

/// The quantities of the frames of a [`CanSample`].
pub fn quantities_of(frames: &[u8]) -> impl Iterator<Item = &'static Quantity> {
    messages_of(frames).filter_map(|(place, _)| CAN_MESSAGES[place].content.quantity())
}

/// The messages of the frames of a [`CanSample`], by their places in the table, and their data.
fn messages_of(frames: &[u8]) -> impl Iterator<Item = (usize, [u8; DATA_SIZE])> {
    frames.as_chunks::<LIVE_SIZE>().0.iter().filter_map(|[code, data @ ..]| {
        let place = CAN_MESSAGES.iter().position(|message| message.code == *code)?;
        Some((place, *data))
    })
}

/// Decodes samples of a [`LiveReader`] to a part: for each its bus identifier, offset and frames. `first` is the index of
/// the first one.
pub fn part_of<'a>(first: u64, samples: impl Iterator<Item = (u8, u64, &'a [u8])>, wanted: Option<&Wanted>) -> Part {
    let (mut columns, mut singles) = (Columns::default(), vec![]);
    let mut stats = Stats::default();
    for (bid, offset, frames) in samples {
        let sample = first + singles.len() as u64;
        for (place, data) in messages_of(frames) {
            stats.frames += 1;
            stats.bytes += CAN_MESSAGES[place].size() as u64;
            let is_kept =
                |quantity| wanted.is_none_or(|wanted| super::is_wanted(wanted, quantity, coordinates_of(quantity)));
            if CAN_MESSAGES[place].content.quantity().is_some_and(is_kept) {
                columns.add(place, sample, data);
            }
        }
        singles.push(Single { offset, length: 0, bid });
    }
    stats.samples = singles.len() as u64;
    Part { first, columns: columns.into_columns(), layout: vec![0; singles.len()], singles, stats, ..Part::default() }
}
