//! The rules of the scanner in their simplest form: for input that is in memory, without state and without optimization.
//!
//! It is the reference for tests and fuzz targets. It may look at a byte many times, so it suits short inputs only.

use super::{Damage, Reason};
use crate::frame::{self, Frame, Header, PREAMBLE};
use crate::packet::packets;
use crate::table::{self, End, STRINGS};

/// The result of a scan.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Scan {
    /// The frames as (offset, length).
    pub frames: Vec<(usize, usize)>,
    /// The strings as (offset, length, place in the table or none).
    pub strings: Vec<(usize, usize, Option<u8>)>,
    /// Stretches that are neither.
    pub damage: Vec<Damage>,
    /// Number of candidates refused by their checksum where a frame was due.
    pub checksum_errors: u64,
}

/// Scans `input`. `named`: see [`super::Scanner::expect`].
#[must_use]
pub fn scan(input: &[u8], limit: usize, named: u32) -> Scan {
    let mut scan = Scan::default();
    let mut enabled = 0; // strings that are enabled according to the device
    let mut due = 0; // where the last accepted frame or string ended
    let mut refused = None; // what was wrong there
    let mut at = 0;
    while at < input.len() {
        let in_step = at == due;
        let mut verdict = candidate(input, at, limit);
        if let Ok(length) = verdict {
            let frame = &input[at..at + length];
            if is_plausible(frame) || (in_step && is_followed(input, at + length, limit, named | enabled)) {
                enabled = enabled_strings(frame).unwrap_or(enabled);
                scan.frames.push((at, length));
            } else {
                verdict = Err(Reason::Implausible);
            }
        } else if input[at] != PREAMBLE {
            verdict = string(input, at, named | enabled, in_step).map(|(length, place)| {
                scan.strings.push((at, length, place));
                length
            });
        }
        match verdict {
            Ok(length) => {
                scan.damage.extend(refused.take().map(|reason| stretch(due, at, reason)));
                at += length;
                due = at;
            }
            Err(reason) => {
                if in_step {
                    scan.checksum_errors += u64::from(reason == Reason::Checksum);
                    refused = Some(reason);
                }
                at += 1;
            }
        }
    }
    scan.damage.extend(refused.map(|reason| stretch(due, at, reason)));
    scan
}

fn stretch(from: usize, to: usize, reason: Reason) -> Damage {
    Damage { offset: from as u64, length: (to - from) as u64, reason }
}

/// The length of the frame at `at`, if there is one with a good checksum.
fn candidate(input: &[u8], at: usize, limit: usize) -> Result<usize, Reason> {
    let bytes = &input[at..];
    if bytes.first() != Some(&PREAMBLE) {
        return Err(Reason::NoPreamble);
    }
    let header = Header::read(bytes).ok_or(Reason::Truncated)?;
    if header.payload > limit {
        return Err(Reason::TooLong);
    }
    let bytes = bytes.get(..header.frame()).ok_or(Reason::Truncated)?;
    if frame::sum(&bytes[1..]) == 0 { Ok(bytes.len()) } else { Err(Reason::Checksum) }
}

fn is_plausible(bytes: &[u8]) -> bool {
    let frame = Frame::of(bytes);
    (frame.bid == 0xFF || (1..=31).contains(&frame.bid))
        && if frame.mid == table::MTDATA2 {
            !frame.payload.is_empty()
                && packets(frame.payload).all(|packet| packet.is_ok_and(|packet| packet.is_sound()))
        } else {
            table::device_sends(frame.mid, frame.payload.len())
        }
}

fn is_followed(input: &[u8], at: usize, limit: usize, expected: u32) -> bool {
    at == input.len() || candidate(input, at, limit).is_ok() || string(input, at, expected, true).is_ok()
}

fn enabled_strings(frame: &[u8]) -> Option<u32> {
    let frame = Frame::of(frame);
    match (frame.mid, frame.payload) {
        (0x8F, [a, b]) => Some(u32::from_be_bytes([0, 0, *a, *b])),
        (0x8F, [a, b, c, d, _, _]) => Some(u32::from_be_bytes([*a, *b, *c, *d])),
        _ => None,
    }
}

