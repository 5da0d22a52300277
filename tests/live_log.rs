//! A live stream and a log of the same bytes give the same: items, counts, times, gaps and values.

#[allow(dead_code)] // each test takes what it needs
#[path = "../fuzz/src/lib.rs"]
mod fuzz;

use std::collections::{BTreeMap, BTreeSet};

use proptest::prelude::*;

use fuzz::logs::{Bits, Log};
use fuzz::scans::{Scan, credit_suffices};
use fuzz::streams::{Input, Random, frame_of, packet, size, string};
use xbus::clock::{Clocks, Gap, Stamps};
use xbus::frame::{FIRST, Frame, MASTER, device_of};
use xbus::hostclock::HostClock;
use xbus::live::{Acquisition, Block, BlockDecoder, Event, Item, QUEUE, Sample, Text};
use xbus::log::{Options, Wanted};
use xbus::packet::Precision;
use xbus::table::{self, ClockRole, LONGEST_PAYLOAD, QUANTITIES, Series};

// ---------------------------------------------------------------------------------------------
// Streams
// ---------------------------------------------------------------------------------------------

/// A device that measures.
struct Device {
    bid: u8,
    counter: u16,
    /// The fine time, and where it wraps.
    fine: u64,
    wrap: u64,
    coarse: u32,
    /// Ticks between two samples.
    period: u64,
}

impl Device {
    fn new(bid: u8, random: &mut Random) -> Self {
        let wrap = random.pick(&[Series::Hundred.fine_wrap(), Series::SixHundred.fine_wrap()]);
        Self {
            bid,
            counter: random.pick(&[0, 100, 65_500]),
            // A few dozen samples before the wrap, half of the time.
            fine: random.pick(&[0, wrap - 2_000]),
            wrap,
            coarse: random.pick(&[0, 1_600_000_000]),
            period: random.pick(&[25, 100, 1_000]),
        }
    }

    fn sample(&mut self, random: &mut Random) -> Vec<u8> {
        let steps = if random.once_in(20) { random.below(50) } else { 1 };
        self.counter = self.counter.wrapping_add(u16::try_from(steps).expect("few"));
        self.fine = (self.fine + self.period * steps as u64) % self.wrap;
        self.coarse += u32::from(self.fine % 10_000 < self.period);
        let fine = u32::try_from(self.fine).expect("below the wrap");
        let mut payload = vec![];
        for quantity in QUANTITIES {
            let data = match quantity.clock {
                Some(ClockRole::Counter) if !random.once_in(30) => self.counter.to_be_bytes().to_vec(),
                Some(ClockRole::Fine) if !random.once_in(10) => fine.to_be_bytes().to_vec(),
                Some(ClockRole::Coarse) if self.bid.is_multiple_of(2) => self.coarse.to_be_bytes().to_vec(),
                Some(ClockRole::Trigger) if random.once_in(30) => [&[1, 1][..], &fine.to_be_bytes(), &[0, 0]].concat(),
                Some(ClockRole::Receiver) if random.once_in(60) => {
                    vec![0; size(quantity, Precision::Float32, 0, false)]
                }
                None if ["acceleration", "status_word", "temperature"].contains(&quantity.name) => {
                    let mut data = vec![0; size(quantity, Precision::Float32, 0, false)];
                    data.iter_mut().for_each(|byte| *byte = u8::try_from(random.below(256)).expect("a byte"));
                    data
                }
                _ => continue,
            };
            payload.extend(packet(quantity.id, &data));
        }
        frame_of(self.bid, table::MTDATA2, &payload)
    }

    fn message(&mut self, random: &mut Random) -> Vec<u8> {
        const GO_TO_MEASUREMENT_ACK: u8 = 0x11;
        const WAKE_UP: u8 = 0x3E;
        const DEVICE_ID: u8 = 0x01;
        match random.below(5) {
            0 => {
                self.counter = 0;
                frame_of(self.bid, GO_TO_MEASUREMENT_ACK, &[])
            }
            1 => {
                (self.counter, self.fine) = (0, 0);
                frame_of(self.bid, WAKE_UP, &[])
            }
            2 => {
                frame_of(self.bid, DEVICE_ID, &random.pick(&[0x0360_08A6_u32, 0x0770_0000, 0x8000_0001]).to_be_bytes())
            }
            3 => frame_of(self.bid, table::ERROR, &[0x28]),
            // Whether its packets fill it or not.
            _ => frame_of(self.bid, table::MTDATA2, &[0x10, 0x20, 9]),
        }
    }
}

