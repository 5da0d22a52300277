//! The payloads of messages, field by field.
//!
//! From these lists follow the payload lengths that the scanner takes as plausible, the description in documentation
//! and command line, and the layouts with which Python encodes and decodes messages.

use std::fmt::{self, Display, Formatter};

use super::quantities::UTC_TIME as UTC_TIME_PACKET;
use super::{Field, Wire, same};

/// A set of payload lengths.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lengths {
    /// A bit for each length below [`SHORT`].
    short: [u64; SHORT / 64],
    /// The longest of the others: the set has all lengths from [`SHORT`] to this one.
    longest: usize,
}

/// Lengths from here on belong to a set without a gap.
const SHORT: usize = 256;

impl Lengths {
    /// No source gives the lengths, so the set allows none.
    pub const UNKNOWN: Self = Self { short: [0; SHORT / 64], longest: 0 };

    /// From, to, in steps of.
    ///
    /// # Panics
    /// If a range beyond 255 has gaps: in a table, a compile error.
    #[must_use]
    pub const fn range(from: usize, to: usize, step: usize) -> Self {
        assert!(to < SHORT || (step == 1 && from <= SHORT), "long payloads must have any length up to the longest");
        let mut lengths = Self { longest: if to < SHORT { 0 } else { to }, ..Self::UNKNOWN };
        let mut length = from;
        while length <= to && length < SHORT {
            lengths.short[length / 64] |= 1 << (length % 64);
            length += step;
        }
        lengths
    }

    /// This length alone.
    #[must_use]
    pub const fn exactly(length: usize) -> Self {
        Self::range(length, length, 1)
    }

    /// The lengths in either set.
    #[must_use]
    pub const fn or(mut self, other: Self) -> Self {
        let mut i = 0;
        while i < self.short.len() {
            self.short[i] |= other.short[i];
            i += 1;
        }
        if other.longest > self.longest {
            self.longest = other.longest;
        }
        self
    }

    /// Whether a payload of `length` bytes is in the set.
    #[must_use]
    pub const fn allow(&self, length: usize) -> bool {
        if length < SHORT { self.short[length / 64] >> (length % 64) & 1 == 1 } else { length <= self.longest }
    }

    /// The lengths, ascending.
    pub fn iter(&self) -> impl Iterator<Item = usize> {
        let all = if self.longest == 0 { 0..SHORT } else { 0..self.longest + 1 };
        all.filter(|length| self.allow(*length))
    }
}

/// What a field of a message holds. Numbers are big-endian.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Content {
    /// This many numbers of one type.
    Numbers(Wire, usize),
    /// An IEEE 754 double.
    Double,
    /// ASCII of this many bytes, filled with spaces.
    Text(usize),
    /// This many bytes whose meaning the table does not give.
    Bytes(usize),
    /// ASCII up to the end of the payload, at most this many bytes. Only the last field of a record can have it.
    RestText(usize),
    /// Bytes up to the end of the payload, at most this many. Only the last field of a record can have it.
    RestBytes(usize),
}

/// One field of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageField {
    /// Its name.
    pub name: &'static str,
    /// What it holds.
    pub content: Content,
    /// Unit of a number, empty where it has none.
    pub unit: &'static str,
    /// Valid values, or the table of the manual that lists them; or empty.
    pub note: &'static str,
}

impl MessageField {
    /// The fewest and the most bytes that the field takes.
    #[must_use]
    pub const fn size(&self) -> (usize, usize) {
        match self.content {
            Content::Numbers(wire, count) => (count * wire.size(), count * wire.size()),
            Content::Double => (8, 8),
            Content::Text(size) | Content::Bytes(size) => (size, size),
            Content::RestText(most) | Content::RestBytes(most) => (0, most),
        }
    }

    const fn unit(self, unit: &'static str) -> Self {
        Self { unit, ..self }
    }

    const fn note(self, note: &'static str) -> Self {
        Self { note, ..self }
    }
}

