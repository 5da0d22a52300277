//! Streams of samples whose counters and clocks run as those of devices do, with everything that interrupts them.

use xbus::frame::MASTER;
use xbus::table;

use super::streams::{Random, Recipe, extended, frame_of, packet};

/// Most samples of a stream: several times the memory of the pace.
const LONGEST: usize = 12_000;
const DAY: u64 = 864_000_000;
const ALL: u64 = 1 << 32;

const COUNTER: usize = 1;
const FINE: usize = 2;
const COARSE: usize = 4;
/// Times of three triggers.
const TRIGGERS: [usize; 3] = [8, 16, 32];
const GNSS: usize = 64;

/// A device on the bus.
struct Device {
    bid: u8,
    counter: u64,
    /// Time in 0.1 ms, not wrapped.
    ticks: u64,
    /// Ticks from one sample to the next.
    step: u64,
    /// Whether steps vary.
    jitters: bool,
    /// Where the fine time wraps.
    wrap: u64,
    /// The stamps of its samples, as bits.
    stamps: usize,
}

impl Device {
    fn new(bid: u8) -> Self {
        Self { bid, counter: 0, ticks: 0, step: 100, jitters: false, wrap: ALL, stamps: COUNTER | FINE }
    }

    /// The packets of a sample with these stamps.
    fn packets(&self, stamps: usize) -> Vec<u8> {
        let has = |bit: usize| stamps & bit != 0;
        let low = |number: u64, bytes: usize| number.to_be_bytes()[8 - bytes..].to_vec();
        let mut payload = packet(0x0810, &[0; 4]);
        if has(COUNTER) {
            payload.extend(packet(0x1020, &low(self.counter, 2)));
        }
        if has(FINE) {
            payload.extend(packet(0x1060, &low(self.ticks % self.wrap, 4)));
        }
        if has(COARSE) {
            payload.extend(packet(0x1070, &low(self.ticks / 10_000, 4)));
        }
        for (bit, id) in TRIGGERS.into_iter().zip([0x4810, 0x4820, 0x4830]) {
            if has(bit) {
                payload.extend(packet(id, &[&[9, 1][..], &low(self.ticks * 100, 4), &[0, 0]].concat()));
            }
        }
        if has(GNSS) {
            payload.extend(packet(0x7010, &[0; 94]));
        }
        payload
    }

    fn sample(&mut self, random: &mut Random) -> Vec<u8> {
        self.counter += 1;
        self.ticks += if self.jitters { random.below(200) as u64 } else { self.step };
        frame_of(self.bid, table::MTDATA2, &self.packets(self.stamps))
    }
}

/// Makes a stream from a recipe.
pub fn stream(recipe: &[u8], random: &mut Random) -> Vec<u8> {
    let mut recipe = Recipe(recipe);
    let mut devices = [MASTER, 2, 3].map(Device::new);
    let (mut stream, mut samples, mut active) = (vec![], 0, 0);
    while !recipe.is_empty() && samples < LONGEST {
        let device = &mut devices[active];
        match recipe.below(22) {
            0..=4 => {
                let most = [1, 2, 3, 30, 33, 34, 100, 600, 2100, 4500][recipe.below(10)];
                (0..most).for_each(|_| stream.extend(device.sample(random)));
                samples += most;
            }
            5 => {
                let (several, most) = (1 + recipe.below(3), recipe.below(100));
                let turns =
                    |_| devices[..several].iter_mut().flat_map(|device| device.sample(random)).collect::<Vec<_>>();
                stream.extend((0..most).flat_map(turns));
                samples += most * several;
            }
            // Samples are lost, or the same ones come again.
            6 => device.counter += [1, 2, 255, 256, 32_767, 32_768, 40_000, 65_534, 65_535][recipe.below(9)],
            7..=8 => {
                let lost = [1, 3, 300, 40_000, 65_535, 65_536, 70_000, 131_072][recipe.below(8)];
                device.counter += lost;
                device.ticks += lost * device.step;
            }
            // The clock is set.
            9 => device.ticks += [1, 32_668, 32_768, 32_769, 40_000, DAY / 2, DAY, ALL / 2, ALL][recipe.below(9)],
            10 => device.ticks = device.ticks.saturating_sub([1, 100, 150, 10_100, 20_000, DAY][recipe.below(6)]),
            // Wraps are near.
            11 => device.ticks = device.wrap - 1 - recipe.below(100) as u64 * device.step.min(DAY / 100),
            12 => device.counter = 65_535 - recipe.below(100) as u64,
            13 => device.wrap = [DAY, ALL][recipe.below(2)],
            14 => device.step = [0, 1, 1, 5, 100, 100, 32_767, 32_768, 32_769, 100_000][recipe.below(10)],
            15 => device.jitters = recipe.below(2) == 1,
            // Other stamps from now on, or in one sample.
            16 => {
                let any = usize::from(recipe.byte());
                device.stamps = [COUNTER | FINE, COUNTER | FINE, COUNTER, FINE, 0, any][recipe.below(6)];
            }
            17 => {
                device.counter += 1;
                let payload = device.packets(usize::from(recipe.byte()));
                stream.extend(frame_of(device.bid, table::MTDATA2, &payload));
            }
            // Stamps twice, or a frame that no layout recognizes.
            18 => {
                let payload = [device.packets(COUNTER | FINE), device.packets(device.stamps)].concat();
                stream.extend(if recipe.below(2) == 0 {
                    frame_of(device.bid, table::MTDATA2, &payload)
                } else {
                    extended(device.bid, table::MTDATA2, &device.packets(device.stamps))
                });
            }
            // The device starts again, with a message or without, or is identified.
            19 => {
                if recipe.below(2) == 0 {
                    (device.counter, device.ticks) = (0, recipe.below(256) as u64);
                }
                let messages: [&[u8]; 4] = [&[], &[0x3E], &[0x11], &[0x41]];
                if let [mid] = messages[recipe.below(4)] {
                    stream.extend(frame_of(device.bid, *mid, &[]));
                }
            }
            20 => {
                let id: u32 = [0x0360_08A6, 0x8000_40D2][recipe.below(2)];
                stream.extend(frame_of(device.bid, table::DEVICE_ID, &id.to_be_bytes()));
                active = recipe.below(devices.len());
            }
            _ if !stream.is_empty() => {
                let at = stream.len() - 1 - recipe.below(stream.len().min(256));
                stream[at] ^= 1 << recipe.below(8);
            }
            _ => {}
        }
    }
    stream
}
