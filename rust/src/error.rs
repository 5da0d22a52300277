//! Errors, as data. `Display` gives the message.

use std::fmt;
use std::io;

use crate::mtdata::Output;
use crate::scan::Reason;

/// The first invalid bytes of a log, in strict mode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// A stretch of bytes that is neither frame nor string.
    Damage {
        /// Where it begins in the input.
        offset: u64,
        /// What is wrong where it begins.
        reason: Reason,
    },
    /// An MTData2 message that is empty or that its packets do not fill.
    Malformed {
        /// Where its frame begins in the input.
        offset: u64,
        /// Data identifier of the packet that runs past the end, if there is one.
        id: Option<u16>,
    },
    /// An MTData message whose length does not fit the settings in force, or whose settings are not known.
    Unfit {
        /// Where its frame begins in the input.
        offset: u64,
        /// Bytes of its payload.
        length: usize,
        /// Bytes that the settings in force give, if they are known.
        expected: Option<usize>,
    },
    /// A packet whose size does not fit its data identifier.
    Size {
        /// Where its frame begins in the input.
        offset: u64,
        /// Data identifier as received.
        id: u16,
        /// Bytes of its data.
        size: usize,
    },
}

impl Fault {
    /// Where the frame or the damage begins in the input.
    #[must_use]
    pub const fn offset(&self) -> u64 {
        match *self {
            Self::Damage { offset, .. }
            | Self::Malformed { offset, .. }
            | Self::Unfit { offset, .. }
            | Self::Size { offset, .. } => offset,
        }
    }

    /// Data identifier of the invalid packet, if there is one.
    #[must_use]
    pub const fn data_id(&self) -> Option<u16> {
        match *self {
            Self::Damage { .. } | Self::Unfit { .. } => None,
            Self::Malformed { id, .. } => id,
            Self::Size { id, .. } => Some(id),
        }
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Damage { offset, reason } => {
                write!(f, "no frame at byte {offset} ({}); read without strict to skip the damage", reason.name())
            }
            Self::Malformed { offset, id: Some(id) } => {
                write!(f, "MTData2 at byte {offset}: packet {id:#06X} runs past the end of the message")
            }
            Self::Malformed { offset, id: None } => {
                write!(f, "MTData2 at byte {offset}: its packets do not fill the message")
            }
            Self::Unfit { offset, length, expected: Some(expected) } => {
                write!(f, "MTData at byte {offset}: it has {length} bytes, and with the settings in force {expected}")
            }
            Self::Unfit { offset, length, expected: None } => {
                write!(
                    f,
                    "MTData at byte {offset} with {length} bytes: OutputMode and OutputSettings are not known; pass them \
                     as legacy"
                )
            }
            Self::Size { offset, id, size } => {
                write!(
                    f,
                    "MTData2 at byte {offset}: packet {id:#06X} with {size} bytes, a size that its identifier does not allow"
                )
            }
        }
    }
}

impl std::error::Error for Fault {}

/// Why a log cannot be read any further.
#[derive(Debug)]
pub enum ReadError {
    /// The input cannot be read.
    Io(io::Error),
    /// Invalid bytes, in strict mode.
    Fault(Fault),
}

impl From<io::Error> for ReadError {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

impl From<Fault> for ReadError {
    fn from(fault: Fault) -> Self {
        Self::Fault(fault)
    }
}

impl fmt::Display for ReadError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Io(error) => error.fmt(f),
            Self::Fault(fault) => fault.fmt(f),
        }
    }
}

impl std::error::Error for ReadError {}

/// Host times for a table that are not one for each sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HostTimesError {
    /// Samples of the part.
    pub samples: usize,
    /// Host times.
    pub found: usize,
}

impl fmt::Display for HostTimesError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { samples, found } = self;
        write!(f, "a table of {samples} samples needs {samples} host times, not {found}")
    }
}

impl std::error::Error for HostTimesError {}

/// A part of a log that does not have the shape of the log: the input has changed since its shape was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ShapeError;

impl fmt::Display for ShapeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the part has columns that its log does not have")
    }
}

impl std::error::Error for ShapeError {}

/// Why CAN frames cannot be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CanError {
    /// Identifiers, sizes and data are not of the same frames.
    Lengths,
    /// More frames than a log can count.
    TooMany,
    /// No message has this code.
    Code(u8),
    /// An identifier that has more bits than its format.
    Range(u32),
    /// One identifier for two messages.
    Twice(u32),
}

impl fmt::Display for CanError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Lengths => f.write_str("identifiers, lengths and data must have one row for each frame"),
            Self::TooMany => f.write_str("a log has fewer than 2^32 CAN frames; read a shorter part of the capture"),
            Self::Code(code) => write!(f, "no CAN message has the code {code:#04X}"),
            Self::Range(id) => write!(f, "the identifier {id:#X} has more bits than its format"),
            Self::Twice(id) => write!(f, "the identifier {id:#X} stands for two messages"),
        }
    }
}

