//! The string outputs: section 5.3.5, under `SetStringOutputType`.
//!
//! The table has what the scanner needs: how each string begins and ends. Its fields are declared in Python, which parses
//! and encodes strings.

/// How a string ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// With a checksum: `*`, two hexadecimal digits, and the end of the line.
    Checksum,
    /// With the end of the line, after this many fields that are numbers or empty.
    Numbers(usize),
    /// With the end of the line, after characters as in this mask: `D` a digit or blank, `-` a minus or blank, others
    /// themselves.
    Mask(&'static [u8]),
    /// With nothing: it is binary and has this many bytes. Only its length and the range of its angles distinguish it
    /// from noise, so the scanner looks for it only where it is expected.
    Length(usize),
}

/// One string output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StringOutput {
    /// Its name in the manual, without `$`.
    pub name: &'static str,
    /// The bytes before its first field.
    pub start: &'static [u8],
    /// How it ends.
    pub end: End,
}

/// All of them, in the order of their bits in `SetStringOutputType`.
pub const STRINGS: [StringOutput; 15] = [
    sentence("HCHDM", b"$HCHDM,"),
    sentence("HCHDG", b"$HCHDG,"),
    StringOutput { name: "TSS2", start: b":", end: End::Mask(b"DDDDD -DDDDH-DDDD -DDDDF") },
    sentence("PHTRO", b"$PHTRO,"),
    StringOutput { name: "PRDID", start: b"$PRDID,", end: End::Numbers(3) },
    StringOutput { name: "EM1000", start: &[0x00, 0x90], end: End::Length(10) },
    sentence("PSONCMS", b"$PSONCMS,"),
    sentence("HCMTW", b"$HCMTW,"),
    sentence("HEHDT", b"$HEHDT,"),
    sentence("HEROT", b"$HEROT,"),
    sentence("GPGGA", b"$GPGGA,"),
    sentence("PTCF", b"$PTCF,"),
    sentence("XSVEL", b"$XSVEL,"),
    sentence("GPZDA", b"$GPZDA,"),
    sentence("GPRMC", b"$GPRMC,"),
];

/// The string outputs that have neither a checksum nor an end of line, as bits of `SetStringOutputType`.
pub const BARE_STRINGS: u32 = {
    let (mut bits, mut at) = (0, 0);
    while at < STRINGS.len() {
        if matches!(STRINGS[at].end, End::Length(_)) {
            bits |= 1 << at;
        }
        at += 1;
    }
    bits
};

const fn sentence(name: &'static str, start: &'static [u8]) -> StringOutput {
    StringOutput { name, start, end: End::Checksum }
}
