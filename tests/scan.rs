//! The three laws of the scanner, the manual's frames, and damage.

#[allow(dead_code)] // each test takes what it needs
#[path = "../fuzz/src/lib.rs"]
mod fuzz;

use proptest::prelude::*;

use fuzz::checks::scanning;
use fuzz::scans::Scan;
use fuzz::streams::{Random, extended, frame, frame_of, packet, sample, stream, string};
use xbus::frame::{Frame, MASTER, PREAMBLE};
use xbus::scan::{Reason, Scanner, Step, Window, plain};
use xbus::strings::LONGEST_STRING;
use xbus::table;

/// The limit of a log.
const LIMIT: usize = 65535;

// ---------------------------------------------------------------------------------------------
// The manual's frames
// ---------------------------------------------------------------------------------------------

/// A line of `spec/frames.txt`.
struct Printed {
    name: &'static str,
    mid: u8,
    payload: Vec<u8>,
    wire: Vec<u8>,
}

fn printed() -> Vec<Printed> {
    let lines = include_str!("spec/frames.txt").lines().filter(|line| !line.is_empty() && !line.starts_with('#'));
    let frames: Vec<_> = lines
        .map(|line| {
            let columns: Vec<_> = line.split("  ").map(str::trim).filter(|column| !column.is_empty()).collect();
            let [name, mid, payload, wire] = columns[..] else { panic!("{line}") };
            Printed { name, mid: hex(mid)[0], payload: hex(payload), wire: hex(wire) }
        })
        .collect();
    assert!(frames.len() > 20);
    frames
}

/// Bytes as printed; `-` means no bytes.
fn hex(text: &str) -> Vec<u8> {
    text.split(' ').filter(|byte| *byte != "-").map(|byte| u8::from_str_radix(byte, 16).expect(text)).collect()
}

#[test]
fn printed_frames_are_encoded_as_printed() {
    for Printed { name, mid, payload, wire } in printed() {
        assert_eq!(frame(mid, &payload), wire, "{name}");
        assert!(table::messages(mid).any(|message| message.name == name), "{name}");
    }
}

#[test]
fn printed_frames_are_decoded_in_every_chunking() {
    for Printed { name, mid, payload, wire } in printed() {
        let expected = Scan { frames: vec![(0, wire.len())], ..Scan::default() };
        assert_eq!(Scan::plainly(&wire, LIMIT), expected, "{name}");
        assert_eq!(Scan::whole(&wire, LIMIT), expected, "{name}");
        assert_eq!(Scan::byte_by_byte(&wire, LIMIT), expected, "{name}");
        for cut in 0..wire.len() {
            assert_eq!(in_two(&wire, cut), expected, "{name} cut at {cut}");
        }
        assert_eq!(Frame::of(&wire), Frame { bid: MASTER, mid, payload: &payload }, "{name}");
    }
}

/// First the bytes up to `cut`, then the rest.
fn in_two(bytes: &[u8], cut: usize) -> Scan {
    let mut ends = [cut, bytes.len()].into_iter();
    Scan::in_windows(bytes, LIMIT, |at| at..ends.next().unwrap_or(bytes.len()))
}

#[test]
fn printed_frames_are_found_back_to_back() {
    let wires: Vec<_> = printed().into_iter().map(|frame| frame.wire).collect();
    let stream = wires.concat();
    let expected = Scan { frames: places(&wires), ..Scan::default() };
    assert_eq!(Scan::plainly(&stream, LIMIT), expected);
    assert_eq!(Scan::byte_by_byte(&stream, LIMIT), expected);
    for cut in 0..stream.len() {
        assert_eq!(in_two(&stream, cut), expected);
    }
}

/// Offsets and lengths.
fn places(wires: &[Vec<u8>]) -> Vec<(usize, usize)> {
    let mut end = 0;
    let mut place = |wire: &Vec<u8>| {
        end += wire.len();
        (end - wire.len(), wire.len())
    };
    wires.iter().map(&mut place).collect()
}

