//! The seeds of the corpus: `tests/corpus.rs` keeps `corpus/<target>/seed-*` equal to them.

use xbus::frame::{MASTER, PREAMBLE};
use xbus::table;

use super::streams::{Random, extended, frame, frame_of, packet, sample};

/// Names and bytes of the seeds of a target.
pub fn seeds(target: &str) -> Vec<(String, Vec<u8>)> {
    let streams = [
        ("sound", sound()),
        ("damaged", damaged()),
        ("hostile", hostile()),
        ("odd", odd()),
        ("layouts", layouts()),
        ("packets", packets()),
        ("gaps", gaps()),
        ("triggers", triggers()),
    ];
    // After an even seed of the random choices the rest is a stream, after an odd seed it is a recipe.
    let streams =
        streams.into_iter().map(|(name, stream)| (format!("seed-{name}"), [&[1, 2, 4], &stream[..]].concat()));
    let salt = target.bytes().fold(0_u64, |salt, byte| salt << 5 ^ u64::from(byte));
    let recipes = (0..4).map(|i| {
        let mut recipe = Random::new(salt + i).noise(40 + 20 * usize::try_from(i).expect("small"));
        recipe[2] |= 1;
        (format!("seed-recipe-{i}"), recipe)
    });
    streams.chain(recipes).collect()
}

/// A device starts, sends its identity, and measures.
fn sound() -> Vec<u8> {
    let start = [frame(0x3E, &[]), frame(0x01, &[0x03, 0x60, 0x08, 0xA6]), frame(0x11, &[])];
    start.into_iter().chain((0..6).map(inertial)).collect::<Vec<_>>().concat()
}

fn inertial(i: u8) -> Vec<u8> {
    let (counter, time, acceleration) = ([0, i], [0, 0, i, 100], [0x41, i, 0, 0].repeat(3));
    sample(&[(0x1020, &counter), (0x1060, &time), (0x4020, &acceleration), (0xE020, &[0, 0, 0, 3])])
}

/// The same with a flipped bit, a lost byte, an additional byte, and without its end.
fn damaged() -> Vec<u8> {
    let mut stream = sound();
    stream[30] ^= 0x10;
    stream.remove(80);
    stream.insert(120, 0xAA);
    stream.truncate(stream.len() - 3);
    stream
}

/// Headers that announce more bytes than follow.
fn hostile() -> Vec<u8> {
    let claim = [PREAMBLE, MASTER, table::MTDATA2, 0xFF, 0x01, 0x00, 0xF0, 0x00, 0x00];
    [&[PREAMBLE; 20][..], &claim.repeat(8), &inertial(1), &[PREAMBLE, MASTER, 0x31, 0xFF, 0x02]].concat()
}

/// Unknown and malformed messages, in step.
fn odd() -> Vec<u8> {
    let odd = [
        frame(0x08, &[1, 2, 3]),
        frame_of(0x77, 0x31, &[]),
        frame(0x30, &[]),
        frame(table::MTDATA2, &[]),
        frame(table::MTDATA2, &[0x10, 0x20, 9, 0]),
        sample(&[(0x4020, &[0; 5]), (0x201C, &[0; 16])]),
        sample(&[(0xF000, &[1, 2, 3]), (0xF000, &[])]),
        extended(1, table::MTDATA2, &packet(0x1020, &[0, 1])),
        frame(0x92, &[7; 300]),
    ];
    odd.concat()
}

/// Three layouts in turns, often enough to be learned: lists of two lengths, unused format bits, a packet that occurs twice.
fn layouts() -> Vec<u8> {
    let list = |count: u8| [&[0, 0, 0, 1, count, 0, 0, 0], &[7; 4].repeat(count.into())[..]].concat();
    let turn = |i: u8| {
        let turn = [
            inertial(i),
            sample(&[(0x7020, &list(i % 2)), (0x3010, &[0, 1, 0x86, i])]),
            sample(&[(0x3013, &[0, 1, 0x87, i]), (0x1020, &[1, i]), (0x1020, &[2, i])]),
        ];
        turn.concat()
    };
    (0..12).map(turn).collect::<Vec<_>>().concat()
}

/// Frames at even distances, and fewer bytes after the last: a reader once lost a row there.
fn gaps() -> Vec<u8> {
    let one = [vec![0; 50], inertial(3)].concat();
    [one.repeat(5), vec![0; 10], inertial(4).repeat(3), inertial(5), vec![0; 40]].concat()
}

/// Two triggers in one sample, then one: a reader once read the second from the wrong row.
fn triggers() -> Vec<u8> {
    let stamp = |i: u8| [9, 1, 0, 0, i, 0, 0, 0];
    let both = |i| sample(&[(0x4810, &stamp(i)), (0x4820, &stamp(i + 1)), (0x1020, &[0, i])]);
    let first = |i| sample(&[(0x4810, &stamp(i)), (0x1060, &[0, 0, i, 0])]);
    (0..5).flat_map(|i| [both(10 * i), first(10 * i + 5)].concat()).collect()
}

/// Packets without frames: one in each precision, a record, a list.
fn packets() -> Vec<u8> {
    let packets = [
        packet(0x0810, &[0x41, 0xDB, 0x80, 0x00]),
        packet(0x0811, &[0xFF, 0xF0, 0x47, 0x35]),
        packet(0x0812, &[0x60, 0, 0, 0, 0, 0x18]),
        packet(0x0813, &[0x7F, 0xF4, 0, 0, 0, 0, 0, 1]),
        packet(0x2014, &[0x3F; 16]),
        packet(0x1010, &[0x2C, 0xA8, 0x4D, 0x3C, 0x07, 0xE9, 7, 13, 9, 21, 34, 0]),
        packet(0x7020, &[0, 0, 0, 1, 1, 0, 0, 0, 0, 5, 22, 20]),
        packet(0xE080, &[0, 0, 0, 0, 0x80, 0, 0x40, 0xD2]),
    ];
    packets.concat()
}
