//! Logs of CAN frames: the frames of one sample instant are a group, and a group is a sample.
//!
//! A device sends the frames of a group one after the other, and the bus orders them: the lowest identifier first. So a
//! group ends where an identifier does not rise. If a device sends its frames in another order, as frames that are
//! recorded behind a gateway may be, a group begins with `SampleTime` or `GroupCounter`. Which of the two holds is
//! counted before the frames are grouped.
//!
//! Nothing of this is in the scanner's terms: the offset of a sample is the index of its first frame, and a frame that
//! is not decoded has a [`Verdict`].

use std::sync::Arc;

use rustc_hash::FxHashMap;

use super::{Part, Single, Stats};
use crate::clock::Change;
use crate::column::{Column, Subject, Values};
use crate::error::CanError;
use crate::huge_pages;
use crate::packet::{Coordinates, Precision, record_size};
use crate::table::{CAN_MESSAGES, CanContent, CanMessage, Kind, MAX_EXPONENT, Quantity, Series, Wire};

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
/// Code of `SampleTime`.
const SAMPLE_TIME: u8 = 0x05;
/// Code of `GroupCounter`.
const GROUP_COUNTER: u8 = 0x06;

/// The frames of a capture, in order.
#[derive(Clone, Copy, Debug)]
pub struct CanFrames<'a> {
    /// The identifier of each, with its [`flag`]s.
    pub ids: &'a [u32],
    /// Bytes of data of each.
    pub sizes: &'a [u8],
    /// The data, padded.
    pub data: &'a [[u8; DATA_SIZE]],
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

/// A log, and what became of each frame.
#[derive(Debug)]
pub struct CanLog {
    /// The log.
    pub part: Part,
    /// For each frame its [`Verdict`].
    pub verdicts: Vec<u8>,
}

/// Groups and decodes frames.
///
/// # Errors
/// If the arrays differ in length, an identifier stands for two messages, a code does not exist, or there are 2^32 frames.
pub fn read_can(frames: CanFrames<'_>, ids: &[CanId]) -> Result<CanLog, CanError> {
    let count = frames.ids.len();
    if frames.sizes.len() != count || frames.data.len() != count {
        return Err(CanError::Lengths);
    }
    if count >= NO_SAMPLE as usize {
        return Err(CanError::TooMany);
    }
    let table = Table::of(ids)?;
    let groups = Groups::of(frames, &table);
    let mut columns = Columns { columns: vec![], places: [None; CAN_MESSAGES.len()] };
    let add = |frame: usize| {
        let (sample, entry) = (groups.samples[frame], table.entry(frames.ids[frame]));
        if let (Some(entry), true) = (entry, sample != NO_SAMPLE) {
            columns.add(entry, sample.into(), frames.data[frame]);
        }
    };
    if groups.is_ordered {
        (0..count).for_each(add);
    } else {
        groups.order().into_iter().for_each(add);
    }
    let decoded = groups.verdicts.iter().filter(|verdict| **verdict <= Verdict::Event as u8).count();
    let stats = Stats {
        bytes: frames.sizes.iter().map(|size| u64::from(*size)).sum(),
        frames: decoded as u64,
        samples: groups.spans.len() as u64,
        ..Stats::default()
    };
    let mut bids: Vec<u8> = ids.iter().map(|id| id.bid).collect();
    bids.sort_unstable();
    bids.dedup();
    let part = Part {
        columns: columns.columns.into_iter().map(Arc::new).collect(),
        layout: vec![0; groups.spans.len()],
        singles: groups.spans,
        changes: bids.into_iter().map(|bid| (0, bid, Change::Wrap(Series::SixHundred.fine_wrap()))).collect(),
        stats,
        ..Part::default()
    };
    Ok(CanLog { part, verdicts: groups.verdicts })
}

/// A message of a device.
#[derive(Clone, Copy)]
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

/// The frame belongs to no sample.
const NO_SAMPLE: u32 = u32::MAX;

/// Which frames are the samples.
struct Groups {
    verdicts: Vec<u8>,
    /// The sample of each frame.
    samples: Vec<u32>,
    /// The samples, in the order of their first frames.
    spans: Vec<Single>,
    /// Whether the samples of the frames never fall.
    is_ordered: bool,
}

/// The open group of a device.
#[derive(Clone, Copy, Default)]
struct Open {
    /// Its messages, as bits of their places; none before the first group.
    seen: u64,
    /// The messages that begin a group.
    headers: u64,
    priority: u32,
    sample: u32,
}