/// The payload of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Payload {
    /// Nothing.
    Empty,
    /// Bytes that are passed on unchanged: what they are, and how many there can be.
    Bytes(&'static str, Lengths),
    /// ASCII.
    Text {
        /// The fewest characters.
        least: usize,
        /// The most characters.
        most: usize,
        /// Whether a sender fills the text with spaces to `most`.
        filled: bool,
    },
    /// One of these records. They differ in length; the longest comes first.
    Record(&'static [&'static [MessageField]]),
    /// The same record several times.
    List {
        /// The record.
        entry: &'static [MessageField],
        /// The fewest entries.
        least: usize,
        /// The most entries.
        most: usize,
        /// Whether an empty list is written as one entry of zeros. Otherwise it is an empty payload.
        zeros: bool,
    },
}

impl Payload {
    /// The lengths that the payload can have.
    #[must_use]
    pub const fn lengths(&self) -> Lengths {
        match *self {
            Self::Empty => Lengths::exactly(0),
            Self::Bytes(_, lengths) => lengths,
            Self::Text { least, most, .. } => Lengths::range(least, most, 1),
            Self::List { entry, least, most, .. } => {
                let (size, _) = size(entry);
                Lengths::range(least * size, most * size, size)
            }
            Self::Record(forms) => {
                let mut lengths = Lengths::UNKNOWN;
                let mut i = 0;
                while i < forms.len() {
                    let (least, most) = size(forms[i]);
                    lengths = lengths.or(Lengths::range(least, most, 1));
                    i += 1;
                }
                lengths
            }
        }
    }

    /// Whether every record in it can be read: field names differ, only the last field has a variable length, and
    /// alternatives differ in length, the longest first.
    #[must_use]
    pub const fn is_sound(&self) -> bool {
        match *self {
            Self::Record(forms) => {
                let mut i = 0;
                while i < forms.len() {
                    let falls = i == 0 || size(forms[i - 1]).0 > size(forms[i]).1;
                    if !falls || !is_readable(forms[i], true) {
                        return false;
                    }
                    i += 1;
                }
                !forms.is_empty()
            }
            Self::List { entry, least, most, .. } => least <= most && is_readable(entry, false),
            Self::Text { least, most, .. } => 0 < least && least <= most,
            Self::Empty | Self::Bytes(..) => true,
        }
    }
}

/// The fewest and the most bytes of a record.
#[must_use]
pub const fn size(fields: &[MessageField]) -> (usize, usize) {
    let (mut least, mut most, mut i) = (0, 0, 0);
    while i < fields.len() {
        let (a, b) = fields[i].size();
        (least, most) = (least + a, most + b);
        i += 1;
    }
    (least, most)
}

/// Where the field of this name begins in a record; a name that no field has does not compile in a constant.
///
/// # Panics
/// If no field has the name.
#[must_use]
pub const fn offset(fields: &[MessageField], name: &str) -> usize {
    let (mut at, mut i) = (0, 0);
    while i < fields.len() {
        if same(fields[i].name, name) {
            return at;
        }
        at += fields[i].size().1;
        i += 1;
    }
    panic!("no field of that name")
}

const fn is_readable(fields: &[MessageField], can_vary: bool) -> bool {
    let mut i = 0;
    while i < fields.len() {
        let (least, most) = fields[i].size();
        if least != most && !(can_vary && i == fields.len() - 1) {
            return false;
        }
        let mut j = 0;
        while j < i {
            if same(fields[j].name, fields[i].name) {
                return false;
            }
            j += 1;
        }
        i += 1;
    }
    !fields.is_empty()
}

/// Records of more fields are described by their size.
const MOST_DESCRIBED: usize = 8;

impl Display for MessageField {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self.content {
            Content::Numbers(wire, 1) => write!(f, "{wire:?}")?,
            Content::Numbers(wire, count) => write!(f, "{count} {wire:?}")?,
            Content::Double => write!(f, "F8")?,
            Content::Text(size) => write!(f, "ASCII of {size}")?,
            Content::Bytes(size) => write!(f, "{size} bytes")?,
            Content::RestText(most) => write!(f, "ASCII of at most {most}")?,
            Content::RestBytes(most) => write!(f, "at most {most} bytes")?,
        }
        write!(f, " {}", self.name)?;
        match (self.unit, self.note) {
            ("", "") => Ok(()),
            (about, "") | ("", about) => write!(f, " ({about})"),
            (unit, note) => write!(f, " ({unit}, {note})"),
        }
    }
}

