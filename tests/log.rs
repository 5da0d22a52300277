//! Logs: joined parts equal the whole log, and columns, clocks and counts match the input.

#[allow(dead_code)] // each test takes what it needs
#[path = "../fuzz/src/lib.rs"]
mod fuzz;

use std::io::{self, Read};

use proptest::prelude::*;

use fuzz::checks::{self, decode, fast_is_plain, parallel, parts};
use fuzz::logs::{Bits, Log};
use fuzz::streams::{Random, extended, frame, frame_of, packet, sample};
use xbus::clock::Clocks;
use xbus::error::{Fault, ReadError};
use xbus::frame::MASTER;
use xbus::input::{PushBuffer, Stream};
use xbus::log::{Options, Reader, TimedPart};
use xbus::packet::Coordinates;
use xbus::scan::{Damage, Reason, Window};
use xbus::table::{self, quantity_named};

fn read(stream: &[u8]) -> Log {
    let log = Log::whole(stream, Options::default());
    Log::whole(stream, Options { fast: false, ..Options::default() }).same_as(&log, "plain, fast");
    log
}

/// A message with a counter and one quantity.
fn counted(counter: u8, id: u16, data: &[u8]) -> Vec<u8> {
    sample(&[(0x1020, &[0, counter]), (id, data)])
}

// ---------------------------------------------------------------------------------------------
// Joined parts equal the whole log
// ---------------------------------------------------------------------------------------------

proptest! {
    #![proptest_config(ProptestConfig { cases: 100, failure_persistence: None, ..ProptestConfig::default() })]

    /// Each input is a seed and a stream, or a recipe for one.
    #[test]
    fn joined_parts_equal_the_whole_log(input in prop::collection::vec(any::<u8>(), 3..60)) {
        parts(&input);
    }

    #[test]
    fn threads_do_not_change_the_log(input in prop::collection::vec(any::<u8>(), 3..60)) {
        parallel(&input);
    }

    #[test]
    fn log_matches_the_reference_decoder(input in prop::collection::vec(any::<u8>(), 3..60)) {
        decode(&input);
    }

    #[test]
    fn parts_are_equal_on_both_paths(input in prop::collection::vec(any::<u8>(), 3..60)) {
        fast_is_plain(&input);
    }

    /// Each input is a seed and a recipe for counters and clocks.
    #[test]
    fn times_and_counters_are_unwrapped_as_sample_by_sample(input in prop::collection::vec(any::<u8>(), 3..60)) {
        checks::unwrap(&input);
    }
}

#[test]
fn cutting_at_any_byte_does_not_change_the_log() {
    let frames = [
        frame(0x01, &[0x03, 0x60, 0x08, 0xA6]),
        counted(1, 0x4020, &[0x41; 12]),
        counted(2, 0x4020, &[0x42; 12]),
        vec![0xAA; 7],
        counted(3, 0x4020, &[0x43; 12]),
        counted(3, 0x4023, &[0x40; 24]),
        frame(0x42, &[4]),
        counted(9, 0x4020, &[0x44; 12]),
        counted(10, 0x7020, &[0, 0, 0, 1, 1, 0, 0, 0, 0, 5, 22, 20]),
        vec![0xFA, 0xFF, 0x36],
    ];
    let stream = frames.concat();
    let whole = read(&stream);
    assert_eq!((whole.offsets.len(), whole.messages.len(), whole.damage.len()), (6, 2, 2));
    for cut in 0..=stream.len() {
        let mut reader = Reader::new(Options::default(), 0);
        let mut clocks = Clocks::default();
        let mut joined = Log::default();
        for (end, last) in [(cut, false), (stream.len(), true)] {
            let window = Window { bytes: &stream[..end], offset: 0, last };
            reader.read(window, u64::MAX).unwrap();
            joined.join(Log::of(&reader.take(), &mut clocks));
        }
        assert!(reader.is_finished());
        joined.same_as(&whole, &format!("cut at {cut}"));
    }
}

/// A log with 1.5 MB of samples, damage and another message.
fn long_stream() -> Vec<u8> {
    let samples = |count: usize| (0..=u8::MAX).cycle().take(count).flat_map(|i| counted(i, 0x4020, &[0x41; 12]));
    samples(30_000).chain([0xAA; 7]).chain(frame(0x42, &[4])).chain(samples(30_000)).collect()
}

