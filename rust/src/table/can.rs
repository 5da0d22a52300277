//! The CAN output of the 600-series: one row per message, with its signals.
//!
//! The sources are the vendor's CAN document (MT1604P, revisions A and 2020.A), the identifiers in its code, and
//! readers and a DBC file of other people, which were tested with devices. Where they disagree, the row follows the
//! majority; docs/howto/can.md lists the disagreements.

use super::products::Products;
use super::quantities::record;
use super::{Field, Interpolation, QUANTITIES, Quantity, Wire, quantity_row};
use Wire::{I2, I4, U1, U2, U4};

/// One number of a CAN message. All are big-endian.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CanSignal {
    /// Its name.
    pub name: &'static str,
    /// How it is written.
    pub wire: Wire,
    /// Counts in one `unit`; 1 where the integer is the value.
    pub per_unit: u32,
    /// Unit of the scaled value, empty for counts, dates and bits.
    pub unit: &'static str,
    /// Range of the scaled value, as the vendor documents it.
    pub range: (f64, f64),
}

/// What the signals of a CAN message are in a log.
#[derive(Clone, Copy, Debug)]
pub enum CanContent {
    /// The components of a quantity.
    Numbers(&'static Quantity),
    /// Three components, and the exponent `e` of their unit: one count is 2^-e.
    Scaled(&'static Quantity),
    /// One component of a quantity, with its place.
    Component(&'static Quantity, usize),
    /// An integer that the quantity has as it is.
    Integer(&'static Quantity),
    /// The fields of a struct.
    Record(&'static Quantity),
    /// Date and time with a year of two digits.
    Utc(&'static Quantity),
    /// The device reports a fault.
    Event,
    /// No source gives the layout.
    Opaque,
}

impl CanContent {
    /// The quantity that a log has of the message.
    #[must_use]
    pub const fn quantity(self) -> Option<&'static Quantity> {
        match self {
            Self::Numbers(row)
            | Self::Scaled(row)
            | Self::Component(row, _)
            | Self::Integer(row)
            | Self::Record(row)
            | Self::Utc(row) => Some(row),
            Self::Event | Self::Opaque => None,
        }
    }
}

/// A CAN message of the 600-series.
#[derive(Clone, Copy, Debug)]
pub struct CanMessage {
    /// Its code in the configuration (XCDI), which is also its default identifier.
    pub code: u8,
    /// The vendor's name.
    pub name: &'static str,
    /// What it is in a log.
    pub content: CanContent,
    /// Its signals, in the order of the bytes.
    pub signals: &'static [CanSignal],
    /// The highest rate in Hz; none where it follows the group or the source gives none.
    pub max_rate: Option<u16>,
    /// Products that offer it.
    pub products: Products,
}

impl CanMessage {
    /// Bytes of the data of its frames; 0 where no source gives the layout.
    #[must_use]
    pub const fn size(&self) -> usize {
        let (mut size, mut i) = (0, 0);
        while i < self.signals.len() {
            size += self.signals[i].wire.size();
            i += 1;
        }
        size
    }
}

/// The exponents that a reader of `DeltaV` accepts; devices send 8 to 17.
pub const MAX_EXPONENT: u8 = 30;

/// Every known code, ascending.
#[rustfmt::skip]
pub const CAN_MESSAGES: &[CanMessage] = &[
    row(0x01, "Error",              CanContent::Event,              CODE).on(ALL),
    row(0x02, "Warning",            CanContent::Event,              CODE).on(ALL),
    row(0x05, "SampleTime",         integer("sample_time_fine"),    TICKS).on(ALL),
    row(0x06, "GroupCounter",       integer("packet_counter"),      COUNTER).on(ALL),
    row(0x07, "UtcTime",            CanContent::Utc(of("utc_time")), UTC).on(ALL),
    row(0x11, "StatusWord",         integer("status_word"),         STATUS).on(ALL),
    row(0x21, "Quaternion",         numbers("quaternion"),          QUATERNION).max(400).on(ORIENTED),
    row(0x22, "EulerAngles",        numbers("euler_angles"),        EULER).max(400).on(ORIENTED),
    row(0x23, "RotationMatrix",     CanContent::Opaque,             &[]).on(ORIENTED),
    row(0x31, "DeltaV",             CanContent::Scaled(of("delta_v")), DELTA_V).max(400).on(ALL),
    row(0x32, "RateOfTurn",         numbers("rate_of_turn"),        GYRO).max(400).on(ALL),
    row(0x33, "DeltaQ",             numbers("delta_q"),             QUATERNION).max(400).on(ALL),
    row(0x34, "Acceleration",       numbers("acceleration"),        ACCELERATION).max(400).on(ALL),
    row(0x35, "FreeAcceleration",   numbers("free_acceleration"),   ACCELERATION).max(400).on(ORIENTED),
    row(0x41, "MagneticField",      numbers("magnetic_field"),      MAGNETIC).on(ALL),
    row(0x51, "Temperature",        numbers("temperature"),         TEMPERATURE).on(ALL),
    row(0x52, "BaroPressure",       numbers("baro_pressure"),       PRESSURE).on(ALL),
    row(0x61, "RateOfTurnHR",       numbers("rate_of_turn_hr"),     GYRO).max(1600).on(ALL),
    row(0x62, "AccelerationHR",     numbers("acceleration_hr"),     ACCELERATION).max(2000).on(ALL),
    row(0x71, "LatLong",            numbers("lat_lon"),             LAT_LONG).max(400).on(GNSS),
    row(0x72, "AltitudeEllipsoid",  numbers("altitude_ellipsoid"),  ALTITUDE).max(400).on(GNSS),
    row(0x73, "PositionEcef_X",     ecef(0),                        ECEF).max(400).on(GNSS),
    row(0x74, "PositionEcef_Y",     ecef(1),                        ECEF).max(400).on(GNSS),
    row(0x75, "PositionEcef_Z",     ecef(2),                        ECEF).max(400).on(GNSS),
    row(0x76, "Velocity",           numbers("velocity_xyz"),        VELOCITY).max(400).on(GNSS),
    row(0x77, "Latitude",           CanContent::Opaque,             &[]).on(GNSS),
    row(0x78, "Longitude",          CanContent::Opaque,             &[]).on(GNSS),
    row(0x79, "GnssReceiverStatus", CanContent::Record(&RECEIVER_STATUS), RECEIVER).on(GNSS),
    row(0x7A, "GnssReceiverDop",    CanContent::Record(&RECEIVER_DOP), DOP).on(GNSS),
];

/// Quantities that only CAN has. Their identifiers, the code and four zero bits, are in no group of `MTData2`.
pub const CAN_QUANTITIES: &[Quantity] = &[RECEIVER_STATUS, RECEIVER_DOP];

const SOURCE: &str = "a DBC file and a driver of the vendor's users";
const RECEIVER_STATUS: Quantity =
    record(0x0790, "gnss_receiver_status", "GnssReceiverStatus", STATUS_FIELDS).interpolated(PREVIOUS).from(SOURCE);
const RECEIVER_DOP: Quantity =
    record(0x07A0, "gnss_receiver_dop", "GnssReceiverDop", DOP_FIELDS).interpolated(PREVIOUS).from(SOURCE);
const PREVIOUS: Interpolation = Interpolation::Previous;

#[rustfmt::skip]
const STATUS_FIELDS: &[Field] = &[
    Field { name: "fixtype", wire: U1, scale: 1.0, unit: "", missing: None },
    Field { name: "numSV",   wire: U1, scale: 1.0, unit: "", missing: None },
    Field { name: "flags",   wire: U1, scale: 1.0, unit: "", missing: None },
    Field { name: "valid",   wire: U1, scale: 1.0, unit: "", missing: None },
    Field { name: "numSvs",  wire: U1, scale: 1.0, unit: "", missing: None },
];

#[rustfmt::skip]
const DOP_FIELDS: &[Field] = &[
    Field { name: "pdop", wire: U2, scale: 0.01, unit: "", missing: None },
    Field { name: "tdop", wire: U2, scale: 0.01, unit: "", missing: None },
    Field { name: "vdop", wire: U2, scale: 0.01, unit: "", missing: None },
    Field { name: "hdop", wire: U2, scale: 0.01, unit: "", missing: None },
];

const ALL: Products = Products::of(&[610, 620, 630, 670, 680]);
const ORIENTED: Products = Products::of(&[620, 630, 670, 680]);
const GNSS: Products = Products::of(&[670, 680]);

/// 1/(2^15-1), as the document and three readers have it. The vendor's DBC has 2^-15 for the quaternion only.
const UNIT: u32 = 32767;

const CODE: &[CanSignal] = &[plain("code", U1, 0.0, 255.0)];
/// Ticks of 0.1 ms, as in `SampleTimeFine`; revision A and the vendor's DBC say 1 µs.
const TICKS: &[CanSignal] = &[signal("ticks", U4, 10_000, "s", 0.0, 429_496.729_5)];
const COUNTER: &[CanSignal] = &[plain("counter", U2, 0.0, 65535.0)];
const STATUS: &[CanSignal] = &[plain("status", U4, 0.0, 4_294_967_295.0)];
#[rustfmt::skip]
const UTC: &[CanSignal] = &[
    plain("year",     U1, 0.0, 99.0),
    plain("month",    U1, 1.0, 12.0),
    plain("day",      U1, 1.0, 31.0),
    plain("hour",     U1, 0.0, 23.0),
    plain("minute",   U1, 0.0, 59.0),
    plain("second",   U1, 0.0, 60.0),
    signal("tenth_ms", U2, 10_000, "s", 0.0, 0.9999),
];
const QUATERNION: &[CanSignal] = &[unit("q0"), unit("q1"), unit("q2"), unit("q3")];
#[rustfmt::skip]
const EULER: &[CanSignal] = &[
    signal("roll",  I2, 1 << 7, "deg", -180.0, 180.0),
    signal("pitch", I2, 1 << 7, "deg",  -90.0,  90.0),
    signal("yaw",   I2, 1 << 7, "deg", -180.0, 180.0),
];
/// The numbers are counts: the unit is in the last byte.
const DELTA_V: &[CanSignal] = &[count("x"), count("y"), count("z"), plain("exponent", U1, 8.0, 17.0)];
const GYRO: &[CanSignal] = &xyz(1 << 9, "rad/s", 35.0);
const ACCELERATION: &[CanSignal] = &xyz(1 << 8, "m/s2", 100.0);
const MAGNETIC: &[CanSignal] = &xyz(1 << 10, "a.u.", 32.0);
const VELOCITY: &[CanSignal] = &xyz(1 << 6, "m/s", 500.0);
const TEMPERATURE: &[CanSignal] = &[signal("temperature", I2, 1 << 8, "degC", -40.0, 85.0)];
/// Without a sign, as the document says; the vendor's DBC has one, which is wrong above 65,536 Pa.
const PRESSURE: &[CanSignal] = &[signal("pressure", U4, 1 << 15, "Pa", 30_000.0, 125_000.0)];
const LAT_LONG: &[CanSignal] =
    &[signal("latitude", I4, 1 << 24, "deg", -90.0, 90.0), signal("longitude", I4, 1 << 23, "deg", -180.0, 180.0)];
/// With a sign, as newer sources have it. The older ones without a sign agree up to 65,536 m.
const ALTITUDE: &[CanSignal] = &[signal("altitude", I4, 1 << 15, "m", -1_000.0, 50_000.0)];
const ECEF: &[CanSignal] = &[signal("position", I4, 1 << 8, "m", -6.5e6, 6.5e6)];
#[rustfmt::skip]
const RECEIVER: &[CanSignal] = &[
    plain("fixType", U1, 0.0, 255.0),
    plain("numSv",   U1, 0.0, 255.0),
    plain("flags",   U1, 0.0, 255.0),
    plain("valid",   U1, 0.0, 255.0),
    plain("numSvs",  U1, 0.0, 255.0),
];
const DOP: &[CanSignal] = &[dilution("pdop"), dilution("tdop"), dilution("vdop"), dilution("hdop")];

const fn row(code: u8, name: &'static str, content: CanContent, signals: &'static [CanSignal]) -> CanMessage {
    CanMessage { code, name, content, signals, max_rate: None, products: Products::NONE }
}

impl CanMessage {
    const fn max(self, rate: u16) -> Self {
        Self { max_rate: Some(rate), ..self }
    }

    const fn on(self, products: Products) -> Self {
        Self { products, ..self }
    }
}

/// The quantity of this name; a name that no row has does not compile.
const fn of(name: &str) -> &'static Quantity {
    quantity_row(QUANTITIES, name).expect("a quantity of that name")
}

const fn numbers(name: &str) -> CanContent {
    CanContent::Numbers(of(name))
}

const fn integer(name: &str) -> CanContent {
    CanContent::Integer(of(name))
}

const fn ecef(place: usize) -> CanContent {
    CanContent::Component(of("position_ecef"), place)
}

const fn signal(name: &'static str, wire: Wire, per_unit: u32, unit: &'static str, min: f64, max: f64) -> CanSignal {
    CanSignal { name, wire, per_unit, unit, range: (min, max) }
}

const fn plain(name: &'static str, wire: Wire, min: f64, max: f64) -> CanSignal {
    signal(name, wire, 1, "", min, max)
}

const fn count(name: &'static str) -> CanSignal {
    plain(name, I2, -32768.0, 32767.0)
}

const fn unit(name: &'static str) -> CanSignal {
    signal(name, I2, UNIT, "", -1.0, 1.0)
}

const fn dilution(name: &'static str) -> CanSignal {
    signal(name, U2, 100, "", 0.0, 100.0)
}

const fn xyz(per_unit: u32, unit: &'static str, limit: f64) -> [CanSignal; 3] {
    [
        signal("x", I2, per_unit, unit, -limit, limit),
        signal("y", I2, per_unit, unit, -limit, limit),
        signal("z", I2, per_unit, unit, -limit, limit),
    ]
}

const _: () = assert!(ascend_and_fit(CAN_MESSAGES), "codes must rise, and a frame has eight bytes");

const fn ascend_and_fit(rows: &[CanMessage]) -> bool {
    let mut i = 0;
    while i < rows.len() {
        if rows[i].size() > 8 || (i > 0 && rows[i - 1].code >= rows[i].code) {
            return false;
        }
        i += 1;
    }
    true
}