/// `"U1 major, U1 minor"`; of a record of many fields their number.
fn describe(fields: &[MessageField]) -> String {
    if fields.len() > MOST_DESCRIBED {
        return format!("{} fields, {} bytes", fields.len(), size(fields).1);
    }
    fields.iter().map(MessageField::to_string).collect::<Vec<_>>().join(", ")
}

impl Display for Payload {
    /// What the payload holds, as documentation and error messages say it.
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Empty => write!(f, "empty"),
            Self::Bytes(about, _) => write!(f, "{about}"),
            Self::Text { most, filled: true, .. } => write!(f, "ASCII, filled with spaces to {most} bytes"),
            Self::Text { least, most, .. } => write!(f, "ASCII, {least} to {most} bytes"),
            Self::Record(forms) => {
                let forms: Vec<_> = forms.iter().map(|fields| describe(fields)).collect();
                write!(f, "{}", forms.join("; or "))
            }
            Self::List { entry, least, most, .. } if least == most => write!(f, "{most} times ({})", describe(entry)),
            Self::List { entry, least, most, .. } => write!(f, "{least} to {most} times ({})", describe(entry)),
        }
    }
}

// What the rows of `MESSAGES` are made of

pub(super) const EMPTY: Payload = Payload::Empty;
pub(super) const UNKNOWN: Payload = opaque("unknown");

/// Bytes of which no source gives the lengths.
pub(super) const fn opaque(about: &'static str) -> Payload {
    Payload::Bytes(about, Lengths::UNKNOWN)
}

/// `least` to `most` bytes.
pub(super) const fn bytes(about: &'static str, least: usize, most: usize) -> Payload {
    Payload::Bytes(about, Lengths::range(least, most, 1))
}

/// ASCII of `least` to `most` characters.
pub(super) const fn text(least: usize, most: usize) -> Payload {
    Payload::Text { least, most, filled: false }
}

/// ASCII that is filled with spaces to `most` bytes; at least `least` of them were seen.
pub(super) const fn filled_text(least: usize, most: usize) -> Payload {
    Payload::Text { least, most, filled: true }
}

/// One of these records, by their length.
pub(super) const fn record(forms: &'static [&'static [MessageField]]) -> Payload {
    Payload::Record(forms)
}

/// `least` to `most` entries.
pub(super) const fn list(entry: &'static [MessageField], least: usize, most: usize) -> Payload {
    Payload::List { entry, least, most, zeros: false }
}

/// `least` to `most` entries, of which a single one of zeros stands for none.
pub(super) const fn list_or_zeros(entry: &'static [MessageField], least: usize, most: usize) -> Payload {
    Payload::List { entry, least, most, zeros: true }
}

const fn field(name: &'static str, content: Content) -> MessageField {
    MessageField { name, content, unit: "", note: "" }
}

const fn number(name: &'static str, wire: Wire) -> MessageField {
    field(name, Content::Numbers(wire, 1))
}

const fn u1(name: &'static str) -> MessageField {
    number(name, Wire::U1)
}

const fn u2(name: &'static str) -> MessageField {
    number(name, Wire::U2)
}

const fn u4(name: &'static str) -> MessageField {
    number(name, Wire::U4)
}

const fn f4(name: &'static str) -> MessageField {
    number(name, Wire::F4)
}

const fn f8(name: &'static str) -> MessageField {
    field(name, Content::Double)
}

/// The fields of a struct quantity, for a message that has the same.
const fn fields_of<const N: usize>(fields: &[Field]) -> [MessageField; N] {
    assert!(fields.len() == N);
    let mut all = [number("", Wire::U1); N];
    let mut i = 0;
    while i < N {
        all[i] = number(fields[i].name, fields[i].wire);
        i += 1;
    }
    all
}