#[test]
fn printed_frames_are_found_after_noise() {
    // Messages of the host are implausible: in noise they are accepted only between plausible frames.
    let before = frame(0x31, &[]);
    let noises = [
        Random::new(1).noise(80),
        Random::new(2).noise(80),
        vec![PREAMBLE; 80],
        vec![0; 80],
        printed().into_iter().flat_map(|frame| frame.wire).take(300).collect(),
    ];
    for noise in noises {
        for length in 0..=noise.len() {
            // Frames found in the noise do not matter; the noise must not affect what follows.
            let noise = [&noise[..length], &[PREAMBLE, 0, 0]].concat();
            let step = if length % 10 == 0 { 1 } else { 7 };
            for Printed { name, wire, .. } in printed().into_iter().skip(length % step).step_by(step) {
                let stream = [&noise[..], &before, &wire, &before].concat();
                let scan = Scan::whole(&stream, LIMIT);
                let at = noise.len() + before.len();
                assert!(scan.frames.contains(&(at, wire.len())), "{name} behind {noise:02X?}");
                scan.covers(&stream);
            }
        }
    }
}

// ---------------------------------------------------------------------------------------------
// First law: chunking does not matter
// ---------------------------------------------------------------------------------------------

/// Failing inputs go to `fuzz/corpus`, where every toolchain replays them.
fn cases(cases: u32) -> ProptestConfig {
    ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() }
}

proptest! {
    #![proptest_config(cases(150))]

    /// Frames, damage, host messages, odd and extended frames in any order.
    #[test]
    fn chunked_streams_match_the_reference_scanner(
        recipe in prop::collection::vec(any::<u8>(), 0..60),
        limit in prop::sample::select(vec![16, 254, 255, 8185, LIMIT]),
        seed: u64,
    ) {
        let mut random = Random::new(seed);
        scanning(&stream(&recipe, 3000, &mut random), limit, &mut random);
    }
}

proptest! {
    #![proptest_config(cases(500))]

    #[test]
    fn chunked_random_bytes_match_the_reference_scanner(
        bytes in prop::collection::vec(any::<u8>(), 0..300),
        seed: u64,
    ) {
        scanning(&bytes, LIMIT, &mut Random::new(seed));
    }

    /// Only bytes that occur in headers.
    #[test]
    fn chunked_hostile_bytes_match_the_reference_scanner(
        bytes in prop::collection::vec(prop::sample::select(vec![0xFA, 0xFF, 0x36, 0x31, 0x00, 0x01, 0x03, 0xE0, 0x20]), 0..200),
        limit in prop::sample::select(vec![0, 1, 16, 254, 255, 256, LIMIT]),
        seed: u64,
    ) {
        scanning(&bytes, limit, &mut Random::new(seed));
    }
}

proptest! {
    #![proptest_config(cases(300))]

    /// Strings of all kinds, whole and damaged, among frames and noise.
    #[test]
    fn chunked_strings_match_the_reference_scanner(
        kinds in prop::collection::vec(0_usize..20, 0..40),
        limit in prop::sample::select(vec![16, 254, LIMIT]),
        seed: u64,
    ) {
        let mut random = Random::new(seed);
        let piece = |kind: usize, random: &mut Random| match kind {
            17 => random.noise(20),
            18 => frame(0xB2, b"odd"),
            19 => frame(0x31, &[]),
            place => string(place, random),
        };
        let stream: Vec<u8> = kinds.into_iter().flat_map(|kind| piece(kind, &mut random)).collect();
        scanning(&stream, limit, &mut random);
    }

    /// Only bytes that occur in strings.
    #[test]
    fn chunked_string_pieces_match_the_reference_scanner(
        bytes in prop::collection::vec(prop::sample::select(b"$:*ABPRDI,-.0 \r\nHF\x00\x90\xFA\xFF".to_vec()), 0..400),
        seed: u64,
    ) {
        let enabled = frame(table::STRING_OUTPUT_TYPE, &[0xFF, 0xFF]);
        scanning(&bytes, LIMIT, &mut Random::new(seed));
        scanning(&[enabled, bytes].concat(), LIMIT, &mut Random::new(seed));
    }
}