impl Groups {
    fn of(frames: CanFrames<'_>, table: &Table) -> Self {
        let rises = rising(frames, table);
        let mut open = vec![Open::default(); table.devices];
        let mut groups = Self {
            verdicts: huge_pages::with_capacity(frames.ids.len()),
            samples: huge_pages::with_capacity(frames.ids.len()),
            spans: vec![],
            is_ordered: true,
        };
        let mut last = 0;
        for (at, ((&id, &size), &data)) in frames.ids.iter().zip(frames.sizes).zip(frames.data).enumerate() {
            let entry = table.entry(id);
            let verdict = judge(entry, id, size, data);
            groups.verdicts.push(verdict as u8);
            let (Some(entry), Verdict::Decoded | Verdict::Long) = (entry, verdict) else {
                groups.samples.push(NO_SAMPLE);
                continue;
            };
            let group = &mut open[entry.device];
            let bit = 1 << entry.place;
            let begins = group.seen == 0
                || group.seen & bit != 0
                || if rises[entry.device] {
                    entry.priority <= group.priority
                } else {
                    entry.is_header() && group.seen & !group.headers != 0
                };
            if begins {
                #[allow(clippy::cast_possible_truncation)] // fewer samples than frames
                let sample = groups.spans.len() as u32;
                *group = Open { sample, ..Open::default() };
                huge_pages::push(&mut groups.spans, Single { offset: at as u64, length: 0, bid: entry.bid });
            }
            group.seen |= bit;
            group.headers |= if entry.is_header() { bit } else { 0 };
            group.priority = entry.priority;
            groups.samples.push(group.sample);
            groups.is_ordered &= group.sample >= last;
            last = group.sample;
            let span = &mut groups.spans[group.sample as usize];
            #[allow(clippy::cast_possible_truncation)] // fewer than 2^32 frames
            let length = (at as u64 - span.offset) as u32 + 1;
            span.length = length;
        }
        groups
    }

    /// The frames in the order of their samples.
    fn order(&self) -> Vec<usize> {
        // Those of each sample are counted, which gives the place of its first frame.
        let mut places = vec![0; self.spans.len() + 1];
        let own = || self.samples.iter().enumerate().filter(|(_, sample)| **sample != NO_SAMPLE);
        own().for_each(|(_, &sample)| places[sample as usize + 1] += 1);
        let mut total = 0;
        for place in &mut places {
            total += *place;
            *place = total;
        }
        let mut order = vec![0; total];
        for (frame, &sample) in own() {
            let place = &mut places[sample as usize];
            order[*place] = frame;
            *place += 1;
        }
        order
    }
}

