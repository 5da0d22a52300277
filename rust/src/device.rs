//! What a log says about the device that wrote it: identifiers, product codes and the Configuration message.

use crate::mtdata::Output;
use crate::table::{self, Series};

/// Where `SampleTimeFine` of the device with this identifier wraps, if its family is known.
#[must_use]
pub const fn wrap_of_id(id: u64) -> Option<u64> {
    // Bit 31 marks the serial numbers of the 600-series and later, which carry no family.
    if id >> 31 != 0 {
        return Some(Series::SixHundred.fine_wrap());
    }
    match id >> 20 & 0xF {
        6 => Some(Series::Ten.fine_wrap()),
        7 => Some(Series::Hundred.fine_wrap()),   // and MTi-G
        8 | 0xD => Some(Series::One.fine_wrap()), // the 3x0 too, as far as is known
        _ => None,
    }
}

/// The same by product code, such as `MTi-30-2A5G4` or `MTi-680G`.
#[must_use]
pub fn wrap_of_product(code: &str) -> Option<u64> {
    if code.starts_with(['A', 'S']) {
        return Some(Series::SixHundred.fine_wrap()); // Avior and Sirius
    }
    let model = code.strip_prefix("MTi-")?;
    if model.starts_with("G-7") {
        return Some(Series::Hundred.fine_wrap());
    }
    let digits = model.split(|c: char| !c.is_ascii_digit()).next()?;
    match digits.parse().ok()? {
        1..=9 | 320 | 330 => Some(Series::One.fine_wrap()),
        10..=99 => Some(Series::Ten.fine_wrap()),
        100..=399 => Some(Series::Hundred.fine_wrap()),
        600..=699 => Some(Series::SixHundred.fine_wrap()),
        _ => None,
    }
}

/// A device identifier: 4 bytes, or 8 from the 600-series on.
///
/// Eight bytes with bit 31 set in neither half come from devices that fill the second half with something else; then
/// only the first four count.
#[cfg_attr(feature = "python", pyo3::pyfunction)]
#[must_use]
pub fn device_id(payload: &[u8]) -> Option<u64> {
    match payload.len() {
        4 => Some(u32_at(payload, 0)?.into()),
        8 => {
            let (high, low) = (u32_at(payload, 0)?, u32_at(payload, 4)?);
            Some(if (high | low) >> 31 == 0 { high.into() } else { u64::from(high) << 32 | u64::from(low) })
        }
        _ => None,
    }
}

/// The text of a ProductCode message: 20 bytes, padded with spaces.
#[cfg_attr(feature = "python", pyo3::pyfunction)]
#[must_use]
pub fn product_code(payload: &[u8]) -> Option<String> {
    let code: String =
        payload.iter().take_while(|byte| byte.is_ascii_graphic()).map(|byte| char::from(*byte)).collect();
    (!code.is_empty()).then_some(code)
}

/// The Configuration message (Tables 13 and 14; the tail, which the manual calls reserved, as devices fill it).
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "python", derive(pyo3::IntoPyObject))]
pub struct Configuration {
    /// Device identifier.
    pub device_id: u64,
    /// Product code, if the message has one.
    pub product_code: Option<String>,
    /// Sampling period in 1/115200 s; devices with 8-byte identifiers have none.
    pub sampling_period: Option<u16>,
    /// Output skip factor; devices with 8-byte identifiers have none.
    pub output_skip_factor: Option<u16>,
    /// Date, `YYYYMMDD`, as the host has set it.
    pub date: Option<String>,
    /// Time, `HHMMSSHH` (the last two are hundredths), as the host has set it.
    pub time: Option<String>,
    /// Number of devices on the bus.
    pub devices: u16,
    /// Filter profile.
    pub filter_profile: u16,
    /// Firmware: major, minor, revision.
    pub firmware: [u8; 3],
    /// Bytes of the payload of `MTData`; 0 if the device does not send it.
    pub data_length: u16,
    /// Output mode of the older `MTData`; devices with 8-byte identifiers have none.
    pub output_mode: Option<u16>,
    /// Output settings of the older `MTData`; devices with 8-byte identifiers have none.
    pub output_settings: Option<u32>,
    /// Letter of the kind of filter, where there is one.
    pub filter_type: Option<char>,
    /// Filter: major, minor.
    pub filter_version: [u8; 2],
}

impl Configuration {
    /// Reads the payload; `None` if it is shorter than one device needs.
    #[must_use]
    pub fn read(payload: &[u8]) -> Option<Self> {
        if payload.len() < field::END {
            return None;
        }
        let (first, second) = (u32_at(payload, field::DEVICE_ID)?, u32_at(payload, field::DEVICE_ID_REST)?);
        // Eight-byte identifiers stand here with their halves exchanged, against the DeviceID message.
        let (device_id, wide) = if first >> 31 == 1 {
            (u64::from(second) << 32 | u64::from(first), true)
        } else if first == 0 && second >> 31 == 1 {
            (u64::from(second), true)
        } else {
            (u64::from(first), false)
        };
        let narrow = |number| if wide { None } else { number };
        let digits = |at: usize| {
            let bytes = &payload[at..at + 8];
            bytes.iter().all(u8::is_ascii_digit).then(|| String::from_utf8_lossy(bytes).into_owned())
        };
        let filter_type = char::from(payload[field::FILTER_TYPE]);
        Some(Self {
            device_id,
            product_code: product_code(&payload[field::PRODUCT_CODE..field::HOST]),
            sampling_period: narrow(u16_at(payload, field::SAMPLING_PERIOD)),
            output_skip_factor: narrow(u16_at(payload, field::OUTPUT_SKIP_FACTOR)),
            date: digits(field::DATE),
            time: digits(field::TIME),
            devices: u16_at(payload, field::DEVICES)?,
            filter_profile: u16_at(payload, field::FILTER_PROFILE)?,
            firmware: [payload[field::MAJOR], payload[field::MINOR], payload[field::REVISION]],
            data_length: if wide { 0 } else { u16_at(payload, field::DATA_LENGTH)? },
            output_mode: narrow(u16_at(payload, field::OUTPUT_MODE)),
            output_settings: if wide { None } else { u32_at(payload, field::OUTPUT_SETTINGS) },
            filter_type: filter_type.is_ascii_graphic().then_some(filter_type),
            filter_version: [payload[field::FILTER_MAJOR], payload[field::FILTER_MINOR]],
        })
    }
}

