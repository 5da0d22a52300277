//! Which settings of `MTData` are in force, as the messages of a stream say it.

use std::sync::Arc;

use super::{Item, Output};
use crate::device::MtDataDevices;
use crate::frame::{Frame, MASTER, device_of};
use crate::table;

/// The settings in force, device by device.
///
/// They follow the messages of the stream: Configuration, the replies to `ReqOutputMode` and `ReqOutputSettings`, and
/// `SetOutputMode` and `SetOutputSettings` once they are acknowledged. If a stream has the acknowledgement but not the
/// request, as one that only the device has written, the settings are not known until the stream has them again. A
/// Configuration with a data length of 0 says nothing: the device sends `MTData2`, and its other numbers are from before.
/// Settings of the caller hold for each device as long as the stream has none.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Outputs {
    /// Those of the caller: one for any device, or one for each tracker of an Xbus Master.
    given: Vec<Output>,
    /// Those of the stream, by bus identifier.
    devices: Vec<(u8, Known)>,
    /// Number of trackers, if the master of the bus is an Xbus Master.
    trackers: Option<u8>,
}

/// What the stream says about one device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Known {
    mode: Option<u16>,
    settings: Option<u32>,
    /// What the host has requested last. It stays, because a request that is repeated is acknowledged twice.
    requested_mode: Option<u16>,
    requested_settings: Option<u32>,
}

/// The samples of a message: one, or one of each tracker of an Xbus Master.
#[derive(Debug)]
pub struct MessageLayout {
    /// Bytes of the payload.
    pub size: usize,
    /// For each sample the bus identifier of its device, and its items.
    pub samples: Vec<(u8, Vec<Item>)>,
}

impl Outputs {
    /// Settings of the caller: none, one for any device, or one for each tracker of an Xbus Master.
    #[must_use]
    pub fn given(given: Vec<Output>) -> Self {
        let trackers = if given.len() > 1 { u8::try_from(given.len()).ok() } else { None };
        Self { given, trackers, ..Self::default() }
    }

    /// Replaces the settings of the caller.
    pub fn give(&mut self, given: Vec<Output>) {
        let Self { given, trackers, .. } = Self::given(given);
        (self.given, self.trackers) = (given, trackers.or(self.trackers));
    }

    /// Handles a message. Returns whether it changes what is in force.
    pub fn learn(&mut self, frame: Frame<'_>) -> bool {
        let Frame { bid, mid, payload } = frame;
        match mid {
            table::CONFIGURATION => self.configure(bid, payload),
            table::SET_OUTPUT_MODE
            | table::OUTPUT_MODE_ACK
            | table::SET_OUTPUT_SETTINGS
            | table::OUTPUT_SETTINGS_ACK => self.update(bid, |known| known.learn(mid, payload)),
            _ => false,
        }
    }

    /// The layout of the messages of a device; `None` if its settings or their layout are not known.
    #[must_use]
    pub fn layout(&self, bid: u8) -> Option<Arc<MessageLayout>> {
        let trackers = self.trackers.filter(|_| bid == MASTER);
        let Some(trackers) = trackers else {
            let items = self.of(bid)?.items().ok()?;
            let size = items.last().map_or(0, |item| item.at + item.size);
            return Some(MessageLayout { size, samples: vec![(bid, items)] }.into());
        };
        let outputs = (1..=trackers).map(|tracker| self.of(tracker)).collect::<Option<Vec<_>>>()?;
        MessageLayout::of_trackers(&outputs).map(Arc::new)
    }

    /// The bus identifiers of the devices that a message of this one is about: an Xbus Master speaks for its trackers.
    pub fn devices_of(&self, bid: u8) -> impl Iterator<Item = u8> + use<> {
        let trackers = self.trackers.filter(|_| bid == MASTER);
        let (first, last) = trackers.map_or((bid, bid), |trackers| (1, trackers));
        first..=last
    }

    /// Sets what is in force of a device. Returns whether that changes it.
    pub fn set(&mut self, bid: u8, output: Output) -> bool {
        self.update(bid, |known| known.set(Some(output.mode), Some(output.settings)))
    }

