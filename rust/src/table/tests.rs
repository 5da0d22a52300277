//! The tables against a second copy in `tests/spec`, which was written from the sources and not from the tables; and
//! against themselves.

use std::collections::BTreeSet;

use super::*;

const QUANTITIES_SPEC: &str = include_str!("../../../tests/spec/quantities.txt");
const MESSAGES_SPEC: &str = include_str!("../../../tests/spec/messages.txt");

/// The rows of a file. `-` is an empty field.
fn rows<const N: usize>(text: &str) -> impl Iterator<Item = [&str; N]> {
    text.lines().filter(|line| !line.is_empty() && !line.starts_with('#')).map(|line| {
        let fields = line.split("  ").map(str::trim).filter(|field| !field.is_empty());
        let fields: Vec<_> = fields.map(|field| if field == "-" { "" } else { field }).collect();
        fields.try_into().unwrap_or_else(|fields| panic!("not {N} fields: {fields:?}"))
    })
}

fn products(text: &str) -> Products {
    if text == "all" {
        return Products::ALL;
    }
    Products::of(&text.split_whitespace().map(|number| number.parse().unwrap()).collect::<Vec<u16>>())
}

/// `"4 11"`, `"4..20"` or `"0..120 step 12"`.
fn lengths(text: &str) -> Lengths {
    let number = |text: &str| text.parse::<usize>().unwrap();
    if text.is_empty() {
        return Lengths::UNKNOWN;
    }
    let Some((from, rest)) = text.split_once("..") else {
        return text.split(' ').map(|text| Lengths::exactly(number(text))).fold(Lengths::UNKNOWN, Lengths::or);
    };
    let (to, step) = rest.split_once(" step ").unwrap_or((rest, "1"));
    Lengths::range(number(from), number(to), number(step))
}

#[test]
fn messages_are_those_of_the_specification() {
    let mut seen = BTreeSet::new();
    for row in rows(MESSAGES_SPEC) {
        let [mid, name, direction, states, payload_lengths, reply, remark, on] = row;
        let mid = u8::from_str_radix(mid, 16).unwrap();
        let found = messages(mid).find(|message| message.name.eq_ignore_ascii_case(name));
        let message = found.unwrap_or_else(|| panic!("{mid:02X} {name} is missing"));
        assert!(seen.insert(message.name), "{name} twice");
        let expected_direction = match direction {
            "to device" => Direction::ToDevice,
            "to host" => Direction::ToHost,
            "both" => Direction::Both,
            other => panic!("{other}"),
        };
        let expected_states = States {
            wakeup: states.contains("wakeup"),
            config: states.contains("config"),
            measurement: states.contains("measurement"),
        };
        assert_eq!(message.direction, expected_direction, "{name}");
        assert_eq!(message.states, expected_states, "{name}");
        assert_eq!(message.reply.map_or(String::new(), |reply| format!("{reply:02X}")), reply, "{name}");
        assert_eq!(message.status, remark, "{name}");
        assert_eq!(message.products, products(on), "{name}");
        if message.direction == Direction::ToDevice {
            assert_eq!(payload_lengths, "", "{name}");
        } else {
            assert_eq!(message.lengths(), lengths(payload_lengths), "{name}");
        }
    }
    assert_eq!(seen.len(), MESSAGES.len(), "a message of the table is not in the specification");
}

#[test]
fn quantities_are_those_of_the_specification() {
    let mut seen = 0;
    for row in rows(QUANTITIES_SPEC) {
        let [id, name, bytes, unit, axes, coordinates, on] = row;
        let id = u16::from_str_radix(id, 16).unwrap();
        let quantity = quantity(id).unwrap_or_else(|| panic!("{id:04X} {name} is missing"));
        assert_eq!((quantity.id, quantity.manual, quantity.unit), (id, name, unit));
        assert_eq!(size_label(quantity.kind), bytes, "{name}");
        assert_eq!(quantity.axes.map_or("", Axes::name), axes, "{name}");
        assert_eq!(quantity.rotates, coordinates == "yes", "{name}");
        assert_eq!(quantity.products, products(on), "{name}");
        seen += 1;
    }
    assert_eq!(seen, QUANTITIES.len(), "a quantity of the table is not in the specification");
}

/// Bytes of a packet as the specification writes them; for real numbers in each of the four precisions.
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