#[test]
fn streams_equal_memory() {
    let bytes = long_stream();
    let mut reader = Reader::new(Options::default(), 0);
    let mut stream = Stream::new(&bytes[..]);
    let (mut clocks, mut joined, mut parts) = (Clocks::default(), Log::default(), 0);
    while !reader.is_finished() {
        let until = reader.at() + 400_000;
        reader.read_stream(&mut stream, until).unwrap();
        assert!(reader.is_finished() || reader.at() >= until);
        joined.join(Log::of(&reader.take(), &mut clocks));
        parts += 1;
    }
    assert_eq!(parts, 4);
    joined.same_as(&Log::whole(&bytes, Options::default()), "stream, memory");
}

#[test]
fn pushed_bytes_equal_memory() {
    let bytes = long_stream();
    let frame = counted(0, 0x4020, &[0x41; 12]).len();
    let (mut reader, mut buffer) = (Reader::new(Options::default(), 0), PushBuffer::default());
    for piece in bytes.chunks(77_777) {
        buffer.push(piece);
        reader.read(buffer.window(false), u64::MAX).unwrap();
        buffer.release(reader.at());
        assert!(buffer.window(false).bytes.len() < frame, "only an incomplete frame is kept");
    }
    reader.read(buffer.window(true), u64::MAX).unwrap();
    assert!(reader.is_finished());
    Log::of(&reader.take(), &mut Clocks::default()).same_as(&Log::whole(&bytes, Options::default()), "pushed, memory");
}

#[test]
fn streams_end_with_the_input_error_or_the_first_fault() {
    struct Broken;
    impl Read for Broken {
        fn read(&mut self, _: &mut [u8]) -> io::Result<usize> {
            Err(io::ErrorKind::ConnectionReset.into())
        }
    }
    let bytes = long_stream();
    let error =
        Reader::new(Options::default(), 0).read_stream(&mut Stream::new(bytes.chain(Broken)), u64::MAX).unwrap_err();
    assert!(matches!(&error, ReadError::Io(error) if error.kind() == io::ErrorKind::ConnectionReset), "{error}");

    let options = Options { strict: true, ..Options::default() };
    let error = Reader::new(options, 0).read_stream(&mut Stream::new(&bytes[..]), u64::MAX).unwrap_err();
    let place = 30_000 * counted(0, 0x4020, &[0x41; 12]).len() as u64;
    assert!(matches!(&error, ReadError::Fault(fault) if fault.offset() == place), "{error}");
    assert!(error.to_string().starts_with(&format!("no frame at byte {place} (no preamble)")));
}

#[test]
fn timed_parts_are_contiguous() {
    let bytes = long_stream();
    let window = Window { bytes: &bytes, offset: 0, last: true };
    let (mut reader, mut clocks, mut counters, mut gaps) =
        (Reader::new(Options::default(), 0), Clocks::default(), vec![], 0);
    while !reader.is_finished() {
        reader.read(window, reader.at() + 400_000).unwrap();
        let part = TimedPart::take(&mut reader, &mut clocks);
        assert_eq!(part.times().counter.len(), part.part.len());
        counters.extend_from_slice(&part.times().counter);
        gaps += part.times().losses().gaps;
    }
    let whole = Log::whole(&bytes, Options::default());
    assert_eq!((gaps, counters), (whole.losses().gaps, whole.counters));
}

#[test]
fn parts_end_at_the_requested_size() {
    let frames: Vec<_> = (0..50).map(|i| counted(i, 0x4020, &[0x41; 12])).collect();
    let stream = frames.concat();
    let length = frames[0].len() as u64;
    for until in [1, length, length + 1, 7 * length, 7 * length + 1] {
        let mut reader = Reader::new(Options::default(), 0);
        let window = Window { bytes: &stream, offset: 0, last: true };
        reader.read(window, until).unwrap();
        assert_eq!(reader.at(), until.div_ceil(length) * length, "{until}");
        assert_eq!(reader.take().len() as u64, until.div_ceil(length));
    }
}

/// The expected length of the input decides only how much memory columns reserve.
#[test]
fn inputs_shorter_than_expected_are_read() {
    let stream = counted(7, 0x2020, &[0x3F; 36]).repeat(3000);
    for total in [0, 1, stream.len() as u64, 1 << 30, u64::MAX] {
        let mut reader = Reader::new(Options::default(), total);
        reader.read(Window { bytes: &stream, offset: 0, last: true }, u64::MAX).unwrap();
        assert_eq!(reader.take().columns[1].rows, 3000, "{total}");
    }
}

