//! The data identifiers: what a packet of an `MTData2` message can measure.
//!
//! The first source is Table 16 of the manual with the descriptions of section 5.3.6. Identifiers that the manual does
//! not list but that devices send or the vendor's open code writes have a row where their layout is known. The others
//! have none on purpose and stay unknown identifiers, kept byte for byte: opaque blobs (A080), the full snapshots and
//! glove data of other product lines (from C820 to CA40), and two messages of the old MTi-G-700 whose layouts in
//! circulation disagree about their size or were never checked (8840, 88A0).

use super::Axes::{Earth, Local, Sensor, SensorToLocal};
use super::ClockRole::{Coarse, Counter, Fine, Receiver, Trigger};
use super::Interpolation::{Angle, Linear, Previous, Rotation};
use super::Wire::{F4, I1, I2, I4, U1, U2, U4, U8};
use super::{Axes, ClockRole, Field, Interpolation, Kind, Products, Quantity, StatusFlag, Wire};

const ALL: Products = Products::ALL;
/// All that compute an orientation: everything but the IMUs.
const ORIENTED: Products = Products::of(&[2, 3, 7, 20, 30, 200, 300, 710, 620, 630, 670, 680]);
const BAROMETER: Products = Products::of(&[7, 100, 200, 300, 710, 610, 620, 630, 670, 680]);
const GNSS: Products = Products::of(&[7, 710, 670, 680]);
const SERIES_10_100: Products = Products::of(&[10, 20, 30, 100, 200, 300, 710]);
const SERIES_600: Products = Products::of(&[610, 620, 630, 670, 680]);

const ONE: &[&str] = &[];
pub(super) const XYZ: &[&str] = &["x", "y", "z"];
const QUATERNION: &[&str] = &["q0", "q1", "q2", "q3"];
const EULER: &[&str] = &["roll", "pitch", "yaw"];
const LAT_LON: &[&str] = &["lat", "lon"];
/// Column by column: where a device sent the quaternion as well, 92 packets agree with it to 1e-7 in this order and
/// are 2e-2 off in the other.
const MATRIX: &[&str] = &["m11", "m21", "m31", "m12", "m22", "m32", "m13", "m23", "m33"];
const SENSORS: &[&str] = &["accX", "accY", "accZ", "gyrX", "gyrY", "gyrZ", "magX", "magY", "magZ", "Temp"];

/// Not in this revision of the manual; only the vendor's code writes or reads it.
const VENDOR: &str = "vendor's open code";
/// The manual's text lost the figure; settled from device bytes.
const BYTES: &str = "device bytes";
const TRIGGER_GUIDE: &str = "TriggerIndication user guide";
/// The vendor's open code has the fields; recordings with the vendor's exports confirm counter and magnetic field.
const AWINDA_LOGS: &str = "vendor's open code, recordings with exports";
const OLD_GPS: &str = "third-party drivers of the MTi-G-700";

