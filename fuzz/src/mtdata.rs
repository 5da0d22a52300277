//! MTData by hand: the settings in force, and streams of messages that fit them or not.

use std::collections::HashMap;

use xbus::mtdata::{Item, Output};
use xbus::table::{self, MTDATA_ITEMS};

use super::streams::{Random, Recipe, frame, frame_of};

/// The settings in force, by the bytes of the messages.
#[derive(Default)]
pub struct InForce {
    modes: HashMap<u8, u16>,
    settings: HashMap<u8, u32>,
    requests: HashMap<(u8, u8), Vec<u8>>,
    /// Trackers of an Xbus Master; 0 without one.
    pub trackers: u8,
}

/// The bus identifier of the device of a sample, and its items.
type Sample = (u8, Vec<Item>);

impl InForce {
    /// Takes note of a message.
    pub fn learn(&mut self, bid: u8, mid: u8, payload: &[u8]) {
        let device = if bid == 0xFF { 1 } else { bid };
        match (mid, payload.len()) {
            (0x0D, 118..) => self.configure(bid, payload),
            (0xD0 | 0xD2, _) => {
                self.requests.insert((device, mid), payload.to_vec());
            }
            (0xD1, 2) => self.set(device, 0xD0, payload),
            (0xD3, 4) => self.set(device, 0xD2, payload),
            (0xD1 | 0xD3, 0) => {
                if let Some(request) = self.requests.remove(&(device, mid - 1)) {
                    self.set(device, mid - 1, &request);
                }
            }
            _ => {}
        }
    }

    fn set(&mut self, device: u8, mid: u8, value: &[u8]) {
        match (mid, value) {
            (0xD0, &[a, b]) => drop(self.modes.insert(device, u16::from_be_bytes([a, b]))),
            (0xD2, &[a, b, c, d]) => drop(self.settings.insert(device, u32::from_be_bytes([a, b, c, d]))),
            _ => {}
        }
    }

    fn configure(&mut self, bid: u8, payload: &[u8]) {
        let count = usize::from(u16::from_be_bytes([payload[96], payload[97]])).min(31);
        let entries: Vec<_> = payload[98..].chunks_exact(20).take(count).collect();
        let master = &payload[..4];
        if master[0] >= 0x80 || master == [0; 4] || entries.iter().all(|entry| entry[4..6] == [0, 0]) {
            return;
        }
        let is_master = bid == 0xFF && (entries.len() > 1 || master[1] >> 4 == 1);
        if bid == 0xFF {
            self.trackers = if is_master { u8::try_from(entries.len()).expect("at most 31") } else { 0 };
        }
        for (entry, tracker) in entries.iter().zip(1..) {
            let device = if is_master { tracker } else { [bid, 1][usize::from(bid == 0xFF)] };
            self.set(device, 0xD0, &entry[6..8]);
            self.set(device, 0xD2, &entry[8..12]);
            self.requests.retain(|(of, _), _| *of != device);
        }
    }

    /// Bytes of a message of this device and its samples, if its settings are known.
    pub fn layout(&self, bid: u8) -> Option<(usize, Vec<Sample>)> {
        let output =
            |device: u8| Some(Output { mode: *self.modes.get(&device)?, settings: *self.settings.get(&device)? });
        if bid != 0xFF || self.trackers == 0 {
            let output = output(if bid == 0xFF { 1 } else { bid })?;
            return Some((output.size().ok()?, vec![(bid, output.items().ok()?)]));
        }
        let counter = Output { mode: 0, settings: 1 }.items().expect("a layout")[0];
        let (mut at, mut samples) = (2, vec![]);
        for tracker in 1..=self.trackers {
            let output = output(tracker)?;
            let mut items = output.items().ok()?;
            items.retain(|item| item.reading.quantity.name != "packet_counter");
            items.iter_mut().for_each(|item| item.at += at);
            items.insert(0, counter);
            at += output.size().ok()?;
            samples.push((tracker, items));
        }
        Some((at, samples))
    }
}

/// Messages of a device that sends MTData: settings, and messages with some of the lengths that these give.
pub fn stream(recipe: &mut Recipe<'_>, random: &mut Random) -> Vec<u8> {
    let mut stream = vec![];
    let bid = [0xFF, 0xFF, 0xFF, 1, 2, 3][recipe.below(6)];
    let trackers = [1, 1, 1, 2, 3, 31][recipe.below(6)];
    let mut outputs: Vec<_> = (0..trackers).map(|_| output(recipe)).collect();
    for _ in 0..=recipe.below(4) {
        let changed = recipe.below(outputs.len());
        outputs[changed] = output(recipe);
        let (mode, settings) = (outputs[changed].mode.to_be_bytes(), outputs[changed].settings.to_be_bytes());
        let device = if trackers > 1 { u8::try_from(changed).expect("few") + 1 } else { bid };
        match recipe.below(4) {
            0 => stream.extend(frame_of(bid, 0x0D, &configuration(&outputs, recipe))),
            1 => {
                stream.extend(frame_of(device, 0xD1, &mode));
                stream.extend(frame_of(device, 0xD3, &settings));
            }
            2 => {
                let acknowledged = recipe.below(4) > 0;
                for (mid, data) in [(0xD0, &mode[..]), (0xD2, &settings)] {
                    stream.extend(frame_of(device, mid, data));
                    stream.extend(if acknowledged { frame_of(device, mid + 1, &[]) } else { frame(0x42, &[3]) });
                }
            }
            _ => {} // settings that the stream does not have
        }
        let sizes: usize = outputs.iter().map(|output| output.size().unwrap_or(7)).sum();
        let size = if trackers > 1 { sizes + 2 } else { sizes };
        for _ in 0..recipe.below(60) {
            let length = if random.once_in(20) { random.below(60) } else { size };
            stream.extend(frame_of(bid, table::MTDATA, &random.data(length)));
        }
    }
    stream
}

fn output(recipe: &mut Recipe<'_>) -> Output {
    let modes = [0x0006, 0x0004, 0x4000, 0x1836, 0x0001, 0x0008, 0x0200, 0x0804];
    let bits = [0, 1, 2, 0x8000_0000, 4, 8, 0x80, 0x0200_0000];
    let mut output = Output { mode: modes[recipe.below(8)], settings: bits[recipe.below(8)] | 1 };
    output.settings |= u32::try_from(recipe.below(4)).expect("two bits") << 8;
    if recipe.below(8) == 0 {
        let row = &MTDATA_ITEMS[recipe.below(MTDATA_ITEMS.len())];
        output.mode |= row.mode;
        output.settings |= row.value | u32::from(recipe.byte()) << 16;
    }
    output
}

fn configuration(outputs: &[Output], recipe: &mut Recipe<'_>) -> Vec<u8> {
    let mut payload = vec![0; 98 + 20 * outputs.len()];
    payload[..4].copy_from_slice(&[[0x01, 0x50, 6, 0x18], [0x01, 0x10, 0, 1], [0x80; 4]][recipe.below(3)]);
    payload[97] = u8::try_from(outputs.len()).expect("at most 31");
    let is_new = recipe.below(5) == 0;
    for (output, entry) in outputs.iter().zip(payload[98..].chunks_exact_mut(20)) {
        let size = if is_new { 0 } else { u16::try_from(output.size().unwrap_or(1)).expect("short") };
        entry[4..6].copy_from_slice(&size.to_be_bytes());
        entry[6..8].copy_from_slice(&output.mode.to_be_bytes());
        entry[8..12].copy_from_slice(&output.settings.to_be_bytes());
    }
    payload
}