#[test]
fn strings_have_a_maximum_length() {
    for length in 240..270 {
        let body = format!("PX,{}", "0".repeat(length - "$PX,*hh\r\n".len()));
        let sum = body.bytes().fold(0, |sum, byte| sum ^ byte);
        let wire = format!("${body}*{sum:02X}\r\n").into_bytes();
        assert_eq!(wire.len(), length);
        let scan = Scan::whole(&wire, LIMIT);
        assert_eq!(scan, Scan::plainly(&wire, LIMIT));
        assert_eq!(scan, Scan::byte_by_byte(&wire, LIMIT));
        if length <= LONGEST_STRING {
            assert_eq!(scan.strings, [(0, length, None)]);
        } else {
            assert_eq!((scan.strings.len(), scan.damage[0].reason), (0, Reason::TooLong));
        }
    }
}

#[test]
fn em1000_is_accepted_only_where_expected() {
    let wire = [0x00, 0x90, 0x7B, 0x00, 0x38, 0xFE, 0x00, 0x00, 0x39, 0x30];
    let window = Window { bytes: &wire, offset: 0, last: true };
    let mut scanner = Scanner::new(LIMIT);
    assert!(matches!(scanner.step(window), Step::End(Some(_))));
    let mut scanner = Scanner::new(LIMIT);
    scanner.expect(u32::MAX);
    assert_eq!(scanner.step(window), Step::String { at: 0, length: 10, place: Some(5), damage: None });
    assert_eq!(plain::scan(&wire, LIMIT, table::BARE_STRINGS).strings, [(0, 10, Some(5))]);
}

#[test]
fn incomplete_headers_wait() {
    let wire = extended(MASTER, 0x31, &[]);
    for length in 0..wire.len() {
        let mut scanner = Scanner::new(LIMIT);
        assert_eq!(scanner.step(Window { bytes: &wire[..length], offset: 0, last: false }), Step::More, "{length}");
        assert_eq!(scanner.at(), 0);
    }
}

#[test]
fn false_headers_do_not_delay_decided_bytes() {
    let good = frame(0x31, &[]);
    // In damage, so that only plausibility counts.
    let waits = |header: &[u8], more: usize| {
        let bytes = [&[0], header, &good, &vec![0; more]].concat();
        let step = Scanner::new(LIMIT).step(Window { bytes: &bytes, offset: 0, last: false });
        assert!(step == Step::More || matches!(step, Step::Frame { at, .. } if at == 1 + header.len()));
        step == Step::More
    };
    // Rejected by the header: unknown bus identifier, a command, an invalid length, too long.
    assert!(!waits(&[0xFA, 0x40, 0x36, 0x80], 0));
    assert!(!waits(&[0xFA, 0xFF, 0x30, 0x00], 0));
    assert!(!waits(&[0xFA, 0xFF, 0x31, 0x80], 0));
    assert!(!waits(&[0xFA, 0xFF, 0x36, 0x00], 0));
    // Rejected by a packet once received: an acceleration has 12 bytes, and no packet exceeds the payload.
    assert!(!waits(&[0xFA, 0xFF, 0x36, 0x80, 0x40, 0x20, 0x0D], 8));
    assert!(!waits(&[0xFA, 0xFF, 0x36, 0x80, 0x40, 0x20, 0x7E], 0));
    assert!(!waits(&[0xFA, 0xFF, 0x36, 0x08, 0x10, 0x20, 0x02, 0x00, 0x00, 0x10, 0x20], 0));
    // Only the checksum is wrong, which requires all claimed bytes.
    assert!(waits(&[0xFA, 0xFF, 0x36, 0x80, 0x40, 0x20, 0x0C], 0));
    assert!(waits(&[0xFA, 0xFF, 0x36, 0x0F, 0x40, 0x20, 0x0C], 7));
    assert!(!waits(&[0xFA, 0xFF, 0x36, 0x0F, 0x40, 0x20, 0x0C], 8));
}

