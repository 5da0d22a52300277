//! The strings that a device sends instead of MTData2, or between its frames (section 5.3.5).
//!
//! A sentence is `$`, printable characters, `*`, two hexadecimal digits (the exclusive or of the characters between `$` and
//! `*`), CR LF. Every sentence with a good checksum is a string, even if the manual does not list it: unknown is not damage.
//! Of the strings in the manual, PRDID has no checksum, TSS2 begins with `:` and has no checksum, and EM1000 is ten bytes of
//! binary data.
//!
//! No string but EM1000 can contain a preamble, so none hides a frame.

use crate::frame::PREAMBLE;
use crate::scan::Reason;
use crate::table::{BARE_STRINGS, End, STRINGS, StringOutput};

/// Most bytes of a sentence, including the end of its line. PSONCMS, the longest in the manual, has up to 130.
pub const LONGEST_STRING: usize = 255;

/// What a candidate for a string is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Found {
    /// A string: its length in bytes, and its place in [`STRINGS`] if the manual lists it.
    String(usize, Option<u8>),
    /// Not a string.
    Not(Reason),
    /// More bytes are needed.
    Wait,
}

/// Whether a string can begin with this byte. `expected`: see [`Scanner::expect`](crate::scan::Scanner::expect).
#[must_use]
pub const fn can_begin(byte: u8, expected: u32) -> bool {
    matches!(byte, b'$' | b':') || (byte == EM1000_START[0] && expected & BARE_STRINGS != 0)
}

/// Whether no string can begin with these two bytes. [`find`] refuses these candidates, too; this is faster.
#[must_use]
pub const fn is_hopeless(first: u8, second: u8) -> bool {
    !match first {
        b'$' => second.is_ascii_uppercase(),
        b':' => matches!(second, b' ' | b'0'..=b'9'),
        _ => second == EM1000_START[1],
    }
}

const TSS2: usize = 2;
const EM1000: usize = 5;
const EM1000_START: &[u8] = STRINGS[EM1000].start;

/// Judges the string that begins with `bytes`, whose first byte [`can_begin`] one. `last` is whether the input ends with
/// `bytes`, `in_step` whether they begin where a frame or string ended.
#[must_use]
pub fn find(bytes: &[u8], last: bool, expected: u32, in_step: bool) -> Found {
    let cut = if last { Found::Not(Reason::Truncated) } else { Found::Wait };
    let (Some(&first), second) = (bytes.first(), bytes.get(1)) else { return cut };
    let Some(&second) = second else { return cut };
    if is_hopeless(first, second) {
        return Found::Not(Reason::NoPreamble);
    }
    match first {
        b'$' => sentence(bytes, cut),
        b':' => masked(bytes, cut),
        _ => em1000(bytes, last, expected, in_step),
    }
}

/// The strings that are enabled according to a `StringOutputType` (0x8F), as bits; `None` for other payloads, such as the
/// empty one that acknowledges `SetStringOutputType`.
#[must_use]
pub fn enabled_strings(payload: &[u8]) -> Option<u32> {
    match *payload {
        [a, b] => Some(u16::from_be_bytes([a, b]).into()),
        [a, b, c, d, _, _] => Some(u32::from_be_bytes([a, b, c, d])),
        _ => None,
    }
}

/// `$` to the end of the line.
fn sentence(bytes: &[u8], cut: Found) -> Found {
    let is_text = |byte: &u8| matches!(byte, b' '..=b'~') && *byte != b'$';
    let text = &bytes[1..bytes.len().min(LONGEST_STRING)];
    let end = text.iter().position(|byte| !is_text(byte)).unwrap_or(text.len());
    let line_end = match line_end(&text[end..]) {
        Line::Ends(size) => size,
        Line::Cut if bytes.len() < LONGEST_STRING => return cut,
        Line::Cut => return Found::Not(Reason::TooLong),
        Line::GoesOn => return Found::Not(Reason::NoPreamble),
    };
    let length = 1 + end + line_end;
    let text = &text[..end];
    if let Some((body, &[b'*', high, low])) = text.split_last_chunk() {
        let (Some(high), Some(low)) = (hex(high), hex(low)) else { return Found::Not(Reason::NoPreamble) };
        if body.iter().fold(0, |sum, byte| sum ^ byte) != high << 4 | low {
            return Found::Not(Reason::Checksum);
        }
        let is_kind = |row: &StringOutput| row.start[0] == b'$' && body.starts_with(&row.start[1..]);
        return Found::String(length, place(is_kind));
    }
    let is_kind = |row: &StringOutput| match row.end {
        End::Numbers(count) => text.strip_prefix(&row.start[1..]).is_some_and(|fields| {
            let mut fields = fields.split(|byte| *byte == b',');
            let numbers = fields.by_ref().take(count).filter(|field| is_number_or_empty(field)).count();
            numbers == count && fields.next().is_none()
        }),
        _ => false,
    };
    place(is_kind).map_or(Found::Not(Reason::NoPreamble), |place| Found::String(length, Some(place)))
}

