//! The tables against the lists that they were made from, where these lie next to the repository, and against
//! themselves.

use std::collections::BTreeSet;
use std::path::Path;

use super::*;

/// The rows of a list, each with its fields; nothing where the list is not at hand.
#[expect(clippy::print_stderr, reason = "a test that skips says so")]
fn rows(file: &str) -> Vec<Vec<String>> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/spec").join(file);
    let Ok(text) = std::fs::read_to_string(&path) else {
        eprintln!("skipped: no {}", path.display());
        return Vec::new();
    };
    text.lines().skip(1).map(fields).collect()
}

/// The comma-separated fields of a line; a comma between quotes separates nothing.
fn fields(line: &str) -> Vec<String> {
    let mut fields = vec![String::new()];
    let mut quoted = false;
    for character in line.chars() {
        match character {
            '"' => quoted = !quoted,
            ',' if !quoted => fields.push(String::new()),
            _ => fields.last_mut().unwrap().push(character),
        }
    }
    fields
}

fn hex(text: &str) -> Option<u16> {
    u16::from_str_radix(text.strip_prefix("0x")?, 16).ok()
}

/// What a product column of the lists means. Numbers are products where the manual has them (it does not have an
/// MTi-8 or an MTi-700); everything from a parenthesis on is a remark.
fn products(text: &str) -> Products {
    if text.starts_with("all") {
        return Products::ALL;
    }
    if text.starts_with("10/100-series, 600") {
        return Products::of(&[10, 20, 30, 100, 200, 300, 710, 610, 620, 630, 670, 680]);
    }
    let numbers = text.split('(').next().unwrap().split(' ').filter_map(|word| word.parse().ok());
    Products::of(&numbers.filter(|&number| Products::ALL.has(number)).collect::<Vec<u16>>())
}

#[test]
fn every_listed_message_is_in_the_table() {
    let mut seen = BTreeSet::new();
    for row in rows("messages.csv") {
        let [mid, _, name, direction, states, _, lengths, reply, on, notes] = &row[..] else { panic!("{row:?}") };
        let mid: u8 = mid.parse().unwrap();
        let listed_direction = match direction.as_str() {
            "host->mt" => Direction::ToDevice,
            "mt->host" => Direction::ToHost,
            "mt->host/host->mt" => Direction::Both,
            other => panic!("{other}"),
        };
        let listed_states = States {
            wakeup: states.contains("wakeup"),
            config: states.contains("config"),
            measurement: states.contains("measurement"),
        };
        for name in names(name) {
            let found = messages(mid).find(|message| message.name.eq_ignore_ascii_case(&name));
            let message = found.unwrap_or_else(|| panic!("{mid:02X} {name} is missing"));
            assert!(seen.insert(message.name), "{name} twice");
            assert_eq!(message.direction, listed_direction, "{name}");
            assert_eq!(message.states, listed_states, "{name}");
            assert_eq!(message.reply.map(u16::from), hex(reply), "{name}");
            // InitBus was seen on an MTi-300 only, but the vendor's software sends it to every MTi.
            let listed_products = if name.starts_with("InitBus") { Products::ALL } else { products(on) };
            assert_eq!(message.products, listed_products, "{name}");
            assert_eq!(message.status, status(&row[2], notes), "{name}");
            if listed_direction == Direction::ToDevice {
                assert_eq!(lengths, "", "{name}");
            } else {
                assert_eq!(message.lengths(), parsed(lengths), "{name}");
            }
        }
    }
    assert!(seen.is_empty() || seen.len() == MESSAGES.len(), "a message of the table is not in the list");
}

/// The names in the table for a name in the list, which has remarks behind it and sometimes two messages in one row.
fn names(listed: &str) -> Vec<String> {
    let name = listed.split(" (").next().unwrap();
    match name {
        "CanOutputConfig / SetCanOutputConfigAck" => vec!["CanOutputConfig".into(), "SetCanOutputConfigAck".into()],
        "GnssReceiverSettings / SetAck" => vec!["GnssReceiverSettings".into(), "SetGnssReceiverSettingsAck".into()],
        _ if listed.ends_with("(modern)") => vec![format!("{name}Modern")],
        _ => match name.strip_prefix("Req/Set") {
            Some(both) => vec![format!("Req{both}"), format!("Set{both}")],
            None => vec![name.into()],
        },
    }
}

