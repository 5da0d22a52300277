//! Which frames are the samples, for frames that come in chunks of any size.
//!
//! A frame waits for the end of its group, so the frames of incomplete groups are held until the next chunk and grouped
//! again with it. What is held is bounded, because a group ends after [`GROUP_FRAMES`] and the order of a device is
//! decided after [`ORDER_FRAMES`], even if no other frame of the device comes.

use super::{CanFrames, DATA_SIZE, Entry, Table, Verdict, judge};
use crate::error::CanError;
use crate::huge_pages;
use crate::log::Single;
use crate::table::CanMessage;

/// A group ends this number of frames after its first one, whatever they are. A device sends a group within milliseconds.
const GROUP_FRAMES: u64 = 1 << 12;
/// The order of a device is decided this number of frames after its first one, whatever they are.
const ORDER_FRAMES: u64 = 1 << 16;
/// ... or when a message comes this often.
const ORDER_REPEATS: u32 = 4;

/// Code of `SampleTime`.
pub const SAMPLE_TIME: u8 = 0x05;
/// Code of `GroupCounter`.
pub const GROUP_COUNTER: u8 = 0x06;

/// The frame belongs to no sample.
pub const NO_SAMPLE: u32 = u32::MAX;
/// The group of the frame is not complete.
const HELD: u32 = u32::MAX - 1;

/// When a complete group leaves a [`Grouper`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Release {
    /// At once: groups of several devices leave in the order in which they become complete.
    Complete,
    /// When all groups that began before it have left: in the order of their first frames.
    InOrder,
}

/// Groups the frames of a bus.
#[derive(Debug)]
pub struct Grouper {
    table: Table,
    release: Release,
    devices: Vec<Device>,
    held: Held,
    /// Index of the next frame.
    next: u64,
}

/// What is remembered of a device from chunk to chunk.
#[derive(Clone, Copy, Debug, Default)]
struct Device {
    /// Whether its identifiers rise within a group; none while that is not decided.
    rises: Option<bool>,
}

/// Frames of groups that are not complete.
#[derive(Debug, Default)]
struct Held {
    index: Vec<u64>,
    times: Vec<f64>,
    ids: Vec<u32>,
    sizes: Vec<u8>,
    data: Vec<[u8; DATA_SIZE]>,
}

impl Held {
    const fn frames(&self) -> CanFrames<'_> {
        CanFrames {
            times: self.times.as_slice(),
            ids: self.ids.as_slice(),
            sizes: self.sizes.as_slice(),
            data: self.data.as_slice(),
        }
    }

    fn push(&mut self, frames: CanFrames<'_>, at: usize, index: u64) {
        self.index.push(index);
        self.times.push(frames.times[at]);
        self.ids.push(frames.ids[at]);
        self.sizes.push(frames.sizes[at]);
        self.data.push(frames.data[at]);
    }

    fn extend(&mut self, frames: CanFrames<'_>, first: u64) {
        self.index.extend(first..first + frames.ids.len() as u64);
        self.times.extend(frames.times);
        self.ids.extend(frames.ids);
        self.sizes.extend(frames.sizes);
        self.data.extend(frames.data);
    }
}

/// The groups that are complete.
#[derive(Debug)]
pub struct Groups {
    /// The [`Verdict`] of each new frame.
    pub verdicts: Vec<u8>,
    /// The sample of each frame, counted from the first one here; [`NO_SAMPLE`] for other frames.
    pub samples: Vec<u32>,
    /// The samples, in the order in which they leave.
    pub spans: Vec<Single>,
    /// When the first frame of each sample was received.
    pub received: Vec<f64>,
    /// Whether the samples of the frames never fall.
    pub is_ordered: bool,
}

impl Grouper {
    pub fn new(table: Table, release: Release) -> Self {
        let devices = vec![Device::default(); table.devices];
        Self { table, release, devices, held: Held::default(), next: 0 }
    }

    pub const fn table(&self) -> &Table {
        &self.table
    }

