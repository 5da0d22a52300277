//! An MTData2 payload: packets `[data identifier U2, size U1, data]`, one after another (section 5.3.6).

use crate::table::{self, Field, Kind, Quantity, Wire};

/// The number formats of the manual's type ℝ: the two low bits of the identifier (Table 17).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Precision {
    /// IEEE 754 single.
    Float32,
    /// Fixed point, 12 bits before the point and 20 after it.
    Fp1220,
    /// Fixed point, 16 bits before the point and 32 after it.
    Fp1632,
    /// IEEE 754 double.
    Float64,
}

impl Precision {
    /// All four, in the order of their codes.
    pub const ALL: [Self; 4] = [Self::Float32, Self::Fp1220, Self::Fp1632, Self::Float64];

    /// The precision in a data identifier.
    #[must_use]
    pub const fn of(id: u16) -> Self {
        Self::ALL[(id & 3) as usize]
    }

    /// Bytes of one number on the wire.
    #[must_use]
    pub const fn size(self) -> usize {
        [4, 4, 6, 8][self as usize]
    }

    /// The manual's short name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        ["Float32", "Fp1220", "Fp1632", "Float64"][self as usize]
    }
}

/// The coordinate systems of Table 17: bits 2 and 3 of the identifier, for orientation and velocity only (note 11).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[repr(u8)]
pub enum Coordinates {
    /// East, north, up.
    Enu,
    /// North, east, down.
    Ned,
    /// North, west, up.
    Nwu,
}

impl Coordinates {
    /// All three, in the order of their codes.
    pub const ALL: [Self; 3] = [Self::Enu, Self::Ned, Self::Nwu];

    /// The coordinate system in a data identifier; `None` for the fourth code, which is undefined.
    #[must_use]
    pub fn of(id: u16) -> Option<Self> {
        Self::ALL.get(usize::from(id >> 2 & 3)).copied()
    }

    /// The bits in the identifier.
    #[must_use]
    pub const fn bits(self) -> u16 {
        (self as u16) << 2
    }

    /// The manual's short name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        ["ENU", "NED", "NWU"][self as usize]
    }
}

/// The form of a packet's data: what a decoder needs to know besides the bytes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Form {
    /// Real numbers: their precision, and how many.
    Real(Precision, usize),
    /// Numbers of a fixed type: the type, and how many.
    Fixed(Wire, usize),
    /// One U2 that counts steps of this size in the quantity's unit. Only `MTData` has it.
    Steps(u32),
    /// One record.
    Struct(&'static [Field]),
    /// A record, followed by a list of entries.
    List(&'static [Field], &'static [Field]),
}

/// How to read a packet that the tables explain.
#[derive(Clone, Copy, Debug)]
pub struct Reading {
    /// The row of the table.
    pub quantity: &'static Quantity,
    /// Coordinate system, if the manual defines one for this quantity.
    pub coordinates: Option<Coordinates>,
    /// Form of the data.
    pub form: Form,
}

impl Reading {
    /// Precision of real numbers; `None` for others.
    #[must_use]
    pub const fn precision(&self) -> Option<Precision> {
        match self.form {
            Form::Real(precision, _) => Some(precision),
            _ => None,
        }
    }
}

/// Bytes of one record.
#[must_use]
pub const fn record_size(fields: &[Field]) -> usize {
    let (mut size, mut i) = (0, 0);
    while i < fields.len() {
        size += fields[i].wire.size();
        i += 1;
    }
    size
}

/// One packet of an MTData2 message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Packet<'a> {
    /// Data identifier as received.
    pub id: u16,
    /// Where it begins in the payload.
    pub at: usize,
    /// Its data.
    pub data: &'a [u8],
}

/// Bytes before a packet's data: identifier and size.
pub const PACKET_HEADER: usize = 3;

