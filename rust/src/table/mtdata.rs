//! The items of an `MTData` message, which older devices send: one row per item, in the order of the wire.
//!
//! An `MTData` message does not describe itself. `OutputMode` and `OutputSettings` decide which items it has, and in which
//! number format. The sources are the vendor's user manual of the MTi and MTx (MT0100P), its libraries of 2006 and 2012,
//! and drivers of other people. Where the meaning is the same, an item has the quantity of `MTData2`.

use super::Interpolation::{Linear, Previous};
use super::Wire::{I4, U1, U4};
use super::quantities::{XYZ, fixed, real, record, scaled};
use super::{Axes, Field, QUANTITIES, Quantity, quantity_row};

/// One item of an `MTData` message.
#[derive(Clone, Copy, Debug)]
pub struct MtDataItem {
    /// The bit of `OutputMode` that it needs; 0 for an item that `OutputSettings` alone decides.
    pub mode: u16,
    /// Bits of `OutputSettings`.
    pub mask: u32,
    /// The value that these bits must have.
    pub value: u32,
    /// What it measures.
    pub quantity: &'static Quantity,
    /// If it is a U2 that counts steps of the quantity's unit: the size of one.
    pub step: Option<u32>,
}

impl MtDataItem {
    /// Whether a message has the item.
    #[must_use]
    pub const fn is_in(&self, mode: u16, settings: u32) -> bool {
        (self.mode == 0 || mode & self.mode != 0) && settings & self.mask == self.value
    }

    const fn set(self, bits: u32) -> Self {
        self.bits(bits, bits)
    }

    const fn clear(self, bits: u32) -> Self {
        self.bits(bits, 0)
    }

    const fn bits(self, mask: u32, value: u32) -> Self {
        Self { mask, value, ..self }
    }

    const fn steps(self, step: u32) -> Self {
        Self { step: Some(step), ..self }
    }
}

/// Bits of `OutputMode`.
pub mod output_mode {
    /// Temperature.
    pub const TEMPERATURE: u16 = 1 << 0;
    /// Acceleration, rate of turn and magnetic field.
    pub const CALIBRATED: u16 = 1 << 1;
    /// Orientation.
    pub const ORIENTATION: u16 = 1 << 2;
    /// Analog inputs.
    pub const AUXILIARY: u16 = 1 << 3;
    /// Position.
    pub const POSITION: u16 = 1 << 4;
    /// Velocity.
    pub const VELOCITY: u16 = 1 << 5;
    /// Strap-down increments of an Awinda tracker.
    pub const STRAPDOWN: u16 = 1 << 9;
    /// Status.
    pub const STATUS: u16 = 1 << 11;
    /// The GPS receiver and the barometer of an MTi-G.
    pub const GPS_PVT: u16 = 1 << 12;
    /// Counts of the analog-digital converters.
    pub const RAW: u16 = 1 << 14;
    /// Output like that of an MT9, of which no source gives the layout.
    pub const MT9: u16 = 1 << 15;
}

/// Bits of `OutputSettings`.
pub mod output_settings {
    /// The packet counter.
    pub const COUNTER: u32 = 1 << 0;
    /// UTC.
    pub const UTC: u32 = 1 << 1;
    /// The form of the orientation.
    pub const ORIENTATION: u32 = 3 << 2;
    /// Orientation: Euler angles.
    pub const EULER: u32 = 1 << 2;
    /// Orientation: rotation matrix.
    pub const MATRIX: u32 = 2 << 2;
    /// Without the acceleration.
    pub const NO_ACCELERATION: u32 = 1 << 4;
    /// Without the rate of turn.
    pub const NO_RATE_OF_TURN: u32 = 1 << 5;
    /// Without the magnetic field.
    pub const NO_MAGNETIC_FIELD: u32 = 1 << 6;
    /// The status has 32 bits.
    pub const DETAILED_STATUS: u32 = 1 << 7;
    /// Where the number format of real numbers begins: two bits, with the codes of a data identifier.
    pub const PRECISION_SHIFT: u32 = 8;
    /// Without the first analog input.
    pub const NO_ANALOG_IN1: u32 = 1 << 10;
    /// Without the second analog input.
    pub const NO_ANALOG_IN2: u32 = 1 << 11;
    /// The form of the position, of which only 0 is defined.
    pub const POSITION: u32 = 7 << 14;
    /// The form of the velocity, of which only 0 is defined.
    pub const VELOCITY: u32 = 3 << 17;
    /// Without the GPS receiver: of `GPS_PVT` only the barometer.
    pub const NO_GPS: u32 = 1 << 19;
    /// The temperatures of the gyroscopes, too.
    pub const GYRO_TEMPERATURES: u32 = 1 << 24;
    /// `SampleTimeFine`.
    pub const SAMPLE_TIME_FINE: u32 = 1 << 25;
    /// North, east, down instead of north, west, up.
    pub const NED: u32 = 1 << 31;
}

use output_mode as mode;
use output_settings as settings;