/// What devices on one bus send, with strings, and damaged at a few places.
fn bus(random: &mut Random) -> Vec<u8> {
    let bids = random.pick(&[&[MASTER][..], &[FIRST], &[MASTER, FIRST], &[FIRST, 2, 3], &[2, 3, 31]]);
    let mut devices: Vec<_> = bids.iter().map(|bid| Device::new(*bid, random)).collect();
    let mut stream = vec![];
    let is_damaged = random.once_in(2);
    for _ in 0..30 + random.below(300) {
        let device = random.below(devices.len());
        let device = &mut devices[device];
        match random.below(40) {
            0 | 1 => stream.extend(device.message(random)),
            2 => (0..3).for_each(|_| stream.extend(string(random.below(16), random))),
            3 if is_damaged => stream.extend(random.noise(20)),
            4 if is_damaged => {
                let at = stream.len().saturating_sub(1 + random.below(60));
                stream.truncate(at);
            }
            5 if is_damaged && !stream.is_empty() => {
                let at = stream.len() - 1 - random.below(stream.len().min(60));
                stream[at] ^= 1 << random.below(8);
            }
            _ => stream.extend(device.sample(random)),
        }
    }
    stream
}

/// Pieces with their arrivals.
fn pieces<'a>(stream: &'a [u8], random: &mut Random) -> Vec<(&'a [u8], i64)> {
    let longest = random.pick(&[2, 30, 400, 5_000]);
    let (mut rest, mut now, mut pieces) = (stream, 0, vec![]);
    while !rest.is_empty() {
        let (piece, behind) = rest.split_at(rest.len().min(1 + random.below(longest)));
        now += i64::try_from(random.below(20_000_000)).expect("few");
        pieces.push((piece, now));
        rest = behind;
    }
    pieces
}

/// When the byte before `end` arrived.
fn arrival(pieces: &[(&[u8], i64)], end: u64) -> i64 {
    let mut length = 0;
    let last = pieces.iter().find(|(piece, _)| {
        length += piece.len() as u64;
        length >= end
    });
    last.expect("a piece").1
}

/// The log of the stream as a port would give it.
fn log_of(stream: &[u8], wanted: Option<Wanted>) -> Log {
    Log::whole(stream, Options { limit: LONGEST_PAYLOAD, wanted, ..Options::default() })
}

/// Seeds of `bus`.
fn cases(cases: u32) -> ProptestConfig {
    ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() }
}

// ---------------------------------------------------------------------------------------------
// Items and counts
// ---------------------------------------------------------------------------------------------

/// What was taken from a stream, as the scan of a log gives it.
fn scan_of(items: &[Item], stream: &[u8]) -> Scan {
    let position = |offset: u64| usize::try_from(offset).expect("a position in memory");
    let same = |offset: u64, bytes: &[u8]| {
        assert_eq!(*bytes, stream[position(offset)..][..bytes.len()]);
        (position(offset), bytes.len())
    };
    let mut scan = Scan::default();
    for item in items {
        match item {
            Item::Sample(sample, bytes) => scan.frames.push(same(sample.offset, bytes)),
            Item::Event(Event::Message { offset, bytes }) => scan.frames.push(same(*offset, bytes)),
            Item::Event(Event::Damage(damage)) => scan.damage.push(*damage),
            Item::Event(Event::Data) => panic!("a mark is not received"),
            Item::Text(text) => {
                let (at, length) = same(text.offset, &text.bytes);
                scan.strings.push((at, length, text.place));
            }
        }
    }
    scan
}