// ---------------------------------------------------------------------------------------------
// Second law: after a false start the scan continues one byte further
// ---------------------------------------------------------------------------------------------

#[test]
fn truncated_frames_do_not_hide_the_next_frame() {
    for Printed { name, wire, .. } in printed() {
        for length in 1..wire.len() {
            let rest = [frame(0x42, &[4]), wire.clone(), frame(0x31, &[])];
            let stream = [&wire[..length], &rest.concat()].concat();
            let scan = Scan::whole(&stream, LIMIT);
            assert_eq!((scan.damage[0].offset, scan.damage[0].length), (0, length as u64), "{name}");
            let found: Vec<_> = scan.frames.iter().map(|&(at, length)| &stream[at..at + length]).collect();
            assert_eq!(found, rest, "{name}, {length} bytes of it");
        }
    }
}

#[test]
fn wrong_lengths_hide_no_frame() {
    let frames: Vec<_> = (0..40).map(|i| sample(&[(0x1020, &[0, i]), (0xE020, &[0, 0, 0, i])])).collect();
    let true_stream = frames.concat();
    for length in 0..=u8::MAX {
        let mut stream = true_stream.clone();
        stream[3] = length;
        let expected = places(&frames);
        let expected = if stream == true_stream { &expected[..] } else { &expected[1..] };
        assert_eq!(Scan::whole(&stream, LIMIT).frames, expected, "{length}");
    }
}

// ---------------------------------------------------------------------------------------------
// Third law: an intact frame is not lost to adjacent damage
// ---------------------------------------------------------------------------------------------

/// One device message of each kind: standard and extended, samples and replies.
fn answers() -> Vec<Vec<u8>> {
    let long: Vec<u8> =
        (0..30).flat_map(|i| packet(0x1060, &[0, 0, 1, i])).chain(packet(0x2023, &[0x3F; 72])).collect();
    vec![
        sample(&[(0x1020, &[0xDF, 0xC5]), (0x4020, &[0x41; 12]), (0xE020, &[0, 0, 0, 3])]),
        sample(&[(0x1020, &[0xDF, 0xC6]), (0x4020, &[0x42; 12]), (0xE020, &[0, 0, 0, 3])]),
        frame(0x31, &[]),
        frame(0x01, &[0x03, 0x60, 0x08, 0xA6]),
        extended(MASTER, table::MTDATA2, &long),
        frame_of(1, 0x42, &[0x28, 0, 0, 0, 1]),
        sample(&[(0x1020, &[0xDF, 0xC7]), (0x4020, &[0x43; 12]), (0xE020, &[0, 0, 0, 3])]),
    ]
}

#[test]
fn one_flipped_bit_loses_one_frame() {
    let frames = answers();
    let places = places(&frames);
    let stream = frames.concat();
    for bit in 0..8 * stream.len() {
        let mut stream = stream.clone();
        stream[bit / 8] ^= 1 << (bit % 8);
        let scan = Scan::whole(&stream, LIMIT);
        let intact = places.iter().filter(|&&(at, length)| bit / 8 < at || at + length <= bit / 8);
        assert!(scan.frames.iter().eq(intact), "bit {} of byte {}: {scan:?}", bit % 8, bit / 8);
        assert_eq!(scan, Scan::plainly(&stream, LIMIT));
        assert_eq!(scan, Scan::byte_by_byte(&stream, LIMIT));
    }
}

