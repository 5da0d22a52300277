//! MTSSP, the protocol of the 1-series on I²C and SPI: opcodes, addresses and limits.
//!
//! The sources are the data sheet of the 1-series (2021), that of the FMT1000, a sister product, and the vendor's
//! examples for mbed and STM32. Where the two sheets disagree on a bit, the row follows the 1-series.

/// The first byte of a transfer: what is read or written.
#[derive(Clone, Copy, Debug)]
pub struct Opcode {
    /// Its code.
    pub code: u8,
    /// The vendor's name.
    pub name: &'static str,
    /// Whether the module sends the data.
    pub is_read: bool,
    /// Bytes of the data; none where it is a message.
    pub size: Option<usize>,
}

/// Every opcode, ascending.
#[rustfmt::skip]
pub const OPCODES: &[Opcode] = &[
    Opcode { code: 0x01, name: "ProtocolInfo",      is_read: true,  size: Some(2) },
    Opcode { code: 0x02, name: "ConfigureProtocol", is_read: false, size: Some(1) },
    Opcode { code: 0x03, name: "ControlPipe",       is_read: false, size: None },
    Opcode { code: 0x04, name: "PipeStatus",        is_read: true,  size: Some(4) },
    Opcode { code: 0x05, name: "NotificationPipe",  is_read: true,  size: None },
    Opcode { code: 0x06, name: "MeasurementPipe",   is_read: true,  size: None },
];

/// The bits of the data-ready configuration, from bit 0; the others are reserved.
pub const DATA_READY_BITS: [&str; 4] = ["IDLE_HIGH", "OPEN_DRAIN", "NOTIFICATIONS", "MEASUREMENTS"];

/// The I²C address for each level of the pins ADD2 to ADD0, as a number. Sources confirm the first and the last two; the
/// others are from a data sheet that is no longer public.
pub const ADDRESSES: [u8; 8] = [0x1D, 0x1E, 0x28, 0x29, 0x68, 0x69, 0x6A, 0x6B];

/// What a module sends on SPI before the data, while it receives the opcode and three bytes of any value. With the message
/// after it, the first and the last two make a frame.
pub const SPI_HEADER: [u8; 4] = [0xFA, 0xFF, 0xFF, 0xFF];

/// SPI mode: clock idle high, data valid at the second edge.
pub const SPI_MODE: u8 = 3;

/// The fastest clocks in Hz: of SPI, which also gives the 4 µs that the module needs for a byte, and of I²C.
pub const MAX_SPI_HZ: u32 = 2_000_000;
/// See [`MAX_SPI_HZ`].
pub const MAX_I2C_HZ: u32 = 400_000;

/// Bytes of a message to a module. Of a longer one, only the bytes beyond a multiple of this stay in its buffer.
pub const MAX_INPUT: usize = 512;

/// Bytes of a message from a module: 2048 of payload, and identifier, length and checksum.
pub const MAX_OUTPUT: usize = 2048 + 5;

/// The error code with which a module reports that a pipe was full, and that the newest message was dropped.
pub const PIPE_OVERFLOW: u8 = 0x29;

const _: () = {
    let mut i = 1;
    while i < OPCODES.len() {
        assert!(OPCODES[i - 1].code < OPCODES[i].code, "opcodes must rise");
        i += 1;
    }
};