// ---------------------------------------------------------------------------------------------
// Columns
// ---------------------------------------------------------------------------------------------

#[test]
fn rows_have_their_sample() {
    let stream = [
        counted(0, 0x4020, &[0x41; 12]),
        frame(0x42, &[4]),
        counted(1, 0x8020, &[0x42; 12]),
        sample(&[(0x4020, &[0x43; 12]), (0x4020, &[0x44; 12])]),
        counted(2, 0xF123, &[1, 2, 3]),
        counted(3, 0x4020, &[0; 5]),
    ];
    let log = read(&stream.concat());
    assert_eq!(log.subjects(), ["packet_counter", "acceleration", "rate_of_turn", "F123", "4020"]);
    assert_eq!(log.column("packet_counter").samples, [0, 1, 3, 4]);
    assert_eq!(log.column("acceleration").samples, [0, 2, 2]);
    assert_eq!(log.column("acceleration").rows[2], [Bits(0x4444_4444); 3]);
    assert_eq!(log.column("rate_of_turn").samples, [1]);
    // Unknown identifiers and wrong sizes are kept unchanged.
    assert_eq!(log.column("F123").rows, [[1, 2, 3].map(Bits)]);
    assert_eq!((&log.column("4020").samples[..], log.column("4020").rows[0].len()), (&[4][..], 5));
    assert_eq!(log.messages[0].sample, 1);
    assert_eq!(log.counters, [0, 1, -1, 2, 3]);
}

#[test]
fn columns_use_the_widest_precision() {
    #[rustfmt::skip]
    let rows: [(&str, Vec<Vec<u8>>, &str, bool); 8] = [
        ("acceleration", vec![packet(0x4020, &[0; 12]), packet(0x4020, &[1; 12])], "f4", false),
        ("acceleration", vec![packet(0x4020, &[0; 12]), packet(0x4021, &[1; 12])], "f8", true),
        ("acceleration", vec![packet(0x4022, &[0; 18]), packet(0x4020, &[1; 12])], "f8", true),
        ("acceleration", vec![packet(0x4022, &[0; 18]), packet(0x4023, &[1; 24])], "f8", true),
        ("device_id",    vec![packet(0xE080, &[0; 4]),  packet(0xE080, &[1; 4])],  "u4", false),
        ("device_id",    vec![packet(0xE080, &[0; 4]),  packet(0xE080, &[1; 8])],  "u8", false),
        ("device_id",    vec![packet(0xE080, &[0; 8]),  packet(0xE080, &[1; 4])],  "u8", false),
        ("baro_pressure", vec![packet(0x3010, &[0; 4]), packet(0x3013, &[1; 4])],  "u4", false),
    ];
    for (name, packets, numbers, mixed) in rows {
        // Rare, so that each is decoded separately, and frequent, so that each layout is learned.
        for times in [1, 3, 100] {
            let stream: Vec<u8> =
                packets.iter().flat_map(|packet| frame(table::MTDATA2, packet).repeat(times)).collect();
            let log = read(&stream);
            let column = log.column(name);
            assert_eq!((column.numbers, column.mixed_precisions), (numbers, mixed), "{name}, {times}");
            assert_eq!(column.rows.len(), 2 * times);
            assert_eq!(column.mixed_ids, packets[0][..2] != packets[1][..2], "{name}, {times}");
            assert_eq!(column.id.to_be_bytes(), packets[0][..2], "{name}, {times}");
        }
    }
}

#[test]
fn coordinate_systems_have_separate_columns() {
    let stream: Vec<u8> =
        [0x2010, 0x2014, 0x2018, 0x2010].iter().flat_map(|id| sample(&[(*id, &[0x3F; 16])])).collect();
    let log = read(&stream);
    assert_eq!(log.subjects(), ["quaternion ENU", "quaternion NED", "quaternion NWU"]);
    assert_eq!(log.column("quaternion ENU").samples, [0, 3]);
    // The fourth code is undefined, and acceleration has no coordinates whatever its bits are.
    let log = read(&[sample(&[(0x201C, &[0x3F; 16])]), sample(&[(0x4024, &[0; 12])])].concat());
    assert_eq!(log.subjects(), ["201C", "acceleration"]);
}