#[test]
fn one_missing_or_extra_byte_loses_one_frame() {
    let frames = answers();
    let places = places(&frames);
    let stream = frames.concat();
    let texts = |bytes: &[u8]| -> Vec<Vec<u8>> {
        Scan::whole(bytes, LIMIT).frames.iter().map(|&(at, length)| bytes[at..at + length].to_vec()).collect()
    };
    for byte in 0..stream.len() {
        let hit = places.iter().position(|&(at, length)| byte < at + length).unwrap();
        let mut less = stream.clone();
        less.remove(byte);
        let mut expected = frames.clone();
        expected.remove(hit);
        assert_eq!(texts(&less), expected, "without byte {byte}");
        let mut more = stream.clone();
        more.insert(byte, 0xAA);
        let expected = if byte == places[hit].0 { &frames } else { &expected };
        assert_eq!(texts(&more), *expected, "one more byte at {byte}");
    }
}

#[test]
fn unknown_messages_are_accepted_between_frames() {
    let good = frame(0x31, &[]);
    let odd = [
        ("a message without a row", frame(0x08, &[1, 2, 3])),
        ("a command", frame(0x30, &[])),
        ("a length that its row rules out", frame(0x31, &[0])),
        ("no such bus", frame_of(0x77, 0x31, &[])),
        ("the broadcast bus", frame_of(0x00, 0x31, &[])),
        ("a packet of a size that its identifier rules out", sample(&[(0x4020, &[0; 5])])),
        ("packets that do not tile", frame(table::MTDATA2, &[0x10, 0x20, 3, 0, 0])),
        ("an empty MTData2", frame(table::MTDATA2, &[])),
        ("15 kB that the manual never mentions", frame(0x92, &[7; 15_000])),
    ];
    for (what, odd) in odd {
        let frames = [good.clone(), odd.clone(), odd.clone(), good.clone()];
        let sound = Scan { frames: places(&frames), ..Scan::default() };
        assert_eq!(Scan::whole(&frames.concat(), LIMIT), sound, "{what}");
        // Also alone, because the input begins and ends with the frame.
        assert_eq!(Scan::whole(&odd, LIMIT).frames, [(0, odd.len())], "{what}");
        // Rejected with damage before or after the frame.
        let behind = Scan::whole(&[&good[..], &[0], &odd, &good].concat(), LIMIT);
        assert_eq!(behind.frames, [(0, 5), (6 + odd.len(), 5)], "{what}");
        assert_eq!(behind.damage[0].reason, Reason::NoPreamble, "{what}");
        let before = Scan::whole(&[&good[..], &odd, &[0], &good].concat(), LIMIT);
        assert_eq!(before.frames, [(0, 5), (6 + odd.len(), 5)], "{what}");
        assert_eq!(before.damage[0].reason, Reason::Implausible, "{what}");
        assert_eq!(before.checksum_errors, 0, "{what}");
    }
}

#[test]
fn device_messages_are_accepted_anywhere() {
    let plausible = [
        frame(0x31, &[]),
        frame_of(1, 0x31, &[]),
        frame_of(31, 0x31, &[]),
        extended(MASTER, 0x31, &[]),
        frame(0x3E, &[]),
        frame(0x01, &[0, 0, 0, 0, 0x80, 0, 0x40, 0xD2]),
        frame(0x42, &[4]),
        sample(&[(0x4020, &[0; 12])]),
        sample(&[(0x3013, &[0, 1, 0x86, 0xE1])]),
        sample(&[(0xF123, &[0; 7])]),
        sample(&[(0x7020, &[0, 0, 0, 0, 1, 0, 0, 0, 0, 5, 22, 20])]),
        extended(MASTER, table::MTDATA2, &packet(0x1020, &[0, 1])),
        frame(0x91, &[0x55; 1320]),
    ];
    for wire in plausible {
        let noise = [0; 3];
        let stream = [&noise[..], &wire, &noise].concat();
        let scan = Scan::whole(&stream, LIMIT);
        assert_eq!(scan.frames, [(3, wire.len())], "{wire:02X?}");
        assert_eq!(scan, Scan::plainly(&stream, LIMIT));
        assert_eq!(scan, Scan::byte_by_byte(&stream, LIMIT));
    }
}