impl Packet<'_> {
    /// How to read the packet; `None` if its identifier is unknown or its size does not fit the identifier.
    ///
    /// Precision bits do not change the form of quantities without real numbers: devices that are configured for doubles send
    /// `BaroPressure` as 0x3013, which is still U4. Coordinate bits count only if the manual defines them for the quantity.
    #[must_use]
    pub fn reading(&self) -> Option<Reading> {
        let quantity = table::quantity(self.id)?;
        let size = self.data.len();
        let coordinates = if quantity.rotates { Some(Coordinates::of(self.id)?) } else { None };
        let (form, fits) = match quantity.kind {
            Kind::Real(n) => {
                let precision = Precision::of(self.id);
                (Form::Real(precision, n), size == n * precision.size())
            }
            Kind::Fixed(wire, n) => (Form::Fixed(wire, n), size == n * wire.size()),
            Kind::Id if size == 8 => (Form::Fixed(Wire::U8, 1), true),
            Kind::Id => (Form::Fixed(Wire::U4, 1), size == 4),
            Kind::Struct(fields) => (Form::Struct(fields), size == record_size(fields)),
            Kind::List(head, entry) => (Form::List(head, entry), list_length(self.data, head, entry).is_some()),
        };
        fits.then_some(Reading { quantity, coordinates, form })
    }

    /// Whether the packet is valid: a known identifier has a size that it allows, an unknown one any size.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        table::quantity(self.id).is_none() || self.reading().is_some()
    }
}

/// Number of entries in a list packet: the second field of its head, if the size agrees.
fn list_length(data: &[u8], head: &[Field], entry: &[Field]) -> Option<usize> {
    let count = usize::from(*data.get(head[0].wire.size())?);
    (data.len() == record_size(head) + count * record_size(entry)).then_some(count)
}

/// The packets of a payload, in order.
#[derive(Clone, Debug)]
pub struct Packets<'a> {
    payload: &'a [u8],
    at: usize,
}

/// A packet that runs past the end of its payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Overrun {
    /// Where it begins in the payload.
    pub at: usize,
    /// Its identifier, if the payload has both bytes of it.
    pub id: Option<u16>,
}

/// The packets of an MTData2 payload, up to one that runs past its end.
///
/// ```
/// let payload = [0x10, 0x20, 0x02, 0xDF, 0xC5, 0xE0, 0x20, 0x04, 0, 0, 0, 0x81];
/// let packets: Result<Vec<_>, _> = xbus::packet::packets(&payload).collect();
/// let packets = packets.unwrap();
/// assert_eq!((packets[0].id, packets[0].data), (0x1020, &[0xDF, 0xC5][..]));
/// assert_eq!((packets[1].id, packets[1].at), (0xE020, 5));
/// ```
#[must_use]
pub const fn packets(payload: &[u8]) -> Packets<'_> {
    Packets { payload, at: 0 }
}

/// Whether an MTData2 payload is a sample: it has packets, and they tile it.
#[must_use]
pub fn is_well_formed(payload: &[u8]) -> bool {
    !payload.is_empty() && packets(payload).all(|packet| packet.is_ok())
}

impl<'a> Iterator for Packets<'a> {
    type Item = Result<Packet<'a>, Overrun>;

    fn next(&mut self) -> Option<Self::Item> {
        let at = self.at;
        let rest = self.payload.get(at..).filter(|rest| !rest.is_empty())?;
        let &[high, low, size, ref rest @ ..] = rest else {
            self.at = self.payload.len();
            return Some(Err(Overrun { at, id: rest.first_chunk().map(|id| u16::from_be_bytes(*id)) }));
        };
        let id = u16::from_be_bytes([high, low]);
        let Some(data) = rest.get(..size.into()) else {
            self.at = self.payload.len();
            return Some(Err(Overrun { at, id: Some(id) }));
        };
        self.at = at + PACKET_HEADER + data.len();
        Some(Ok(Packet { id, at, data }))
    }
}
