//! The messages: sections 5.3 and 8 of the manual, and those that only the vendor's open code names.
//!
//! The manual's product boxes are partly lost in its text; where one is, the request, the setting and the reply of one
//! command lend each other theirs.
//!
//! `lengths` of a message to the device is what its row carries. Of a message from the device it is what its MID may
//! carry: whether a device answers a setting with nothing or with the new value is written down for few of them, so
//! both rows of such a MID allow both. `Unknown` stays where no source tells.

use super::Lengths::{OneOf, Range, Unknown};
use super::{Direction, Lengths, Message, Products, States, same};

/// The longest payload that a live device is believed to send. The manual says 2048; the vendor's own code allows 8192
/// bytes for a whole message, and the extended header takes 6 and the checksum 1 of these.
pub const LONGEST_PAYLOAD: usize = 8192 - 7;

/// The longest payload to send: the manual's limit.
const LONGEST_SENT: usize = 2048;

/// MID of the output data.
pub const MTDATA2: u8 = mid("MTData2");
/// MID of the first message after power-up.
pub const WAKE_UP: u8 = mid("WakeUp");
/// MID of the answer after which samples come.
pub const GOTO_MEASUREMENT_ACK: u8 = mid("GoToMeasurementAck");
/// MID of the answer to `Reset`.
pub const RESET_ACK: u8 = mid("ResetAck");
/// MID of the device id.
pub const DEVICE_ID: u8 = mid("DeviceID");
/// MID of the device ids that the vendor's software asks for first.
pub const INIT_BUS_RESULTS: u8 = mid("InitBusResults");
/// MID of the configuration, asked for or sent before measuring.
pub const CONFIGURATION: u8 = mid("Configuration");
/// MID of the product code.
pub const PRODUCT_CODE: u8 = mid("ProductCode");
/// MID of the firmware's version.
pub const FIRMWARE_REV: u8 = mid("FirmwareRev");
/// MID of the hardware's version.
pub const HARDWARE_VERSION: u8 = mid("HardwareVersion");
/// MID that takes the place of an answer when the device refuses.
pub const ERROR: u8 = mid("Error");
/// MID of the strings that are on.
pub const STRING_OUTPUT_TYPE: u8 = mid("ReqStringOutputTypeAck");
/// MID of a warning.
pub const WARNING: u8 = mid("Warning");

const NOTHING: Lengths = OneOf(&[0]);
/// What `payload` says of a row that carries nothing; the row of a MID that `message_name` picks for empty payloads.
pub(super) const EMPTY: &str = "empty";

const WAKEUP: States = States { wakeup: true, config: false, measurement: false };
const CONFIG: States = States { wakeup: false, config: true, measurement: false };
const MEASUREMENT: States = States { wakeup: false, config: false, measurement: true };
const ANY: States = States { wakeup: false, config: true, measurement: true };

const NONE: Products = Products::NONE;
/// All that compute an orientation: everything but the IMUs.
const ORIENTED: Products = Products::of(&[2, 3, 7, 20, 30, 200, 300, 710, 620, 630, 670, 680]);
/// Of these, the ones whose filter profiles have numbers, and the ones whose profiles have names.
const CLASSIC: Products = Products::of(&[2, 3, 7, 20, 30, 200, 300, 710]);
const MODERN: Products = Products::of(&[620, 630, 670, 680]);
const SERIES_10_100: Products = Products::of(&[10, 20, 30, 100, 200, 300, 710]);
const SERIES_600: Products = Products::of(&[610, 620, 630, 670, 680]);
/// All but the 1-series. (For strings the manual's box also names a 700, which it does not describe.)
const SERIES_10_TO_600: Products = Products::of(&[10, 20, 30, 100, 200, 300, 710, 610, 620, 630, 670, 680]);
const GNSS_EXTERNAL: Products = Products::of(&[7, 670, 680]);