// ---------------------------------------------------------------------------------------------
// Damage
// ---------------------------------------------------------------------------------------------

#[test]
fn damage_has_the_reason_at_its_first_byte() {
    use Reason::{Checksum, Implausible, NoPreamble, TooLong, Truncated};
    let good = frame(0x31, &[]);
    let rows: [(&[u8], Reason, u64); 9] = [
        (&[0x00], NoPreamble, 0),
        (&[0x00, 0xFA, 0xFF], NoPreamble, 0),
        (&[0xFA, 0xFF, 0x31, 0x00, 0xD1], Checksum, 1),
        (&[0xFA, 0xFF, 0x31, 0x00, 0xD1, 0xFA, 0xFF, 0x31, 0x00, 0xD1], Checksum, 1),
        (&[0xFA, 0xFF, 0x36, 0xFF, 0x04, 0x01], TooLong, 0),
        (&[0xFA, 0xFF, 0x36, 0xFF, 0x04, 0x00], Truncated, 0),
        (&[0xFA, 0xFF, 0x36, 0x20], Truncated, 0),
        (&[0xFA, 0xFF, 0x30, 0x00, 0xD1, 0x00], Implausible, 0),
        (&[0xFA, 0xFF, 0x36, 0x00, 0xCB, 0x00], Implausible, 0),
    ];
    for (bytes, reason, checksum_errors) in rows {
        let stream = [&good[..], bytes, &good].concat();
        let scan = Scan::whole(&stream, 1024);
        assert_eq!(scan.frames, [(0, 5), (5 + bytes.len(), 5)], "{bytes:02X?}");
        let [damage] = scan.damage[..] else { panic!("{bytes:02X?}: {:?}", scan.damage) };
        assert_eq!((damage.offset, damage.length, damage.reason), (5, bytes.len() as u64, reason), "{bytes:02X?}");
        assert_eq!(scan.checksum_errors, checksum_errors, "{bytes:02X?}");
        scan.covers(&stream);
    }
}

#[test]
fn frames_cut_by_the_end_of_input_are_damage() {
    let wire = sample(&[(0x1020, &[0, 7]), (0x4020, &[0x41; 12])]);
    for length in 1..wire.len() {
        let scan = Scan::whole(&[&wire[..], &wire[..length]].concat(), LIMIT);
        assert_eq!(scan.frames, [(0, wire.len())]);
        let [damage] = scan.damage[..] else { panic!("{:?}", scan.damage) };
        assert_eq!((damage.length, damage.reason), (length as u64, Reason::Truncated));
    }
}

#[test]
fn empty_input_is_valid() {
    assert_eq!(Scan::whole(&[], LIMIT), Scan::default());
    assert_eq!(Scan::plainly(&[], LIMIT), Scan::default());
    assert_eq!(Reason::ALL.map(Reason::name).len(), Reason::ALL.len());
}

// ---------------------------------------------------------------------------------------------
// Lengths
// ---------------------------------------------------------------------------------------------

#[test]
fn extended_frames_accept_any_length() {
    for length in [0, 1, 3, 253, 254, 255, 256, 511, 512, 2048, 8185, 65534, 65535] {
        let payload = vec![0x55; length];
        for wire in [frame(0x08, &payload), extended(MASTER, 0x08, &payload)] {
            let scan = Scan::whole(&wire, LIMIT);
            assert_eq!(scan.frames, [(0, wire.len())], "{length}");
            assert_eq!(Frame::of(&wire).payload, payload, "{length}");
        }
    }
    // The encoder uses one byte of length whenever possible.
    assert_eq!(frame(0x08, &[0; 254])[..4], [0xFA, 0xFF, 0x08, 0xFE]);
    assert_eq!(frame(0x08, &[0; 255])[..6], [0xFA, 0xFF, 0x08, 0xFF, 0x00, 0xFF]);
    assert_eq!(extended(MASTER, 0x08, &[0; 255]), frame(0x08, &[0; 255]));
}