#[test]
fn evenly_spaced_frames_lose_no_row() {
    // Frames have equal distances, and fewer bytes than that follow the last one.
    for gap in [0, 1, 2, 50, 300] {
        for tail in [0, 1, 10, 40, 100] {
            for times in [3, 4, 5, 300] {
                let one = [vec![0; gap], counted(7, 0x4020, &[0x41; 12])].concat();
                let stream = [one.repeat(times), vec![0; tail]].concat();
                let rows = read(&stream).column("acceleration").rows.len();
                assert_eq!(rows, times, "{gap} bytes between the frames, {tail} behind the last one");
            }
        }
    }
}

#[test]
fn a_short_frame_behind_a_long_one_loses_no_row() {
    let long = sample(&[(0x1020, &[0, 1]), (0x2020, &[0x3F; 36]), (0x4020, &[0x41; 12]), (0x8020, &[0x41; 12])]);
    let short = sample(&[(0x1020, &[0, 2]), (0xE020, &[0; 4])]);
    let known = [long.clone(), short.clone()].concat().repeat(4);
    for tail in 0..100 {
        // The command has no layout, so the frames before and after are gathered separately.
        let stream = [&known[..], &frame(0x08, &[]), &long, &short, &vec![0; tail]].concat();
        assert_eq!(read(&stream).column("packet_counter").rows.len(), 10, "{tail}");
    }
}

#[test]
fn columns_of_later_parts_use_their_first_identifier() {
    // Two alternating layouts: in the second part both are known, and its first packet is 3010.
    let turn = [counted(0, 0x3010, &[0, 1, 0x86, 0xE1]), counted(1, 0x3013, &[0, 1, 0x86, 0xE2])].concat();
    let stream = turn.repeat(50);
    for fast in [false, true] {
        let mut reader = Reader::new(Options { fast, ..Options::default() }, 0);
        let window = Window { bytes: &stream, offset: 0, last: true };
        for until in [stream.len() / 2, stream.len()] {
            reader.read(window, until as u64).unwrap();
            let part = Log::of(&reader.take(), &mut Clocks::default());
            let column = part.column("baro_pressure");
            assert_eq!((column.id, column.mixed_ids), (0x3010, true), "fast: {fast}");
        }
    }
}

#[test]
fn selected_quantities_do_not_change_the_clocks() {
    let stamps = sample(&[(0x1020, &[0, 7]), (0x1060, &[0, 0, 0, 9]), (0x1070, &[0, 0, 0, 1])]);
    let measured = sample(&[(0x2010, &[0; 16]), (0x2014, &[0; 16]), (0x4020, &[0; 12]), (0xF123, &[1])]);
    let stream = [stamps, measured].concat().repeat(5);
    let whole = read(&stream);
    let kept = |wanted: &[(&str, Option<Coordinates>)]| {
        let wanted = wanted.iter().map(|&(name, system)| (quantity_named(name).unwrap(), system)).collect();
        let log = Log::whole(&stream, Options { wanted: Some(wanted), ..Options::default() });
        assert_eq!((&log.times, &log.counters, &log.offsets), (&whole.times, &whole.counters, &whole.offsets));
        for column in &log.columns {
            assert_eq!(column, whole.column(&column.subject));
        }
        log.subjects()[3..].join(", ")
    };
    assert_eq!(kept(&[]), "F123");
    assert_eq!(kept(&[("acceleration", None)]), "acceleration, F123");
    assert_eq!(kept(&[("quaternion", None)]), "quaternion ENU, quaternion NED, F123");
    assert_eq!(kept(&[("quaternion", Some(Coordinates::Ned))]), "quaternion NED, F123");
    assert_eq!(kept(&[("rate_of_turn", None)]), "F123");
}

// ---------------------------------------------------------------------------------------------
// Messages, damage, counts
// ---------------------------------------------------------------------------------------------