    /// Adds frames, and hands the complete groups to `take`, with the frames that they are of. At the end all groups are
    /// complete.
    ///
    /// # Errors
    /// If the arrays differ in length, or there are 2^32 frames in one chunk.
    pub fn push<T>(
        &mut self,
        new: CanFrames<'_>,
        is_end: bool,
        take: impl FnOnce(&Table, CanFrames<'_>, &Groups) -> T,
    ) -> Result<(T, Vec<u8>), CanError> {
        let count = new.ids.len();
        if new.times.len() != count || new.sizes.len() != count || new.data.len() != count {
            return Err(CanError::Lengths);
        }
        if count + self.held.ids.len() >= HELD as usize {
            return Err(CanError::TooMany);
        }
        let first = self.next;
        self.next += count as u64;
        let mut before = std::mem::take(&mut self.held);
        let held = before.ids.len();
        // A capture that is read at once is not copied.
        let mut groups = if held == 0 {
            self.group(new, &[], first, is_end)
        } else {
            before.extend(new, first);
            self.group(before.frames(), &before.index[..held], first, is_end)
        };
        let frames = if held == 0 { new } else { before.frames() };
        let verdicts = groups.verdicts.split_off(held);
        Ok((take(&self.table, frames, &groups), verdicts))
    }

    /// Groups frames, of which the first ones were held and have these indices.
    fn group(&mut self, frames: CanFrames<'_>, held: &[u64], first: u64, is_end: bool) -> Groups {
        let index = |at: usize| held.get(at).copied().unwrap_or_else(|| first + (at - held.len()) as u64);
        self.decide(frames, index, is_end);
        let mut open = vec![Open::default(); self.devices.len()];
        let mut groups = Groups {
            verdicts: huge_pages::with_capacity(frames.ids.len()),
            samples: huge_pages::with_capacity(frames.ids.len()),
            spans: vec![],
            received: vec![],
            is_ordered: true,
        };
        // The first frame that waits for something else than the end of its group.
        let mut undecided = u64::MAX;
        let mut last = 0;
        for (at, ((&id, &size), &data)) in frames.ids.iter().zip(frames.sizes).zip(frames.data).enumerate() {
            let entry = self.table.entry(id);
            let verdict = judge(entry, id, size, data);
            groups.verdicts.push(verdict as u8);
            let (Some(entry), Verdict::Decoded | Verdict::Long) = (entry, verdict) else {
                groups.samples.push(NO_SAMPLE);
                continue;
            };
            let Some(rises) = self.devices[entry.device].rises else {
                undecided = undecided.min(index(at));
                groups.samples.push(HELD);
                continue;
            };
            let group = &mut open[entry.device];
            let frame = index(at);
            if group.is_over(entry, rises, frame) {
                #[allow(clippy::cast_possible_truncation)] // fewer samples than frames
                let sample = groups.spans.len() as u32;
                *group = Open { sample, first: frame, ..Open::default() };
                huge_pages::push(&mut groups.spans, Single { offset: frame, length: 0, bid: entry.bid });
                huge_pages::push(&mut groups.received, frames.times[at]);
            }
            let bit = 1 << entry.place;
            group.seen |= bit;
            group.headers |= if entry.is_header() { bit } else { 0 };
            group.priority = entry.priority;
            groups.samples.push(group.sample);
            groups.is_ordered &= group.sample >= last;
            last = group.sample;
            let span = &mut groups.spans[group.sample as usize];
            #[allow(clippy::cast_possible_truncation)] // at most GROUP_FRAMES
            let length = (frame - span.offset) as u32 + 1;
            span.length = length;
        }
        if !is_end {
            self.hold(&mut groups, frames, index, &open, undecided);
        }
        groups
    }

    /// Takes the groups that are not complete out, and holds their frames.
    fn hold(
        &mut self,
        groups: &mut Groups,
        frames: CanFrames<'_>,
        index: impl Fn(usize) -> u64,
        open: &[Open],
        undecided: u64,
    ) {
        let open: Vec<_> =
            open.iter().filter(|group| group.seen != 0 && self.next < group.first + GROUP_FRAMES).collect();
        // Groups that began after this frame wait.
        let limit = match self.release {
            Release::Complete => u64::MAX,
            Release::InOrder => open.iter().map(|group| group.first).min().unwrap_or(u64::MAX).min(undecided),
        };
        if open.is_empty() && undecided == u64::MAX {
            return;
        }
        let mut places: Vec<u32> = vec![0; groups.spans.len()];
        open.iter().for_each(|group| places[group.sample as usize] = HELD);
        let mut kept = 0;
        for (place, span) in places.iter_mut().zip(&groups.spans) {
            if *place != HELD && span.offset < limit {
                *place = kept;
                kept += 1;
            } else {
                *place = HELD;
            }
        }
        let mut is_kept = places.iter().map(|place| *place != HELD);
        groups.spans.retain(|_| is_kept.next().unwrap_or(false));
        let mut is_kept = places.iter().map(|place| *place != HELD);
        groups.received.retain(|_| is_kept.next().unwrap_or(false));
        for (at, sample) in groups.samples.iter_mut().enumerate().filter(|(_, sample)| **sample != NO_SAMPLE) {
            *sample = if *sample == HELD { HELD } else { places[*sample as usize] };
            if *sample == HELD {
                self.held.push(frames, at, index(at));
                *sample = NO_SAMPLE;
            }
        }
    }

    /// Decides for devices whose order is not known whether their identifiers rise within a group. Then they fall once for
    /// each group, or less often where frames were lost. All frames of such a device are here.
    fn decide(&mut self, frames: CanFrames<'_>, index: impl Fn(usize) -> u64, is_end: bool) {
        let mut left = self.devices.iter().filter(|device| device.rises.is_none()).count();
        if left == 0 {
            return;
        }
        let mut devices = vec![Counts::default(); self.devices.len()];
        for (at, &id) in frames.ids.iter().enumerate() {
            let Some(entry) = self.table.entry(id) else { continue };
            let (counts, device) = (&mut devices[entry.device], &mut self.devices[entry.device]);
            let verdict = judge(Some(entry), id, frames.sizes[at], frames.data[at]);
            if device.rises.is_some() || !matches!(verdict, Verdict::Decoded | Verdict::Long) {
                continue;
            }
            let frame = index(at);
            let is_late = counts.first.is_some_and(|first| frame >= first + ORDER_FRAMES);
            if !is_late {
                counts.add(entry, frame);
            }
            if is_late || counts.most == ORDER_REPEATS {
                device.rises = Some(counts.rises());
                left -= 1;
                if left == 0 {
                    return;
                }
            }
        }
        for (counts, device) in devices.iter().zip(&mut self.devices) {
            let is_late = counts.first.is_some_and(|first| self.next >= first + ORDER_FRAMES);
            if device.rises.is_none() && (is_end || is_late) {
                device.rises = Some(counts.rises());
            }
        }
    }
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
    /// Index of its first frame.
    first: u64,
}

impl Open {
    /// Whether a frame of the device begins the next group.
    const fn is_over(&self, entry: Entry, rises: bool, frame: u64) -> bool {
        self.seen == 0
            || self.seen & 1 << entry.place != 0
            || frame >= self.first + GROUP_FRAMES
            || if rises { entry.priority <= self.priority } else { entry.is_header() && self.seen & !self.headers != 0 }
    }
}

/// What decides the order of a device.
#[derive(Clone, Default)]
struct Counts {
    /// Index of its first frame.
    first: Option<u64>,
    priority: u32,
    falls: u32,
    times: u32,
    counters: u32,
    /// Number of frames of each message, by its place.
    messages: [u32; crate::table::CAN_MESSAGES.len()],
    /// The largest of these.
    most: u32,
}

impl Counts {
    fn add(&mut self, entry: Entry, frame: u64) {
        self.first.get_or_insert(frame);
        match entry.message() {
            CanMessage { code: SAMPLE_TIME, .. } => self.times += 1,
            CanMessage { code: GROUP_COUNTER, .. } => self.counters += 1,
            _ => {}
        }
        self.falls += u32::from(entry.priority <= self.priority);
        self.priority = entry.priority;
        self.messages[entry.place] += 1;
        self.most = self.most.max(self.messages[entry.place]);
    }

    fn rises(&self) -> bool {
        let groups = self.times.max(self.counters);
        // One more, for a group whose first frames were lost.
        groups == 0 || self.falls <= groups + 1
    }
}

impl Groups {
    /// The frames of samples, in the order of the samples.
    pub fn order(&self) -> Vec<usize> {
        let own = || self.samples.iter().enumerate().filter(|(_, sample)| **sample != NO_SAMPLE);
        if self.is_ordered {
            return own().map(|(frame, _)| frame).collect();
        }
        // Those of each sample are counted, which gives the place of its first frame.
        let mut places = vec![0; self.spans.len() + 1];
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
