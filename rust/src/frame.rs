//! A frame: the bytes from preamble to checksum (section 5.1 of the manual).
//!
//! ```text
//! standard   FA  BID  MID  LEN                DATA (0 to 254 bytes)  CHECKSUM
//! extended   FA  BID  MID  FF   EXT LEN (2)   DATA                   CHECKSUM
//! ```

use crate::error::EncodeError;

/// First byte of every frame.
pub const PREAMBLE: u8 = 0xFA;
/// The value of LEN that says: the length follows in two bytes of its own.
pub const EXTENDED: u8 = 0xFF;
/// Payloads of this length and more need the extended form; shorter ones must use the standard one.
pub const EXTENDED_FROM: usize = 255;
/// Bus identifier of a stand-alone device; it answers to 1 as well.
pub const MASTER: u8 = 0xFF;

/// What stands before the payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Bus identifier.
    pub bid: u8,
    /// Message identifier.
    pub mid: u8,
    /// Bytes before the payload: 4, or 6 in the extended form.
    pub size: usize,
    /// Bytes of payload.
    pub payload: usize,
}

impl Header {
    /// Reads a header at the start of `bytes`, which the caller knows to begin with the preamble; `None` if it is cut.
    #[must_use]
    pub fn read(bytes: &[u8]) -> Option<Self> {
        let &[_, bid, mid, length, ref rest @ ..] = bytes else { return None };
        if length != EXTENDED {
            return Some(Self { bid, mid, size: 4, payload: length.into() });
        }
        let &[high, low, ..] = rest else { return None };
        Some(Self { bid, mid, size: 6, payload: u16::from_be_bytes([high, low]).into() })
    }

    /// Bytes of the whole frame, checksum included.
    #[must_use]
    pub const fn frame(&self) -> usize {
        self.size + self.payload + 1
    }
}

/// The sum of `bytes`, modulo 256. A frame is intact when everything after its preamble, checksum included, sums to 0.
#[must_use]
pub fn sum(bytes: &[u8]) -> u8 {
    // Sixteen sums side by side: the compiler makes one vector of them.
    let (blocks, rest) = bytes.as_chunks::<16>();
    let mut lanes = [0u8; 16];
    for block in blocks {
        for (lane, byte) in lanes.iter_mut().zip(block) {
            *lane = lane.wrapping_add(*byte);
        }
    }
    lanes.iter().chain(rest).fold(0, |sum, byte| sum.wrapping_add(*byte))
}

/// What a frame says, borrowed from the bytes it stands in.
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
    /// Takes an accepted frame apart.
    ///
    /// # Panics
    /// If `bytes` is not one whole frame; only the scanner decides what is.
    #[must_use]
    pub fn of(bytes: &'a [u8]) -> Self {
        let header = Header::read(bytes).expect("a whole frame has a header");
        Self { bid: header.bid, mid: header.mid, payload: &bytes[header.size..header.size + header.payload] }
    }

    /// Writes the frame in its shortest form: extended length from 255 bytes on.
    ///
    /// ```
    /// let frame = xbus::frame::Frame { bid: 0xFF, mid: 0x30, payload: &[] }; // GoToConfig, section 6
    /// assert_eq!(frame.encode().unwrap(), [0xFA, 0xFF, 0x30, 0x00, 0xD1]);
    /// ```
    ///
    /// # Errors
    /// [`EncodeError::PayloadTooLong`] if the payload does not fit the 16-bit length.
    pub fn encode(&self) -> Result<Vec<u8>, EncodeError> {
        let length = self.payload.len();
        let [high, low] = u16::try_from(length).map_err(|_| EncodeError::PayloadTooLong { length })?.to_be_bytes();
        let mut bytes = Vec::with_capacity(length + 7);
        bytes.extend([PREAMBLE, self.bid, self.mid]);
        if length < EXTENDED_FROM {
            bytes.push(low);
        } else {
            bytes.extend([EXTENDED, high, low]);
        }
        bytes.extend(self.payload);
        bytes.push(sum(&bytes[1..]).wrapping_neg());
        Ok(bytes)
    }
}