/// All that is taken from a stream is what a plain scan of it finds, and it is counted.
fn items_equal_the_scan(stream: &[u8], random: &mut Random) {
    let acquisition = Acquisition::new(QUEUE, MASTER, Some(0));
    let (mut items, mut early) = (vec![], BTreeSet::new());
    let [takes, looks] = [(); 2].map(|()| random.pick(&[1, 10, usize::MAX]));
    for (piece, now) in pieces(stream, random) {
        acquisition.push(piece, Some(now));
        if random.once_in(takes) {
            items.extend(acquisition.take_all().expect("the stream has not ended"));
        }
        // Someone waits for an answer: messages are handed out early, some of which are part of something else.
        if looks != usize::MAX && random.once_in(looks) {
            for event in acquisition.take_events(true).0 {
                if let Event::Message { offset, .. } = &event {
                    assert!(early.insert(*offset), "each is handed out once");
                }
                items.extend((event != Event::Data).then_some(Item::Event(event)));
            }
        }
    }
    acquisition.end("all is pushed");
    items.extend(acquisition.take_all().unwrap_or_default());
    assert!(acquisition.take_all().is_none());

    let mut expected = if credit_suffices(stream) {
        Scan::plainly(stream, LONGEST_PAYLOAD)
    } else {
        Scan::whole(stream, LONGEST_PAYLOAD)
    };
    let counts = acquisition.stats(0).counts;
    let checksum_errors = std::mem::take(&mut expected.checksum_errors);
    assert_eq!(counts.checksum_errors, checksum_errors);
    if looks == usize::MAX {
        let found = scan_of(&items, stream);
        assert!(takes != usize::MAX || found.frames.is_sorted());
        assert_eq!(found, expected);
        found.covers(stream);
    } else {
        let mut found = scan_of(&items, stream);
        found.frames.sort_unstable();
        let is_expected = |frame: &(usize, usize)| expected.frames.binary_search(frame).is_ok();
        let others: Vec<_> = found.frames.extract_if(.., |frame| !is_expected(frame)).collect();
        assert!(others.iter().all(|(offset, _)| early.contains(&(*offset as u64))), "{others:?}");
        found.damage.sort_unstable_by_key(|damage| damage.offset);
        assert_eq!(found, expected);
    }

    let log = log_of(stream, None);
    let stats = log.stats;
    assert_eq!((counts.bytes, counts.frames, counts.samples), (stats.bytes, stats.frames, stats.samples));
    assert_eq!((counts.messages, counts.malformed), (stats.messages, stats.malformed));
    let mut mids = BTreeMap::new();
    log.messages.iter().for_each(|message| *mids.entry(message.mid).or_default() += 1);
    assert_eq!(counts.mids, mids);
    assert_eq!((counts.strings.values().sum::<u64>(), counts.skipped_bytes), (stats.strings, stats.skipped_bytes));
    assert_eq!(counts.losses, log.losses());
}

// ---------------------------------------------------------------------------------------------
// Samples
// ---------------------------------------------------------------------------------------------

/// What a program takes from a live stream, one sample or one block at a time.
#[derive(Default)]
struct Taken {
    samples: Vec<(Sample, Vec<u8>)>,
    strings: Vec<Text>,
    /// The blocks, joined.
    log: Log,
    host_times: Vec<f64>,
    string_times: Vec<f64>,
}

impl Taken {
    /// Takes a sample.
    fn sample(&mut self, acquisition: &Acquisition) {
        self.samples.extend(acquisition.take_sample());
    }

    /// Takes a block.
    fn block(&mut self, acquisition: &Acquisition, samples: Option<usize>, decoder: &mut BlockDecoder) {
        let Some(block) = acquisition.take_block(samples) else { return };
        assert!(samples.is_none_or(|samples| block.samples.len() == samples));
        let Block { frames, samples, strings, .. } = &block;
        let mut rest = &frames[..];
        for sample in samples {
            let (frame, behind) = rest.split_at(sample.length as usize);
            self.samples.push((*sample, frame.to_vec()));
            rest = behind;
        }
        assert!(rest.is_empty());
        self.strings.extend(strings.iter().cloned());
        let columns = decoder.decode(block);
        self.host_times.extend(columns.host_times);
        self.string_times.extend(columns.string_times);
        let times = columns.part.times();
        self.log.join(Log {
            times: times.time.iter().map(|time| Bits(time.to_bits())).collect(),
            counters: times.counter.clone(),
            gaps: times.gaps.clone(),
            ..Log::of(&columns.part.part, &mut Clocks::default())
        });
    }
}

