//! Logs read on several threads equal logs read on one.

#[allow(dead_code)] // each test takes what it needs
#[path = "../fuzz/src/lib.rs"]
mod fuzz;

use std::fs::File;
use std::io::{self, Write};
use std::sync::atomic::{AtomicU64, Ordering};

use fuzz::logs::Log;
use fuzz::streams::{Random, extended, frame, packet, sample};
use xbus::catch::{Caught, catch, out_of_memory};
use xbus::clock::Clocks;
use xbus::column::Pieces;
use xbus::error::{Fault, ReadError};
use xbus::input::ReadAt;
use xbus::log::{Blocks, Input, Options, Part, Reader};
use xbus::scan::Reason;

fn parallel(input: Input<'_>, length: usize, options: &Options, blocks: Blocks) -> Result<Part, ReadError> {
    let mut reader = Reader::new(options.clone(), length as u64);
    while !reader.is_finished() {
        reader.read_parallel(input, reader.at() + length.max(1) as u64, blocks)?;
    }
    Ok(reader.take())
}

/// Reads a stream from memory and from a file, in blocks of several sizes, and compares with one thread.
fn check(stream: &[u8]) -> Log {
    let options = Options::default();
    let whole = Log::whole(stream, options.clone());
    let mut file = tempfile();
    file.write_all(stream).unwrap();
    for count in [2, 5, 40] {
        let size = stream.len() as u64 / count + 1;
        for threads in [1, 2, 3] {
            let blocks = Blocks { size, threads };
            for input in [Input::Memory(stream), Input::Copied(&file)] {
                let part = parallel(input, stream.len(), &options, blocks).unwrap();
                let log = Log::of(&part, &mut Clocks::default());
                log.same_as(&whole, &format!("blocks of {size}, {threads} threads"));
            }
        }
    }
    whole
}

/// A file without a name.
fn tempfile() -> File {
    let path =
        std::env::temp_dir().join(format!("xbus-parallel-{}-{:?}", std::process::id(), std::thread::current().id()));
    let file = File::options().read(true).write(true).create_new(true).open(&path).unwrap();
    std::fs::remove_file(path).unwrap();
    file
}

fn inertial(i: u16) -> Vec<u8> {
    let time = (u32::from(i) * 100).to_be_bytes();
    sample(&[(0x1020, &i.to_be_bytes()), (0x1060, &time), (0x4020, &[i.to_be_bytes()[1]; 12])])
}

#[test]
fn sound_logs() {
    let stream: Vec<u8> = [frame(0x3E, &[]), frame(0x01, &[0x03, 0x60, 0x08, 0xA6])]
        .into_iter()
        .chain((0..3000).map(inertial))
        .flatten()
        .collect();
    let log = check(&stream);
    assert_eq!((log.stats.samples, log.stats.messages, log.stats.skipped_bytes), (3000, 2, 0));
    check(&[]);
    check(&inertial(1));
    check(&inertial(1)[..9]);
}

/// New columns, wider columns, other layouts and a restart in later blocks.
#[test]
fn logs_that_change() {
    let stream: Vec<u8> = (0..2000_u16)
        .flat_map(|i| match i % 1000 {
            400 => frame(0x3E, &[]),
            500..600 => sample(&[(0x1020, &(i - 500).to_be_bytes()), (0x4023, &[0x40; 24])]),
            700..720 => {
                sample(&[(0x2030, &[0x41; 12]), (0xF123, &[1; 9]), (0x8020, &[0x42; 12]), (0x8020, &[0x43; 12])])
            }
            990..995 => b"$GPHDT,12.3,T*0F\r\n".to_vec(),
            _ => inertial(i),
        })
        .collect();
    let log = check(&stream);
    assert_eq!(log.column("acceleration").numbers, "f8");
    assert_eq!(log.restarts.len(), 2);
}