#[test]
fn statistics_count_everything() {
    let good = counted(1, 0x4020, &[0x41; 12]);
    let stream = [
        &good[..],
        &frame_of(1, 0x31, &[]),
        &frame(table::MTDATA2, &[]),
        &frame(table::MTDATA2, &[0x10, 0x20, 9]),
        &good,
        &[0xFA, 0xFF, 0x31, 0x00, 0xD1],
        &good,
        &[0, 0, 0],
        &extended(MASTER, table::MTDATA2, &good[4..good.len() - 1]),
    ]
    .concat();
    let log = read(&stream);
    let stats = log.stats;
    assert_eq!(stats.bytes, stream.len() as u64);
    assert_eq!((stats.frames, stats.samples, stats.messages, stats.malformed), (7, 4, 3, 2));
    assert_eq!((stats.skipped_bytes, stats.checksum_errors), (8, 1));
    let place = |damage: &Damage| (damage.offset, damage.length, damage.reason);
    let end = stream.len() as u64 - 3 - (good.len() as u64 + 2);
    let expected = [(good.len() as u64 * 2 + 5 + 5 + 8, 5, Reason::Checksum), (end, 3, Reason::NoPreamble)];
    assert_eq!(log.damage.iter().map(place).collect::<Vec<_>>(), expected);
    let messages: Vec<_> =
        log.messages.iter().map(|message| (message.mid, message.bid, message.sample, message.payload.len())).collect();
    assert_eq!(messages, [(0x31, 1, 1, 0), (0x36, 0xFF, 1, 0), (0x36, 0xFF, 1, 3)]);
    assert_eq!(log.bids, [0xFF; 4]);
    assert_eq!(log.offsets[0], 0);
    assert_eq!(log.offsets[3], end.cast_signed() + 3);
}

#[test]
fn an_empty_input_is_an_empty_log() {
    assert_eq!(read(&[]), Log::default());
}

#[test]
fn strict_readers_stop_at_the_first_fault() {
    let good = counted(1, 0x4020, &[0x41; 12]);
    let offset = 2 * good.len() as u64;
    #[rustfmt::skip]
    let rows: [(&[u8], Fault, &str); 6] = [
        (&[0x00], Fault::Damage { offset, reason: Reason::NoPreamble },
         "no frame at byte 50 (no preamble); read without strict to skip the damage"),
        (&[0xFA, 0xFF, 0x31, 0x00, 0xD1], Fault::Damage { offset, reason: Reason::Checksum },
         "no frame at byte 50 (checksum); read without strict to skip the damage"),
        (&frame(table::MTDATA2, &[]), Fault::Malformed { offset, id: None },
         "MTData2 at byte 50: its packets do not fill the message"),
        (&frame(table::MTDATA2, &[0x10]), Fault::Malformed { offset, id: None },
         "MTData2 at byte 50: its packets do not fill the message"),
        (&frame(table::MTDATA2, &[0x10, 0x20, 9]), Fault::Malformed { offset, id: Some(0x1020) },
         "MTData2 at byte 50: packet 0x1020 runs past the end of the message"),
        (&sample(&[(0xF000, &[1]), (0x4020, &[0; 5])]), Fault::Size { offset, id: 0x4020, size: 5 },
         "MTData2 at byte 50: packet 0x4020 with 5 bytes, a size that its identifier does not allow"),
    ];
    for (bytes, fault, sentence) in rows {
        let stream = [&good, &good, bytes, &good, &[0]].concat();
        for fast in [false, true] {
            let strict = Options { strict: true, fast, ..Options::default() };
            for seed in 0..20 {
                assert_eq!(Log::apart(&stream, strict.clone(), &mut Random::new(seed)).err(), Some(fault));
            }
        }
        assert_eq!(fault.to_string(), sentence);
        assert_eq!(fault.offset(), offset);
        assert_eq!(fault.data_id().is_some(), sentence.contains("packet 0x"));
        // Not strict, it is a row of some table.
        assert_eq!(read(&stream).stats.frames, if matches!(fault, Fault::Damage { .. }) { 3 } else { 4 });
    }
    let strict = Options { strict: true, ..Options::default() };
    Log::whole(&[good.clone(), sample(&[(0xF000, &[1])]), frame(0x08, &[1]), good].concat(), strict);
}

// ---------------------------------------------------------------------------------------------
// Clocks and counters
// ---------------------------------------------------------------------------------------------

/// Where the fine time of the older families wraps, in ticks of 0.1 ms; that of the others wraps at 32 bits.
const DAY: i64 = 864_000_000;
const ALL: i64 = 1 << 32;

const MTI_1: u32 = 0x0880_0001;
const MTI_30: u32 = 0x0360_08A6;
const MTI_630: u32 = 0x8000_40D2;

/// A message whose only packet is `SampleTimeFine`, cut to its 32 bits.
#[allow(clippy::cast_possible_truncation)] // as devices do
fn fine(ticks: i64) -> Vec<u8> {
    sample(&[(0x1060, &(ticks.cast_unsigned() as u32).to_be_bytes())])
}