/// Samples have the times, counters and gaps that they have in the log, and the values if they are taken in blocks.
fn samples_equal_the_log(stream: &[u8], random: &mut Random) {
    let epoch = random.pick(&[0, 1_700_000_000_000_000_000]);
    let wanted: Option<Wanted> =
        random.once_in(3).then(|| (0..9).map(|_| (&QUANTITIES[random.below(QUANTITIES.len())], None)).collect());
    let acquisition = Acquisition::new(QUEUE, MASTER, Some(epoch));
    let mut decoder = BlockDecoder::new(wanted.clone(), epoch);
    let pieces = pieces(stream, random);
    let (only_blocks, seldom, most) =
        (random.once_in(2), random.pick(&[1, 5, usize::MAX]), 1 + random.pick(&[1, 7, 200]));
    let mut taken = Taken::default();
    for (piece, now) in &pieces {
        acquisition.push(piece, Some(*now));
        while seldom != usize::MAX && random.once_in(seldom) && acquisition.waiting().samples > 0 {
            match random.below(3) {
                0 if !only_blocks => taken.sample(&acquisition),
                1 => taken.block(&acquisition, None, &mut decoder),
                _ => taken.block(&acquisition, Some(random.below(most)), &mut decoder),
            }
        }
    }
    acquisition.end("all is pushed");
    taken.block(&acquisition, None, &mut decoder);

    let log = log_of(stream, wanted);
    let bits = |number: f64| Bits(number.to_bits());
    let (mut times, mut counters, mut gaps) = (vec![], vec![], vec![]);
    let mut host_clocks = BTreeMap::<u8, HostClock>::new();
    for ((sample, frame), index) in taken.samples.iter().zip(0..) {
        times.push(bits(sample.moment.seconds));
        counters.push(sample.moment.counter);
        let lost = sample.moment.lost;
        gaps.extend((lost > 0).then_some(Gap { sample: index, lost, bid: sample.bid }));
        let at = usize::try_from(sample.offset).expect("a position in memory");
        assert_eq!(*frame, stream[at..at + frame.len()]);
        assert_eq!(sample.arrival, arrival(&pieces, sample.offset + frame.len() as u64));
        let leads = Stamps::read(Frame::of(frame).payload).lead();
        assert_eq!(sample.leads, leads);
        let clock = host_clocks.entry(device_of(sample.bid)).or_default();
        let host_time = clock.update(sample.moment.seconds, sample.arrival + epoch, leads);
        assert_eq!(bits(sample.host_time), bits(host_time));
    }
    let offsets: Vec<_> = taken.samples.iter().map(|(sample, _)| sample.offset.cast_signed()).collect();
    let senders: Vec<_> = taken.samples.iter().map(|(sample, _)| sample.bid).collect();
    assert_eq!((&offsets, &senders), (&log.offsets, &log.bids));
    assert_eq!(times, log.times);
    assert_eq!(counters, log.counters);
    assert_eq!(gaps, log.gaps);

    assert_eq!(taken.strings.len(), log.strings.len());
    for ((live, logged), seconds) in taken.strings.iter().zip(&log.strings).zip(&taken.string_times) {
        assert_eq!((live.offset, live.place, &live.bytes[..]), (logged.offset, logged.place, &logged.bytes[..]));
        assert_eq!(live.arrival, arrival(&pieces, live.offset + live.bytes.len() as u64));
        #[allow(clippy::cast_precision_loss)] // so is the time
        let expected = (live.arrival + epoch) as f64 / 1e9;
        assert_eq!(bits(*seconds), bits(expected));
    }

    if only_blocks {
        let blocks = &taken.log;
        assert_eq!(blocks.columns, log.columns);
        assert_eq!((&blocks.times, &blocks.counters, &blocks.gaps), (&times, &counters, &gaps));
        let index = |log: &Log| log.strings.iter().map(|text| text.sample).collect::<Vec<_>>();
        assert_eq!(index(blocks), index(&log));
        let host_times: Vec<_> = taken.samples.iter().map(|(sample, _)| bits(sample.host_time)).collect();
        assert_eq!(taken.host_times.iter().copied().map(bits).collect::<Vec<_>>(), host_times);
    }
}