/// Every data identifier whose layout is known, sorted by identifier.
#[rustfmt::skip]
pub const QUANTITIES: &[Quantity] = &[
    real  (0x0810, "temperature",         "Temperature",         ONE, "degC").on(ALL),

    record(0x1010, "utc_time",            "UtcTime",             UTC_TIME).on(ALL).from("Table 35, device bytes"),
    fixed (0x1020, "packet_counter",      "PacketCounter",       U2, ONE, "").not_interpolated().on(ALL).clock(Counter),
    fixed (0x1030, "itow",                "Itow",                U4, ONE, "ms").not_interpolated().from(VENDOR),
    fixed (0x1040, "gnss_age",            "GnssAge",             U1, ONE, "").from(VENDOR),
    fixed (0x1050, "pressure_age",        "PressureAge",         U1, ONE, "").from(VENDOR),
    fixed (0x1060, "sample_time_fine",    "SampleTimeFine",      U4, ONE, "0.1 ms").not_interpolated().on(ALL).clock(Fine),
    fixed (0x1070, "sample_time_coarse",  "SampleTimeCoarse",    U4, ONE, "s").not_interpolated().on(ALL).clock(Coarse),
    record(0x1080, "frame_range",         "FrameRange",          FRAME_RANGE).from(VENDOR),
    fixed (0x1090, "packet_counter8",     "PacketCounter8",      U1, ONE, "").not_interpolated().from(VENDOR),
    // What a tick is worth is not written down.
    fixed (0x10A0, "sample_time64",       "SampleTime64",        U8, ONE, "").not_interpolated().from(VENDOR),
    // The vendor's code has the identifier but no decoder; the width is that of the name.
    fixed (0x10B0, "packet_counter32",    "PacketCounter32",     U4, ONE, "").not_interpolated().from(VENDOR),

    real  (0x2010, "quaternion",          "Quaternion",          QUATERNION, "")
           .interpolated(Rotation).axes(SensorToLocal).rotates().on(ORIENTED),
    real  (0x2020, "rotation_matrix",     "RotationMatrix",      MATRIX, "").interpolated(Rotation)
           .matrix().axes(SensorToLocal).rotates().on(ORIENTED).from(BYTES),
    real  (0x2030, "euler_angles",        "EulerAngles",         EULER, "deg")
           .interpolated(Angle).axes(SensorToLocal).rotates().on(ORIENTED),

    fixed (0x3010, "baro_pressure",       "BaroPressure",        U4, ONE, "Pa").interpolated(Linear).on(BAROMETER),

    real  (0x4010, "delta_v",             "DeltaV",              XYZ, "m/s").not_interpolated().axes(Sensor).on(ALL),
    real  (0x4020, "acceleration",        "Acceleration",        XYZ, "m/s2").axes(Sensor).on(ALL),
    // Given in the local frame, and yet the coordinate bits are not defined for it (Table 17, note 11).
    real  (0x4030, "free_acceleration",   "FreeAcceleration",    XYZ, "m/s2").axes(Local).on(ORIENTED),
    real  (0x4040, "acceleration_hr",     "AccelerationHR",      XYZ, "m/s2").axes(Sensor).on(ALL).from("5.3.6, Table 23"),

    record(0x4810, "trigger_in1",         "TriggerIn1",          TRIGGER).on(SERIES_600).clock(Trigger).from(TRIGGER_GUIDE),
    record(0x4820, "trigger_in2",         "TriggerIn2",          TRIGGER).on(SERIES_600).clock(Trigger).from(TRIGGER_GUIDE),
    // An identifier without a decoder there, too; taken to be like the other two.
    record(0x4830, "trigger_in3",         "TriggerIn3",          TRIGGER).on(Products::of(&[680])).clock(Trigger).from(VENDOR),

    real  (0x5010, "altitude_msl",        "AltitudeMsl",         ONE, "m").axes(Earth).from(VENDOR),
    real  (0x5020, "altitude_ellipsoid",  "AltitudeEllipsoid",   ONE, "m").axes(Earth).on(GNSS),
    real  (0x5030, "position_ecef",       "PositionEcef",        XYZ, "m").axes(Earth).on(GNSS),
    real  (0x5040, "lat_lon",             "LatLon",              LAT_LON, "deg").interpolated(Angle).axes(Earth).on(GNSS),

    record(0x7010, "gnss_pvt_data",       "GnssPvtData",         PVT)
           .interpolated(Linear).axes(Earth).on(GNSS).clock(Receiver).from("5.3.6, Table 25"),
    list  (0x7020, "gnss_sat_info",       "GnssSatInfo",         SAT_INFO, SATELLITE)
           .on(Products::of(&[710, 670, 680])).clock(Receiver).from("5.3.6, Table 26"),
    fixed (0x7030, "gnss_pvt_pulse",      "GnssPvtPulse",        U4, ONE, "0.1 ms")
           .not_interpolated().on(Products::of(&[670, 680])),

    real  (0x8020, "rate_of_turn",        "RateOfTurn",          XYZ, "rad/s").axes(Sensor).on(ALL),
    real  (0x8030, "delta_q",             "DeltaQ",              QUATERNION, "").not_interpolated().axes(Sensor).on(ALL),
    real  (0x8040, "rate_of_turn_hr",     "RateOfTurnHR",        XYZ, "rad/s").axes(Sensor).on(ALL).from("5.3.6, Table 24"),

    record(0x8830, "gps_dop",             "GpsDop",              GPS_DOP).interpolated(Previous).from(OLD_GPS),
    record(0x8880, "gps_time_utc",        "GpsTimeUtc",          GPS_TIME_UTC).from(OLD_GPS),

    // In the four raw ones with U2 counts, bit 0 of the identifier means that the counts are signed.
    record(0xA010, "raw_acc_gyr_mag_temp", "RawAccGyrMagTemp",   RAW).interpolated(Previous).axes(Sensor).on(SERIES_10_100),
    fixed (0xA020, "raw_gyro_temp",       "RawGyroTemp",         I2, XYZ, "1/256 degC")
           .interpolated(Linear).on(SERIES_10_100),
    fixed (0xA030, "raw_acc",             "RawAcc",              U2, XYZ, "").interpolated(Linear).axes(Sensor).from(VENDOR),
    fixed (0xA040, "raw_gyr",             "RawGyr",              U2, XYZ, "").interpolated(Linear).axes(Sensor).from(VENDOR),
    fixed (0xA050, "raw_mag",             "RawMag",              U2, XYZ, "").interpolated(Linear).axes(Sensor).from(VENDOR),
    real  (0xA060, "raw_delta_q",         "RawDeltaQ",           QUATERNION, "")
           .not_interpolated().axes(Sensor).from(VENDOR),
    real  (0xA070, "raw_delta_v",         "RawDeltaV",           XYZ, "m/s").not_interpolated().axes(Sensor).from(VENDOR),
    fixed (0xA090, "raw_float_acc_gyr_mag_temp", "RawFloatAccGyrMagTemp", F4, SENSORS, "")
           .interpolated(Linear).axes(Sensor).from(VENDOR),

    fixed (0xB010, "analog_in1",          "AnalogIn1",           U2, ONE, "").from(VENDOR),
    fixed (0xB020, "analog_in2",          "AnalogIn2",           U2, ONE, "").from(VENDOR),

    real  (0xC020, "magnetic_field",      "MagneticField",       XYZ, "a.u.").axes(Sensor).on(ALL),
    real  (0xC030, "magnetic_field_corrected", "MagneticFieldCorrected", XYZ, "a.u.").axes(Sensor).from(VENDOR),

    record(0xC810, "awinda_snapshot",     "AwindaSnapshot",      AWINDA).axes(Sensor).from(AWINDA_LOGS),

    real  (0xD010, "velocity_xyz",        "VelocityXYZ",         XYZ, "m/s").axes(Local).rotates().on(GNSS).from(BYTES),

    fixed (0xE010, "status_byte",         "StatusByte",          U1, ONE, "").flags().on(ALL).from("5.3.6, Table 27"),
    fixed (0xE020, "status_word",         "StatusWord",          U4, ONE, "").flags().on(ALL).from("5.3.6, Table 27"),
    fixed (0xE040, "rssi",                "Rssi",                I1, ONE, "dBm").from(VENDOR),
    new   (0xE080, "device_id",           "DeviceId",            Kind::Id).interpolated(Previous).on(SERIES_10_100),
    fixed (0xE090, "location_id",         "LocationId",          U2, ONE, "").on(SERIES_10_100),
];