#[test]
fn the_limit_is_inclusive() {
    for limit in [0, 1, 253, 254, 255, 300, 65534] {
        let (fits, too_long) = (frame(0x08, &vec![0; limit]), frame(0x08, &vec![0; limit + 1]));
        assert_eq!(Scan::whole(&fits, limit).frames, [(0, fits.len())], "{limit}");
        let scan = Scan::whole(&too_long, limit);
        assert_eq!((scan.frames.len(), scan.damage[0].reason), (0, Reason::TooLong), "{limit}");
        assert_eq!(scan, Scan::plainly(&too_long, limit));
    }
}

#[test]
fn payloads_beyond_16_bits_are_rejected() {
    let error = Frame { bid: MASTER, mid: 0x08, payload: &vec![0; 65536] }.encode().unwrap_err();
    assert_eq!(error.to_string(), "a payload of 65536 bytes does not fit into a frame; its length has 16 bits");
}

// ---------------------------------------------------------------------------------------------
// Attacks: hostile input takes no more time than other input
// ---------------------------------------------------------------------------------------------

/// Long enough for a quadratic algorithm to run for minutes.
const MUCH: usize = 1 << 20;

#[test]
fn hostile_input_is_scanned_in_linear_time() {
    let claims = |length: u16| {
        let [high, low] = length.to_be_bytes();
        [0xFA, 0xFF, 0x36, 0xFF, high, low]
    };
    let attacks: [(&str, Vec<u8>); 7] = [
        ("nothing but preambles", vec![PREAMBLE; 6]),
        ("headers that claim a short frame", vec![0xFA, 0xFF, 0x36, 0xFE]),
        ("headers that claim 8192 bytes", claims(8192).to_vec()),
        ("headers that claim all there can be", claims(65535).to_vec()),
        ("the same, and packets to walk", [&claims(65535)[..], &[0xF0, 0x00, 0x00].repeat(3)].concat()),
        ("headers that are packets", [&claims(65535)[..], &[0x00]].concat()),
        ("opaque data that claims all there can be", vec![0xFA, 0xFF, 0x91, 0xFF, 0x1F, 0xF9]),
    ];
    let good = frame(0x31, &[]);
    for (what, piece) in attacks {
        let mut stream = piece.repeat(MUCH / piece.len());
        let end = stream.len();
        stream.extend(&good);
        let scan = Scan::whole(&stream, LIMIT);
        assert_eq!(scan.frames.last(), Some(&(end, good.len())), "{what}");
        scan.covers(&stream);
        assert_eq!(Scan::at_random(&stream, LIMIT, &mut Random::new(9)), scan, "{what}");
    }
}

#[test]
fn messages_after_hostile_input_are_found() {
    // Checking the packets of extended candidates uses a budget, which such input exhausts. Later bytes restore it.
    let attack = [0xFA, 0xFF, 0x36, 0xFF, 0xFF, 0xFF, 0xF0, 0x00, 0x00].repeat(10_000);
    let packets = packet(0x2010, &[0x3F; 16]).repeat(1000);
    let long = extended(MASTER, table::MTDATA2, &packets);
    let stream = [&attack[..], &vec![0; 1 << 16], &long].concat();
    let scan = Scan::whole(&stream, LIMIT);
    assert_eq!(scan.frames, [(stream.len() - long.len(), long.len())]);
    // In step only the frame's own packets use the budget.
    let short = frame(0x31, &[]);
    let stream = [&attack[..], &short, &extended(MASTER, table::MTDATA2, &packets[..19])].concat();
    assert_eq!(Scan::whole(&stream, LIMIT).frames.len(), 2);
}
