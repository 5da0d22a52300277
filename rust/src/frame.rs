//! A frame: the bytes from preamble to checksum (section 5.1 of the manual).
//!
//! ```text
//! standard   FA  BID  MID  LEN                DATA (0 to 254 bytes)  CHECKSUM
//! extended   FA  BID  MID  FF   EXT LEN (2)   DATA                   CHECKSUM
//! ```

use crate::error::EncodeError;
use crate::packet::{Packets, packets};

/// First byte of every frame.
pub const PREAMBLE: u8 = 0xFA;
/// The value of LEN in the extended form.
pub const EXTENDED: u8 = 0xFF;
/// Payloads of this length and more need the extended form; shorter ones must use the standard form.
pub const EXTENDED_FROM: usize = 255;
/// Longest payload that the extended length can hold. Logs contain frames that are longer than the manual allows.
pub const MAX_PAYLOAD: usize = 0xFFFF;
/// Bus identifier of a stand-alone device, which also answers to 1.
pub const MASTER: u8 = 0xFF;
/// The other bus identifier of a stand-alone device, which is also that of the first one on a bus.
pub const FIRST: u8 = 1;

/// The device that a bus identifier belongs to (section 5.1): FF and 1 are the same one.
#[must_use]
pub const fn device_of(bid: u8) -> u8 {
    if bid == MASTER { FIRST } else { bid }
}

/// Positions of the header's fields in a frame.
pub mod field {
    /// Bus identifier.
    pub const BID: usize = 1;
    /// Message identifier.
    pub const MID: usize = 2;
    /// Length of the payload, or [`EXTENDED`](super::EXTENDED).
    pub const LEN: usize = 3;
    /// Length of the payload in the extended form, two bytes.
    pub const EXT_LEN: usize = 4;
}

/// Bytes before the payload in the standard form.
pub const HEADER_SIZE: usize = field::LEN + 1;
/// Bytes before the payload in the extended form.
pub const EXTENDED_HEADER_SIZE: usize = field::EXT_LEN + 2;

/// The header of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Bus identifier.
    pub bid: u8,
    /// Message identifier.
    pub mid: u8,
    /// Bytes before the payload: [`HEADER_SIZE`] or [`EXTENDED_HEADER_SIZE`].
    pub size: usize,
    /// Bytes of payload.
    pub payload: usize,
}

impl Header {
    /// Reads the header at the start of `bytes`, whose first byte is taken for the preamble; `None` if it is incomplete.
    #[must_use]
    pub fn read(bytes: &[u8]) -> Option<Self> {
        let &[_, bid, mid, length, ref rest @ ..] = bytes else { return None };
        if length != EXTENDED {
            return Some(Self { bid, mid, size: HEADER_SIZE, payload: length.into() });
        }
        let &[high, low, ..] = rest else { return None };
        Some(Self { bid, mid, size: EXTENDED_HEADER_SIZE, payload: u16::from_be_bytes([high, low]).into() })
    }

    /// Bytes of the whole frame, including the checksum.
    #[must_use]
    pub const fn frame(&self) -> usize {
        self.size + self.payload + 1
    }
}

/// The sum of `bytes`, modulo 256. The bytes of an intact frame after the preamble, including the checksum, sum to 0.
#[must_use]
pub fn sum(bytes: &[u8]) -> u8 {
    // Sixteen sums side by side, which the compiler turns into one vector.
    let (blocks, rest) = bytes.as_chunks::<16>();
    let mut lanes = [0u8; 16];
    for block in blocks {
        for (lane, byte) in lanes.iter_mut().zip(block) {
            *lane = lane.wrapping_add(*byte);
        }
    }
    lanes.iter().chain(rest).fold(0, |sum, byte| sum.wrapping_add(*byte))
}

/// The fields of a frame, borrowed from its bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame<'a> {
    /// Bus identifier.
    pub bid: u8,
    /// Message identifier.
    pub mid: u8,
    /// The DATA field.
    pub payload: &'a [u8],
}

impl<'a> Frame<'a> {
    /// The fields of a frame that a scanner has accepted.
    ///
    /// # Panics
    /// If `bytes` is not one whole frame.
    #[must_use]
    pub fn of(bytes: &'a [u8]) -> Self {
        let header = Header::read(bytes).expect("a whole frame has a header");
        Self { bid: header.bid, mid: header.mid, payload: &bytes[header.size..header.size + header.payload] }
    }

    /// The packets of an MTData2 frame: see [`packets`].
    #[must_use]
    pub const fn packets(&self) -> Packets<'a> {
        packets(self.payload)
    }

    /// Encodes the frame, in the extended form from [`EXTENDED_FROM`] bytes of payload on.
    ///
    /// ```
    /// let frame = xbus::frame::Frame { bid: 0xFF, mid: 0x30, payload: &[] }; // GoToConfig, section 6
    /// assert_eq!(frame.encode().unwrap(), [0xFA, 0xFF, 0x30, 0x00, 0xD1]);
    /// ```
    ///
    /// # Errors
    /// [`EncodeError::PayloadTooLong`] if the payload is longer than [`MAX_PAYLOAD`].
    pub fn encode(&self) -> Result<Vec<u8>, EncodeError> {
        let length = self.payload.len();
        let [high, low] = u16::try_from(length).map_err(|_| EncodeError::PayloadTooLong { length })?.to_be_bytes();
        let mut bytes = Vec::with_capacity(EXTENDED_HEADER_SIZE + length + 1);
        bytes.extend([PREAMBLE, self.bid, self.mid]);
        if length < EXTENDED_FROM {
            bytes.push(low);
        } else {
            bytes.extend([EXTENDED, high, low]);
        }
        bytes.extend(self.payload);
        bytes.push(sum(&bytes[field::BID..]).wrapping_neg());
        Ok(bytes)
    }
}