/// What a lane drops is counted once, and changes neither counts nor times.
fn dropped_entries_are_counted_once(stream: &[u8], random: &mut Random) {
    let bid = random.pick(&[MASTER, 2, 3]);
    let acquisition = Acquisition::new(random.pick(&[100, 1_000, 10_000]), bid, Some(0));
    let (mut samples, mut strings, mut messages) = (vec![], 0, 0);
    for (piece, now) in pieces(stream, random) {
        acquisition.push(piece, Some(now));
        match random.below(12) {
            0 => samples.extend(acquisition.take_sample().map(|(sample, _)| sample)),
            1 => strings += u64::from(acquisition.take_string().is_some()),
            2 => {
                let block = acquisition.take_block(Some(random.below(9))).unwrap_or_default();
                samples.extend(block.samples);
                strings += block.strings.len() as u64;
            }
            3 => {
                let events = acquisition.take_events(false).0;
                messages += events.iter().filter(|event| matches!(event, Event::Message { .. })).count() as u64;
            }
            _ => {}
        }
    }
    acquisition.end("all is pushed");
    for item in acquisition.take_all().unwrap_or_default() {
        match item {
            Item::Sample(sample, _) => samples.push(sample),
            Item::Text(_) => strings += 1,
            Item::Event(Event::Message { .. }) => messages += 1,
            Item::Event(_) => {}
        }
    }

    let log = log_of(stream, None);
    let is_wanted = |of: u8| bid == MASTER || of == MASTER || of == bid;
    let count = |bids: &mut dyn Iterator<Item = u8>| bids.filter(|bid| is_wanted(*bid)).count() as u64;
    let stats = acquisition.stats(0);
    let dropped = stats.dropped;
    assert_eq!(samples.len() as u64 + dropped.samples, count(&mut log.bids.iter().copied()));
    assert_eq!(strings + dropped.strings, log.strings.len() as u64);
    assert_eq!(messages + dropped.messages, count(&mut log.messages.iter().map(|message| message.bid)));
    assert_eq!((stats.queued, stats.unread), (0, 0));

    assert_eq!((stats.counts.samples, stats.counts.messages), (log.stats.samples, log.stats.messages));
    assert_eq!(stats.counts.losses, log.losses());
    assert!(samples.is_sorted_by_key(|sample| sample.offset));
    for sample in samples {
        let index = log.offsets.binary_search(&sample.offset.cast_signed()).expect("a sample of the log");
        assert_eq!(Bits(sample.moment.seconds.to_bits()), log.times[index]);
        let lost = log.gaps.iter().find(|gap| gap.sample == index as u64).map_or(0, |gap| gap.lost);
        assert_eq!((sample.moment.counter, sample.moment.lost), (log.counters[index], lost));
    }
}

proptest! {
    #![proptest_config(cases(150))]

    #[test]
    fn items_of_a_bus(seed in any::<u64>()) {
        let random = &mut Random::new(seed);
        items_equal_the_scan(&bus(random), random);
    }

    #[test]
    fn samples_of_a_bus(seed in any::<u64>()) {
        let random = &mut Random::new(seed);
        samples_equal_the_log(&bus(random), random);
    }

    #[test]
    fn drops_of_a_bus(seed in any::<u64>()) {
        let random = &mut Random::new(seed);
        dropped_entries_are_counted_once(&bus(random), random);
    }

    /// Each input is a seed and a stream, or a recipe for one.
    #[test]
    fn any_stream(input in prop::collection::vec(any::<u8>(), 3..60)) {
        let Input { random, stream } = Input::of(&input);
        for law in [items_equal_the_scan, samples_equal_the_log, dropped_entries_are_counted_once] {
            law(&stream, &mut random.clone());
        }
    }
}

/// The generator makes what the laws are about.
#[test]
fn buses_wrap_restart_and_lose() {
    let mut seen = [0; 8];
    for seed in 0..100 {
        let log = log_of(&bus(&mut Random::new(seed)), None);
        let has = |name: &str| log.columns.iter().any(|column| column.subject == name && !column.rows.is_empty());
        let turns = log.counters.iter().any(|counter| *counter > 65_535);
        let late = log.times.iter().any(|time| f64::from_bits(time.0) > 429_496.8);
        let found = [
            turns,
            late,
            !log.gaps.is_empty(),
            has("trigger_in1"),
            has("gnss_pvt_data"),
            !log.strings.is_empty(),
            !log.damage.is_empty(),
            log.messages.iter().any(|message| message.mid == table::MTDATA2),
        ];
        seen.iter_mut().zip(found).for_each(|(seen, found)| *seen += u32::from(found));
    }
    assert!(seen.iter().all(|seen| *seen > 5), "{seen:?}");
}
