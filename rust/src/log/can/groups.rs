//! Which frames are the samples, for frames that come in chunks of any size.
//!
//! A frame waits for the end of its group, so the frames of incomplete groups are held until the next chunk and grouped
//! again with it. What is held is bounded, because a group ends after [`GROUP_FRAMES`] and the order of a device is
//! decided after [`ORDER_FRAMES`], even if no other frame of the device comes.
//!
//! If the last frames of a group and the first ones of the next are lost, identifiers go on rising, and frames of two
//! instants look like one group. Then `GroupCounter` skips. So a group waits for the next counter, and beside a skip it is
//! cut where its frames are too far apart in time: see [`Counter`].

use super::{CanFrames, DATA_SIZE, Entry, Table, Verdict, judge};
use crate::error::CanError;
use crate::huge_pages;
use crate::log::Single;
use crate::table::CanMessage;

/// A group ends this number of frames after its first one, whatever they are, and waits for the next counter this number of
/// frames after its last one. A device sends a group within milliseconds.
const GROUP_FRAMES: u64 = 1 << 12;
/// The order of a device is decided this number of frames after its first one, whatever they are.
const ORDER_FRAMES: u64 = 1 << 16;
/// ... or when a message comes this often.
const ORDER_REPEATS: u32 = 4;

/// Frames of two instants are an interval apart, and those of a group at most half an interval, which two frames are if they
/// are spread evenly. This share of an interval divides them.
const DIVIDING_SHARE: f64 = 2.0 / 3.0;

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
    /// The held frames that begin a group because of their time, by index.
    cuts: Vec<u64>,
    /// Index of the next frame.
    next: u64,
}

/// What is remembered of a device from chunk to chunk.
#[derive(Clone, Copy, Debug, Default)]
struct Device {
    /// Whether its identifiers rise within a group; none while that is not decided.
    rises: Option<bool>,
    /// The counter before the held frames.
    counter: Counter,
}

/// The last `GroupCounter` of a device, which shows where groups are missing.
///
/// Receive times then show which frames are not of one instant: see [`DIVIDING_SHARE`]. Without a skip no group with values
/// is cut, because a late receiver explains a gap too.
#[derive(Clone, Copy, Debug, Default)]
struct Counter {
    /// Its value, and when it was received.
    last: Option<(u16, f64)>,
    /// The shortest time between the counters of consecutive groups, in seconds; none before the first.
    interval: Option<f64>,
}