/// Every message, sorted by MID; of one MID the request and its answer come before the setting and its answer.
#[rustfmt::skip]
pub const MESSAGES: &[Message] = &[
    req(0x00, "ReqDID"),
    ack(0x01, "DeviceID",            "U4 device id; U8 on the 600-series", OneOf(&[4, 8])),
    // The vendor's software opens every MTi with it, so every product knows it.
    req(0x02, "InitBus").status("reserved"),
    ack(0x03, "InitBusResults",      "U4 device id of each device", Range(4, 32, 4)).status("reserved"),
    req(0x04, "ReqPeriod").on(SERIES_10_100),
    set(0x04, "SetPeriod",           "U2 period, 1/115200 s, 225 to 1152", OneOf(&[2])).on(SERIES_10_100),
    ack(0x05, "ReqPeriodAck",        "U2 period", OneOf(&[0, 2])).on(SERIES_10_100),
    ack(0x05, "SetPeriodAck",        EMPTY, OneOf(&[0, 2])).on(SERIES_10_100),
    set(0x06, "SetBid",              "unknown", Unknown).on(NONE).status("unlisted"),
    ack(0x07, "SetBidAck",           "unknown", Unknown).on(NONE).status("unlisted"),
    req(0x0A, "ReqDataLength").on(NONE).status("reserved"),
    ack(0x0B, "DataLength",          "U2 length of the MTData payload", Unknown).on(NONE).status("reserved"),
    req(0x0C, "ReqConfiguration"),
    ack(0x0D, "Configuration",       "the configuration, Tables 13 and 14", OneOf(&[118])).valid(ANY),
    req(0x0E, "RestoreFactoryDef"),
    ack(0x0F, "RestoreFactoryDefAck", EMPTY, NOTHING),
    req(0x10, "GoToMeasurement"),
    ack(0x11, "GoToMeasurementAck",  EMPTY, NOTHING),
    req(0x12, "ReqFWRev"),
    ack(0x13, "FirmwareRev",         "U1 major, U1 minor, U1 revision, U4 build, U4 source reference; 3 bytes of old",
        OneOf(&[3, 11])),
    req(0x14, "ReqUniqueId").on(NONE).status("unlisted"),
    ack(0x15, "ReqUniqueIdAck",      "unknown", Unknown).on(NONE).status("unlisted"),
    req(0x18, "ReqBaudrate"),
    set(0x18, "SetBaudrate",         "U1 baud rate code, Table 7", OneOf(&[1])),
    ack(0x19, "ReqBaudrateAck",      "U1 baud rate code", OneOf(&[0, 1])),
    ack(0x19, "SetBaudrateAck",      EMPTY, OneOf(&[0, 1])),
    req(0x1A, "ReqProductVariant").on(NONE).status("unlisted"),
    ack(0x1B, "ReqProductVariantAck", "unknown", Unknown).on(NONE).status("unlisted"),
    req(0x1C, "ReqProductCode"),
    ack(0x1D, "ProductCode",         "ASCII, filled with spaces", Range(4, 20, 1)),
    req(0x1E, "ReqHardwareVersion"),
    ack(0x1F, "HardwareVersion",     "U1 major, U1 minor", OneOf(&[2])),
    req(0x20, "ReqProcessingFlags").on(NONE).status("reserved"),
    set(0x20, "SetProcessingFlags",  "U1 flags", OneOf(&[1])).on(NONE).status("reserved"),
    ack(0x21, "ProcessingFlagsAck",  "U1 flags, or empty", Unknown).on(NONE).status("reserved"),
    set(0x22, "SetNoRotation",       "U2 duration, s", OneOf(&[2])).valid(MEASUREMENT).on(ORIENTED),
    ack(0x23, "SetNoRotationAck",    EMPTY, NOTHING).valid(MEASUREMENT).on(ORIENTED),
    req(0x24, "RunSelftest"),
    ack(0x25, "SelftestResults",     "U2, a bit for each sensor that passed", OneOf(&[2])),
    req(0x2C, "ReqSyncSettings"),
    set(0x2C, "SetSyncSettings",     "1 to 10 settings of 12 bytes, Tables 9 and 10; one of zeros clears",
        Range(12, 120, 12)),
    ack(0x2D, "ReqSyncSettingsAck",  "0 to 10 settings of 12 bytes", Range(0, 120, 12)),
    ack(0x2D, "SetSyncSettingsAck",  EMPTY, Range(0, 120, 12)),
    req(0x30, "GoToConfig").valid(ANY),
    ack(0x31, "GoToConfigAck",       EMPTY, NOTHING).valid(ANY),
    ack(0x32, "MTData",              "output data in the fixed layout of OutputMode and OutputSettings", Unknown)
        .valid(MEASUREMENT).on(NONE).status("obsolete"),
    req(0x34, "ReqData").valid(MEASUREMENT).unanswered(),  // what comes is an MTData2 or a string, not a reply
    ack(0x36, "MTData2",             "packets: U2 data identifier, U1 size, data", Unknown).valid(MEASUREMENT),
    ack(0x3E, "WakeUp",              EMPTY, NOTHING).valid(WAKEUP).reply(0x3F),
    req(0x3F, "WakeUpAck").valid(WAKEUP).unanswered(),     // the only acknowledgement that the host sends
    req(0x40, "Reset").valid(ANY),
    ack(0x41, "ResetAck",            EMPTY, NOTHING).valid(ANY),
    ack(0x42, "Error",               "U1 code, for code 40 a U4 more", Range(1, 8, 1)).valid(ANY),
    ack(0x43, "Warning",             "U4 code, text of at most 128 characters", Range(4, 132, 1))
        .valid(ANY).on(GNSS_EXTERNAL),
    ack(0x46, "MasterIndication",    "unknown, wireless products only", Unknown).valid(ANY).on(NONE).status("unlisted"),
    req(0x48, "ReqOptionFlags"),
    set(0x48, "SetOptionFlags",      "U4 flags to set, U4 flags to clear, Table 8", OneOf(&[8])),
    ack(0x49, "ReqOptionFlagsAck",   "U4 flags", OneOf(&[0, 4])),
    ack(0x49, "SetOptionFlagsAck",   EMPTY, OneOf(&[0, 4])),
    req(0x60, "ReqUTCTime"),
    set(0x60, "SetUTCTime",          "time, Table 35", OneOf(&[12])),
    ack(0x61, "UTCTime",             "time, Table 35; possibly empty after a setting", OneOf(&[0, 12])),
    req(0x62, "ReqAvailableFilterProfiles").on(ORIENTED),
    ack(0x63, "AvailableFilterProfiles", "profiles of 22 bytes, Table 29", Range(22, 220, 22)).on(ORIENTED),
    req(0x64, "ReqFilterProfile").on(ORIENTED),
    set(0x64, "SetFilterProfile",    "U2 profile, Table 30", OneOf(&[2])).on(CLASSIC),
    set(0x64, "SetFilterProfileModern", "ASCII, names joined by '/'", Range(1, 62, 1)).on(MODERN),
    ack(0x65, "ReqFilterProfileAck", "U1 version, U1 profile", Range(0, 62, 1)).on(CLASSIC),
    ack(0x65, "ReqFilterProfileAckModern", "ASCII, names joined by '/'", Range(0, 62, 1)).on(MODERN),
    ack(0x65, "SetFilterProfileAck", EMPTY, Range(0, 62, 1)).on(ORIENTED),
    req(0x66, "ReqGravityMagnitude").on(NONE).status("reserved"),
    set(0x66, "SetGravityMagnitude", "F4", OneOf(&[4])).on(NONE).status("reserved"),
    ack(0x67, "GravityMagnitudeAck", "F4, or empty", Unknown).on(NONE).status("reserved"),
    req(0x68, "ReqGnssLeverArm").on(Products::of(&[680])),
    set(0x68, "SetGnssLeverArm",     "F4 x, y, z, m", OneOf(&[12])).on(Products::of(&[680])),
    ack(0x69, "ReqGnssLeverArmAck",  "F4 x, y, z, m", OneOf(&[0, 12])).on(Products::of(&[680])),
    ack(0x69, "SetGnssLeverArmAck",  EMPTY, OneOf(&[0, 12])).on(Products::of(&[680])),
    req(0x6A, "ReqMagneticField").on(NONE).status("reserved"),
    set(0x6A, "SetMagneticField",    "unknown", Unknown).on(NONE).status("reserved"),
    ack(0x6B, "MagneticFieldAck",    "unknown", Unknown).on(NONE).status("reserved"),
    req(0x6C, "ReqReplayMode").on(NONE).status("unlisted"),
    set(0x6C, "SetReplayMode",       "unknown", Unknown).on(NONE).status("unlisted"),
    ack(0x6D, "ReplayModeAck",       "unknown", Unknown).on(NONE).status("unlisted"),
    req(0x6E, "ReqLatLonAlt"),
    set(0x6E, "SetLatLonAlt",        "F8 latitude, longitude, deg, F8 altitude, m", OneOf(&[24])),
    ack(0x6F, "ReqLatLonAltAck",     "F8 latitude, longitude, deg, F8 altitude, m; F4 of old", OneOf(&[0, 12, 24])),
    ack(0x6F, "SetLatLonAltAck",     EMPTY, OneOf(&[0, 12, 24])),
    req(0x74, "IccCommand").carries("U1 command, Table 36", OneOf(&[1])).valid(ANY).on(ORIENTED),
    ack(0x75, "IccCommandAck",       "U1 command, then F4 ddt, U1 dimension, U1 status (stop), U1 (state) or nothing",
        OneOf(&[1, 2, 7])).valid(ANY).on(ORIENTED),
    req(0x76, "ReqGnssPlatform").on(Products::of(&[7, 710])),
    set(0x76, "SetGnssPlatform",     "U2 platform, Table 31", OneOf(&[2])).on(Products::of(&[7, 710])),
    ack(0x77, "ReqGnssPlatformAck",  "U2 platform", OneOf(&[0, 2])).on(Products::of(&[7, 710])),
    ack(0x77, "SetGnssPlatformAck",  EMPTY, OneOf(&[0, 2])).on(Products::of(&[7, 710])),
    req(0x7E, "ReqErrorReport").carries("unknown", Unknown).on(NONE).status("unlisted"),
    ack(0x7F, "ReqErrorReportAck",   "unknown", Unknown).on(NONE).status("unlisted"),
    req(0x82, "ReqHeading").on(NONE).status("reserved"),
    set(0x82, "SetHeading",          "F4, rad", OneOf(&[4])).on(NONE).status("reserved"),
    ack(0x83, "HeadingAck",          "F4, or empty", Unknown).on(NONE).status("reserved"),
    req(0x84, "ReqLocationID"),
    set(0x84, "SetLocationID",       "U2 any number", OneOf(&[2])),
    ack(0x85, "ReqLocationIDAck",    "U2 any number", OneOf(&[0, 2])),
    ack(0x85, "SetLocationIDAck",    EMPTY, OneOf(&[0, 2])),
    req(0x86, "ReqExtOutputMode").on(SERIES_10_100),
    set(0x86, "SetExtOutputMode",    "U2 mode", OneOf(&[2])).on(SERIES_10_100),
    ack(0x87, "ExtOutputMode",       "U2 mode", OneOf(&[0, 2])).on(SERIES_10_100),
    ack(0x87, "SetExtOutputModeAck", EMPTY, OneOf(&[0, 2])).on(SERIES_10_100),
    req(0x8A, "StoreFilterState").valid(ANY).on(SERIES_10_TO_600).status("unlisted"),
    ack(0x8B, "StoreFilterStateAck", "unknown", Unknown).valid(ANY).on(SERIES_10_TO_600).status("unlisted"),
    req(0x8C, "ReqPortConfig").on(SERIES_600),
    set(0x8C, "SetPortConfig",       "3 words U4: RS232, UART, RS232 for RTCM", OneOf(&[12])).on(SERIES_600),
    ack(0x8D, "PortConfig",          "3 words U4", Range(0, 12, 4)).on(SERIES_600),
    ack(0x8D, "SetPortConfigAck",    EMPTY, Range(0, 12, 4)).on(SERIES_600),
    req(0x8E, "ReqStringOutputType").on(SERIES_10_TO_600),
    set(0x8E, "SetStringOutputType", "U2 types; U4 types, U2 frequency on the 600-series", OneOf(&[2, 6]))
        .on(SERIES_10_TO_600),
    ack(0x8F, "ReqStringOutputTypeAck", "U2 types; U4 types, U2 frequency on the 600-series", OneOf(&[0, 2, 6]))
        .on(SERIES_10_TO_600),
    ack(0x8F, "SetStringOutputTypeAck", EMPTY, OneOf(&[0, 2, 6])).on(SERIES_10_TO_600),
    req(0x90, "ReqEmts").carries("00 FF", OneOf(&[2])).status("unlisted"),
    ack(0x91, "EmtsData",            "opaque", Range(255, LONGEST_PAYLOAD, 1)).valid(ANY).status("unlisted"),
    set(0x92, "UpdateFilterProfile", "opaque", Unknown).on(NONE).status("unlisted"),
    ack(0x93, "UpdateFilterProfileAck", "unknown", Unknown).on(NONE).status("unlisted"),
    set(0x94, "RestoreEmts",         "opaque", Unknown).on(NONE).status("unlisted"),
    ack(0x95, "RestoreEmtsAck",      "unknown", Unknown).on(NONE).status("unlisted"),
    set(0x96, "StoreEmts",           "opaque", Unknown).on(NONE).status("unlisted"),
    ack(0x97, "StoreEmtsAck",        "unknown", Unknown).on(NONE).status("unlisted"),
    set(0x98, "UnlockMaintenanceMode", "opaque", Unknown).on(NONE).status("unlisted"),
    ack(0x99, "UnlockMaintenanceModeAck", "unknown", Unknown).on(NONE).status("unlisted"),
    set(0x9A, "ClockSyncCommand",    "unknown", Unknown).on(NONE).status("unlisted"),
    ack(0x9B, "ClockSyncCommandAck", "unknown", Unknown).on(NONE).status("unlisted"),
    req(0xA0, "ReqFilterSettings").on(NONE).status("unlisted"),
    set(0xA0, "SetFilterSettings",   "unknown", Unknown).on(NONE).status("unlisted"),
    ack(0xA1, "FilterSettingsAck",   "unknown", Unknown).on(NONE).status("unlisted"),
    req(0xA2, "ReqAmd").on(NONE).status("unlisted"),
    set(0xA2, "SetAmd",              "U2", OneOf(&[2])).on(NONE).status("unlisted"),
    ack(0xA3, "AmdAck",              "unknown", Unknown).on(NONE).status("unlisted"),
    set(0xA4, "ResetOrientation",    "U2 code, Table 33", OneOf(&[2])).valid(ANY).on(ORIENTED),
    ack(0xA5, "ResetOrientationAck", EMPTY, NOTHING).valid(ANY).on(ORIENTED),
    req(0xA6, "ReqGnssStatus").on(NONE).status("reserved"),
    ack(0xA7, "GnssStatus",          "unknown", Unknown).on(NONE).status("reserved"),
    set(0xA8, "AdjustUTCTime",       "I4 correction, 0.1 ms", OneOf(&[4])),
    ack(0xA9, "AdjustUTCTimeAck",    EMPTY, NOTHING),
    req(0xAC, "ReqGnssReceiverSettings").on(GNSS_EXTERNAL).status("unlisted"),
    set(0xAC, "SetGnssReceiverSettings", "U2 receiver, U2 baud rate code, U2 rate, Hz, U4 options", OneOf(&[10]))
        .on(GNSS_EXTERNAL).status("unlisted"),
    ack(0xAD, "GnssReceiverSettings", "U2 receiver, U2 baud rate code, U2 rate, Hz, U4 options", OneOf(&[0, 10]))
        .on(GNSS_EXTERNAL).status("unlisted"),
    ack(0xAD, "SetGnssReceiverSettingsAck", EMPTY, OneOf(&[0, 10])).on(GNSS_EXTERNAL).status("unlisted"),
    set(0xBC, "UpdateBias",          "unknown", Unknown).valid(ANY).on(NONE).status("unlisted"),
    ack(0xBD, "UpdateBiasAck",       "unknown", Unknown).valid(ANY).on(NONE).status("unlisted"),
    req(0xC0, "ReqOutputConfiguration"),
    set(0xC0, "SetOutputConfiguration", "1 to 32 times U2 data identifier, U2 frequency; one of zeros clears",
        Range(4, 128, 4)),
    ack(0xC1, "ReqOutputConfigurationAck", "0 to 32 times U2 data identifier, U2 frequency in effect",
        Range(0, 128, 4)),
    ack(0xC1, "SetOutputConfigurationAck", "0 to 32 times U2 data identifier, U2 frequency in effect",
        Range(0, 128, 4)),
    req(0xD0, "ReqOutputMode").on(NONE).status("deprecated"),
    set(0xD0, "SetOutputMode",       "U2 mode", OneOf(&[2])).on(NONE).status("deprecated"),
    ack(0xD1, "ReqOutputModeAck",    "U2 mode", Unknown).on(NONE).status("deprecated"),
    ack(0xD1, "SetOutputModeAck",    EMPTY, Unknown).on(NONE).status("deprecated"),
    req(0xD2, "ReqOutputSettings").on(NONE).status("deprecated"),
    set(0xD2, "SetOutputSettings",   "U4 settings", OneOf(&[4])).on(NONE).status("deprecated"),
    ack(0xD3, "ReqOutputSettingsAck", "U4 settings", Unknown).on(NONE).status("deprecated"),
    ack(0xD3, "SetOutputSettingsAck", EMPTY, Unknown).on(NONE).status("deprecated"),
    req(0xD4, "ReqOutputSkipFactor").on(SERIES_10_100),
    set(0xD4, "SetOutputSkipFactor", "U2 skip factor, FFFF: only on ReqData", OneOf(&[2])).on(SERIES_10_100),
    ack(0xD5, "ReqOutputSkipFactorAck", "U2 skip factor", OneOf(&[0, 2])).on(SERIES_10_100),
    ack(0xD5, "SetOutputSkipFactorAck", EMPTY, OneOf(&[0, 2])).on(SERIES_10_100),
    set(0xD6, "SetInitialHeading",   "F4 heading, deg, -180 to 180", OneOf(&[4])).on(Products::of(&[710, 670, 680])),
    ack(0xD7, "SetInitialHeadingAck", EMPTY, NOTHING).on(Products::of(&[710, 670, 680])),
    set(0xD8, "SetSyncOutSettings",  "unknown", Unknown).on(NONE).status("reserved"),
    ack(0xD9, "SetSyncOutSettingsAck", "unknown", Unknown).on(NONE).status("reserved"),
    req(0xDA, "ReqErrorMode").on(SERIES_10_100).status("deprecated"),
    set(0xDA, "SetErrorMode",        "U2 mode, 0 to 3", OneOf(&[2])).on(SERIES_10_100).status("deprecated"),
    ack(0xDB, "ReqErrorModeAck",     "U2 mode", OneOf(&[0, 2])).on(SERIES_10_100).status("deprecated"),
    ack(0xDB, "SetErrorModeAck",     EMPTY, OneOf(&[0, 2])).on(SERIES_10_100).status("deprecated"),
    req(0xDC, "ReqTransmitDelay").on(SERIES_10_100),
    set(0xDC, "SetTransmitDelay",    "U2 delay, 1/29.4912 MHz, from 590", OneOf(&[2])).on(SERIES_10_100),
    ack(0xDD, "ReqTransmitDelayAck", "U2 delay", OneOf(&[0, 2])).on(SERIES_10_100),
    ack(0xDD, "SetTransmitDelayAck", EMPTY, OneOf(&[0, 2])).on(SERIES_10_100),
    set(0xDE, "SetMfmResults",       "opaque", Unknown).on(NONE).status("unlisted"),
    ack(0xDF, "SetMfmResultsAck",    "unknown", Unknown).on(NONE).status("unlisted"),
    req(0xE0, "ReqObjectAlignment").on(NONE).status("reserved"),
    set(0xE0, "SetObjectAlignment",  "F4 matrix of 3 by 3", OneOf(&[36])).on(NONE).status("reserved"),
    ack(0xE1, "ObjectAlignmentAck",  "F4 matrix of 3 by 3, or empty", Unknown).on(NONE).status("reserved"),
    set(0xE2, "ForwardGnssData",     "bytes for the GNSS receiver", Range(1, LONGEST_SENT, 1))
        .valid(MEASUREMENT).on(Products::of(&[680])),
    ack(0xE3, "ForwardGnssDataAck",  EMPTY, NOTHING).valid(MEASUREMENT).on(Products::of(&[680])),
    req(0xE6, "ReqCanConfig").on(SERIES_600),
    set(0xE6, "SetCanConfig",        "U4 baud rate code in bits 0 to 7, enabled in bit 8", OneOf(&[4])).on(SERIES_600),
    ack(0xE7, "CanConfig",           "U4 baud rate code in bits 0 to 7, enabled in bit 8", OneOf(&[0, 4]))
        .on(SERIES_600),
    ack(0xE7, "SetCanConfigAck",     EMPTY, OneOf(&[0, 4])).on(SERIES_600),
    req(0xE8, "ReqCanOutputConfig").on(SERIES_600),
    set(0xE8, "SetCanOutputConfig",  "1 to 16 times U1 data, U1 format, U4 CAN id, U2 frequency; one of zeros clears",
        Range(8, 128, 8)).on(SERIES_600),
    ack(0xE9, "CanOutputConfig",     "0 to 16 times U1 data, U1 format, U4 CAN id, U2 frequency",
        Range(0, 128, 8)).on(SERIES_600),
    ack(0xE9, "SetCanOutputConfigAck", "0 to 16 times U1 data, U1 format, U4 CAN id, U2 frequency",
        Range(0, 128, 8)).on(SERIES_600),
    req(0xEC, "ReqAlignmentRotation").carries("U1 rotation: 0 RotSensor, 1 RotLocal", OneOf(&[1])),
    set(0xEC, "SetAlignmentRotation", "U1 rotation, F4 q0, q1, q2, q3", OneOf(&[17])),
    ack(0xED, "ReqAlignmentRotationAck", "U1 rotation (not in old firmware), F4 q0, q1, q2, q3", OneOf(&[0, 16, 17])),
    ack(0xED, "SetAlignmentRotationAck", EMPTY, OneOf(&[0, 16, 17])),
    ack(0xEE, "ExtendedMessageID",   "unknown", Unknown).valid(ANY).on(NONE).both_ways().status("unlisted"),
    set(0xFE, "SetDeviceIdContext",  "device id", Unknown).on(NONE).status("unlisted"),
    ack(0xFF, "SetDeviceIdContextAck", "unknown", Unknown).on(NONE).status("unlisted"),
];