/// A line with a mask for each of its characters.
fn masked(bytes: &[u8], cut: Found) -> Found {
    let End::Mask(mask) = STRINGS[TSS2].end else { return Found::Not(Reason::NoPreamble) };
    let text = &bytes[1..];
    let fits = |(byte, mask): (&u8, &u8)| match mask {
        b'D' => matches!(byte, b'0'..=b'9' | b' '),
        b'-' => matches!(byte, b'-' | b' '),
        _ => byte == mask,
    };
    if !text.iter().zip(mask).all(fits) {
        return Found::Not(Reason::NoPreamble);
    }
    match text.get(mask.len()..).map(line_end) {
        #[allow(clippy::cast_possible_truncation)] // a row of fifteen
        Some(Line::Ends(size)) => Found::String(1 + mask.len() + size, Some(TSS2 as u8)),
        Some(Line::GoesOn) => Found::Not(Reason::NoPreamble),
        Some(Line::Cut) | None => cut,
    }
}

/// A header, then roll, pitch, heave and heading as little-endian words. The angles must be in range, and, unless it is in
/// step, something that can begin a frame or string must follow.
fn em1000(bytes: &[u8], last: bool, expected: u32, in_step: bool) -> Found {
    const LENGTH: usize = match STRINGS[EM1000].end {
        End::Length(length) => length,
        _ => 0,
    };
    if expected & 1 << EM1000 == 0 {
        return Found::Not(Reason::NoPreamble);
    }
    let Some(&[_, _, r0, r1, p0, p1, _, _, h0, h1]) = bytes.first_chunk::<LENGTH>() else {
        return if last { Found::Not(Reason::Truncated) } else { Found::Wait };
    };
    let (roll, pitch) = (i16::from_le_bytes([r0, r1]), i16::from_le_bytes([p0, p1]));
    let heading = u16::from_le_bytes([h0, h1]);
    // In 0.01 degrees.
    if roll.unsigned_abs() > 18_000 || pitch.unsigned_abs() > 9_000 || heading > 36_000 {
        return Found::Not(Reason::Implausible);
    }
    let is_followed = match bytes[LENGTH..] {
        _ if in_step => true,
        [] if !last => return Found::Wait,
        [] => true,
        [next, ..] => next == PREAMBLE || can_begin(next, expected),
    };
    #[allow(clippy::cast_possible_truncation)] // a row of fifteen
    if is_followed { Found::String(LENGTH, Some(EM1000 as u8)) } else { Found::Not(Reason::Implausible) }
}

fn place(is_kind: impl Fn(&StringOutput) -> bool) -> Option<u8> {
    STRINGS.iter().zip(0..).find(|(row, _)| is_kind(row)).map(|(_, place)| place)
}

enum Line {
    Ends(usize),
    GoesOn,
    Cut,
}

/// Whether a line ends here: CR LF, or LF alone, because some programs convert line ends.
fn line_end(bytes: &[u8]) -> Line {
    match bytes {
        [b'\n', ..] => Line::Ends(1),
        [b'\r', b'\n', ..] => Line::Ends(2),
        [] | [b'\r'] => Line::Cut,
        _ => Line::GoesOn,
    }
}

fn hex(digit: u8) -> Option<u8> {
    #[allow(clippy::cast_possible_truncation)] // below 16
    char::from(digit).to_digit(16).map(|digit| digit as u8)
}

/// Whether a field is a number (`-012.3`, `+1`, `.5`), empty, or blank.
fn is_number_or_empty(field: &[u8]) -> bool {
    let field = field.trim_ascii();
    let digits = field.strip_prefix(b"-").or(field.strip_prefix(b"+")).unwrap_or(field);
    let mut parts = digits.splitn(2, |byte| *byte == b'.');
    let is_number = digits.iter().any(u8::is_ascii_digit) && parts.all(|part| part.iter().all(u8::is_ascii_digit));
    field.is_empty() || is_number
}
