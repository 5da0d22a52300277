//! What the benches share: the streams, and the comparison with `memcpy`.
//!
//! Every figure is relative to `memcpy` of the same bytes into memory that is already mapped. The two are measured in turns
//! in one run, so that a busy machine slows both.

#![allow(dead_code)] // each bench uses a part
#![allow(clippy::cast_possible_truncation, clippy::cast_possible_wrap, clippy::cast_precision_loss)] // synthetic numbers

use std::hint::black_box;
use std::time::Instant;

use xbus::frame::Frame;
use xbus::packet::{Coordinates, Precision};
use xbus::table;
use xbus::value::{Number, write_packet};

/// A small random number generator (xorshift), the same on every machine.
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    pub fn below(&mut self, limit: u64) -> u64 {
        self.next() % limit
    }

    pub fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64 - 0.5
    }

    pub fn chance(&mut self, p: f64) -> bool {
        self.unit() + 0.5 < p
    }
}

pub struct Sample {
    payload: Vec<u8>,
}

impl Sample {
    pub fn new() -> Self {
        Self { payload: vec![] }
    }

    pub fn integers(mut self, name: &str, values: &[i64]) -> Self {
        let numbers: Vec<_> = values.iter().map(|value| Number::Integer(*value)).collect();
        write_packet(&mut self.payload, table::quantity_named(name).unwrap(), None, None, &numbers).unwrap();
        self
    }

    pub fn reals(mut self, name: &str, precision: Precision, values: &[f64]) -> Self {
        let quantity = table::quantity_named(name).unwrap();
        let numbers: Vec<_> = values.iter().map(|value| Number::Double(*value)).collect();
        let coordinates = quantity.rotates.then_some(Coordinates::Enu);
        write_packet(&mut self.payload, quantity, Some(precision), coordinates, &numbers).unwrap();
        self
    }

    pub fn frame(self) -> Vec<u8> {
        Frame { bid: 0xFF, mid: table::MTDATA2, payload: &self.payload }.encode().unwrap()
    }
}

fn ahrs_sample(i: i64, random: &mut Random) -> Sample {
    use Precision::Float32;
    let mut real = |_| random.unit();
    Sample::new()
        .integers("packet_counter", &[i & 0xFFFF])
        .integers("sample_time_fine", &[i * 100])
        .reals("quaternion", Float32, &[0.5; 4].map(&mut real))
        .reals("acceleration", Float32, &[0.5; 3].map(&mut real))
        .reals("rate_of_turn", Float32, &[0.5; 3].map(&mut real))
        .reals("magnetic_field", Float32, &[0.5; 3].map(&mut real))
}

/// Counter, time, orientation, inertial and magnetic vectors, status: 88-byte frames.
pub fn ahrs(n: usize) -> Vec<u8> {
    let mut random = Random(1);
    (0..n as i64).flat_map(|i| ahrs_sample(i, &mut random).integers("status_word", &[3]).frame()).collect()
}

/// Time and one high-rate vector: 27-byte frames.
pub fn hr(n: usize) -> Vec<u8> {
    let mut random = Random(2);
    let mut frame = |i: i64| {
        let vector = [0.5; 3].map(|_| random.unit());
        let sample = Sample::new().integers("sample_time_fine", &[i * 5]);
        sample.reals("acceleration_hr", Precision::Float32, &vector).frame()
    };
    (0..n as i64).flat_map(&mut frame).collect()
}

/// The same with both high-rate vectors, in no regular order.
pub fn hr_mixed(n: usize) -> Vec<u8> {
    let mut random = Random(2);
    let mut frame = |i: i64| {
        let vector = [0.5; 3].map(|_| random.unit());
        let name = if random.chance(0.44) { "rate_of_turn_hr" } else { "acceleration_hr" };
        Sample::new().integers("sample_time_fine", &[i * 5]).reals(name, Precision::Float32, &vector).frame()
    };
    (0..n as i64).flat_map(&mut frame).collect()
}

/// `ahrs` with position, velocity and UTC, and the receiver's own solution in every 25th message.
pub fn gnssins(n: usize) -> Vec<u8> {
    use Precision::Fp1632;
    let mut random = Random(3);
    let mut frame = |i: i64| {
        let utc = [i % 1_000_000_000, 2026, 11, 22, 12, i / 6000 % 60, i / 100 % 60, 7];
        let mut sample = ahrs_sample(i, &mut random)
            .integers("utc_time", &utc)
            .reals("lat_lon", Fp1632, &[52.24 + random.unit() / 1e3, 6.84 + random.unit() / 1e3])
            .reals("altitude_ellipsoid", Fp1632, &[80.0 + random.unit()])
            .reals("velocity_xyz", Fp1632, &[0.5; 3].map(|_| random.unit()));
        if i % 25 == 0 {
            let pvt: Vec<i64> = (0..35).map(|field| (i + field) & 0x7F).collect();
            sample = sample.integers("gnss_pvt_data", &pvt);
        }
        sample.integers("status_word", &[0x0180_0007]).frame()
    };
    (0..n as i64).flat_map(&mut frame).collect()
}

/// `ahrs` with 0.1 % of the bytes flipped, 0.1 % dropped, and bursts of garbage that are rich in preambles.
pub fn dirty(n: usize) -> Vec<u8> {
    let mut random = Random(4);
    let mut out = vec![];
    for byte in ahrs(n) {
        if random.chance(1e-4) {
            let length = random.below(32);
            out.extend((0..length).map(|_| if random.chance(0.25) { 0xFA } else { random.next() as u8 }));
        }
        if random.chance(1e-3) {
            out.push(byte ^ 1 << random.below(8));
        } else if !random.chance(1e-3) {
            out.push(byte);
        }
    }
    out
}

/// Returns the speed of `work` relative to `reference`: the median of the ratios of alternating runs, so that changes in
/// the speed of the machine affect both.
pub fn ratio(rounds: usize, mut reference: impl FnMut(), mut work: impl FnMut()) -> f64 {
    let time = |work: &mut dyn FnMut()| {
        let start = Instant::now();
        work();
        start.elapsed().as_secs_f64()
    };
    let _warm = (time(&mut reference), time(&mut work));
    let mut ratios: Vec<f64> = (0..rounds).map(|_| time(&mut reference) / time(&mut work)).collect();
    ratios.sort_by(f64::total_cmp);
    ratios[rounds / 2]
}

/// Returns the speed of `work` relative to a `memcpy` of `bytes`.
pub fn against_memcpy(bytes: &[u8], rounds: usize, work: impl FnMut()) -> f64 {
    let mut target = vec![1u8; bytes.len()];
    let copy = || {
        target.copy_from_slice(black_box(bytes));
        black_box(&mut target);
    };
    ratio(rounds, copy, work)
}