/// A message to the device that carries nothing, and that the next MID answers.
const fn req(mid: u8, name: &'static str) -> Message {
    set(mid, name, EMPTY, NOTHING)
}

/// A message to the device that carries something, and that the next MID answers.
const fn set(mid: u8, name: &'static str, payload: &'static str, lengths: Lengths) -> Message {
    Message { direction: Direction::ToDevice, reply: Some(mid.wrapping_add(1)), ..ack(mid, name, payload, lengths) }
}

/// A message from the device. In Config State and known to all products, unless the row says otherwise.
const fn ack(mid: u8, name: &'static str, payload: &'static str, lengths: Lengths) -> Message {
    let direction = Direction::ToHost;
    Message { mid, name, direction, states: CONFIG, payload, lengths, reply: None, products: Products::ALL, status: "" }
}

impl Message {
    const fn valid(self, states: States) -> Self {
        Self { states, ..self }
    }

    const fn on(self, products: Products) -> Self {
        Self { products, ..self }
    }

    const fn status(self, status: &'static str) -> Self {
        Self { status, ..self }
    }

    const fn reply(self, mid: u8) -> Self {
        Self { reply: Some(mid), ..self }
    }

    const fn unanswered(self) -> Self {
        Self { reply: None, ..self }
    }

    /// For the few requests that say what they want.
    const fn carries(self, payload: &'static str, lengths: Lengths) -> Self {
        Self { payload, lengths, ..self }
    }

    const fn both_ways(self) -> Self {
        Self { direction: Direction::Both, ..self }
    }
}

/// The MID of a name; a name that no row has does not compile.
const fn mid(name: &str) -> u8 {
    let mut i = 0;
    while i < MESSAGES.len() {
        if same(MESSAGES[i].name, name) {
            return MESSAGES[i].mid;
        }
        i += 1;
    }
    panic!("no message of that name")
}

const _: () = assert!(sorted(MESSAGES), "MIDs must not fall");

const fn sorted(rows: &[Message]) -> bool {
    let mut i = 1;
    while i < rows.len() {
        if rows[i - 1].mid > rows[i].mid {
            return false;
        }
        i += 1;
    }
    true
}