#[rustfmt::skip]
pub(super) const UTC_TIME: &[Field] = &[
    scaled("ns",     U4, 1e-9, "s"),
    plain ("year",   U2),
    plain ("month",  U1),
    plain ("day",    U1),
    plain ("hour",   U1),
    plain ("minute", U1),
    plain ("second", U1),
    plain ("valid",  U1),
];

#[rustfmt::skip]
const FRAME_RANGE: &[Field] = &[
    plain("first", U2),
    plain("last",  U2),
];

#[rustfmt::skip]
const TRIGGER: &[Field] = &[
    plain ("line",      U1),
    plain ("polarity",  U1),
    scaled("timestamp", U4, 1e-6, "s"),
    plain ("frame",     U2),
];

/// Table 25.
#[rustfmt::skip]
const PVT: &[Field] = &[
    scaled("itow",      U4, 1e-3, "s"),
    plain ("year",      U2),
    plain ("month",     U1),
    plain ("day",       U1),
    plain ("hour",      U1),
    plain ("min",       U1),
    plain ("sec",       U1),
    plain ("valid",     U1),
    spread("tAcc",      1e-9, "s"),
    scaled("nano",      I4, 1e-9, "s"),  // can be negative
    plain ("fixtype",   U1),
    plain ("flags",     U1),
    plain ("numSV",     U1),
    plain ("Reserved1", U1),
    scaled("lon",       I4, 1e-7, "deg"),
    scaled("lat",       I4, 1e-7, "deg"),
    scaled("height",    I4, 1e-3, "m"),
    scaled("hMSL",      I4, 1e-3, "m"),
    spread("hAcc",      1e-3, "m"),
    spread("vAcc",      1e-3, "m"),
    scaled("velN",      I4, 1e-3, "m/s"),
    scaled("velE",      I4, 1e-3, "m/s"),
    scaled("velD",      I4, 1e-3, "m/s"),
    scaled("gSpeed",    I4, 1e-3, "m/s"),
    scaled("headMot",   I4, 1e-5, "deg"),
    spread("sAcc",      1e-3, "m/s"),
    spread("headAcc",   1e-5, "deg"),
    scaled("headVeh",   I4, 1e-5, "deg"),
    scaled("gdop",      U2, 0.01, ""),
    scaled("pdop",      U2, 0.01, ""),
    scaled("tdop",      U2, 0.01, ""),
    scaled("vdop",      U2, 0.01, ""),
    scaled("hdop",      U2, 0.01, ""),
    scaled("ndop",      U2, 0.01, ""),
    scaled("edop",      U2, 0.01, ""),
];

