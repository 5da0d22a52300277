//! Packets to numbers and back: the manual's, every quantity's, and those that the encoder must refuse.

#[allow(dead_code)] // each test takes what it needs
#[path = "../fuzz/src/lib.rs"]
mod fuzz;

use proptest::prelude::*;
use proptest::sample::{Index, select};

use fuzz::checks::rewrite;
use fuzz::streams;
use xbus::error::EncodeError;
use xbus::packet::{Coordinates, Form, Overrun, Packet, Precision, packets};
use xbus::table::{Kind, QUANTITIES, Quantity, Wire, quantity_named};
use xbus::value::{Number, is_canonical, numbers, write_as, write_packet};

// ---------------------------------------------------------------------------------------------
// The manual's numbers
// ---------------------------------------------------------------------------------------------

/// A line of `spec/items.txt`.
struct Item {
    line: &'static str,
    id: u16,
    quantity: &'static Quantity,
    precision: Option<Precision>,
    coordinates: Option<Coordinates>,
    data: Vec<u8>,
    values: Vec<&'static str>,
}

fn items() -> Vec<Item> {
    let lines = include_str!("spec/items.txt").lines().filter(|line| !line.is_empty() && !line.starts_with('#'));
    let items: Vec<_> = lines
        .map(|line| {
            let columns: Vec<_> = line.split('|').map(str::trim).collect();
            let [id, quantity, precision, coordinates, data, values] = columns[..] else { panic!("{line}") };
            let digits: String = data.split(' ').collect();
            let byte = |at: usize| u8::from_str_radix(&digits[at..at + 2], 16).expect(line);
            Item {
                line,
                id: u16::from_str_radix(id, 16).expect(line),
                quantity: quantity_named(quantity).expect(line),
                precision: Precision::ALL.into_iter().find(|known| known.name() == precision),
                coordinates: Coordinates::ALL.into_iter().find(|known| known.name() == coordinates),
                data: (0..digits.len()).step_by(2).map(byte).collect(),
                values: values.split(' ').collect(),
            }
        })
        .collect();
    assert!(items.len() > 50);
    items
}

/// Whether a number equals the text, to the last bit.
fn is(number: Number, text: &str) -> bool {
    match number {
        Number::Integer(value) => text.parse() == Ok(value),
        Number::Wide(value) => text.parse() == Ok(value),
        Number::Single(value) => text.parse::<f32>().is_ok_and(|parsed| parsed.to_bits() == value.to_bits()),
        Number::Double(value) => text.parse::<f64>().is_ok_and(|parsed| parsed.to_bits() == value.to_bits()),
    }
}

#[test]
fn printed_packets_decode_to_the_printed_numbers() {
    for Item { line, id, quantity, precision, coordinates, data, values } in items() {
        let reading = Packet { id, at: 0, data: &data }.reading().expect(line);
        assert_eq!(reading.quantity.id, quantity.id, "{line}");
        assert_eq!(reading.coordinates, coordinates, "{line}");
        let found = match reading.form {
            Form::Real(precision, _) => Some(precision),
            _ => None,
        };
        assert_eq!(found, precision, "{line}");
        let numbers = numbers(&reading, &data);
        assert_eq!(numbers.len(), values.len(), "{line}");
        for (number, text) in numbers.into_iter().zip(values) {
            assert!(is(number, text), "{number:?} in {line}");
        }
    }
}

#[test]
fn printed_numbers_encode_to_the_printed_packets() {
    for Item { line, id, quantity, precision, coordinates, data, values } in items() {
        // Numbers as a user types them: integers if they look like integers, doubles otherwise.
        let wide = matches!(quantity.kind, Kind::Id) && data.len() == 8;
        let number = |text: &&str| match (text.parse(), text.parse()) {
            (_, Ok(value)) if wide => Number::Wide(value),
            (Ok(value), _) if *text != "-0" => Number::Integer(value),
            (_, Ok(value)) => Number::Wide(value),
            _ => Number::Double(text.parse().expect(line)),
        };
        let numbers: Vec<_> = values.iter().map(number).collect();
        let mut payload = vec![];
        write_packet(&mut payload, quantity, precision, coordinates, &numbers).expect(line);
        let canonical = is_canonical(&Packet { id, at: 0, data: &data });
        assert_eq!(canonical, id != 0x3013, "{line}");
        let id = if canonical { id } else { quantity.id };
        assert_eq!(payload, streams::packet(id, &data), "{line}");
    }
}

// ---------------------------------------------------------------------------------------------
// Every quantity
// ---------------------------------------------------------------------------------------------