/// A message that identifies the device.
fn device(id: u32) -> Vec<u8> {
    frame(0x01, &id.to_be_bytes())
}

/// The times of a log in ticks.
#[allow(clippy::cast_possible_truncation)] // below 2^53
fn ticks(log: &Log) -> Vec<i64> {
    log.times.iter().map(|time| (f64::from_bits(time.0) * 1e4).round() as i64).collect()
}

/// Asserts the unwrapped times of a device that sends these fine times.
fn unwrap(what: &str, id: Option<u32>, sent: &[i64], expected: &[i64]) {
    let samples = sent.iter().map(|ticks| fine(*ticks));
    let stream: Vec<u8> = id.map(device).into_iter().chain(samples).flatten().collect();
    assert_eq!(ticks(&read(&stream)), expected, "{what}");
}

#[test]
#[rustfmt::skip]
fn fine_time_is_unwrapped() {
    unwrap("no wrap",                      None,          &[0, 25, 50],               &[0, 25, 50]);
    unwrap("a day, device known",          Some(MTI_30),  &[DAY - 25, 0, 25],         &[DAY - 25, DAY, DAY + 25]);
    unwrap("32 bits, device known",        Some(MTI_630), &[ALL - 1, 24],             &[ALL - 1, ALL + 24]);
    unwrap("32 bits, another family",      Some(MTI_1),   &[ALL - 10, 15],            &[ALL - 10, ALL + 15]);
    unwrap("a day is nothing to these",    Some(MTI_630), &[DAY - 25, DAY, DAY + 25], &[DAY - 25, DAY, DAY + 25]);
    unwrap("a day, by the value before",   None,          &[DAY - 25, 0],             &[DAY - 25, DAY]);
    unwrap("32 bits, by the value before", None,          &[ALL - 25, 0],             &[ALL - 25, ALL]);
    unwrap("twice",                        Some(MTI_30),  &[DAY - 1, DAY / 2 - 1, DAY - 1, 0],
                                                          &[DAY - 1, DAY * 3 / 2 - 1, DAY * 2 - 1, DAY * 2]);
    unwrap("a small step back",            Some(MTI_30),  &[1000, 900, 1100],         &[1000, 900, 1100]);
    unwrap("back over the wrap",           Some(MTI_30),  &[DAY - 5, 5, DAY - 1, 10], &[DAY - 5, DAY + 5, DAY - 1, DAY + 10]);
    unwrap("never below zero",             Some(MTI_30),  &[10, DAY - 10],            &[10, DAY - 10]);
}

#[test]
fn identity_messages_select_the_clock_wrap() {
    let mut configuration = vec![0; 118];
    configuration[..4].copy_from_slice(&MTI_630.to_be_bytes());
    let code = |text: &str| frame(0x1D, format!("{text:<20}").as_bytes());
    let wide = u64::from(MTI_630).to_be_bytes();
    let rows = [
        (device(MTI_30), DAY),
        (device(MTI_630), ALL),
        (device(MTI_1), ALL),
        (frame(0x01, &wide), ALL),
        (frame(0x03, &MTI_630.to_be_bytes()), ALL),
        (frame(0x0D, &configuration), ALL),
        (code("MTi-30-2A5G4"), DAY),
        (code("MTi-G-710"), DAY),
        (code("MTi-680G"), ALL),
        (code("MTi-3-8A7G6"), ALL),
        // Unknown device: a wrap after a day, because the last time was within a day.
        (frame(0x42, &[4]), DAY),
        (code("something else"), DAY),
    ];
    for (naming, wrap) in rows {
        let log = read(&[naming.clone(), fine(DAY - 1), fine(0)].concat());
        // Far from the wrap this is a step back, because a step forward would be longer.
        assert_eq!(ticks(&log)[1], if wrap == DAY { DAY } else { 0 }, "{naming:02X?}");
    }
}

/// Asserts the unwrapped counters of a device, its number of missing samples and of gaps.
fn count(what: &str, sent: &[u16], expected: &[i64], missing: u64, places: u64) {
    let stream: Vec<u8> = sent.iter().flat_map(|counter| sample(&[(0x1020, &counter.to_be_bytes())])).collect();
    let log = read(&stream);
    assert_eq!(log.counters, expected, "{what}");
    assert_eq!((log.losses().samples, log.losses().gaps), (missing, places), "{what}");
}

