//! The protocol as data.
//!
//! Every number of the manual (MT0101P, revision 2020.A) that the code needs stands in one of these tables and nowhere
//! else: decoder, encoder, scanner, Python enums, stubs, documentation and command line read them. A new data
//! identifier or message is a new row.

mod can;
mod errors;
mod messages;
mod mtdata;
pub mod mtssp;
mod payload;
mod products;
mod quantities;
mod strings;
#[cfg(test)]
mod tests;

pub use can::{CAN_MESSAGES, CAN_QUANTITIES, CanContent, CanMessage, CanSignal, MAX_EXPONENT};
pub use errors::{RESULT_CODES, result_text};
pub use messages::{
    CONFIGURATION, DEVICE_ID, ERROR, FIRMWARE_REV, HARDWARE_VERSION, INIT_BUS_RESULTS, LONGEST_PAYLOAD, MESSAGES,
    MTDATA, MTDATA2, OUTPUT_MODE_ACK, OUTPUT_SETTINGS_ACK, PRODUCT_CODE, SET_OUTPUT_MODE, SET_OUTPUT_SETTINGS,
    STRING_OUTPUT_TYPE, WARNING,
};
pub use mtdata::{MTDATA_ITEMS, MTDATA_QUANTITIES, MtDataItem, output_mode, output_settings};
pub use payload::{CONFIGURATION_FIELDS, Content, Lengths, MessageField, Payload, offset, size};
pub use products::{Class, LEGACY_PRODUCTS, PRODUCTS, Product, Products, Series};
pub use quantities::{QUANTITIES, STATUS_FLAGS};
pub use strings::{BARE_STRINGS, End, STRINGS, StringOutput};

/// The number types of the manual, section 5.3.6. All are big-endian on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wire {
    /// Unsigned, 8 bits.
    U1,
    /// Unsigned, 16 bits.
    U2,
    /// Unsigned, 32 bits.
    U4,
    /// Unsigned, 64 bits.
    U8,
    /// Two's complement, 8 bits.
    I1,
    /// Two's complement, 16 bits.
    I2,
    /// Two's complement, 32 bits.
    I4,
    /// IEEE 754 single, whatever the identifier's precision bits say.
    F4,
}

impl Wire {
    /// Bytes on the wire.
    #[must_use]
    pub const fn size(self) -> usize {
        match self {
            Self::U1 | Self::I1 => 1,
            Self::U2 | Self::I2 => 2,
            Self::U4 | Self::I4 | Self::F4 => 4,
            Self::U8 => 8,
        }
    }

    /// The name in numpy's type strings, native byte order: `"u1"`, `"i4"`, `"f4"`, ...
    #[must_use]
    pub const fn numpy(self) -> &'static str {
        match self {
            Self::U1 => "u1",
            Self::U2 => "u2",
            Self::U4 => "u4",
            Self::U8 => "u8",
            Self::I1 => "i1",
            Self::I2 => "i2",
            Self::I4 => "i4",
            Self::F4 => "f4",
        }
    }
}

/// One member of a struct quantity, as the manual names it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Field {
    /// The manual's name.
    pub name: &'static str,
    /// How it is written.
    pub wire: Wire,
    /// What one count is worth in `unit`; 1 where the integer is the value.
    pub scale: f64,
    /// Unit of the scaled value (`"deg"`, `"m"`, `"m/s"`, ...), empty for counts, dates and bits.
    pub unit: &'static str,
    /// The integer for "not provided", if the field has one.
    pub missing: Option<u32>,
}

/// How the bytes of a packet are to be read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// This many numbers of the manual's type ℝ, in the precision that the identifier's two low bits name.
    Real(usize),
    /// This many numbers of one type that format bits do not change.
    Fixed(Wire, usize),
    /// An integer of 4 or 8 bytes, by the packet's size (`DeviceId`).
    Id,
    /// One record.
    Struct(&'static [Field]),
    /// A record, its second field counting the entries that follow it (`GnssSatInfo`).
    List(&'static [Field], &'static [Field]),
}

/// The role of a quantity in the clock of its device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClockRole {
    /// It counts the samples.
    Counter,
    /// It is the device's clock, in 0.1 ms.
    Fine,
    /// It is the device's clock in whole seconds, which does not wrap.
    Coarse,
    /// It has a separate time stamp, in µs, and its sample arrives late.
    Trigger,
    /// It comes from the GNSS receiver. Its sample arrives late, and without a fix its time is arbitrary, so that it does
    /// not move the clock.
    Receiver,
}

impl ClockRole {
    /// The name in Python: `"counter"`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Counter => "counter",
            Self::Fine => "fine",
            Self::Coarse => "coarse",
            Self::Trigger => "trigger",
            Self::Receiver => "receiver",
        }
    }
}

/// The axes that the numbers of a quantity refer to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axes {
    /// Those of the sensor, after its alignment rotation.
    Sensor,
    /// Those of the local frame: east, north and up, or as the coordinate bits say.
    Local,
    /// A rotation from the axes of the sensor to those of the local frame.
    SensorToLocal,
    /// Fixed to the Earth: latitude, longitude and height, ECEF, or the directions in the names of the fields.
    Earth,
}