pub(super) const DEVICE_ID_4: &[MessageField] = &[u4("device_id")];
pub(super) const DEVICE_ID_8: &[MessageField] = &[number("device_id", Wire::U8).note("from the 600-series on")];
pub(super) const FIRMWARE: &[MessageField] = &[u1("major"), u1("minor"), u1("revision"), u4("build"), u4("scm")];
/// Of very old firmware.
pub(super) const FIRMWARE_3: &[MessageField] = &[u1("major"), u1("minor"), u1("revision")];
pub(super) const HARDWARE: &[MessageField] = &[u1("major"), u1("minor")];
pub(super) const SELFTEST: &[MessageField] = &[u2("results").note("a bit for each part that passed")];
pub(super) const ERROR_CODE: &[MessageField] =
    &[u1("code").note("Table 5"), field("extra", Content::RestBytes(7)).note("four of code 40")];
pub(super) const WARNING_CODE: &[MessageField] = &[u4("code").note("Table 6"), field("text", Content::RestText(128))];

pub(super) const BAUD_CODE: &[MessageField] = &[u1("code").note("Table 7")];
pub(super) const SET_FLAGS: &[MessageField] = &[u4("set").note("Table 8"), u4("clear").note("Table 8")];
pub(super) const FLAGS: &[MessageField] = &[u4("flags").note("Table 8")];
pub(super) const LOCATION: &[MessageField] = &[u2("location_id")];
pub(super) const TRANSMIT_DELAY: &[MessageField] = &[u2("delay").unit("1/29.4912 MHz").note("from 590")];
pub(super) const MODE: &[MessageField] = &[u2("mode")];
pub(super) const ERROR_MODE: &[MessageField] = &[u2("mode").note("0 to 3")];
pub(super) const PROCESSING_FLAGS: &[MessageField] = &[u1("flags")];
pub(super) const AMD: &[MessageField] = &[u2("setting")];

/// Tables 9 and 10.
#[rustfmt::skip]
pub(super) const SYNC_SETTING: &[MessageField] = &[
    u1("function").note("Table 11"),
    u1("line").note("Table 12"),
    u1("polarity").note("Tables 9 and 10"),
    u1("trigger_once"),
    u2("skip_first"),
    u2("skip_factor"),
    u2("pulse_width").unit("0.1 ms"),
    // Signed where a pulse goes out (Table 10), milliseconds for the period of a reference clock.
    u2("offset").unit("0.1 ms").note("0 to 60000; of an output pulse -30000 to 30000"),
];

/// Tables 13 and 14, the tail as devices fill it. Eight bytes of identifier, with the halves exchanged against the
/// DeviceID message, take the places of the identifier, the sampling period and the skip factor, and at the end those of
/// the identifier, the data length and the output mode.
#[rustfmt::skip]
pub const CONFIGURATION_FIELDS: &[MessageField] = &[
    u4("device_id"),
    u2("sampling_period").unit("1/115200 s"),
    u2("output_skip_factor"),
    field("sync_in", Content::Bytes(8)),
    field("date", Content::Bytes(8)).note("YYYYMMDD"),
    field("time", Content::Bytes(8)).note("HHMMSSHH"),
    field("product_code", Content::Bytes(20)),
    field("host", Content::Bytes(12)),
    field("client", Content::Bytes(32)),
    u2("devices"),
    u4("first_device_id"),
    u2("data_length"),
    u2("output_mode"),
    u4("output_settings"),
    u2("filter_profile"),
    u1("major"),
    u1("minor"),
    u1("revision"),
    field("filter_type", Content::Bytes(1)),
    u1("filter_major"),
    u1("filter_minor"),
];
// 98 bytes, and 20 for each device (Table 13).
const _: () = assert!(size(CONFIGURATION_FIELDS).1 == 118);