/// A packet of any quantity that the encoder could have written.
fn canonical() -> impl Strategy<Value = (u16, Vec<u8>)> {
    let format = (select(&Precision::ALL[..]), select(&Coordinates::ALL[..]), 0..=61_usize, any::<bool>());
    (select(QUANTITIES), format).prop_flat_map(|(quantity, (precision, coordinates, entries, wide))| {
        let real = matches!(quantity.kind, Kind::Real(_));
        let id = quantity.id
            | if real { precision as u16 } else { 0 }
            | if quantity.rotates { coordinates.bits() } else { 0 };
        let size = streams::size(&quantity, precision, entries, wide);
        // Any bytes, and those that are rare among them: NaN, infinities, zeros, ends of ranges.
        let byte = prop_oneof![3 => any::<u8>(), 1 => select(vec![0x00, 0xFF, 0x7F, 0x80, 0xF8])];
        (
            Just(id),
            prop::collection::vec(byte, size).prop_map(move |mut data| {
                if let Kind::List(head, _) = quantity.kind {
                    data[head[0].wire.size()] = u8::try_from(entries).unwrap();
                }
                data
            }),
        )
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 3000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn decoded_packets_encode_to_the_same_bytes((id, data) in canonical()) {
        let packet = Packet { id, at: 0, data: &data };
        prop_assert!(is_canonical(&packet));
        let reading = packet.reading().unwrap();
        let mut payload = vec![];
        write_as(&mut payload, &reading, &numbers(&reading, &data)).unwrap();
        prop_assert_eq!(payload, streams::packet(id, &data));
    }

    /// Unused format bits are ignored when decoding, and are not encoded.
    #[test]
    fn unused_format_bits_are_ignored((id, data) in canonical(), bits in 0u16..16) {
        rewrite(&Packet { id: id | bits, at: 0, data: &data });
        let plain = Packet { id, at: 0, data: &data }.reading().unwrap();
        if !matches!(plain.form, Form::Real(..)) {
            let idle = Packet { id: id | bits, at: 0, data: &data }.reading();
            let undefined = plain.quantity.rotates && Coordinates::of(id | bits).is_none();
            prop_assert!(undefined || idle.unwrap().form == plain.form);
        }
    }

    /// A packet whose size does not fit its identifier is kept unchanged, never guessed.
    #[test]
    fn packets_of_wrong_size_are_not_decoded((id, data) in canonical(), size in 0usize..256) {
        let other: Vec<u8> = data.iter().copied().cycle().chain(std::iter::repeat(0)).take(size).collect();
        let packet = Packet { id, at: 0, data: &other };
        if size != data.len() {
            match packet.reading().map(|reading| reading.form) {
                None => prop_assert!(!packet.is_sound()),
                // Device identifiers have two sizes, and lists have one for each count.
                Some(form) => prop_assert!(matches!(form, Form::Fixed(Wire::U4 | Wire::U8, 1) | Form::List(..))),
            }
        }
    }

    #[test]
    fn packets_fill_their_payload(all in prop::collection::vec(canonical(), 0..8), cut: Index) {
        let payload: Vec<u8> = all.iter().flat_map(|(id, data)| streams::packet(*id, data)).collect();
        let found: Vec<_> = packets(&payload).map(|packet| packet.map(|packet| (packet.id, packet.data.to_vec()))).collect();
        prop_assert_eq!(found, all.iter().cloned().map(Ok).collect::<Vec<_>>());
        // In a truncated payload all packets but the last are the same, and the error has the offset of the last.
        let cut = cut.index(payload.len() + 1);
        let mut end = 0;
        for packet in packets(&payload[..cut]) {
            match packet {
                Ok(packet) => {
                    prop_assert_eq!(packet.at, end);
                    end += 3 + packet.data.len();
                }
                Err(Overrun { at, id }) => {
                    prop_assert_eq!(at, end);
                    prop_assert_eq!(id.is_some(), cut - at >= 2);
                    end = cut;
                }
            }
        }
        prop_assert_eq!(end, cut);
    }

    /// A number is rounded to its precision, and saturates out of range.
    #[test]
    #[allow(clippy::cast_possible_truncation)] // to a Float32
    fn encoded_numbers_decode_within_the_resolution(value: f64, small in -40_000.0..40_000.0, which: bool) {
        let value = if which { value } else { small };
        let [float32, fp1220, fp1632, float64] = Precision::ALL.map(|precision| through(precision, value));
        prop_assert_eq!(float64.to_bits(), value.to_bits());
        prop_assert_eq!(float32.to_bits(), f64::from(value as f32).to_bits());
        for (read, one, range) in [(fp1220, 2f64.powi(20), 2f64.powi(11)), (fp1632, 2f64.powi(32), 2f64.powi(15))] {
            let inside = value.clamp(-range, range - 1.0 / one);
            prop_assert!((read - inside).abs() <= 0.5 / one, "{} for {}", read, value);
        }
    }
}

/// Writes one number and reads it again.
fn through(precision: Precision, value: f64) -> f64 {
    let temperature = quantity_named("temperature").unwrap();
    let mut payload = vec![];
    write_packet(&mut payload, temperature, Some(precision), None, &[Number::Double(value)]).unwrap();
    let packet = packets(&payload).next().unwrap().unwrap();
    match numbers(&packet.reading().unwrap(), packet.data)[..] {
        [Number::Single(value)] => value.into(),
        [Number::Double(value)] => value,
        ref other => panic!("{other:?}"),
    }
}

#[test]
fn nan_bits_are_preserved() {
    let acceleration = quantity_named("acceleration").unwrap();
    for data in ["7FC00000 7F800001 FFBFFFFF", "FFC12345 7FA00000 FF800001"] {
        let bits: Vec<u32> = data.split(' ').map(|digits| u32::from_str_radix(digits, 16).unwrap()).collect();
        let numbers: Vec<_> = bits.iter().map(|bits| Number::Single(f32::from_bits(*bits))).collect();
        let mut payload = vec![];
        write_packet(&mut payload, acceleration, None, None, &numbers).unwrap();
        let data: Vec<u8> = bits.iter().flat_map(|bits| bits.to_be_bytes()).collect();
        assert_eq!(payload, streams::packet(0x4020, &data));
        rewrite(&Packet { id: 0x4020, at: 0, data: &data });
    }
    let signalling = 0xFFF4_0000_0000_0001_u64.to_be_bytes().repeat(3);
    rewrite(&Packet { id: 0x4023, at: 0, data: &signalling });
}

#[test]
fn fixed_point_saturates_and_rounds_half_away_from_zero() {
    #[rustfmt::skip]
    let rows: &[(Precision, f64, f64)] = &[
        (Precision::Fp1220,  2048.0,                2048.0 - 2f64.powi(-20)),
        (Precision::Fp1220, -2048.5,               -2048.0),
        (Precision::Fp1220,  f64::INFINITY,         2048.0 - 2f64.powi(-20)),
        (Precision::Fp1220,  f64::MIN,             -2048.0),
        (Precision::Fp1220,  0.5 * 2f64.powi(-20),  2f64.powi(-20)),
        (Precision::Fp1220, -1.5 * 2f64.powi(-20), -2.0 * 2f64.powi(-20)),
        (Precision::Fp1632,  32768.0,               32768.0 - 2f64.powi(-32)),
        (Precision::Fp1632, -32768.5,              -32768.0),
        (Precision::Fp1632,  f64::NEG_INFINITY,    -32768.0),
        (Precision::Fp1632,  f64::MAX,              32768.0 - 2f64.powi(-32)),
        (Precision::Fp1632,  2.5 * 2f64.powi(-32),  3.0 * 2f64.powi(-32)),
        (Precision::Fp1632, -0.5 * 2f64.powi(-32), -2f64.powi(-32)),
        (Precision::Fp1632,  f64::MIN_POSITIVE,     0.0),
    ];
    for &(precision, value, expected) in rows {
        assert_eq!(through(precision, value).to_bits(), expected.to_bits(), "{} {value}", precision.name());
    }
}

// ---------------------------------------------------------------------------------------------
// Values that the encoder rejects
// ---------------------------------------------------------------------------------------------

fn refuse(
    name: &str,
    precision: Option<Precision>,
    coordinates: Option<Coordinates>,
    numbers: &[Number],
    sentence: &str,
) {
    let mut payload = vec![1, 2, 3];
    let error = write_packet(&mut payload, quantity_named(name).unwrap(), precision, coordinates, numbers);
    assert_eq!(error.expect_err(sentence).to_string(), sentence);
    assert_eq!(payload, [1, 2, 3], "{sentence}");
}

#[test]
#[rustfmt::skip]
fn invalid_values_are_rejected_with_an_error() {
    use Number::{Double, Integer, Single, Wide};
    let one = [Integer(1); 35];
    let nan = [Single(f32::NAN), Double(1.0), Double(1.0)];
    let mut pvt = one;
    pvt[9] = Integer(-1_000_000_000); // nano can be negative
    pvt[1] = Integer(-1); // a year cannot
    let (fp1220, fp1632) = (Some(Precision::Fp1220), Some(Precision::Fp1632));
    let enu = Some(Coordinates::Enu);
    refuse("acceleration",   None,   None, &one[..2],                "acceleration takes 3 numbers, not 2");
    refuse("acceleration",   None,   None, &[],                      "acceleration takes 3 numbers, not 0");
    refuse("acceleration",   fp1220, None, &nan,                     "acceleration: Fp1220 has no NaN; use Float32 or Float64");
    refuse("acceleration",   fp1632, None, &nan,                     "acceleration: Fp1632 has no NaN; use Float32 or Float64");
    refuse("acceleration",   None,   enu,  &one[..3],                "acceleration has no coordinate system in the manual");
    refuse("status_word",    fp1220, None, &one[..1],                "status_word consists of integers, which have no precision");
    refuse("status_byte",    None,   None, &[Integer(256)],          "status_byte: 256 is outside U1 (0 to 255)");
    refuse("packet_counter", None,   None, &[Integer(-1)],           "packet_counter: -1 is outside U2 (0 to 65535)");
    refuse("status_word",    None,   None, &[Wide(1 << 32)],         "status_word: 4294967296 is outside U4 (0 to 4294967295)");
    refuse("rssi",           None,   None, &[Integer(-129)],         "rssi: -129 is outside I1 (-128 to 127)");
    refuse("status_word",    None,   None, &[Double(0.5)],           "status_word: 0.5 is outside the integers");
    refuse("status_word",    None,   None, &[Double(f64::INFINITY)], "status_word: inf is outside the integers");
    refuse("status_word",    None,   None, &[Single(f32::NAN)],      "status_word: NaN is outside the integers");
    refuse("device_id",      None,   None, &[Integer(1 << 32)],      "device_id: 4294967296 is outside U4 (0 to 4294967295)");
    refuse("device_id",      None,   None, &one[..2],                "device_id takes 1 numbers, not 2");
    refuse("gnss_pvt_data",  None,   None, &one[..34],               "gnss_pvt_data takes 35 numbers, not 34");
    refuse("gnss_pvt_data",  None,   None, &pvt,                     "year: -1 is outside U2 (0 to 65535)");
    refuse("gnss_sat_info",  None,   None, &one[..5],                "gnss_sat_info takes 9 numbers, not 5");
    refuse("gnss_sat_info",  None,   None, &one[..4],                "gnss_sat_info takes 9 numbers, not 4");
    refuse("gnss_sat_info",  None,   None, &[],                      "gnss_sat_info takes 5 numbers, not 0");
}

#[test]
fn lists_that_do_not_fit_a_packet_are_rejected() {
    let info = quantity_named("gnss_sat_info").unwrap();
    for satellites in [61, 62, 255] {
        let mut numbers = vec![Number::Integer(0); 5 + 4 * satellites];
        numbers[1] = Number::Integer(i64::try_from(satellites).unwrap());
        let written = write_packet(&mut vec![], info, None, None, &numbers);
        let length = 8 + 4 * satellites;
        let expected =
            if length > 255 { Err(EncodeError::PacketTooLong { name: "gnss_sat_info", length }) } else { Ok(()) };
        assert_eq!(written, expected, "{satellites}");
    }
}

#[test]
fn invalid_list_counts_are_rejected() {
    let info = quantity_named("gnss_sat_info").unwrap();
    for count in [-1, 256, 1 << 32, 1 << 62, i64::MAX, i64::MIN] {
        let mut numbers = [Number::Integer(0); 5];
        numbers[1] = Number::Integer(count);
        assert!(write_packet(&mut vec![], info, None, None, &numbers).is_err(), "{count}");
    }
}

#[test]
fn list_counts_match_the_entries() {
    let info = quantity_named("gnss_sat_info").unwrap();
    let counted = |count, satellites: usize| {
        let mut numbers = vec![Number::Integer(7); 5 + 4 * satellites];
        numbers[1] = count;
        let mut payload = vec![];
        write_packet(&mut payload, info, None, None, &numbers).map(|()| payload)
    };
    let two = counted(Number::Integer(2), 2).unwrap();
    assert_eq!(two.len(), 3 + 8 + 2 * 4);
    for count in [Number::Wide(2), Number::Single(2.0), Number::Double(2.0)] {
        // A float count may be accepted or rejected, but a packet must have as many entries as its count.
        assert!(counted(count, 2).is_ok_and(|payload| payload == two) || counted(count, 2).is_err(), "{count:?}");
        assert!(counted(count, 0).is_err(), "{count:?}");
    }
    for count in [Number::Double(2.5), Number::Single(f32::NAN), Number::Wide(u64::MAX), Number::Double(-1.0)] {
        assert!(counted(count, 2).is_err() && counted(count, 0).is_err(), "{count:?}");
    }
}