impl Counter {
    /// Takes the next counter. Returns the time between two frames that divides instants, in seconds, and whether it skips.
    fn add(&mut self, data: [u8; DATA_SIZE], time: f64) -> Option<(f64, bool)> {
        let value = u16::from_be_bytes([data[0], data[1]]);
        let (before, received) = self.last.replace((value, time))?;
        let (steps, seconds) = (value.wrapping_sub(before), time - received);
        if steps == 1 && seconds > 0.0 {
            self.interval = Some(self.interval.map_or(seconds, |interval| interval.min(seconds)));
        }
        // After a restart the steps are no number of groups, and their mean is too short.
        let mean = seconds / f64::from(steps);
        let interval = self.interval.map_or(mean, |interval| interval.max(mean));
        // Not if the clock of the receiver was set back.
        (interval > 0.0).then_some((interval * DIVIDING_SHARE, steps != 1))
    }
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
        Self { table, release, devices, held: Held::default(), cuts: vec![], next: 0 }
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
        let mut cuts = std::mem::take(&mut self.cuts);
        let mut pass = self.pass(frames, index, &cuts);
        cuts.extend(&pass.cuts);
        cuts.sort_unstable();
        if pass.is_to_repeat {
            pass = self.pass(frames, index, &cuts);
        }
        if !is_end {
            self.hold(&mut pass, frames, index);
            let held = &self.held.index;
            cuts.retain(|cut| held.binary_search(cut).is_ok());
            self.cuts = cuts;
        }
        pass.groups
    }

    /// Groups frames. `cuts` begin a group because of their time.
    fn pass(&self, frames: CanFrames<'_>, index: impl Fn(usize) -> u64, cuts: &[u64]) -> Pass {
        let mut cuts = cuts.iter().copied().peekable();
        let mut found = vec![];
        let mut open: Vec<Open> = self.devices.iter().map(|device| Open::after(device.counter)).collect();
        let mut gaps: Vec<Gaps> = self.devices.iter().map(|device| Gaps::after(device.counter)).collect();
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
            let (group, gaps) = (&mut open[entry.device], &mut gaps[entry.device]);
            let (frame, time) = (index(at), frames.times[at]);
            while cuts.next_if(|cut| *cut < frame).is_some() {}
            let is_start = cuts.next_if_eq(&frame).is_some() || group.is_over(entry, rises, frame);
            if is_start {
                gaps.follows_headers = !rises && group.seen != 0 && group.seen & !group.headers == 0;
                #[allow(clippy::cast_possible_truncation)] // fewer samples than frames
                let sample = groups.spans.len() as u32;
                *group = Open { sample, first: frame, counted: group.counted, ..Open::default() };
                huge_pages::push(&mut groups.spans, Single { offset: frame, length: 0, bid: entry.bid });
                huge_pages::push(&mut groups.received, time);
            }
            gaps.add(frame, time, is_start);
            let bit = 1 << entry.place;
            group.seen |= bit;
            if entry.is_header() {
                group.headers |= bit;
                if entry.message().code == GROUP_COUNTER {
                    gaps.end(data, frame, &mut found);
                    group.counted = Some(group.first);
                }
            }
            group.priority = entry.priority;
            groups.samples.push(group.sample);
            groups.is_ordered &= group.sample >= last;
            last = group.sample;
            let span = &mut groups.spans[group.sample as usize];
            #[allow(clippy::cast_possible_truncation)] // at most GROUP_FRAMES
            let length = (frame - span.offset) as u32 + 1;
            span.length = length;
        }
        let is_to_repeat = found.iter().any(|gap| !gap.is_start);
        Pass { groups, open, undecided, cuts: found.iter().map(|gap| gap.frame).collect(), is_to_repeat }
    }

    /// Takes the groups out that are not complete, or wait for the next counter, and holds their frames.
    fn hold(&mut self, pass: &mut Pass, frames: CanFrames<'_>, index: impl Fn(usize) -> u64) {
        let Pass { groups, open, undecided, .. } = pass;
        let mut waiting = [u64::MAX; 1 << u8::BITS];
        for group in open.iter().filter(|group| group.seen != 0) {
            let bid = groups.spans[group.sample as usize].bid;
            waiting[usize::from(bid)] = group.counted.unwrap_or(group.first);
        }
        let waits = |span: &Single| {
            let end = span.offset + u64::from(span.length);
            span.offset >= waiting[usize::from(span.bid)] && self.next < end + GROUP_FRAMES
        };
        // Groups that began after this frame wait.
        let limit = match self.release {
            Release::Complete => u64::MAX,
            Release::InOrder => {
                let first = groups.spans.iter().find(|span| waits(span));
                first.map_or(*undecided, |span| span.offset.min(*undecided))
            }
        };
        let mut places: Vec<u32> = vec![0; groups.spans.len()];
        let mut kept = 0;
        for (place, span) in places.iter_mut().zip(&groups.spans) {
            if !waits(span) && span.offset < limit {
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
            } else if let Some(entry) = self.table.entry(frames.ids[at])
                && entry.message().code == GROUP_COUNTER
            {
                self.devices[entry.device].counter.add(frames.data[at], frames.times[at]);
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

/// What one pass over the frames gives.
struct Pass {
    groups: Groups,
    /// The open group of each device.
    open: Vec<Open>,
    /// Index of the first frame that waits for something else than the end of its group.
    undecided: u64,
    /// Indices of frames that are of another instant than the frames of the device before them.
    cuts: Vec<u64>,
    /// Whether some of these do not begin a group.
    is_to_repeat: bool,
}

/// Two frames of a device, one after the other.
#[derive(Clone, Copy)]
struct Gap {
    /// Index of the second one.
    frame: u64,
    /// The time between them.
    seconds: f64,
    /// Whether the second one begins a group.
    is_start: bool,
}

/// The time between the frames of a device since its last counter.
struct Gaps {
    counter: Counter,
    gaps: Vec<Gap>,
    /// Gaps that are not longer, in seconds, divide no instants; all until the first counter.
    least: f64,
    /// When the last frame was received; NaN before the first.
    time: f64,
    /// Whether the group before the open one has nothing but headers, which may be those of two groups.
    follows_headers: bool,
}

impl Gaps {
    fn after(counter: Counter) -> Self {
        let mut gaps = Self { counter, gaps: vec![], least: f64::INFINITY, time: f64::NAN, follows_headers: false };
        gaps.set_least();
        gaps
    }

    fn add(&mut self, frame: u64, time: f64, is_start: bool) {
        let seconds = time - self.time;
        self.time = time;
        if seconds > self.least {
            self.gaps.push(Gap { frame, seconds, is_start });
        }
    }

    /// Ends at the next counter, which is the last frame, and adds those that divide instants to `found`.
    fn end(&mut self, data: [u8; DATA_SIZE], frame: u64, found: &mut Vec<Gap>) {
        if let Some((limit, skips)) = self.counter.add(data, self.time) {
            // Older frames have left if they came in small chunks.
            let is_far = |gap: &Gap| gap.seconds > limit && frame < gap.frame + GROUP_FRAMES;
            // Without a skip, a counter that is left alone of its group can be followed by the time of the next group.
            let is_found = |gap: &&Gap| is_far(gap) && (skips || self.follows_headers && !gap.is_start);
            found.extend(self.gaps.iter().filter(is_found));
        }
        self.gaps.clear();
        self.set_least();
    }

    fn set_least(&mut self) {
        if self.counter.last.is_some() {
            self.least = self.counter.interval.map_or(0.0, |interval| interval * DIVIDING_SHARE);
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
    /// Index of the first frame of the last group with a counter; none before the first counter.
    counted: Option<u64>,
}

impl Open {
    /// No group. All groups after a counter wait for the next one.
    fn after(counter: Counter) -> Self {
        Self { counted: counter.last.map(|_| 0), ..Self::default() }
    }

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