/// For each device whether its identifiers rise within a group. Then they fall once for each group, or less often where
/// frames were lost.
fn rising(frames: CanFrames<'_>, table: &Table) -> Vec<bool> {
    #[derive(Clone, Copy, Default)]
    struct Counts {
        priority: u32,
        falls: u64,
        times: u64,
        counters: u64,
    }
    let mut devices = vec![Counts::default(); table.devices];
    for entry in frames.ids.iter().filter_map(|id| table.entry(*id)) {
        let counts = &mut devices[entry.device];
        match entry.message() {
            CanMessage { content: CanContent::Event | CanContent::Opaque, .. } => continue,
            CanMessage { code: SAMPLE_TIME, .. } => counts.times += 1,
            CanMessage { code: GROUP_COUNTER, .. } => counts.counters += 1,
            _ => {}
        }
        counts.falls += u64::from(entry.priority <= counts.priority);
        counts.priority = entry.priority;
    }
    let rises = |counts: &Counts| {
        let groups = counts.times.max(counts.counters);
        // A quarter more, for groups whose first frames were lost.
        groups == 0 || counts.falls <= groups + groups / 4 + 1
    };
    devices.iter().map(rises).collect()
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

/// The columns while they grow, in the order of their first rows.
struct Columns {
    columns: Vec<Column>,
    /// The column of each message, by its place in the table.
    places: [Option<usize>; CAN_MESSAGES.len()],
}

impl Columns {
    #[inline]
    fn add(&mut self, entry: Entry, sample: u64, data: [u8; DATA_SIZE]) {
        let (message, columns) = (entry.message(), &mut self.columns);
        let Some(quantity) = message.content.quantity() else { return };
        let place = *self.places[entry.place].get_or_insert_with(|| {
            let is_same = |column: &Column| column.quantity().is_some_and(|own| own.id == quantity.id);
            columns.iter().position(is_same).unwrap_or_else(|| {
                columns.push(column_of(message, quantity));
                columns.len() - 1
            })
        });
        let column = &mut columns[place];
        if let CanContent::Component(_, element) = message.content {
            component(column, message, element, sample, data);
            return;
        }
        numbers(column, message, data);
        column.rows += 1;
        huge_pages::push(&mut column.single, sample);
    }
}

/// An empty column for a message.
fn column_of(message: &CanMessage, quantity: &'static Quantity) -> Column {
    let is_single = is_exact_in_single(message);
    let (values, width) = match message.content {
        CanContent::Integer(_) => (Values::of(message.signals[0].wire), 1),
        CanContent::Record(_) | CanContent::Utc(_) => {
            let Kind::Struct(fields) = quantity.kind else { unreachable!("a struct") };
            (Values::Records(vec![]), record_size(fields))
        }
        CanContent::Component(..) => (Values::F64(vec![]), quantity.components.len()),
        _ if is_single => (Values::F32(vec![]), quantity.components.len().max(1)),
        _ => (Values::F64(vec![]), quantity.components.len().max(1)),
    };
    // The identifier that the packets of a device would have: with the bits of the precision, and with those of ENU, zero.
    let precision = match (quantity.kind, &values) {
        (Kind::Real(_), Values::F64(_)) => Precision::Float64 as u16,
        _ => 0,
    };
    Column {
        subject: Subject::Known(quantity, quantity.rotates.then_some(Coordinates::Enu)),
        id: quantity.id | precision,
        mixed_ids: false,
        mixed_precisions: false,
        values,
        width,
        entries: vec![],
        rows: 0,
        single: vec![],
        counted: false,
    }
}

/// Whether a single has every value: integers of 16 bits, scaled by a power of two.
fn is_exact_in_single(message: &CanMessage) -> bool {
    message.signals.iter().all(|signal| signal.wire.size() <= 2 && signal.per_unit.is_power_of_two())
}

/// Appends a row.
#[inline]
fn numbers(column: &mut Column, message: &CanMessage, data: [u8; DATA_SIZE]) {
    match (&mut column.values, message.content) {
        (Values::F32(out), CanContent::Scaled(_)) => {
            let exponent = i32::from(data[message.size() - 1]);
            let unit = 2.0_f32.powi(-exponent);
            huge_pages::extend(out, (0..3).map(|at| f32::from(i16_at(data, 2 * at)) * unit));
        }
        (Values::F32(out), _) => {
            #[allow(clippy::cast_precision_loss)] // powers of two
            let unit = 1.0 / message.signals[0].per_unit as f32;
            huge_pages::extend(out, (0..message.signals.len()).map(|at| f32::from(i16_at(data, 2 * at)) * unit));
        }
        (Values::F64(out), _) => {
            let mut at = 0;
            for signal in message.signals {
                let count = integer(signal.wire, &data[at..]);
                huge_pages::push(out, count / f64::from(signal.per_unit));
                at += signal.wire.size();
            }
        }
        (Values::U16(out), _) => huge_pages::push(out, u16::from_be_bytes([data[0], data[1]])),
        (Values::U32(out), _) => huge_pages::push(out, u32::from_be_bytes([data[0], data[1], data[2], data[3]])),
        (Values::Records(out), CanContent::Utc(_)) => {
            let [year, month, day, hour, minute, second, high, low] = data;
            // More than 9999 is no time; what does not fit into the field is not one either.
            let ns = u32::from(u16::from_be_bytes([high, low])).saturating_mul(100_000);
            let year = if year < 70 { 2000 } else { 1900 } + u16::from(year);
            let record = [&ns.to_ne_bytes()[..], &year.to_ne_bytes(), &[month, day, hour, minute, second]];
            record.iter().for_each(|bytes| out.extend_from_slice(bytes));
            // A device sends the time only while it has one.
            out.push(crate::utc::UTC_VALID);
        }
        (Values::Records(out), _) => {
            let mut at = 0;
            for signal in message.signals {
                let (size, old) = (signal.wire.size(), out.len());
                out.extend_from_slice(&data[at..at + size]);
                if cfg!(target_endian = "little") {
                    out[old..].reverse();
                }
                at += size;
            }
        }
        (values, content) => unreachable!("{content:?} into {values:?}"),
    }
}

/// Puts one component into the row of its sample; those that do not arrive are NaN.
fn component(column: &mut Column, message: &CanMessage, element: usize, sample: u64, data: [u8; DATA_SIZE]) {
    let Values::F64(out) = &mut column.values else { return };
    if column.single.last() != Some(&sample) {
        huge_pages::extend(out, std::iter::repeat_n(f64::NAN, column.width));
        huge_pages::push(&mut column.single, sample);
        column.rows += 1;
    }
    let row = out.len() - column.width;
    let signal = &message.signals[0];
    out[row + element] = integer(signal.wire, &data) / f64::from(signal.per_unit);
}

#[inline]
fn i16_at(data: [u8; DATA_SIZE], at: usize) -> i16 {
    i16::from_be_bytes([data[at], data[at + 1]])
}

/// The integer at the start of some data.
#[inline]
fn integer(wire: Wire, data: &[u8]) -> f64 {
    match wire {
        Wire::U1 => data[0].into(),
        Wire::I1 => data[0].cast_signed().into(),
        Wire::U2 => u16::from_be_bytes([data[0], data[1]]).into(),
        Wire::I2 => i16::from_be_bytes([data[0], data[1]]).into(),
        Wire::I4 => i32::from_be_bytes([data[0], data[1], data[2], data[3]]).into(),
        Wire::U4 => u32::from_be_bytes([data[0], data[1], data[2], data[3]]).into(),
        Wire::U8 | Wire::F4 => f64::NAN, // no signal has them
    }
}
