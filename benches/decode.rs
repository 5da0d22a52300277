//! Measures bytes to columns, relative to `memcpy` of the same bytes: `cargo bench --bench decode`.
//!
//! Each stream is decoded as a whole into fresh columns, by the fast and by the plain path. Before the measurement the two
//! are compared on a part of the stream, and each run checks its number of samples. The last two columns are the time that
//! unwrapping the sample times and packet counters takes, relative to decoding, by the fast and by the plain path; the two
//! are compared on the whole stream. At most 0.25 must be reached, 0.15 is the goal.

#![allow(clippy::print_stdout, clippy::type_complexity, clippy::cast_possible_truncation)] // the bench prints its results

mod common;

use std::hint::black_box;

use xbus::clock::Clocks;
use xbus::log::{Options, Part, Reader, Times};
use xbus::scan::Window;

fn read(bytes: &[u8], fast: bool) -> Part {
    let mut reader = Reader::new(Options { fast, ..Options::default() }, bytes.len() as u64);
    reader.read(Window { bytes, offset: 0, last: true }, u64::MAX).unwrap();
    reader.take()
}

fn main() {
    let megabytes = std::env::var("XBUS_BENCH_MIB").ok().and_then(|text| text.parse().ok()).unwrap_or(256);
    let rounds = std::env::var("XBUS_BENCH_ROUNDS").ok().and_then(|text| text.parse().ok()).unwrap_or(9);
    let size: usize = megabytes << 20;
    let streams: [(&str, fn(usize) -> Vec<u8>, usize, f64, f64); 5] = [
        ("ahrs", common::ahrs, 88, 0.28, 0.38),
        ("hr", common::hr, 27, 0.14, 0.22),
        ("hr, both vectors", common::hr_mixed, 27, 0.14, 0.22),
        ("gnssins", common::gnssins, 152, 0.22, 0.32),
        ("dirty", common::dirty, 88, 0.18, 0.27),
    ];
    println!(
        "{:<18}{:>10}{:>10}{:>10}{:>10}   x memcpy, {megabytes} MiB, fresh columns{:>10}{:>10}   x decoding",
        "", "fast", "plain", "must", "goal", "unwrap", "plainly"
    );
    let chosen: Vec<String> = std::env::args().skip(1).filter(|argument| !argument.starts_with('-')).collect();
    for (name, make, frame, must, goal) in streams {
        if !chosen.is_empty() && !chosen.iter().any(|argument| argument == name) {
            continue;
        }
        let bytes = make(size / frame);
        let (fast, plain) = (read(&bytes, true), read(&bytes[..bytes.len() / 16], false));
        assert!(fast.len() > size / frame * 3 / 4);
        for (fast, plain) in fast.columns.iter().zip(&plain.columns) {
            let (fast, plain) = (first(fast), first(plain));
            let common = fast.len().min(plain.len());
            assert!(common == plain.len() && fast[..common] == plain[..common], "{name}");
        }
        let samples = fast.len();
        drop(fast);
        let ratio = common::against_memcpy(&bytes, rounds, || {
            let part = black_box(read(black_box(&bytes), true));
            assert_eq!(part.len(), samples);
        });
        let sixteenth = &bytes[..bytes.len() / 16];
        let slow = common::against_memcpy(sixteenth, 5, || {
            black_box(read(black_box(sixteenth), false));
        });
        print!("{name:<18}{ratio:>10.3}{slow:>10.3}{must:>10.2}{goal:>10.2}{:>41}", "");
        let [fast, plain] = [Part::unwrap, Part::unwrap_plainly].map(|unwrap| unwrapping(&bytes, rounds, unwrap));
        println!("{fast:>10.3}{plain:>10.3}");
    }
}

/// The time of unwrapping times and counters, relative to decoding.
fn unwrapping(bytes: &[u8], rounds: usize, unwrap: fn(&Part, &mut Clocks) -> Times) -> f64 {
    let part = read(bytes, true);
    let (mut clocks, mut plain) = (Clocks::default(), Clocks::default());
    let (times, expected) = (unwrap(&part, &mut clocks), part.unwrap_plainly(&mut plain));
    assert!(times.time.iter().map(|time| time.to_bits()).eq(expected.time.iter().map(|time| time.to_bits())));
    assert!(times.counter == expected.counter && times.gaps == expected.gaps && clocks == plain);
    drop((times, expected));
    let decode = || drop(black_box(read(black_box(bytes), true)));
    common::ratio(rounds, || drop(black_box(unwrap(black_box(&part), &mut Clocks::default()))), decode)
}

/// The first rows of a column, for comparison.
fn first(column: &xbus::column::Column) -> Vec<f64> {
    use xbus::column::Values;
    match &column.values {
        Values::F32(values) => values.iter().take(1000).copied().map(f64::from).collect(),
        Values::F64(values) => values.iter().take(1000).copied().collect(),
        Values::U16(values) => values.iter().take(1000).copied().map(f64::from).collect(),
        Values::U32(values) => values.iter().take(1000).copied().map(f64::from).collect(),
        Values::Records(values) => values.iter().take(1000).copied().map(f64::from).collect(),
        _ => vec![],
    }
}