#[test]
#[rustfmt::skip]
fn counters_are_unwrapped_and_losses_are_counted() {
    count("no loss",        &[5, 6, 7],            &[5, 6, 7],                    0, 0);
    count("the wrap",       &[65534, 65535, 0, 1], &[65534, 65535, 65536, 65537], 0, 0);
    count("one is missing", &[5, 7, 8],            &[5, 7, 8],                    1, 1);
    count("at the wrap",    &[65535, 2],           &[65535, 65538],               2, 1);
    count("two places",     &[5, 7, 17],           &[5, 7, 17],                   10, 2);
    count("an older one",   &[500, 490, 501],      &[500, 490, 501],              10, 1);
    count("the same again", &[500, 500, 501],      &[500, 500, 501],              0, 0);
}

#[test]
fn restarts_are_not_losses() {
    let counter = |it: u8| sample(&[(0x1020, &[0, it])]);
    for (mid, lost) in [(0x11, 0), (0x41, 0), (0x3E, 0), (0x31, 194)] {
        let log = read(&[counter(5), frame(mid, &[]), counter(200), counter(201)].concat());
        assert_eq!(log.losses().samples, lost, "{mid:02X}");
    }
}

#[test]
fn devices_on_a_bus_have_separate_clocks_and_counters() {
    let of = |bid, counter| frame_of(bid, table::MTDATA2, &packet(0x1020, &[0, counter]));
    let log = read(&[of(1, 5), of(2, 100), of(0xFF, 6), of(2, 101), of(1, 7)].concat());
    assert_eq!(log.losses().samples, 0);
    assert_eq!(log.counters, [5, 100, 6, 101, 7]);
    assert_eq!(log.bids, [1, 2, 0xFF, 2, 1]);
}

/// A sample with this counter and fine time.
fn stamped(counter: u16, ticks: u32) -> Vec<u8> {
    sample(&[(0x1020, &counter.to_be_bytes()), (0x1060, &ticks.to_be_bytes())])
}

fn restarts(log: &Log) -> Vec<u64> {
    log.restarts.iter().map(|restart| restart.sample).collect()
}

#[test]
fn losses_include_wraps_of_the_counter_that_the_time_shows() {
    let stamps = [(10, 1000), (11, 1100), (12, 1200), (17, 6_555_300), (18, 6_555_400)];
    let log = read(&stamps.map(|(counter, ticks)| stamped(counter, ticks)).concat());
    assert_eq!((log.losses().samples, log.losses().gaps), (65_540, 1));
    assert_eq!(log.counters, [10, 11, 12, 65_553, 65_554]);
    // A pause, after which the counter continues, is no wrap.
    let pause = [(10, 1000), (11, 1100), (12, 4_000_000), (13, 4_000_100)];
    assert_eq!(read(&pause.map(|(counter, ticks)| stamped(counter, ticks)).concat()).losses().samples, 0);
}

#[test]
fn runs_start_where_clock_and_counter_start_again() {
    let (first, second) =
        ([stamped(0x7530, 5_000_000), stamped(0x7531, 5_000_100)], [stamped(0, 6000), stamped(1, 6100)]);
    for between in [vec![], frame(0x3E, &[]), frame(0x11, &[])] {
        let log = read(&[&first.concat()[..], &between, &second.concat()].concat());
        assert_eq!((restarts(&log), log.losses().samples), (vec![2], 0), "{between:02X?}");
    }
    // The first run needs no sample before it, and a damaged stamp is no restart.
    assert_eq!(restarts(&read(&[&frame(0x3E, &[])[..], &first.concat()].concat())), [0; 0]);
    let damaged = [stamped(1, 100_000), stamped(2, 50_000), stamped(3, 100_200)].concat();
    assert_eq!(restarts(&read(&damaged)), [0; 0]);
}