impl std::error::Error for CanError {}

/// Settings of `MTData` of which no source gives the layout.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutputError {
    /// Bit 15 of `OutputMode`.
    Mt9(Output),
    /// An undefined form of the orientation.
    Orientation(Output),
    /// An undefined form of the position.
    Position(Output),
    /// An undefined form of the velocity.
    Velocity(Output),
}

impl fmt::Display for OutputError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Mt9(output) => {
                write!(f, "{output}: the layout of MT9-compatible output (OutputMode 8000) is not known")
            }
            Self::Orientation(output) => {
                write!(f, "{output}: bits 2 and 3 of OutputSettings are both set, which is no form of an orientation")
            }
            Self::Position(output) => {
                write!(f, "{output}: bits 14 to 16 of OutputSettings must be 0; no other form of a position is known")
            }
            Self::Velocity(output) => {
                write!(f, "{output}: bits 17 and 18 of OutputSettings must be 0; no other form of a velocity is known")
            }
        }
    }
}

impl std::error::Error for OutputError {}

/// Why something cannot be encoded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum EncodeError {
    /// No quantity has this data identifier, or its coordinate bits are undefined.
    Identifier {
        /// The identifier.
        id: u16,
    },
    /// A quantity that is no packet, because only CAN or `MTData` has it.
    NoPacket {
        /// The quantity.
        name: &'static str,
    },
    /// Settings of `MTData` of which no source gives the layout.
    Output(OutputError),
    /// Numbers of another number of items than `MTData` has with these settings.
    Items {
        /// The settings.
        output: Output,
        /// How many items it has.
        expected: usize,
        /// How many there are.
        found: usize,
    },
    /// A payload that is too long for the 16-bit length.
    PayloadTooLong {
        /// Its bytes.
        length: usize,
    },
    /// A packet whose data are too long for the one-byte size.
    PacketTooLong {
        /// Name of the quantity.
        name: &'static str,
        /// Their bytes.
        length: usize,
    },
    /// The wrong number of values.
    Count {
        /// Name of the quantity.
        name: &'static str,
        /// How many the quantity has.
        expected: usize,
        /// How many there are.
        found: usize,
    },
    /// An integer outside its type.
    Range {
        /// Name of the quantity or field.
        name: &'static str,
        /// The value.
        value: String,
        /// The manual's type, with its range.
        wire: &'static str,
    },
    /// NaN in fixed point, which cannot represent it.
    NotANumber {
        /// Name of the quantity.
        name: &'static str,
        /// The requested precision.
        precision: &'static str,
    },
    /// Coordinates for a quantity without.
    Coordinates {
        /// Name of the quantity.
        name: &'static str,
    },
    /// A precision for a quantity of integers.
    Precision {
        /// Name of the quantity.
        name: &'static str,
    },
}

impl fmt::Display for EncodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Identifier { id } => write!(f, "no quantity has the data identifier {id:#06x}"),
            Self::NoPacket { name } => {
                let holder =
                    if crate::table::MTDATA_QUANTITIES.iter().any(|row| row.name == *name) { "MTData" } else { "CAN" };
                write!(f, "{name} has no packet; only {holder} has it")
            }
            Self::Output(error) => error.fmt(f),
            Self::Items { output, expected, found } => {
                write!(f, "MTData with {output} has {expected} items, not {found}")
            }
            Self::PayloadTooLong { length } => {
                write!(f, "a payload of {length} bytes does not fit into a frame; its length has 16 bits")
            }
            Self::PacketTooLong { name, length } => {
                write!(f, "{name}: {length} bytes do not fit into a packet; its size has 8 bits")
            }
            Self::Count { name, expected, found } => write!(f, "{name} takes {expected} numbers, not {found}"),
            Self::Range { name, value, wire } => write!(f, "{name}: {value} is outside {wire}"),
            Self::NotANumber { name, precision } => {
                write!(f, "{name}: {precision} has no NaN; use Float32 or Float64")
            }
            Self::Coordinates { name } => write!(f, "{name} has no coordinate system in the manual"),
            Self::Precision { name } => write!(f, "{name} consists of integers, which have no precision"),
        }
    }
}

impl std::error::Error for EncodeError {}

/// Why the state of a value cannot be restored.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StateError {
    /// This other version made it.
    Version(String),
    /// It is cut or changed.
    Damaged,
}

impl fmt::Display for StateError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Version(version) => {
                write!(f, "saved by xbus {version}, and this is {}: read the log again", env!("CARGO_PKG_VERSION"))
            }
            Self::Damaged => f.write_str("the saved state is damaged: read the log again"),
        }
    }
}

impl std::error::Error for StateError {}
