//! What the codes in `Error` (one byte) and `Warning` (four bytes) mean.

/// Codes that a device can send, sorted. The manual's Tables 5 and 6 have the common ones, the vendor's open code the
/// rest; the codes with which that code reports its own failures to a program are left out.
#[rustfmt::skip]
pub const RESULT_CODES: &[(u32, &str)] = &[
    (  0, "no error"),
    (  1, "no communication on the bus"),
    (  2, "the bus is not ready"),
    (  3, "the period is out of range"),
    (  4, "the message is invalid here, or this device does not know it"),
    ( 16, "the bus could not be initialised (1)"),
    ( 17, "the bus could not be initialised (2)"),
    ( 18, "the bus could not be initialised (3)"),
    ( 20, "the bus identifier could not be set (1)"),
    ( 21, "the bus identifier could not be set (2)"),
    ( 24, "measurement failed (1)"),
    ( 25, "measurement failed (2)"),
    ( 26, "measurement failed (3)"),
    ( 27, "measurement failed (4)"),
    ( 28, "measurement failed (5)"),
    ( 29, "measurement failed (6)"),
    ( 30, "timer overflow: the output frequency is too high, or the host sends too much while measuring"),
    ( 32, "the baud rate is out of range"),
    ( 33, "a parameter is invalid or out of range"),
    ( 35, "the transmit buffer is full"),
    ( 36, "the transmit buffer overflowed"),
    ( 37, "wireless failure"),
    ( 40, "device error: a firmware update may help"),
    ( 41, "more data than the baud rate can carry"),
    ( 42, "a buffer overflowed"),
    ( 43, "the external trigger misbehaves"),
    ( 44, "error in the stream of samples"),
    ( 45, "the supply voltage dipped"),
    ( 46, "over-current"),
    ( 47, "the device is too hot"),
    ( 48, "the battery is low"),
    ( 49, "the filter profile is invalid"),
    ( 50, "the stored settings are invalid"),
    ( 51, "access denied"),
    ( 52, "file error"),
    ( 53, "the output configuration is invalid"),
    ( 54, "file system error"),
    ( 55, "battery system error"),
    (400, "the device is shutting down"),
    (401, "the GNSS receiver refused a setting"),
    (402, "the GNSS receiver did not answer in time"),
    (403, "communication with the GNSS receiver failed"),
    (404, "the device is not calibrated"),
    (405, "the connection to the GNSS receiver was lost"),
    (406, "the GNSS receiver delivers too slowly"),
    (407, "the GNSS receiver's data are incomplete"),
];

/// The meaning of a code, if a source gives it.
#[must_use]
pub fn result_text(code: u32) -> Option<&'static str> {
    let at = RESULT_CODES.binary_search_by_key(&code, |&(code, _)| code).ok()?;
    Some(RESULT_CODES[at].1)
}