fn status(name: &str, notes: &str) -> &'static str {
    if notes.contains("not in ") {
        return "unlisted";
    }
    ["reserved", "deprecated", "obsolete"].into_iter().find(|&status| name.contains(status)).unwrap_or("")
}

/// `"4 11"`, `"4..20"` or `"0..120 step 12"`.
fn parsed(lengths: &str) -> Lengths {
    let number = |text: &str| text.parse::<usize>().unwrap();
    if lengths.is_empty() {
        return Lengths::UNKNOWN;
    }
    let Some((from, rest)) = lengths.split_once("..") else {
        return lengths.split(' ').map(|text| Lengths::exactly(number(text))).fold(Lengths::UNKNOWN, Lengths::or);
    };
    let (to, step) = rest.split_once(" step ").unwrap_or((rest, "1"));
    Lengths::range(number(from), number(to), number(step))
}

#[test]
fn every_listed_identifier_is_in_the_table() {
    let opaque: BTreeSet<u16> =
        [0x8840, 0x88A0, 0xA080, 0xC810, 0xC820, 0xC830, 0xC840, 0xCA30, 0xCA40].into_iter().collect();
    let mut missing = BTreeSet::new();
    let mut seen = 0;
    for row in rows("data_ids.csv") {
        let (id, name, unit, size, on) = (hex(&row[0]).unwrap(), &row[1], &row[5], &row[8], &row[16]);
        let Some(quantity) = quantity(id) else {
            missing.insert(id);
            continue;
        };
        seen += 1;
        assert_eq!(quantity.id, id);
        assert_eq!(quantity.manual, name.split(' ').next().unwrap());
        // The list names a unit for some integers that are mere counts, and for records, whose fields have their own.
        let unit = if unit == "device ticks" || unit.starts_with("timestamp") { "" } else { unit };
        let unit = if ["-", "count", "packets", "ADC", "bits", "mixed"].contains(&unit) { "" } else { unit };
        assert_eq!(quantity.unit, unit, "{name}");
        assert_eq!(&size_label(quantity.kind), size, "{name}");
        assert_eq!(quantity.rotates, row[7] == "y", "{name}");
        assert_eq!(matches!(quantity.kind, Kind::Real(_)), row[6] == "y", "{name}");
        assert_eq!(quantity.products, products(on), "{name}");
    }
    if seen > 0 {
        assert_eq!(seen, QUANTITIES.len(), "a quantity of the table is not in the list");
        assert_eq!(missing, opaque);
    }
}

/// Bytes of a packet as the list writes them; of a real in each of the four precisions.
fn size_label(kind: Kind) -> String {
    let sum = |fields: &[Field]| fields.iter().map(|field| field.wire.size()).sum::<usize>();
    match kind {
        Kind::Real(count) => [4, 4, 6, 8].map(|size| (count * size).to_string()).join("/"),
        Kind::Fixed(wire, count) => (count * wire.size()).to_string(),
        Kind::Id => "4/8".into(),
        Kind::Struct(fields) => sum(fields).to_string(),
        Kind::List(head, entry) => format!("{}+{}*N", sum(head), sum(entry)),
    }
}

#[test]
fn quantity_names_are_the_manuals_in_snake_case() {
    for quantity in QUANTITIES {
        let mut snake = String::new();
        let mut after_capital = true;
        for letter in quantity.manual.chars() {
            if letter.is_ascii_uppercase() && !after_capital {
                snake.push('_');
            }
            after_capital = letter.is_ascii_uppercase();
            snake.push(letter.to_ascii_lowercase());
        }
        assert_eq!(quantity.name, snake);
        assert_eq!(quantity_named(quantity.name).unwrap().id, quantity.id);
    }
    assert!(quantity_named("acc").is_none());
}