pub(super) const OUTPUT: &[MessageField] = &[u2("data_id").note("Table 16"), u2("frequency").unit("Hz")];
pub(super) const STRINGS_600: &[MessageField] = &[u4("types"), u2("frequency").unit("Hz")];
/// Of the 10- and 100-series.
pub(super) const STRINGS_10_100: &[MessageField] = &[u2("types")];
pub(super) const PERIOD: &[MessageField] = &[u2("period").unit("1/115200 s").note("225 to 1152")];
pub(super) const SKIP_FACTOR: &[MessageField] = &[u2("skip_factor").note("FFFF: only on ReqData")];
pub(super) const WHICH_ROTATION: &[MessageField] = &[u1("parameter").note("0 RotSensor, 1 RotLocal")];
pub(super) const ROTATION: &[MessageField] =
    &[u1("parameter").note("0 RotSensor, 1 RotLocal"), field("quaternion", Content::Numbers(Wire::F4, 4))];
/// Of old firmware.
pub(super) const ROTATION_16: &[MessageField] = &[field("quaternion", Content::Numbers(Wire::F4, 4))];
/// One port: protocol in bits 16 to 19, then the format, and the baud rate code in bits 0 to 7.
pub(super) const PORT: &[MessageField] = &[u4("word").note("Table 22")];
pub(super) const CAN: &[MessageField] = &[u4("word").note("baud rate code in bits 0 to 7, enabled in bit 8")];
pub(super) const CAN_OUTPUT: &[MessageField] =
    &[u1("data_id"), u1("extended"), u4("can_id"), u2("frequency").unit("Hz")];
pub(super) const OUTPUT_SETTINGS: &[MessageField] = &[u4("settings")];
pub(super) const DATA_LENGTH: &[MessageField] = &[u2("length").note("of the MTData payload")];

pub(super) const PROFILE: &[MessageField] = &[u2("profile").note("Table 30")];
pub(super) const PROFILE_IN_USE: &[MessageField] = &[u1("version"), u1("profile").note("Table 30")];
/// Table 29.
pub(super) const AVAILABLE_PROFILE: &[MessageField] = &[u1("type"), u1("version"), field("label", Content::Text(20))];
pub(super) const PLACE: &[MessageField] =
    &[f8("lat").unit("deg").note("-90 to 90"), f8("lon").unit("deg").note("-180 to 180"), f8("alt").unit("m")];
/// Of old firmware.
pub(super) const PLACE_12: &[MessageField] = &[f4("lat").unit("deg"), f4("lon").unit("deg"), f4("alt").unit("m")];
pub(super) const PLATFORM: &[MessageField] = &[u2("platform").note("Table 31")];
pub(super) const LEVER_ARM: &[MessageField] = &[f4("x").unit("m"), f4("y").unit("m"), f4("z").unit("m")];
pub(super) const RESET_CODE: &[MessageField] = &[u2("code").note("Table 33")];
pub(super) const NO_ROTATION: &[MessageField] = &[u2("duration").unit("s")];
/// Table 35, the same as in `UtcTime`.
pub(super) const UTC_TIME: &[MessageField] = &fields_of::<8>(UTC_TIME_PACKET);
pub(super) const UTC_STEP: &[MessageField] = &[number("ticks", Wire::I4).unit("0.1 ms")];
pub(super) const ICC_COMMAND: &[MessageField] = &[u1("command").note("Table 36")];
/// Table 39, after a stop.
pub(super) const ICC_RESULT: &[MessageField] = &[u1("command"), f4("ddt"), u1("dimension"), u1("status")];
pub(super) const ICC_STATE: &[MessageField] = &[u1("command"), u1("active")];
pub(super) const INITIAL_HEADING: &[MessageField] = &[f4("heading").unit("deg").note("-180 to 180")];
pub(super) const HEADING: &[MessageField] = &[f4("heading").unit("rad")];
pub(super) const GRAVITY: &[MessageField] = &[f4("gravity").unit("m/s2")];
pub(super) const RECEIVER: &[MessageField] =
    &[u2("receiver"), u2("baud_code").note("Table 7"), u2("rate").unit("Hz"), u4("options")];