    /// The settings in force of a device.
    #[must_use]
    pub fn of(&self, bid: u8) -> Option<Output> {
        let device = device_of(bid);
        let given = if self.given.len() > 1 { self.given.get(usize::from(device) - 1) } else { self.given.first() };
        let known = self.devices.iter().find(|(known, _)| *known == device).map(|(_, known)| *known);
        let known = known.unwrap_or_default();
        Some(Output {
            mode: known.mode.or(given.map(|given| given.mode))?,
            settings: known.settings.or(given.map(|given| given.settings))?,
        })
    }

    fn configure(&mut self, bid: u8, payload: &[u8]) -> bool {
        let Some(devices) = MtDataDevices::read(payload) else { return false };
        if !devices.send_mtdata() {
            return false;
        }
        let is_master = bid == MASTER && devices.is_xbus_master();
        let trackers = is_master.then(|| devices.count());
        let mut changed = self.trackers != trackers && bid == MASTER;
        if bid == MASTER {
            self.trackers = trackers;
        }
        for (device, tracker) in devices.devices.iter().zip(1..) {
            let device_bid = if is_master { tracker } else { bid };
            let Output { mode, settings } = device.output;
            changed |= self.update(device_bid, |known| known.set(Some(mode), Some(settings)));
        }
        changed
    }

    fn update(&mut self, bid: u8, change: impl FnOnce(&mut Known) -> bool) -> bool {
        let device = device_of(bid);
        let place = self.devices.iter().position(|(known, _)| *known == device).unwrap_or_else(|| {
            self.devices.push((device, Known::default()));
            self.devices.len() - 1
        });
        change(&mut self.devices[place].1)
    }
}

impl Known {
    /// Returns whether that changes what is in force.
    fn set(&mut self, mode: Option<u16>, settings: Option<u32>) -> bool {
        let is_new = (self.mode, self.settings) != (mode, settings);
        (self.mode, self.settings) = (mode, settings);
        is_new
    }

    /// Handles a message. Returns whether it changes what is in force.
    fn learn(&mut self, mid: u8, payload: &[u8]) -> bool {
        match (mid, payload) {
            (table::SET_OUTPUT_MODE, &[a, b]) => self.requested_mode = Some(u16::from_be_bytes([a, b])),
            (table::SET_OUTPUT_MODE, _) => self.requested_mode = None,
            (table::SET_OUTPUT_SETTINGS, &[a, b, c, d]) => {
                self.requested_settings = Some(u32::from_be_bytes([a, b, c, d]));
            }
            (table::SET_OUTPUT_SETTINGS, _) => self.requested_settings = None,
            (table::OUTPUT_MODE_ACK, &[a, b]) => return self.set(Some(u16::from_be_bytes([a, b])), self.settings),
            (table::OUTPUT_MODE_ACK, &[]) => return self.set(self.requested_mode, self.settings),
            (table::OUTPUT_SETTINGS_ACK, &[a, b, c, d]) => {
                return self.set(self.mode, Some(u32::from_be_bytes([a, b, c, d])));
            }
            (table::OUTPUT_SETTINGS_ACK, &[]) => return self.set(self.mode, self.requested_settings),
            _ => {}
        }
        false
    }
}

impl MessageLayout {
    /// Whether a payload has this layout. An empty one is no sample.
    #[must_use]
    pub const fn fits(&self, payload: &[u8]) -> bool {
        self.size == payload.len() && self.size > 0
    }

    /// The layout of the messages of an Xbus Master: its counter, then the items of each tracker. `None` if no source
    /// gives the layout of a tracker.
    fn of_trackers(outputs: &[Output]) -> Option<Self> {
        let counter = Output { mode: 0, settings: table::output_settings::COUNTER }.items().ok()?;
        let mut size = counter[0].size;
        let mut samples = vec![];
        for (output, bid) in outputs.iter().zip(1..) {
            let items = output.items().ok()?;
            let length = items.last().map_or(0, |item| item.at + item.size);
            // A tracker that is set to send a counter fills its place, but the counter of the message is the first one.
            let own = items.into_iter().filter(|item| item.id != counter[0].id);
            let shifted = own.map(|item| Item { at: size + item.at, ..item });
            samples.push((bid, counter.iter().copied().chain(shifted).collect()));
            size += length;
        }
        Some(Self { size, samples })
    }
}
