//! Measures hostile input: `cargo bench --bench hostile`.
//!
//! For garbage, the time per byte at 8 MB must be at most 1.3 times that at 1 MB, and the speed at least a hundredth of
//! `memcpy`. Input with messages may take longer, but its time must be linear too. Both are asserted.

#![allow(clippy::print_stdout, clippy::type_complexity, clippy::cast_possible_truncation)] // the bench prints its results

mod common;

use std::hint::black_box;

use common::{Random, against_memcpy, ratio};
use xbus::frame::{Frame, sum};
use xbus::log::{Options, Part, Reader};
use xbus::scan::Window;

fn read(bytes: &[u8]) -> Part {
    let mut reader = Reader::new(Options::default(), bytes.len() as u64);
    reader.read(Window { bytes, offset: 0, last: true }, u64::MAX).unwrap();
    reader.take()
}

fn repeated(pattern: &[u8], size: usize) -> Vec<u8> {
    pattern.iter().copied().cycle().take(size).collect()
}

/// Headers of MTData2 messages that announce `length` bytes of payload.
fn claims(length: u16, size: usize) -> Vec<u8> {
    let [high, low] = length.to_be_bytes();
    repeated(&[0xFA, 0xFF, 0x36, 0xFF, high, low], size)
}

/// The same with a seventh byte that makes nearly every checksum right: only the packets show that candidates are false.
fn good_checksums(size: usize) -> Vec<u8> {
    let claimed = 7 * 9000 - 6 - 1; // a frame of 9000 whole patterns
    let [high, low] = u16::try_from(claimed).unwrap().to_be_bytes();
    let pattern = |last: u8| [0xFA, 0xFF, 0x36, 0xFF, high, low, last];
    let holds = |last: &u8| sum(&repeated(&pattern(*last), 7 * 9000)[1..]) == 0;
    repeated(&pattern((0..=255).find(holds).unwrap_or(0)), size)
}

/// Small sound messages, each before a false header that announces a long message.
fn sound_and_false(size: usize) -> Vec<u8> {
    let sound = Frame { bid: 0xFF, mid: 0x31, payload: &[] }.encode().unwrap();
    repeated(&[&sound[..], &[0xFA, 0xFF, 0xF3, 0xFF, 0xFF, 0xF0]].concat(), size)
}

/// Extended messages full of empty packets with unknown identifiers.
fn empty_packets(size: usize) -> Vec<u8> {
    let payload = repeated(&[0x77, 0x70, 0x00], 8184);
    repeated(&Frame { bid: 0xFF, mid: 0x36, payload: &payload }.encode().unwrap(), size)
}

/// Layouts with as many columns as fit, each often enough to be learned, and soon replaced by the next.
fn changing_layouts(size: usize) -> Vec<u8> {
    let layout = |number: u16| {
        let ids = (0..84u16).map(|packet| 0x0100 + number * 84 + packet);
        let payload: Vec<u8> = ids.flat_map(|id| [(id >> 8) as u8, id as u8, 0]).collect();
        Frame { bid: 0xFF, mid: 0x36, payload: &payload }.encode().unwrap().repeat(4)
    };
    let period: Vec<u8> = (0..60).flat_map(layout).collect();
    repeated(&period, size)
}

fn noise(size: usize) -> Vec<u8> {
    let mut random = Random(9);
    (0..size).map(|_| if random.chance(0.2) { 0xFA } else { random.next() as u8 }).collect()
}

fn main() {
    // Name, input, and whether all of it must be skipped.
    let inputs: [(&str, fn(usize) -> Vec<u8>, bool); 15] = [
        ("FA only", |size| repeated(&[0xFA], size), true),
        ("FA FF 36 FF FF FF", |size| claims(0xFFFF, size), true),
        ("claims of 8185 bytes", |size| claims(8185, size), true),
        ("claims of 65535, odd BID", |size| repeated(&[0xFA, 0x40, 0x36, 0xFF, 0xFF, 0xFF], size), true),
        ("zeros", |size| vec![0; size], true),
        ("strings of one letter", |size| repeated(b"$A", size), true),
        ("strings without an end", |size| repeated(&[b"$", &[b'A'; 300][..]].concat(), size), true),
        ("strings, checksum wrong", |size| repeated(b"$HEHDT,123.45,T*1F\r\n", size), true),
        ("masks cut at their end", |size| repeated(b":12345  0000H 0123 -0456F", size), true),
        ("strings", |size| repeated(b"$A*41\n", size), false),
        ("good checksums", good_checksums, false),
        ("sound and false in turn", sound_and_false, false),
        ("empty packets", empty_packets, false),
        ("changing layouts", changing_layouts, false),
        ("noise", noise, false),
    ];
    println!("{:<26}{:>12}{:>22}", "", "x memcpy", "8 MB : 1 MB per byte");
    for (name, make, is_garbage) in inputs {
        let (large, small) = (make(8_000_000), make(1_000_000));
        let part = read(&large);
        assert_eq!(part.stats.bytes, 8_000_000);
        assert!(!is_garbage || part.stats.skipped_bytes == 8_000_000, "{name}");
        drop(part);
        let speed = against_memcpy(&large, 5, || {
            black_box(read(black_box(&large)));
        });
        let eight_small = || (0..8).for_each(|_| drop(black_box(read(black_box(&small)))));
        let growth = 1.0 / ratio(9, eight_small, || drop(black_box(read(black_box(&large)))));
        println!("{name:<26}{speed:>12.4}{growth:>22.2}");
        // With a message at every eleventh byte, storing the messages is most of the work.
        let (least, most) = if is_garbage { (1.0 / 100.0, 1.3) } else { (1.0 / 1000.0, 2.0) };
        assert!(speed > least, "{name} is read at {speed:.4} times memcpy");
        assert!(growth < most, "{name} costs {growth:.2} times as much per byte at 8 MB as at 1 MB");
    }
}