/// More layouts than a part can have numbers for.
#[test]
fn logs_with_many_layouts() {
    let layout = |i: u16| sample(&[(0xF000 + i % 100 * 16, &vec![1; usize::from(i % 77)]), (0x1020, &i.to_be_bytes())]);
    let stream: Vec<u8> = (0..4000).flat_map(|i: u16| std::iter::repeat_n(layout(i / 8), 8).flatten()).collect();
    let log = check(&stream);
    assert!(log.columns.len() > 90);
}

/// A block that begins inside a message finds the frames in the message's data, which are none.
#[test]
fn frames_in_frames() {
    let inner: Vec<u8> = (0..7).flat_map(inertial).collect();
    let packets: Vec<u8> = std::iter::repeat_n(packet(0xF1F0, &inner[..220]), 200).flatten().collect();
    let stream = [extended(0xFF, 0x36, &packets), inertial(1)].concat().repeat(6);
    let log = check(&stream);
    assert_eq!((log.stats.samples, log.stats.skipped_bytes), (12, 0));
}

/// Ten bytes of EM1000 are a string only if the device has said before that it sends them.
#[test]
fn strings_that_a_message_enables() {
    let em1000 = [0, 0x90, 1, 0, 2, 0, 3, 0, 4, 0];
    let stream = [&inertial(0)[..], &em1000.repeat(300), &frame(0x8F, &[0, 0x20]), &em1000.repeat(300)].concat();
    let log = check(&stream);
    assert_eq!((log.stats.strings, log.stats.skipped_bytes), (300, 3000));
}

#[test]
fn damaged_and_hostile_logs() {
    let mut random = Random::new(7);
    let mut stream: Vec<u8> = (0..5000).flat_map(inertial).collect();
    for _ in 0..2000 {
        let at = random.below(stream.len());
        stream[at] ^= 1 << random.below(8);
    }
    assert!(check(&stream).damage.len() > 1000);
    check(&vec![0xFA; 50_000]);
    check(&[0xFA, 0xFF, 0x36, 0xFF, 0x20, 0x00, 0x10, 0x20, 0x00].repeat(5000));
}

/// A false header makes the buffer long, in which a long message begins. The next step has a new buffer, with fewer bytes
/// of the message than were seen already.
#[test]
fn long_messages_behind_a_false_header() {
    let packets: Vec<u8> = std::iter::repeat_n(packet(0x4020, &[1; 12]), 4000).flatten().collect();
    let false_header = [0xFA, 0xFF, 0x36, 0xFF, 0xFF, 0xFF];
    let stream = [&inertial(0)[..], &false_header, &[0; 16_000], &extended(0xFF, 0x36, &packets)].concat().repeat(2);
    let whole = Log::whole(&stream, Options::default());
    assert_eq!((whole.stats.samples, whole.stats.skipped_bytes), (4, 2 * 16_006));
    let mut file = tempfile();
    file.write_all(&stream).unwrap();
    let mut reader = Reader::new(Options::default(), 0);
    while !reader.is_finished() {
        reader.read_parallel(Input::Copied(&file), reader.at() + 1, Blocks { size: 10, threads: 2 }).unwrap();
    }
    Log::of(&reader.take(), &mut Clocks::default()).same_as(&whole, "single steps");
}

/// Threads stop at the same fault, with the same samples before it.
#[test]
fn strict_logs() {
    let mut stream: Vec<u8> = (0..3000).flat_map(inertial).collect();
    let place = 2500 * inertial(0).len();
    stream[place + 10] ^= 1;
    stream[place + 1000] ^= 1;
    let options = Options { strict: true, ..Options::default() };
    for threads in [1, 3] {
        let blocks = Blocks { size: 5000, threads };
        let mut reader = Reader::new(options.clone(), 0);
        let error = reader.read_parallel(Input::Memory(&stream), stream.len() as u64, blocks).unwrap_err();
        let ReadError::Fault(fault) = error else { panic!("{error}") };
        assert_eq!(fault, Fault::Damage { offset: place as u64, reason: Reason::Checksum });
        assert_eq!(reader.take().len(), 2500);
    }
}

/// Bytes whose reading ends like this from a position on.
struct Ending<'a> {
    bytes: &'a [u8],
    from: u64,
    end: fn(),
}