/// Table 26, before the satellites.
#[rustfmt::skip]
const SAT_INFO: &[Field] = &[
    scaled("itow",   U4, 1e-3, "s"),
    plain ("numSvs", U1),
    plain ("res1",   U1),
    plain ("res2",   U1),
    plain ("res3",   U1),
];

/// Table 26, once for every satellite.
#[rustfmt::skip]
const SATELLITE: &[Field] = &[
    plain ("gnssId", U1),
    plain ("svId",   U1),
    scaled("cno",    U1, 1.0, "dBHz"),
    plain ("flags",  U1),
];

#[rustfmt::skip]
const GPS_DOP: &[Field] = &[
    scaled("itow", U4, 1e-3, "s"),
    scaled("gdop", U2, 0.01, ""),
    scaled("pdop", U2, 0.01, ""),
    scaled("tdop", U2, 0.01, ""),
    scaled("vdop", U2, 0.01, ""),
    scaled("hdop", U2, 0.01, ""),
    scaled("ndop", U2, 0.01, ""),
    scaled("edop", U2, 0.01, ""),
];

#[rustfmt::skip]
const GPS_TIME_UTC: &[Field] = &[
    scaled("itow",  U4, 1e-3, "s"),
    scaled("tAcc",  U4, 1e-9, "s"),
    scaled("nano",  I4, 1e-9, "s"),
    plain ("year",  U2),
    plain ("month", U1),
    plain ("day",   U1),
    plain ("hour",  U1),
    plain ("min",   U1),
    plain ("sec",   U1),
    plain ("valid", U1),
];

/// Counts of the analog-digital converters. The manual prints `gyrX` twice; the second is `gyrY`.
#[rustfmt::skip]
const RAW: &[Field] = &[
    plain ("accX", U2),
    plain ("accY", U2),
    plain ("accZ", U2),
    plain ("gyrX", U2),
    plain ("gyrY", U2),
    plain ("gyrZ", U2),
    plain ("magX", U2),
    plain ("magY", U2),
    plain ("magZ", U2),
    scaled("Temp", I2, 1.0 / 256.0, "degC"),
];