/// The devices of a Configuration, with what they send as `MTData`. Devices with 8-byte identifiers have none of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MtDataDevices {
    master: u32,
    /// The devices, in the order of their bus identifiers.
    pub devices: Vec<MtDataDevice>,
}

/// A device of a Configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MtDataDevice {
    /// Device identifier.
    pub device_id: u32,
    /// Bytes of an `MTData` payload; 0 if the device sends `MTData2`.
    pub data_length: u16,
    /// `OutputMode` and `OutputSettings`.
    pub output: Output,
}

/// Most devices that have a bus identifier.
const MAX_DEVICES: usize = 31;

impl MtDataDevices {
    /// Reads the payload; `None` if it has no device, or those of another kind.
    #[must_use]
    pub fn read(payload: &[u8]) -> Option<Self> {
        if payload.len() < field::END {
            return None;
        }
        let master = u32_at(payload, field::DEVICE_ID)?;
        if master >> 31 == 1 || master == 0 {
            return None;
        }
        let count = usize::from(u16_at(payload, field::DEVICES)?).min(MAX_DEVICES);
        let device = |entry: &[u8]| {
            let at = |field: usize| field - field::FIRST_DEVICE_ID;
            Some(MtDataDevice {
                device_id: u32_at(entry, 0)?,
                data_length: u16_at(entry, at(field::DATA_LENGTH))?,
                output: Output {
                    mode: u16_at(entry, at(field::OUTPUT_MODE))?,
                    settings: u32_at(entry, at(field::OUTPUT_SETTINGS))?,
                },
            })
        };
        let entries = payload[field::FIRST_DEVICE_ID..].chunks_exact(field::END - field::FIRST_DEVICE_ID);
        let devices: Vec<_> = entries.take(count).map_while(device).collect();
        (!devices.is_empty()).then_some(Self { master, devices })
    }

    /// Whether they are the trackers of an Xbus Master, which sends for all of them.
    #[must_use]
    pub fn is_xbus_master(&self) -> bool {
        self.devices.len() > 1 || self.master >> 20 & 0xF == 1
    }

    /// Whether they send `MTData`. Otherwise what the message says about it is from before.
    #[must_use]
    pub fn send_mtdata(&self) -> bool {
        self.devices.iter().any(|device| device.data_length > 0)
    }

    /// Whether they are the trackers of an Xbus Master, which sends their `MTData`.
    #[must_use]
    pub fn are_trackers(&self) -> bool {
        self.send_mtdata() && self.is_xbus_master()
    }

    /// Number of devices.
    #[must_use]
    #[allow(clippy::cast_possible_truncation)] // at most MAX_DEVICES
    pub fn count(&self) -> u8 {
        self.devices.len() as u8
    }
}

/// Where the fields of a Configuration begin.
mod field {
    use crate::table::{CONFIGURATION_FIELDS, offset, size};

    const fn of(name: &str) -> usize {
        offset(CONFIGURATION_FIELDS, name)
    }

    pub const DEVICE_ID: usize = of("device_id");
    pub const DEVICE_ID_REST: usize = DEVICE_ID + 4;
    pub const SAMPLING_PERIOD: usize = of("sampling_period");
    pub const OUTPUT_SKIP_FACTOR: usize = of("output_skip_factor");
    pub const DATE: usize = of("date");
    pub const TIME: usize = of("time");
    pub const PRODUCT_CODE: usize = of("product_code");
    pub const HOST: usize = of("host");
    pub const DEVICES: usize = of("devices");
    pub const FIRST_DEVICE_ID: usize = of("first_device_id");
    pub const DATA_LENGTH: usize = of("data_length");
    pub const OUTPUT_MODE: usize = of("output_mode");
    pub const OUTPUT_SETTINGS: usize = of("output_settings");
    pub const FILTER_PROFILE: usize = of("filter_profile");
    pub const MAJOR: usize = of("major");
    pub const MINOR: usize = of("minor");
    pub const REVISION: usize = of("revision");
    pub const FILTER_TYPE: usize = of("filter_type");
    pub const FILTER_MAJOR: usize = of("filter_major");
    pub const FILTER_MINOR: usize = of("filter_minor");
    pub const END: usize = size(CONFIGURATION_FIELDS).1;
}

/// Where `SampleTimeFine` wraps, if this message names the device.
#[must_use]
pub fn wrap_of_message(mid: u8, payload: &[u8]) -> Option<u64> {
    match mid {
        table::DEVICE_ID => device_id(payload).and_then(wrap_of_id),
        table::INIT_BUS_RESULTS if payload.len() == 4 => device_id(payload).and_then(wrap_of_id),
        table::CONFIGURATION => {
            Configuration::read(payload).and_then(|configuration| wrap_of_id(configuration.device_id))
        }
        table::PRODUCT_CODE => wrap_of_product(&product_code(payload)?),
        _ => None,
    }
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    bytes.get(at..)?.first_chunk().map(|bytes| u16::from_be_bytes(*bytes))
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..)?.first_chunk().map(|bytes| u32::from_be_bytes(*bytes))
}