#[test]
fn one_device_of_a_bus_is_as_if_alone() {
    let of = |bid, counter: u8| frame_of(bid, table::MTDATA2, &packet(0x1020, &[0, counter]));
    let (one, two) = ([of(1, 5), of(0xFF, 7)], [of(2, 100), frame_of(2, 0x42, &[4]), of(2, 101)]);
    let damage = vec![0xFA, 0xFF, 0x36]; // could be of any device
    let stream = [&one[0], &two[0], &two[1], &damage, &one[1], &two[2]].map(Clone::clone).concat();
    let one = [&one[0], &damage, &one[1]].map(Clone::clone);
    let two = [&two[0], &two[1], &damage, &two[2]].map(Clone::clone);
    let timed = |bytes: &[u8]| {
        let mut reader = Reader::new(Options::default(), 0);
        reader.read(Window { bytes, offset: 0, last: true }, u64::MAX).unwrap();
        TimedPart::take(&mut reader, &mut Clocks::default())
    };
    for (bid, alone) in [(1, one.concat()), (0xFF, one.concat()), (2, two.concat())] {
        let (found, expected) = (timed(&stream).of_device(bid, 7), timed(&alone));
        assert_eq!(found.part.stats, expected.part.stats, "{bid}");
        assert_eq!(found.part.damage, timed(&stream).part.damage, "{bid}");
        assert_eq!(found.part.bids(), expected.part.bids(), "{bid}");
        assert_eq!(found.times().counter, expected.times().counter, "{bid}");
        assert_eq!(found.times().gaps.len(), expected.times().gaps.len(), "{bid}");
        assert_eq!(found.part.first, 7);
    }
}

#[test]
fn a_rate_gives_time_to_samples_without_time_stamps() {
    let stream = [counted(100, 0x4020, &[0x41; 12]), counted(150, 0x4020, &[0x41; 12])].concat();
    let mut reader = Reader::new(Options::default(), 0);
    reader.read(Window { bytes: &stream, offset: 0, last: true }, u64::MAX).unwrap();
    let part = TimedPart::take(&mut reader, &mut Clocks::new(Some(100.0)));
    assert_eq!(part.times().time, [1.0, 1.5]);
}

#[test]
fn gnss_samples_do_not_move_the_clock() {
    let gnss = |ticks: i64| [&packet(0x7010, &[0; 94])[..], &fine(ticks)[4..11]].concat();
    let gnss = |ticks: i64| frame(table::MTDATA2, &gnss(ticks));
    let stream = [device(MTI_30), fine(DAY - 25), fine(0), gnss(DAY - 450), fine(25), gnss(3), fine(50)].concat();
    assert_eq!(ticks(&read(&stream)), [DAY - 25, DAY, DAY - 450, DAY + 25, DAY + 3, DAY + 50]);
}

#[test]
fn coarse_and_fine_time_are_combined() {
    let both = |coarse: u32, fine: u32| sample(&[(0x1060, &fine.to_be_bytes()), (0x1070, &coarse.to_be_bytes())]);
    let log = read(&[both(0, 9999), both(1, 10_000), both(500_000, 25), fine(50)].concat());
    assert_eq!(ticks(&log)[..3], [9999, 10_000, 5_000_000_025]);
    // Coarse time alone is also a time.
    assert_eq!(ticks(&read(&sample(&[(0x1070, &[0, 0, 0, 7])]))), [70_000]);
}

#[test]
fn trigger_samples_use_the_trigger_time() {
    let trigger = |id, micros: u32| sample(&[(id, &[&[9, 1][..], &micros.to_be_bytes(), &[0, 0]].concat())]);
    // The trigger guide's example: between two samples, in microseconds of the same clock.
    let log = read(&[fine(2_906_348), trigger(0x4820, 290_637_743), fine(2_906_373)].concat());
    let seconds: Vec<f64> = log.times.iter().map(|time| f64::from_bits(time.0)).collect();
    assert_eq!(seconds, [290.6348, 290.637_743, 290.6373]);
    assert_eq!(log.counters, [-1; 3]);
    // Microseconds wrap every 2^32, that is 72 minutes, and follow the clock.
    let log = read(&[fine(42_949_672), trigger(0x4810, 1_000_000)].concat());
    assert_eq!(ticks(&log)[1], (ALL + 1_000_000 + 50) / 100);
}

#[test]
fn several_triggers_in_one_sample_keep_the_clock() {
    let stamp = |micros: u32| [&[9, 1][..], &micros.to_be_bytes(), &[0, 0]].concat();
    let both = sample(&[(0x4810, &stamp(1_000_000)), (0x4820, &stamp(2_000_000))]);
    let first = sample(&[(0x4810, &stamp(3_000_000))]);
    let log = read(&[both, first].concat());
    assert_eq!(ticks(&log), [20_000, 30_000]);
}

#[test]
fn samples_without_a_stamp_have_no_time() {
    let log = read(&sample(&[(0x4040, &[0; 12])]));
    assert!(f64::from_bits(log.times[0].0).is_nan());
    assert_eq!(log.counters, [-1]);
}
