//! The messages: sections 5.3 and 8 of the manual, and those that only the vendor's open code names.
//!
//! The manual's product boxes are partly lost in its text; where one is, the request, the setting and the reply of one
//! command share the products of the others.

use super::payload::{
    AMD, AVAILABLE_PROFILE, BAUD_CODE, CAN, CAN_OUTPUT, CONFIGURATION_FIELDS, DATA_LENGTH, DEVICE_ID_4, DEVICE_ID_8,
    EMPTY, ERROR_CODE, ERROR_MODE, FIRMWARE, FIRMWARE_3, FLAGS, GRAVITY, HARDWARE, HEADING, ICC_COMMAND, ICC_RESULT,
    ICC_STATE, INITIAL_HEADING, LEVER_ARM, LOCATION, MODE, NO_ROTATION, OUTPUT, OUTPUT_SETTINGS, PERIOD, PLACE,
    PLACE_12, PLATFORM, PORT, PROCESSING_FLAGS, PROFILE, PROFILE_IN_USE, RECEIVER, RESET_CODE, ROTATION, ROTATION_16,
    SELFTEST, SET_FLAGS, SKIP_FACTOR, STRINGS_10_100, STRINGS_600, SYNC_SETTING, TRANSMIT_DELAY, UNKNOWN, UTC_STEP,
    UTC_TIME, WARNING_CODE, WHICH_ROTATION, bytes, filled_text, list, list_or_zeros, opaque, record, text,
};
use super::{Direction, Message, Payload, Products, States, same};

/// The longest payload that a live device is expected to send. The manual says 2048; the vendor's own code allows 8192
/// bytes for a whole message, and the extended header takes 6 and the checksum 1 of these.
pub const LONGEST_PAYLOAD: usize = 8192 - 7;

/// The longest payload to send: the manual's limit.
const LONGEST_SENT: usize = 2048;

/// MID of the output data of older devices.
pub const MTDATA: u8 = mid("MTData");
/// MID of `SetOutputMode`, which also requests it.
pub const SET_OUTPUT_MODE: u8 = mid("SetOutputMode");
/// MID of the replies to it: the mode, or nothing if it was set.
pub const OUTPUT_MODE_ACK: u8 = mid("ReqOutputModeAck");
/// MID of `SetOutputSettings`, which also requests them.
pub const SET_OUTPUT_SETTINGS: u8 = mid("SetOutputSettings");
/// MID of the replies to it: the settings, or nothing if they were set.
pub const OUTPUT_SETTINGS_ACK: u8 = mid("ReqOutputSettingsAck");
/// MID of the output data.
pub const MTDATA2: u8 = mid("MTData2");
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
const LEGACY: Products = Products::LEGACY;
const LEGACY_GNSS: Products = Products::legacy("MTi-G");
/// All that send `MTData`: firmware of the 10- and 100-series did, after an empty `SetOutputConfiguration`.
const SENDERS: Products = LEGACY.or(SERIES_10_100);