impl Axes {
    /// The name in Python: `"sensor to local"`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Sensor => "sensor",
            Self::Local => "local",
            Self::SensorToLocal => "sensor to local",
            Self::Earth => "earth",
        }
    }
}

/// How a value between two samples follows from its neighbours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interpolation {
    /// In proportion to the time. In a record this holds for fields in metres, metres per second and degrees; the other
    /// fields keep the previous value.
    Linear,
    /// As `Linear`, for degrees that wrap.
    Angle,
    /// By a rotation about a fixed axis at a constant rate.
    Rotation,
    /// It keeps the previous value.
    Previous,
}

impl Interpolation {
    /// The name in Python: `"linear"`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Linear => "linear",
            Self::Angle => "angle",
            Self::Rotation => "rotation",
            Self::Previous => "previous",
        }
    }
}

/// One data identifier: a row of the manual's Table 16.
#[derive(Clone, Copy, Debug)]
pub struct Quantity {
    /// Data identifier with its format bits (the four low ones) zero.
    pub id: u16,
    /// Name in xbus: the manual's, in `snake_case`.
    pub name: &'static str,
    /// Name in the manual, without `XDI_`.
    pub manual: &'static str,
    /// Group in the manual's Table 16.
    pub group: &'static str,
    /// How its bytes are read.
    pub kind: Kind,
    /// Names of the components of one row, in the order of the wire; empty for a scalar or a struct.
    pub components: &'static [&'static str],
    /// Unit of every component, or empty.
    pub unit: &'static str,
    /// Whether its numbers are a matrix of 3 by 3, column by column.
    pub is_matrix: bool,
    /// The axes that its numbers refer to; none for numbers without a direction.
    pub axes: Option<Axes>,
    /// How values between two samples follow; none for counters, stamps, events and changes over one period.
    pub interpolation: Option<Interpolation>,
    /// Whether the coordinate bits of the identifier mean something (Table 17, note 11).
    pub rotates: bool,
    /// Its role in the clock, if it has one.
    pub clock: Option<ClockRole>,
    /// Whether its integer has the bits of [`STATUS_FLAGS`].
    pub has_flags: bool,
    /// Products that offer it (Table 16); none where the manual does not list it.
    pub products: Products,
    /// Where the layout is written down.
    pub source: &'static str,
}

/// A named part of `StatusWord`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StatusFlag {
    /// Name in xbus: the manual's, in `snake_case`.
    pub name: &'static str,
    /// Its lowest bit.
    pub bit: u8,
    /// How many bits it has.
    pub width: u8,
    /// Its meaning.
    pub meaning: &'static str,
}

/// Who sends a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// The host, to the device.
    ToDevice,
    /// The device, to the host.
    ToHost,
    /// Either side.
    Both,
}

impl Direction {
    /// The name in Python: `"to device"`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::ToDevice => "to device",
            Self::ToHost => "to host",
            Self::Both => "both",
        }
    }
}

/// The device states in which a message is valid (section 4).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct States {
    /// The wake-up procedure.
    pub wakeup: bool,
    /// Config State.
    pub config: bool,
    /// Measurement State.
    pub measurement: bool,
}

impl States {
    /// The names in Python: `["config", "measurement"]`.
    #[must_use]
    pub fn names(self) -> Vec<&'static str> {
        let states = [(self.wakeup, "wakeup"), (self.config, "config"), (self.measurement, "measurement")];
        states.into_iter().filter_map(|(is_valid, name)| is_valid.then_some(name)).collect()
    }
}

/// One message: a row of the manual's section 5.3. A MID that both requests and sets, or whose reply comes with and
/// without data, has a row for each.
#[derive(Clone, Copy, Debug)]
pub struct Message {
    /// Message identifier.
    pub mid: u8,
    /// The manual's name, `GoToConfig`; no two rows share one.
    pub name: &'static str,
    /// Who sends it.
    pub direction: Direction,
    /// When it is valid.
    pub states: States,
    /// Its payload.
    pub payload: Payload,
    /// Whether it may also carry nothing.
    pub can_be_empty: bool,
    /// Whether a source confirms the payload. If not, the scanner takes no length of it as plausible.
    pub is_confirmed: bool,
    /// Whether the device starts a new run with it: counter and clock may start again, and no sample is lost.
    pub restarts: bool,
    /// MID of the message that answers it.
    pub reply: Option<u8>,
    /// Products of the manual that know it.
    pub products: Products,
    /// Others that know it: products before the manual, and those whose earlier firmware sent `MTData`.
    pub legacy: Products,
    /// `""`, the manual's `"reserved"`, `"deprecated"` or `"obsolete"`, or `"unlisted"` where it does not have the MID.
    pub status: &'static str,
}