impl ReadAt for Ending<'_> {
    fn size(&self) -> io::Result<u64> {
        Ok(self.bytes.len() as u64)
    }

    fn read_at(&self, buffer: &mut [u8], position: u64) -> io::Result<usize> {
        if position >= self.from {
            (self.end)();
        }
        let rest = &self.bytes[self.bytes.len().min(usize::try_from(position).unwrap())..];
        let size = rest.len().min(buffer.len()).min(1000);
        buffer[..size].copy_from_slice(&rest[..size]);
        Ok(size)
    }
}

/// A panic in any thread ends the others, and reaches the caller as it is; so does a lack of memory.
#[test]
fn threads_that_end_early() {
    let stream: Vec<u8> = (0..2000).flat_map(inertial).collect();
    let ends: [(fn(), Caught); 2] =
        [(|| panic!("a fault"), Caught::Panic("a fault".into())), (|| out_of_memory(), Caught::OutOfMemory)];
    for threads in [1, 3] {
        for from in [0, 30_000, 60_000] {
            for (end, why) in &ends {
                let bytes = Ending { bytes: &stream, from, end: *end };
                let mut reader = Reader::new(Options::default(), 0);
                let blocks = Blocks { size: 5000, threads };
                let ended = catch(|| reader.read_parallel(Input::Copied(&bytes), stream.len() as u64, blocks));
                assert_eq!(ended.err().as_ref(), Some(why), "{threads} threads, from {from}");
            }
        }
    }
}

/// Bytes that are others each time they are read.
struct Changing<'a> {
    bytes: &'a [u8],
    reads: AtomicU64,
}

impl ReadAt for Changing<'_> {
    fn size(&self) -> io::Result<u64> {
        Ok(self.bytes.len() as u64)
    }

    fn read_at(&self, buffer: &mut [u8], position: u64) -> io::Result<usize> {
        let mut random = Random::new(self.reads.fetch_add(1, Ordering::Relaxed) + 1);
        // The input may also end earlier or later than a moment ago.
        let end = self.bytes.len() - random.below(3) * 1000;
        let rest = &self.bytes[end.min(usize::try_from(position).unwrap())..end];
        let size = rest.len().min(buffer.len());
        buffer[..size].copy_from_slice(&rest[..size]);
        (0..size / 200).for_each(|_| buffer[random.below(size)] ^= 1 << random.below(8));
        Ok(size)
    }
}

fn sizes(pieces: &Pieces) -> impl Iterator<Item = u64> {
    pieces.ends.iter().scan(0, |last, end| Some(end - std::mem::replace(last, *end)))
}

/// Whatever others write while they are read, each byte is in one frame, one string or damage.
#[test]
fn bytes_that_change() {
    let packets: Vec<u8> = std::iter::repeat_n(packet(0x4020, &[1; 12]), 1000).flatten().collect();
    let long = extended(0xFF, 0x36, &packets);
    let stream: Vec<u8> = (0..4000)
        .flat_map(|i| if i % 1000 == 999 { [long.clone(), inertial(i)].concat() } else { inertial(i) })
        .collect();
    for round in 0..20 {
        let bytes = Changing { bytes: &stream, reads: AtomicU64::new(round * 10_000) };
        for threads in [1, 2, 3] {
            let options = Options::default();
            let input = Input::Copied(&bytes);
            let part = parallel(input, stream.len(), &options, Blocks { size: 20_000, threads }).unwrap();
            let skipped: u64 = part.damage.iter().map(|damage| damage.length).sum();
            let samples: i64 = part.ends().iter().zip(part.offsets()).map(|(end, start)| end - start).sum();
            let messages: u64 = sizes(&part.messages.payload).map(|size| size + if size < 255 { 5 } else { 7 }).sum();
            let strings: u64 = sizes(&part.strings.bytes).sum();
            assert_eq!(part.stats.skipped_bytes, skipped);
            assert_eq!(samples.unsigned_abs() + messages + strings + skipped, part.stats.bytes);
            assert!(part.offsets().is_sorted());
        }
    }
}