/// Every message, sorted by MID; of one MID the request and its answer come before the setting and its answer.
///
/// A row gives the payload of its message alone. Which lengths a device may send under a MID follows from all of its
/// rows: few sources say whether a device answers a setting with nothing or with the new value.
#[rustfmt::skip]
pub const MESSAGES: &[Message] = &[
    req(0x00, "ReqDID").legacy(LEGACY),
    ack(0x01, "DeviceID",                    record(&[DEVICE_ID_8, DEVICE_ID_4])).legacy(LEGACY),
    // The vendor's software opens every MTi with it, so every product knows it.
    req(0x02, "InitBus").status("reserved").legacy(LEGACY),
    ack(0x03, "InitBusResults",              list_or_zeros(DEVICE_ID_4, 1, 8)).status("reserved").legacy(LEGACY),
    req(0x04, "ReqPeriod").on(SERIES_10_100).legacy(LEGACY),
    set(0x04, "SetPeriod",                   record(&[PERIOD])).on(SERIES_10_100).legacy(LEGACY),
    ack(0x05, "ReqPeriodAck",                record(&[PERIOD])).on(SERIES_10_100).legacy(LEGACY),
    ack(0x05, "SetPeriodAck",                EMPTY).on(SERIES_10_100).legacy(LEGACY),
    set(0x06, "SetBid",                      UNKNOWN).on(NONE).status("unlisted"),
    ack(0x07, "SetBidAck",                   UNKNOWN).on(NONE).status("unlisted"),
    req(0x0A, "ReqDataLength").on(NONE).status("reserved").legacy(SENDERS),
    ack(0x0B, "DataLength",                  record(&[DATA_LENGTH]))
        .unconfirmed().on(NONE).status("reserved").legacy(SENDERS),
    req(0x0C, "ReqConfiguration").legacy(LEGACY),
    ack(0x0D, "Configuration",               record(&[CONFIGURATION_FIELDS])).valid(ANY).legacy(LEGACY),
    req(0x0E, "RestoreFactoryDef").legacy(LEGACY),
    ack(0x0F, "RestoreFactoryDefAck",        EMPTY).legacy(LEGACY),
    req(0x10, "GoToMeasurement").legacy(LEGACY),
    ack(0x11, "GoToMeasurementAck",          EMPTY).restarts().legacy(LEGACY),
    req(0x12, "ReqFWRev").legacy(LEGACY),
    ack(0x13, "FirmwareRev",                 record(&[FIRMWARE, FIRMWARE_3])).legacy(LEGACY),
    req(0x14, "ReqUniqueId").on(NONE).status("unlisted"),
    ack(0x15, "ReqUniqueIdAck",              UNKNOWN).on(NONE).status("unlisted"),
    req(0x18, "ReqBaudrate").legacy(LEGACY),
    set(0x18, "SetBaudrate",                 record(&[BAUD_CODE])).legacy(LEGACY),
    ack(0x19, "ReqBaudrateAck",              record(&[BAUD_CODE])).legacy(LEGACY),
    ack(0x19, "SetBaudrateAck",              EMPTY).legacy(LEGACY),
    req(0x1A, "ReqProductVariant").on(NONE).status("unlisted"),
    ack(0x1B, "ReqProductVariantAck",        UNKNOWN).on(NONE).status("unlisted"),
    req(0x1C, "ReqProductCode").legacy(LEGACY),
    ack(0x1D, "ProductCode",                 filled_text(4, 20)).legacy(LEGACY),
    req(0x1E, "ReqHardwareVersion"),
    ack(0x1F, "HardwareVersion",             record(&[HARDWARE])),
    req(0x20, "ReqProcessingFlags").on(NONE).status("reserved"),
    set(0x20, "SetProcessingFlags",          record(&[PROCESSING_FLAGS])).on(NONE).status("reserved"),
    ack(0x21, "ProcessingFlagsAck",          opaque("U1 flags, or empty")).on(NONE).status("reserved"),
    set(0x22, "SetNoRotation",               record(&[NO_ROTATION])).valid(MEASUREMENT).on(ORIENTED).legacy(LEGACY),
    ack(0x23, "SetNoRotationAck",            EMPTY).valid(MEASUREMENT).on(ORIENTED).legacy(LEGACY),
    req(0x24, "RunSelftest"),
    ack(0x25, "SelftestResults",             record(&[SELFTEST])),
    req(0x2C, "ReqSyncSettings"),
    set(0x2C, "SetSyncSettings",             list_or_zeros(SYNC_SETTING, 1, 10)),
    ack(0x2D, "ReqSyncSettingsAck",          list(SYNC_SETTING, 0, 10)),
    ack(0x2D, "SetSyncSettingsAck",          EMPTY),
    req(0x30, "GoToConfig").valid(ANY).legacy(LEGACY),
    ack(0x31, "GoToConfigAck",               EMPTY).valid(ANY).legacy(LEGACY),
    ack(0x32, "MTData",                      bytes("output data in the layout of OutputMode and OutputSettings", 1, LONGEST_SENT))
        .valid(MEASUREMENT).on(NONE).status("obsolete").legacy(SENDERS),
    req(0x34, "ReqData").valid(MEASUREMENT).unanswered().legacy(LEGACY),  // answered by a sample or a string
    ack(0x36, "MTData2",                     opaque("packets: U2 data identifier, U1 size, data")).valid(MEASUREMENT),
    ack(0x3E, "WakeUp",                      EMPTY).valid(WAKEUP).reply(0x3F).restarts().legacy(LEGACY),
    req(0x3F, "WakeUpAck").valid(WAKEUP).unanswered().legacy(LEGACY),  // the only acknowledgement that the host sends
    req(0x40, "Reset").valid(ANY).legacy(LEGACY),
    ack(0x41, "ResetAck",                    EMPTY).valid(ANY).restarts().legacy(LEGACY),
    ack(0x42, "Error",                       record(&[ERROR_CODE])).valid(ANY).legacy(LEGACY),
    ack(0x43, "Warning",                     record(&[WARNING_CODE])).valid(ANY).on(GNSS_EXTERNAL),
    ack(0x46, "MasterIndication",            opaque("unknown, wireless products only"))
        .valid(ANY).on(NONE).status("unlisted"),
    req(0x48, "ReqOptionFlags"),
    set(0x48, "SetOptionFlags",              record(&[SET_FLAGS])),
    ack(0x49, "ReqOptionFlagsAck",           record(&[FLAGS])),
    ack(0x49, "SetOptionFlagsAck",           EMPTY),
    req(0x60, "ReqUTCTime"),
    set(0x60, "SetUTCTime",                  record(&[UTC_TIME])),
    ack(0x61, "UTCTime",                     record(&[UTC_TIME])).or_empty(),
    req(0x62, "ReqAvailableFilterProfiles").on(ORIENTED),
    ack(0x63, "AvailableFilterProfiles",     list_or_zeros(AVAILABLE_PROFILE, 1, 10)).on(ORIENTED),
    req(0x64, "ReqFilterProfile").on(ORIENTED),
    set(0x64, "SetFilterProfile",            record(&[PROFILE])).on(CLASSIC),
    set(0x64, "SetFilterProfileModern",      text(1, 62)).on(MODERN),
    ack(0x65, "ReqFilterProfileAck",         record(&[PROFILE_IN_USE])).on(CLASSIC),
    ack(0x65, "ReqFilterProfileAckModern",   text(1, 62)).on(MODERN),
    ack(0x65, "SetFilterProfileAck",         EMPTY).on(ORIENTED),
    req(0x66, "ReqGravityMagnitude").on(NONE).status("reserved"),
    set(0x66, "SetGravityMagnitude",         record(&[GRAVITY])).on(NONE).status("reserved"),
    ack(0x67, "GravityMagnitudeAck",         opaque("F4, or empty")).on(NONE).status("reserved"),
    req(0x68, "ReqGnssLeverArm").on(Products::of(&[680])).legacy(LEGACY_GNSS),
    set(0x68, "SetGnssLeverArm",             record(&[LEVER_ARM])).on(Products::of(&[680])).legacy(LEGACY_GNSS),
    ack(0x69, "ReqGnssLeverArmAck",          record(&[LEVER_ARM])).on(Products::of(&[680])).legacy(LEGACY_GNSS),
    ack(0x69, "SetGnssLeverArmAck",          EMPTY).on(Products::of(&[680])).legacy(LEGACY_GNSS),
    req(0x6A, "ReqMagneticField").on(NONE).status("reserved"),
    set(0x6A, "SetMagneticField",            UNKNOWN).on(NONE).status("reserved"),
    ack(0x6B, "MagneticFieldAck",            UNKNOWN).on(NONE).status("reserved"),
    req(0x6C, "ReqReplayMode").on(NONE).status("unlisted"),
    set(0x6C, "SetReplayMode",               UNKNOWN).on(NONE).status("unlisted"),
    ack(0x6D, "ReplayModeAck",               UNKNOWN).on(NONE).status("unlisted"),
    req(0x6E, "ReqLatLonAlt"),
    set(0x6E, "SetLatLonAlt",                record(&[PLACE])),
    ack(0x6F, "ReqLatLonAltAck",             record(&[PLACE, PLACE_12])),
    ack(0x6F, "SetLatLonAltAck",             EMPTY),
    req(0x74, "IccCommand").carries(record(&[ICC_COMMAND])).valid(ANY).on(ORIENTED),
    ack(0x75, "IccCommandAck",               record(&[ICC_RESULT, ICC_STATE, ICC_COMMAND])).valid(ANY).on(ORIENTED),
    req(0x76, "ReqGnssPlatform").on(Products::of(&[7, 710])),
    set(0x76, "SetGnssPlatform",             record(&[PLATFORM])).on(Products::of(&[7, 710])),
    ack(0x77, "ReqGnssPlatformAck",          record(&[PLATFORM])).on(Products::of(&[7, 710])),
    ack(0x77, "SetGnssPlatformAck",          EMPTY).on(Products::of(&[7, 710])),
    req(0x7E, "ReqErrorReport").carries(UNKNOWN).on(NONE).status("unlisted"),
    ack(0x7F, "ReqErrorReportAck",           UNKNOWN).on(NONE).status("unlisted"),
    req(0x82, "ReqHeading").on(NONE).status("reserved").legacy(LEGACY),
    set(0x82, "SetHeading",                  record(&[HEADING])).on(NONE).status("reserved").legacy(LEGACY),
    ack(0x83, "HeadingAck",                  record(&[HEADING]))
        .or_empty().unconfirmed().on(NONE).status("reserved").legacy(LEGACY),
    req(0x84, "ReqLocationID").legacy(LEGACY),
    set(0x84, "SetLocationID",               record(&[LOCATION])).legacy(LEGACY),
    ack(0x85, "ReqLocationIDAck",            record(&[LOCATION])).legacy(LEGACY),
    ack(0x85, "SetLocationIDAck",            EMPTY).legacy(LEGACY),
    req(0x86, "ReqExtOutputMode").on(SERIES_10_100).legacy(LEGACY),
    set(0x86, "SetExtOutputMode",            record(&[MODE])).on(SERIES_10_100).legacy(LEGACY),
    ack(0x87, "ExtOutputMode",               record(&[MODE])).on(SERIES_10_100).legacy(LEGACY),
    ack(0x87, "SetExtOutputModeAck",         EMPTY).on(SERIES_10_100).legacy(LEGACY),
    req(0x8A, "StoreFilterState").valid(ANY).on(SERIES_10_TO_600).status("unlisted").legacy(LEGACY),
    ack(0x8B, "StoreFilterStateAck",         UNKNOWN).valid(ANY).on(SERIES_10_TO_600).status("unlisted").legacy(LEGACY),
    req(0x8C, "ReqPortConfig").on(SERIES_600),
    set(0x8C, "SetPortConfig",               list(PORT, 3, 3)).on(SERIES_600),
    ack(0x8D, "PortConfig",                  list(PORT, 0, 3)).on(SERIES_600),
    ack(0x8D, "SetPortConfigAck",            EMPTY).on(SERIES_600),
    req(0x8E, "ReqStringOutputType").on(SERIES_10_TO_600),
    set(0x8E, "SetStringOutputType",         record(&[STRINGS_600, STRINGS_10_100])).on(SERIES_10_TO_600),
    ack(0x8F, "ReqStringOutputTypeAck",      record(&[STRINGS_600, STRINGS_10_100])).on(SERIES_10_TO_600),
    ack(0x8F, "SetStringOutputTypeAck",      EMPTY).on(SERIES_10_TO_600),
    req(0x90, "ReqEmts").carries(bytes("00 FF", 2, 2)).status("unlisted"),
    ack(0x91, "EmtsData",                    bytes("opaque", 255, LONGEST_PAYLOAD)).valid(ANY).status("unlisted"),
    set(0x92, "UpdateFilterProfile",         opaque("opaque")).on(NONE).status("unlisted"),
    ack(0x93, "UpdateFilterProfileAck",      UNKNOWN).on(NONE).status("unlisted"),
    set(0x94, "RestoreEmts",                 opaque("opaque")).on(NONE).status("unlisted"),
    ack(0x95, "RestoreEmtsAck",              UNKNOWN).on(NONE).status("unlisted"),
    set(0x96, "StoreEmts",                   opaque("opaque")).on(NONE).status("unlisted"),
    ack(0x97, "StoreEmtsAck",                UNKNOWN).on(NONE).status("unlisted"),
    set(0x98, "UnlockMaintenanceMode",       opaque("opaque")).on(NONE).status("unlisted"),
    ack(0x99, "UnlockMaintenanceModeAck",    UNKNOWN).on(NONE).status("unlisted"),
    set(0x9A, "ClockSyncCommand",            UNKNOWN).on(NONE).status("unlisted"),
    ack(0x9B, "ClockSyncCommandAck",         UNKNOWN).on(NONE).status("unlisted"),
    req(0xA0, "ReqFilterSettings").on(NONE).status("unlisted"),
    set(0xA0, "SetFilterSettings",           UNKNOWN).on(NONE).status("unlisted"),
    ack(0xA1, "FilterSettingsAck",           UNKNOWN).on(NONE).status("unlisted"),
    req(0xA2, "ReqAmd").on(NONE).status("unlisted"),
    set(0xA2, "SetAmd",                      record(&[AMD])).on(NONE).status("unlisted"),
    ack(0xA3, "AmdAck",                      UNKNOWN).on(NONE).status("unlisted"),
    set(0xA4, "ResetOrientation",            record(&[RESET_CODE])).valid(ANY).on(ORIENTED).legacy(LEGACY),
    ack(0xA5, "ResetOrientationAck",         EMPTY).valid(ANY).on(ORIENTED).legacy(LEGACY),
    req(0xA6, "ReqGnssStatus").on(NONE).status("reserved").legacy(LEGACY_GNSS),
    ack(0xA7, "GnssStatus",                  opaque("U1 channels, then 5 bytes for each"))
        .on(NONE).status("reserved").legacy(LEGACY_GNSS),
    set(0xA8, "AdjustUTCTime",               record(&[UTC_STEP])),
    ack(0xA9, "AdjustUTCTimeAck",            EMPTY),
    req(0xAC, "ReqGnssReceiverSettings").on(GNSS_EXTERNAL).status("unlisted"),
    set(0xAC, "SetGnssReceiverSettings",     record(&[RECEIVER])).on(GNSS_EXTERNAL).status("unlisted"),
    ack(0xAD, "GnssReceiverSettings",        record(&[RECEIVER])).on(GNSS_EXTERNAL).status("unlisted"),
    ack(0xAD, "SetGnssReceiverSettingsAck",  EMPTY).on(GNSS_EXTERNAL).status("unlisted"),
    set(0xBC, "UpdateBias",                  UNKNOWN).valid(ANY).on(NONE).status("unlisted"),
    ack(0xBD, "UpdateBiasAck",               UNKNOWN).valid(ANY).on(NONE).status("unlisted"),
    req(0xC0, "ReqOutputConfiguration"),
    set(0xC0, "SetOutputConfiguration",      list_or_zeros(OUTPUT, 1, 32)),
    ack(0xC1, "ReqOutputConfigurationAck",   list_or_zeros(OUTPUT, 0, 32)),
    ack(0xC1, "SetOutputConfigurationAck",   list_or_zeros(OUTPUT, 0, 32)),
    req(0xD0, "ReqOutputMode").on(NONE).status("deprecated").legacy(SENDERS),
    set(0xD0, "SetOutputMode",               record(&[MODE])).on(NONE).status("deprecated").legacy(SENDERS),
    ack(0xD1, "ReqOutputModeAck",            record(&[MODE]))
        .unconfirmed().on(NONE).status("deprecated").legacy(SENDERS),
    ack(0xD1, "SetOutputModeAck",            EMPTY).unconfirmed().on(NONE).status("deprecated").legacy(SENDERS),
    req(0xD2, "ReqOutputSettings").on(NONE).status("deprecated").legacy(SENDERS),
    set(0xD2, "SetOutputSettings",           record(&[OUTPUT_SETTINGS])).on(NONE).status("deprecated").legacy(SENDERS),
    ack(0xD3, "ReqOutputSettingsAck",        record(&[OUTPUT_SETTINGS]))
        .unconfirmed().on(NONE).status("deprecated").legacy(SENDERS),
    ack(0xD3, "SetOutputSettingsAck",        EMPTY).unconfirmed().on(NONE).status("deprecated").legacy(SENDERS),
    req(0xD4, "ReqOutputSkipFactor").on(SERIES_10_100).legacy(LEGACY),
    set(0xD4, "SetOutputSkipFactor",         record(&[SKIP_FACTOR])).on(SERIES_10_100).legacy(LEGACY),
    ack(0xD5, "ReqOutputSkipFactorAck",      record(&[SKIP_FACTOR])).on(SERIES_10_100).legacy(LEGACY),
    ack(0xD5, "SetOutputSkipFactorAck",      EMPTY).on(SERIES_10_100).legacy(LEGACY),
    set(0xD6, "SetInitialHeading",           record(&[INITIAL_HEADING])).on(Products::of(&[710, 670, 680])),
    ack(0xD7, "SetInitialHeadingAck",        EMPTY).on(Products::of(&[710, 670, 680])),
    set(0xD8, "SetSyncOutSettings",          UNKNOWN).on(NONE).status("reserved"),
    ack(0xD9, "SetSyncOutSettingsAck",       UNKNOWN).on(NONE).status("reserved"),
    req(0xDA, "ReqErrorMode").on(SERIES_10_100).status("deprecated").legacy(LEGACY),
    set(0xDA, "SetErrorMode",                record(&[ERROR_MODE]))
        .on(SERIES_10_100).status("deprecated").legacy(LEGACY),
    ack(0xDB, "ReqErrorModeAck",             record(&[ERROR_MODE]))
        .on(SERIES_10_100).status("deprecated").legacy(LEGACY),
    ack(0xDB, "SetErrorModeAck",             EMPTY).on(SERIES_10_100).status("deprecated").legacy(LEGACY),
    req(0xDC, "ReqTransmitDelay").on(SERIES_10_100).legacy(LEGACY),
    set(0xDC, "SetTransmitDelay",            record(&[TRANSMIT_DELAY])).on(SERIES_10_100).legacy(LEGACY),
    ack(0xDD, "ReqTransmitDelayAck",         record(&[TRANSMIT_DELAY])).on(SERIES_10_100).legacy(LEGACY),
    ack(0xDD, "SetTransmitDelayAck",         EMPTY).on(SERIES_10_100).legacy(LEGACY),
    set(0xDE, "SetMfmResults",               opaque("opaque")).on(NONE).status("unlisted"),
    ack(0xDF, "SetMfmResultsAck",            UNKNOWN).on(NONE).status("unlisted"),
    req(0xE0, "ReqObjectAlignment").on(NONE).status("reserved"),
    set(0xE0, "SetObjectAlignment",          bytes("F4 matrix of 3 by 3", 36, 36)).on(NONE).status("reserved"),
    ack(0xE1, "ObjectAlignmentAck",          opaque("F4 matrix of 3 by 3, or empty")).on(NONE).status("reserved"),
    set(0xE2, "ForwardGnssData",             bytes("bytes for the GNSS receiver", 1, LONGEST_SENT))
        .valid(MEASUREMENT).on(Products::of(&[680])),
    ack(0xE3, "ForwardGnssDataAck",          EMPTY).valid(MEASUREMENT).on(Products::of(&[680])),
    req(0xE6, "ReqCanConfig").on(SERIES_600),
    set(0xE6, "SetCanConfig",                record(&[CAN])).on(SERIES_600),
    ack(0xE7, "CanConfig",                   record(&[CAN])).on(SERIES_600),
    ack(0xE7, "SetCanConfigAck",             EMPTY).on(SERIES_600),
    req(0xE8, "ReqCanOutputConfig").on(SERIES_600),
    set(0xE8, "SetCanOutputConfig",          list_or_zeros(CAN_OUTPUT, 1, 16)).on(SERIES_600),
    ack(0xE9, "CanOutputConfig",             list_or_zeros(CAN_OUTPUT, 0, 16)).on(SERIES_600),
    ack(0xE9, "SetCanOutputConfigAck",       list_or_zeros(CAN_OUTPUT, 0, 16)).on(SERIES_600),
    req(0xEC, "ReqAlignmentRotation").carries(record(&[WHICH_ROTATION])),
    set(0xEC, "SetAlignmentRotation",        record(&[ROTATION])),
    ack(0xED, "ReqAlignmentRotationAck",     record(&[ROTATION, ROTATION_16])),
    ack(0xED, "SetAlignmentRotationAck",     EMPTY),
    ack(0xEE, "ExtendedMessageID",           UNKNOWN).valid(ANY).on(NONE).both_ways().status("unlisted"),
    set(0xFE, "SetDeviceIdContext",          opaque("device id")).on(NONE).status("unlisted"),
    ack(0xFF, "SetDeviceIdContextAck",       UNKNOWN).on(NONE).status("unlisted"),
];