impl Message {
    /// Its payload, as documentation and error messages say it: `"U2 period (1/115200 s, 225 to 1152)"`.
    #[must_use]
    pub fn description(&self) -> String {
        let can_be_cleared = matches!(self.payload, Payload::List { zeros: true, .. });
        let more = match self.direction {
            Direction::ToDevice if can_be_cleared => "; one entry of zeros clears the list",
            _ if self.can_be_empty => "; or empty",
            _ => "",
        };
        format!("{}{more}", self.payload)
    }

    /// The payload lengths of this row.
    #[must_use]
    pub const fn own_lengths(&self) -> Lengths {
        let lengths = self.payload.lengths();
        if self.can_be_empty { lengths.or(Lengths::exactly(0)) } else { lengths }
    }

    /// The payload lengths to expect: of a message to the device those of its row, of a message from the device those
    /// of all rows of its MID.
    #[must_use]
    pub fn lengths(&self) -> Lengths {
        if self.direction == Direction::ToDevice { self.own_lengths() } else { SENT[usize::from(self.mid)] }
    }
}

/// The quantity of a data identifier, whatever its format bits.
#[must_use]
pub fn quantity(data_id: u16) -> Option<&'static Quantity> {
    QUANTITIES.get(usize::from(ROW_OF_ID[usize::from(data_id >> 4)]))
}

/// The quantity of this identifier in a column: as [`quantity`], or one that only CAN or `MTData` has.
#[must_use]
pub fn column_quantity(data_id: u16) -> Option<&'static Quantity> {
    let others = || CAN_QUANTITIES.iter().chain(MTDATA_QUANTITIES);
    quantity(data_id).or_else(|| others().find(|row| row.id == data_id & !0xF))
}

/// The quantity of this name.
#[must_use]
pub fn quantity_named(name: &str) -> Option<&'static Quantity> {
    QUANTITIES.iter().chain(CAN_QUANTITIES).chain(MTDATA_QUANTITIES).find(|quantity| quantity.name == name)
}

/// The base identifier of the quantity of this name; a name that no row has does not compile.
pub(crate) const fn data_id(name: &str) -> u16 {
    quantity_row(QUANTITIES, name).expect("a quantity of that name").id
}

/// The row of this name in a table.
const fn quantity_row(rows: &'static [Quantity], name: &str) -> Option<&'static Quantity> {
    let mut i = 0;
    while i < rows.len() {
        if same(rows[i].name, name) {
            return Some(&rows[i]);
        }
        i += 1;
    }
    None
}

const fn same(a: &str, b: &str) -> bool {
    let (a, b) = (a.as_bytes(), b.as_bytes());
    let mut i = 0;
    while i < a.len() && i < b.len() && a[i] == b[i] {
        i += 1;
    }
    i == a.len() && i == b.len()
}

/// The rows of a MID.
pub fn messages(mid: u8) -> impl Iterator<Item = &'static Message> {
    let first = MESSAGES.partition_point(|message| message.mid < mid);
    MESSAGES[first..].iter().take_while(move |message| message.mid == mid)
}

/// The name of a message. Where a MID has several rows, a row that has payloads of this length goes before one that has
/// not; of these, an empty payload belongs to the row without a payload, and any other to one with a payload.
#[cfg_attr(feature = "python", pyo3::pyfunction)]
#[must_use]
pub fn message_name(mid: u8, length: usize) -> Option<&'static str> {
    let unlike = |message: &&Message| {
        let carries_nothing = message.payload == Payload::Empty;
        (!message.own_lengths().allow(length), carries_nothing != (length == 0))
    };
    messages(mid).min_by_key(unlike).map(|message| message.name)
}

/// Whether a device starts a new run with this message, so that its clock and counter may start again.
///
/// A run is the samples of one device between two such messages.
#[must_use]
pub fn restarts(mid: u8) -> bool {
    messages(mid).any(|message| message.restarts)
}

/// Whether a device is known to send this MID with a payload of this length.
///
/// The scanner asks for every candidate in damaged data, so this is one look-up. `MTData2` may have any length but 0:
/// its packets, not its row, show whether it is sound.
#[must_use]
pub fn device_sends(mid: u8, length: usize) -> bool {
    if mid == MTDATA2 { length > 0 } else { SENT[usize::from(mid)].allow(length) }
}

const NO_ROW: u8 = u8::MAX;
const _: () = assert!(QUANTITIES.len() < NO_ROW as usize);

/// For every identifier, without its four format bits: where `QUANTITIES` has it.
static ROW_OF_ID: [u8; 1 << 12] = {
    let mut rows = [NO_ROW; 1 << 12];
    let mut i: u8 = 0;
    while (i as usize) < QUANTITIES.len() {
        rows[(QUANTITIES[i as usize].id >> 4) as usize] = i;
        i += 1;
    }
    rows
};

/// For every MID: the payload lengths that a device sends.
static SENT: [Lengths; 1 << 8] = {
    let mut sent = [Lengths::UNKNOWN; 1 << 8];
    let mut i = 0;
    while i < MESSAGES.len() {
        let row = &MESSAGES[i];
        if !matches!(row.direction, Direction::ToDevice) && row.is_confirmed {
            sent[row.mid as usize] = sent[row.mid as usize].or(row.own_lengths());
        }
        i += 1;
    }
    sent
};