/// Every item, in the order of the wire.
#[rustfmt::skip]
pub const MTDATA_ITEMS: &[MtDataItem] = &[
    item(mode::RAW,         "raw_acc_gyr_mag_temp"),
    item(mode::RAW,         "raw_gyro_temp").set(settings::GYRO_TEMPERATURES),
    item(mode::STRAPDOWN,   "device_id"),
    item(mode::STRAPDOWN,   "time_sync"),
    item(mode::STRAPDOWN,   "frame_range"),
    item(mode::STRAPDOWN,   "gyro_bias"),
    item(mode::STRAPDOWN,   "delta_q"),
    item(mode::STRAPDOWN,   "delta_v"),
    item(mode::STRAPDOWN,   "aiding"),
    item(mode::STRAPDOWN,   "baro_pressure").steps(PRESSURE_STEP),
    item(mode::STRAPDOWN,   "magnetic_field"),
    item(mode::STRAPDOWN,   "rssi"),
    item(mode::GPS_PVT,     "baro_pressure").steps(PRESSURE_STEP),
    item(mode::GPS_PVT,     "pressure_age"),
    item(mode::GPS_PVT,     "gps_pvt_data").clear(settings::NO_GPS),
    item(mode::GPS_PVT,     "gnss_age").clear(settings::NO_GPS),
    item(mode::TEMPERATURE, "temperature"),
    item(mode::TEMPERATURE, "gyro_temperature").set(settings::GYRO_TEMPERATURES),
    item(mode::CALIBRATED,  "acceleration").clear(settings::NO_ACCELERATION),
    item(mode::CALIBRATED,  "rate_of_turn").clear(settings::NO_RATE_OF_TURN),
    item(mode::CALIBRATED,  "magnetic_field").clear(settings::NO_MAGNETIC_FIELD),
    item(mode::ORIENTATION, "quaternion").clear(settings::ORIENTATION),
    item(mode::ORIENTATION, "euler_angles").bits(settings::ORIENTATION, settings::EULER),
    item(mode::ORIENTATION, "rotation_matrix").bits(settings::ORIENTATION, settings::MATRIX),
    item(mode::AUXILIARY,   "analog_in1").clear(settings::NO_ANALOG_IN1),
    item(mode::AUXILIARY,   "analog_in2").clear(settings::NO_ANALOG_IN2),
    item(mode::POSITION,    "lat_lon"),
    item(mode::POSITION,    "altitude_ellipsoid"),
    item(mode::VELOCITY,    "velocity_xyz"),
    item(mode::STATUS,      "status_byte").clear(settings::DETAILED_STATUS),
    item(mode::STATUS,      "status_word").set(settings::DETAILED_STATUS),
    item(ANY,               "packet_counter").set(settings::COUNTER),
    item(ANY,               "utc_time").set(settings::UTC),
    item(ANY,               "sample_time_fine").set(settings::SAMPLE_TIME_FINE),
];

/// `OutputSettings` alone decides.
const ANY: u16 = 0;
/// The pressure is sent in 2 Pa; the vendor's code says 1/50 mbar.
const PRESSURE_STEP: u32 = 2;

const VENDOR: &str = "vendor's library of 2012";
const READERS: &str = "vendor's libraries of 2006 and 2012, readers of the MTi-G";

/// Quantities that only `MTData` has. Their identifiers are in no group of `MTData2`.
#[rustfmt::skip]
pub const MTDATA_QUANTITIES: &[Quantity] = &[
    real  (0x0400, "gyro_temperature", "GyroTemperature", XYZ, "degC").from(VENDOR),
    record(0x0410, "gps_pvt_data",     "GpsPvtData",      GPS_PVT).interpolated(Linear).axes(Axes::Earth).from(READERS),
    fixed (0x0420, "time_sync",        "TimeSync",        U1, &[], "").interpolated(Previous).from(VENDOR),
    real  (0x0430, "gyro_bias",        "GyroBias",        XYZ, "").axes(Axes::Sensor).from(VENDOR),
    fixed (0x0440, "aiding",           "Aiding",          U1, &[], "").interpolated(Previous).from(VENDOR),
];

/// What the GPS receiver of an MTi-G measures. The unit of `sAcc` is that of the vendor's library and of the receiver's
/// manual; two readers say mm/s.
#[rustfmt::skip]
const GPS_PVT: &[Field] = &[
    scaled("itow",   U4, 1e-3, "s"),
    scaled("lat",    I4, 1e-7, "deg"),
    scaled("lon",    I4, 1e-7, "deg"),
    scaled("height", I4, 1e-3, "m"),
    scaled("velN",   I4, 0.01, "m/s"),
    scaled("velE",   I4, 0.01, "m/s"),
    scaled("velD",   I4, 0.01, "m/s"),
    scaled("hAcc",   U4, 1e-3, "m"),
    scaled("vAcc",   U4, 1e-3, "m"),
    scaled("sAcc",   U4, 0.01, "m/s"),
];

/// An item with the quantity of this name; a name that no row has does not compile.
const fn item(mode: u16, name: &'static str) -> MtDataItem {
    let quantity = match quantity_row(MTDATA_QUANTITIES, name) {
        Some(quantity) => quantity,
        None => quantity_row(QUANTITIES, name).expect("a quantity of that name"),
    };
    MtDataItem { mode, mask: 0, value: 0, quantity, step: None }
}