/// The length of the string at `at`, and its place in the table if it is listed.
fn string(input: &[u8], at: usize, expected: u32, in_step: bool) -> Result<(usize, Option<u8>), Reason> {
    let bytes = &input[at..];
    for (row, place) in STRINGS.iter().zip(0_u8..) {
        if let End::Length(length) = row.end
            && expected >> place & 1 == 1
            && bytes.starts_with(row.start)
        {
            return bare(bytes, length, in_step, expected).map(|()| (length, Some(place)));
        }
    }
    match bytes {
        [b'$' | b':' | 0] => {
            return Err(if can_begin(bytes[0], expected) { Reason::Truncated } else { Reason::NoPreamble });
        }
        [b'$', b'A'..=b'Z', ..] | [b':', b' ' | b'0'..=b'9', ..] => {}
        _ => return Err(Reason::NoPreamble),
    }
    let masked = STRINGS.iter().zip(0_u8..).find_map(|(row, place)| match row.end {
        End::Mask(mask) if bytes.starts_with(row.start) => Some((place, mask)),
        _ => None,
    });
    if let Some((place, mask)) = masked {
        // Each character is judged as soon as it is available.
        for (byte, mask) in bytes[1..].iter().zip(mask) {
            let allowed: &[u8] = match mask {
                b'D' => b"0123456789 ",
                b'-' => b"- ",
                other => std::slice::from_ref(other),
            };
            if !allowed.contains(byte) {
                return Err(Reason::NoPreamble);
            }
        }
        let Some(rest) = bytes.get(1 + mask.len()..) else { return Err(Reason::Truncated) };
        return Ok((1 + mask.len() + line_end(rest)?, Some(place)));
    }
    // A sentence: text up to the end of its line.
    let near = &bytes[..bytes.len().min(255)];
    let is_text = |byte: &u8| (b' '..=b'~').contains(byte) && *byte != b'$';
    let end = (1..near.len()).find(|&at| !is_text(&near[at])).unwrap_or(near.len());
    let text = String::from_utf8_lossy(&near[1..end]).into_owned();
    let length = match line_end(&near[end..]) {
        Ok(size) => end + size,
        Err(Reason::Truncated) if near.len() == 255 => return Err(Reason::TooLong),
        Err(reason) => return Err(reason),
    };
    let name_is = |row: &table::StringOutput| text.split(',').next() == Some(row.name) && text.contains(',');
    if text.len() >= 3 && text.as_bytes()[text.len() - 3] == b'*' {
        let (body, sum) = (&text[..text.len() - 3], &text[text.len() - 2..]);
        if !sum.chars().all(|digit| digit.is_ascii_hexdigit()) {
            return Err(Reason::NoPreamble);
        }
        let expected = format!("{:02X}", body.bytes().fold(0, |sum, byte| sum ^ byte));
        if !sum.eq_ignore_ascii_case(&expected) {
            return Err(Reason::Checksum);
        }
        return Ok((length, STRINGS.iter().zip(0_u8..).find(|(row, _)| name_is(row)).map(|(_, place)| place)));
    }
    let is_number = |field: &str| {
        let field = field.trim_matches(' ');
        field.is_empty()
            || (field.trim_start_matches(['+', '-']).chars().all(|digit| digit.is_ascii_digit() || digit == '.')
                && field.parse::<f64>().is_ok())
    };
    for (row, place) in STRINGS.iter().zip(0_u8..) {
        if let End::Numbers(count) = row.end
            && name_is(row)
            && text.split(',').count() == 1 + count
            && text.split(',').skip(1).all(is_number)
        {
            return Ok((length, Some(place)));
        }
    }
    Err(Reason::NoPreamble)
}

fn can_begin(byte: u8, expected: u32) -> bool {
    let is_bare = |(place, row): (usize, &table::StringOutput)| {
        matches!(row.end, End::Length(_)) && expected >> place & 1 == 1 && row.start[0] == byte
    };
    byte == b'$' || byte == b':' || STRINGS.iter().enumerate().any(is_bare)
}

fn line_end(bytes: &[u8]) -> Result<usize, Reason> {
    match bytes {
        [b'\n', ..] => Ok(1),
        [b'\r', b'\n', ..] => Ok(2),
        [] | [b'\r'] => Err(Reason::Truncated),
        _ => Err(Reason::NoPreamble),
    }
}

/// EM1000: roll, pitch, heave and heading, and what may follow.
fn bare(bytes: &[u8], length: usize, in_step: bool, expected: u32) -> Result<(), Reason> {
    let words = bytes.get(2..length).ok_or(Reason::Truncated)?;
    let word = |at: usize| i32::from(words[at]) | i32::from(words[at + 1]) << 8;
    let signed = |at: usize| if word(at) < 0x8000 { word(at) } else { word(at) - 0x1_0000 };
    let in_range = signed(0).abs() <= 18_000 && signed(2).abs() <= 9_000 && word(6) <= 36_000;
    let next = bytes.get(length);
    let is_followed = in_step || next.is_none_or(|byte| *byte == PREAMBLE || can_begin(*byte, expected));
    if in_range && is_followed { Ok(()) } else { Err(Reason::Implausible) }
}