#[test]
fn format_bits_do_not_hide_a_quantity() {
    for expected in QUANTITIES {
        for format in 0..16 {
            assert_eq!(quantity(expected.id | format).unwrap().id, expected.id);
        }
    }
    assert!(quantity(0x0000).is_none());
    assert!(quantity(0xA080).is_none());
    assert!(quantity(0xFFFF).is_none());
}

#[test]
fn the_payload_length_tells_request_from_setting() {
    assert_eq!(message_name(0x18, 0), Some("ReqBaudrate"));
    assert_eq!(message_name(0x18, 1), Some("SetBaudrate"));
    assert_eq!(message_name(0x19, 1), Some("ReqBaudrateAck"));
    assert_eq!(message_name(0x19, 0), Some("SetBaudrateAck"));
    // Three answers with one MID: numbers, names, and to a setting.
    assert_eq!(message_name(0x65, 2), Some("ReqFilterProfileAck"));
    assert_eq!(message_name(0x65, 10), Some("ReqFilterProfileAckModern"));
    assert_eq!(message_name(0x65, 0), Some("SetFilterProfileAck"));
    assert_eq!(message_name(0x36, 40), Some("MTData2"));
    assert_eq!(message_name(0x3E, 0), Some("WakeUp"));
    assert_eq!(message_name(0x64, 2), Some("SetFilterProfile"));
    assert_eq!(message_name(0x64, 10), Some("SetFilterProfileModern"));
    // Both carry something; the length decides.
    assert_eq!(message_name(0xEC, 1), Some("ReqAlignmentRotation"));
    assert_eq!(message_name(0xEC, 17), Some("SetAlignmentRotation"));
    // A length that no row allows still has a name, an unknown MID has none.
    assert_eq!(message_name(0x18, 3), Some("SetBaudrate"));
    assert_eq!(message_name(0x99, 3), Some("UnlockMaintenanceModeAck"));
    assert_eq!(message_name(0x08, 0), None);
}

#[test]
fn a_device_sends_what_the_rows_to_the_host_allow() {
    for mid in 0..=u8::MAX {
        if mid == MTDATA2 {
            continue;
        }
        for length in 0..=LONGEST_PAYLOAD + 1 {
            let mut to_host = messages(mid).filter(|message| message.direction != Direction::ToDevice);
            assert_eq!(device_sends(mid, length), to_host.any(|message| message.lengths().allow(length)), "{mid:02X}");
        }
    }
    assert!(!device_sends(MTDATA2, 0));
    assert!(device_sends(MTDATA2, 8));
}

#[test]
fn an_answer_has_a_row_of_its_own_and_goes_the_other_way() {
    for message in MESSAGES {
        if let Some(reply) = message.reply {
            assert!(messages(reply).any(|answer| answer.direction != message.direction), "{}", message.name);
        }
    }
}

#[test]
fn requests_come_before_settings() {
    for pair in MESSAGES.windows(2) {
        let backwards = pair[0].name.starts_with("Set") && pair[1].name.starts_with("Req");
        assert!(pair[0].mid < pair[1].mid || !backwards, "{}", pair[1].name);
    }
}

#[test]
fn sets_of_products_print_in_the_manuals_order() {
    assert_eq!(Products::of(&[7, 1, 3, 2]).label(), "1 2 3 7");
    assert_eq!(Products::NONE.label(), "");
    assert_eq!(Products::ALL.iter().count(), PRODUCTS.len());
    assert!(Products::of(&[680]).has(680));
    assert!(!Products::of(&[680]).has(670));
    assert!(!Products::ALL.has(8));
    assert!(Products::NONE.is_empty());
}

#[test]
fn result_codes_are_sorted() {
    assert!(RESULT_CODES.is_sorted_by_key(|&(code, _)| code));
    assert_eq!(result_text(3), Some("the period is out of range"));
    assert_eq!(result_text(5), None);
}