/// What an Awinda tracker (`MTw`) sends: strap-down increments, whose scale is not published. The low 16 bits of the
/// frame number are the packet counter of the vendor's exports. Bit 0 of the identifier means that it was sent again.
#[rustfmt::skip]
const AWINDA: &[Field] = &[
    plain ("deviceId",   U4),
    plain ("frame",      U4),
    plain ("iqX",        I4),
    plain ("iqY",        I4),
    plain ("iqZ",        I4),
    plain ("ivX",        I4),
    plain ("ivY",        I4),
    plain ("ivZ",        I4),
    scaled("magX",       I2, 1.0 / 4096.0, "a.u."),
    scaled("magY",       I2, 1.0 / 4096.0, "a.u."),
    scaled("magZ",       I2, 1.0 / 4096.0, "a.u."),
    plain ("baro",       U4),
    plain ("status",     U2),
    plain ("accClipped", U1),
    plain ("gyrClipped", U1),
];

/// The bits of `StatusWord` from Table 27, and from the vendor's code where the manual has "Reserved" (7, 18, 20) or
/// leaves a value out. Bits 0 to 7 are those of `StatusByte`.
#[rustfmt::skip]
pub const STATUS_FLAGS: &[StatusFlag] = &[
    flag("selftest",                   0, 1, "self-test passed; always 0 on the 600-series"),
    flag("filter_valid",               1, 1, "input of the orientation filter is reliable and complete"),
    flag("gnss_fix",                   2, 1, "the GNSS receiver has a fix"),
    flag("no_rotation_update_status",  3, 2, "0 idle or done, 1 running, data refused, 2 stopped by motion, 3 running"),
    flag("representative_motion",      5, 1, "in-run compass calibration is in representative motion"),
    flag("clock_bias_estimation",      6, 1, "clock bias estimation is active"),
    flag("filter_input_start",         7, 1, "first data that the filter was given"),
    flag("clip_acc_x",                 8, 1, "accelerometer x out of range"),
    flag("clip_acc_y",                 9, 1, "accelerometer y out of range"),
    flag("clip_acc_z",                10, 1, "accelerometer z out of range"),
    flag("clip_gyr_x",                11, 1, "gyroscope x out of range"),
    flag("clip_gyr_y",                12, 1, "gyroscope y out of range"),
    flag("clip_gyr_z",                13, 1, "gyroscope z out of range"),
    flag("clip_mag_x",                14, 1, "magnetometer x out of range"),
    flag("clip_mag_y",                15, 1, "magnetometer y out of range"),
    flag("clip_mag_z",                16, 1, "magnetometer z out of range"),
    flag("retransmitted",             18, 1, "sent a second time (wireless products)"),
    flag("clipping",                  19, 1, "some sensor is out of range"),
    flag("interpolated",              20, 1, "not measured but interpolated (wireless products)"),
    flag("sync_in_marker",            21, 1, "a SyncIn pulse was seen"),
    flag("sync_out_marker",           22, 1, "SyncOut is active"),
    flag("filter_mode",               23, 3, "0 without GNSS, 1 coasting after its loss, 3 with GNSS"),
    flag("have_gnss_time_pulse",      26, 1, "the receiver's time pulse is present"),
    flag("rtk_status",                27, 2, "0 no RTK, 1 floating, 2 fixed"),
];

/// Group of an identifier: Table 16, and beyond it by the name that the vendor gives the group. Nine bits tell groups
/// apart in the vendor's code; fewer would put 48x0 among the accelerations.
const fn group(id: u16) -> &'static str {
    match id & 0xFE00 {
        0x0400 => "MTData",
        0x0600 => "CAN",
        0x0800 => "Temperature",
        0x1000 => "Timestamp",
        0x2000 => "Orientation Data",
        0x3000 => "Pressure",
        0x4000 => "Acceleration",
        0x4800 => "Indication",
        0x5000 => "Position",
        0x7000 => "GNSS",
        0x8000 => "Angular Velocity",
        0x8800 => "GPS",
        0xA000 => "Sensor Component Readout",
        0xB000 => "Analog In",
        0xC000 => "Magnetic",
        0xC800 => "Snapshot",
        0xD000 => "Velocity",
        0xE000 => "Status",
        _ => panic!("no such group"),
    }
}