/// A message to the device without a payload, which the next MID answers.
const fn req(mid: u8, name: &'static str) -> Message {
    set(mid, name, EMPTY)
}

/// A message to the device with a payload, which the next MID answers.
const fn set(mid: u8, name: &'static str, payload: Payload) -> Message {
    Message { direction: Direction::ToDevice, reply: Some(mid.wrapping_add(1)), ..ack(mid, name, payload) }
}

/// A message from the device. In Config State and known to all products, unless the row says otherwise.
const fn ack(mid: u8, name: &'static str, payload: Payload) -> Message {
    Message {
        mid,
        name,
        direction: Direction::ToHost,
        states: CONFIG,
        payload,
        can_be_empty: false,
        is_confirmed: true,
        restarts: false,
        reply: None,
        products: Products::ALL,
        legacy: Products::NONE,
        status: "",
    }
}

impl Message {
    const fn valid(self, states: States) -> Self {
        Self { states, ..self }
    }

    const fn on(self, products: Products) -> Self {
        Self { products, ..self }
    }

    const fn legacy(self, legacy: Products) -> Self {
        Self { legacy, ..self }
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
    const fn carries(self, payload: Payload) -> Self {
        Self { payload, ..self }
    }

    /// For a reply whose row also stands for the acknowledgement of the setting.
    const fn or_empty(self) -> Self {
        Self { can_be_empty: true, ..self }
    }

    const fn unconfirmed(self) -> Self {
        Self { is_confirmed: false, ..self }
    }

    const fn restarts(self) -> Self {
        Self { restarts: true, ..self }
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

const _: () = assert!(is_sound(MESSAGES), "MIDs must not fall, names must differ, and payloads must be readable");

const fn is_sound(rows: &[Message]) -> bool {
    let mut i = 0;
    while i < rows.len() {
        if !rows[i].payload.is_sound() || (i > 0 && rows[i - 1].mid > rows[i].mid) {
            return false;
        }
        let mut j = 0;
        while j < i {
            if same(rows[j].name, rows[i].name) {
                return false;
            }
            j += 1;
        }
        i += 1;
    }
    true
}