/// A row. Its source is section 5.3.6 and no product offers it, unless the row has others.
const fn new(id: u16, name: &'static str, manual: &'static str, kind: Kind) -> Quantity {
    Quantity {
        id,
        name,
        manual,
        group: group(id),
        kind,
        components: &[],
        unit: "",
        is_matrix: false,
        axes: None,
        interpolation: None,
        rotates: false,
        clock: None,
        has_flags: false,
        products: Products::NONE,
        source: "5.3.6",
    }
}

/// Numbers of type ℝ.
pub(super) const fn real(
    id: u16,
    name: &'static str,
    manual: &'static str,
    components: &'static [&'static str],
    unit: &'static str,
) -> Quantity {
    Quantity { components, unit, interpolation: Some(Linear), ..new(id, name, manual, Kind::Real(count(components))) }
}

/// Numbers of one type.
pub(super) const fn fixed(
    id: u16,
    name: &'static str,
    manual: &'static str,
    wire: Wire,
    components: &'static [&'static str],
    unit: &'static str,
) -> Quantity {
    let kind = Kind::Fixed(wire, count(components));
    Quantity { components, unit, interpolation: Some(Previous), ..new(id, name, manual, kind) }
}

pub(super) const fn record(id: u16, name: &'static str, manual: &'static str, fields: &'static [Field]) -> Quantity {
    new(id, name, manual, Kind::Struct(fields))
}

const fn list(
    id: u16,
    name: &'static str,
    manual: &'static str,
    head: &'static [Field],
    entry: &'static [Field],
) -> Quantity {
    new(id, name, manual, Kind::List(head, entry))
}

/// A scalar names no components.
const fn count(components: &[&str]) -> usize {
    if components.is_empty() { 1 } else { components.len() }
}

impl Quantity {
    const fn matrix(self) -> Self {
        Self { is_matrix: true, ..self }
    }

    pub(super) const fn axes(self, axes: Axes) -> Self {
        Self { axes: Some(axes), ..self }
    }

    pub(super) const fn interpolated(self, interpolation: Interpolation) -> Self {
        Self { interpolation: Some(interpolation), ..self }
    }

    const fn not_interpolated(self) -> Self {
        Self { interpolation: None, ..self }
    }

    const fn rotates(self) -> Self {
        Self { rotates: true, ..self }
    }

    const fn clock(self, role: ClockRole) -> Self {
        Self { clock: Some(role), ..self }
    }

    const fn flags(self) -> Self {
        Self { has_flags: true, ..self }
    }

    const fn on(self, products: Products) -> Self {
        Self { products, ..self }
    }

    pub(super) const fn from(self, source: &'static str) -> Self {
        Self { source, ..self }
    }
}

/// A field whose integer is the value.
const fn plain(name: &'static str, wire: Wire) -> Field {
    scaled(name, wire, 1.0, "")
}

pub(super) const fn scaled(name: &'static str, wire: Wire, scale: f64, unit: &'static str) -> Field {
    Field { name, wire, scale, unit, missing: None }
}

/// An accuracy of `GnssPvtData`: all ones where the receiver gives none.
const fn spread(name: &'static str, scale: f64, unit: &'static str) -> Field {
    Field { missing: Some(u32::MAX), ..scaled(name, U4, scale, unit) }
}

const fn flag(name: &'static str, bit: u8, width: u8, meaning: &'static str) -> StatusFlag {
    StatusFlag { name, bit, width, meaning }
}

const _: () = assert!(sorted_and_bare(QUANTITIES), "identifiers must rise and have no format bits");
const _: () = assert!(apart(STATUS_FLAGS), "status flags must rise and not overlap");

const fn sorted_and_bare(rows: &[Quantity]) -> bool {
    let mut i = 0;
    while i < rows.len() {
        if rows[i].id & 0x000F != 0 || (i > 0 && rows[i - 1].id >= rows[i].id) {
            return false;
        }
        i += 1;
    }
    true
}

const fn apart(flags: &[StatusFlag]) -> bool {
    let mut free = 0;
    let mut i = 0;
    while i < flags.len() {
        if flags[i].bit < free || flags[i].width == 0 {
            return false;
        }
        free = flags[i].bit + flags[i].width;
        i += 1;
    }
    free <= 32
}
