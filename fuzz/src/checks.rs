//! The laws. Each function takes any bytes and panics if the law does not hold.

use std::io::{self, Read};

use xbus::clock::{Clocks, Gap, Restart};
use xbus::column::Column;
use xbus::error::Fault;
use xbus::input::ReadAt;
use xbus::log::{self, Blocks, Options, Part, Reader, Shape, TimedPart, Times};
use xbus::packet::{Coordinates, Packet, Precision, packets};
use xbus::scan::Window;
use xbus::table::{self, Kind, QUANTITIES};
use xbus::value::{Number, is_canonical, numbers, write_as, write_packet};

use super::logs::{Bits, ByHand, Log};
use super::scans::{Scan, credit_suffices};
use super::stamps;
use super::streams::{Input, Random, extended, packet, seed_of};

/// Payload limits: shorter than most messages, around the longest standard form, and those of a live port and a log.
const LIMITS: [usize; 6] = [16, 254, 255, 8185, 65535, 65535];

/// Chunking has no effect, and the scanner finds what the plain rules find.
pub fn chunking(data: &[u8]) {
    let Input { mut random, stream } = Input::of(data);
    let limit = random.pick(&LIMITS);
    scanning(&stream, limit, &mut random);
}

/// The same law for a given stream.
pub fn scanning(stream: &[u8], limit: usize, random: &mut Random) {
    let whole = Scan::whole(stream, limit);
    whole.covers(stream);
    for _ in 0..2 {
        assert_eq!(Scan::at_random(stream, limit, random), whole);
    }
    if stream.len() < 500 {
        assert_eq!(Scan::byte_by_byte(stream, limit), whole);
    }
    if credit_suffices(stream) {
        assert_eq!(whole, Scan::plainly(stream, limit));
    }
}

/// Any bytes are a log, and its contents are those that the plain reader finds.
pub fn decode(data: &[u8]) {
    let Input { mut random, stream } = Input::of(data);
    let limit = random.pick(&LIMITS);
    let ByHand { log, faults, .. } = ByHand::read(&stream, &Scan::whole(&stream, limit));
    for fast in [false, true] {
        let options = Options { limit, fast, ..Options::default() };
        Log::whole(&stream, options.clone()).same_as(&log, if fast { "fast, by hand" } else { "plain, by hand" });
        let strict = Options { strict: true, ..options };
        let found = Log::apart(&stream, strict, &mut random).err();
        assert_eq!(found.as_ref(), faults.first(), "fast: {fast}");
        check_sentence(found);
    }
}

/// The message of a fault contains its offset.
fn check_sentence(fault: Option<Fault>) {
    if let Some(fault) = fault {
        assert!(fault.to_string().contains(&fault.offset().to_string()));
    }
}

/// The fast path reads what the plain path reads, part by part: each part ends at the same byte.
pub fn fast_is_plain(data: &[u8]) {
    let Input { mut random, stream } = Input::of(data);
    let options = options(&mut random);
    let [mut fast, mut plain] =
        [true, false].map(|fast| Reader::new(Options { fast, ..options.clone() }, stream.len() as u64));
    let window = Window { bytes: &stream, offset: 0, last: true };
    let step = random.pick(&[300, 3000, 100_000]);
    while !plain.is_finished() {
        let until = plain.at() + 1 + random.below(step) as u64;
        fast.read(window, until).expect("not strict");
        plain.read(window, until).expect("not strict");
        assert_eq!(fast.at(), plain.at());
        let [fast, plain] = [&mut fast, &mut plain].map(|reader| Log::of(&reader.take(), &mut Clocks::default()));
        fast.same_as(&plain, "fast, plain");
    }
}

/// Joined parts are the whole, wherever they end.
pub fn parts(data: &[u8]) {
    let Input { mut random, stream } = Input::of(data);
    let options = options(&mut random);
    let whole = Log::whole(&stream, options.clone());
    for _ in 0..3 {
        let fast = options.fast != random.once_in(4);
        let joined = Log::apart(&stream, Options { fast, ..options.clone() }, &mut random).expect("not strict");
        joined.same_as(&whole, "joined, whole");
    }
}

/// Times and counters are the same sample by sample and in stretches, wherever parts end, and so are the clocks at the end.
pub fn unwrap(data: &[u8]) {
    let (seed, recipe) = seed_of(data);
    let mut random = Random::new(seed);
    let stream = stamps::stream(recipe, &mut random);
    let rate = random.pick(&[None, None, Some(100.0), Some(0.3)]);
    let window = Window { bytes: &stream, offset: 0, last: true };
    let start = |fast| (Reader::new(Options { fast, ..Options::default() }, 0), Clocks::new(rate));
    let (mut reader, mut plain) = start(true);
    reader.read(window, u64::MAX).expect("not strict");
    let whole = Timeline::of(reader.take().unwrap_plainly(&mut plain));
    if rate.is_none() && stream.len() < 20_000 {
        let ByHand { log, .. } = ByHand::read(&stream, &Scan::whole(&stream, usize::from(u16::MAX)));
        assert_eq!((&log.times, &log.counters), (&whole.times, &whole.counters), "by hand");
        assert_eq!((&log.gaps, &log.restarts), (&whole.gaps, &whole.restarts), "by hand");
    }
    for longest in [stream.len() + 1, random.pick(&[100, 3000, 100_000])] {
        let (mut reader, mut clocks) = start(!random.once_in(8));
        let mut joined = Timeline::default();
        while !reader.is_finished() {
            reader.read(window, reader.at() + 1 + random.below(longest) as u64).expect("not strict");
            joined.join(reader.take().unwrap(&mut clocks));
        }
        assert_eq!(joined, whole);
        assert_eq!(clocks, plain);
    }
}

/// The contents of [`Times`], with times as bits.
#[derive(Debug, Default, PartialEq)]
struct Timeline {
    times: Vec<Bits>,
    counters: Vec<i64>,
    gaps: Vec<Gap>,
    restarts: Vec<Restart>,
    has_counter: bool,
}

impl Timeline {
    fn of(times: Times) -> Self {
        let mut timeline = Self::default();
        timeline.join(times);
        timeline
    }

    fn join(&mut self, next: Times) {
        self.times.extend(next.time.iter().map(|time| Bits(time.to_bits())));
        self.counters.extend(next.counter);
        self.gaps.extend(next.gaps);
        self.restarts.extend(next.restarts);
        self.has_counter |= next.has_counter;
    }
}

/// Threads that read blocks of any size read what one thread reads.
pub fn parallel(data: &[u8]) {
    let Input { mut random, mut stream } = Input::of(data);
    if random.once_in(2) {
        stream = nested(&stream);
    }
    let options = options(&mut random);
    let whole = Log::whole(&stream, options.clone());
    for _ in 0..3 {
        let pieces = Pieces { bytes: &stream, most: random.pick(&[1, 60, 5000, usize::MAX]) };
        let input = if random.once_in(2) { log::Input::Copied(&pieces) } else { log::Input::Memory(&stream) };
        let blocks = Blocks { size: random.pick(&[1, 30, 300, 5000]), threads: 2 + random.below(3) };
        let mut reader = Reader::new(options.clone(), stream.len() as u64);
        let mut clocks = Clocks::default();
        let mut joined = Log::default();
        let step = random.pick(&[100, 5000, stream.len() + 1]);
        while !reader.is_finished() {
            let until = reader.at() + 1 + random.below(step) as u64;
            reader.read_parallel(input, until, blocks).expect("not strict");
            if random.once_in(2) || reader.is_finished() {
                joined.join(Log::of(&reader.take(), &mut clocks));
            }
        }
        joined.same_as(&whole, "parallel, whole");
    }
}

/// Bytes of which each read returns a few.
struct Pieces<'a> {
    bytes: &'a [u8],
    most: usize,
}

impl ReadAt for Pieces<'_> {
    fn size(&self) -> io::Result<u64> {
        Ok(self.bytes.len() as u64)
    }

    fn read_at(&self, buffer: &mut [u8], position: u64) -> io::Result<usize> {
        let from = self.bytes.len().min(usize::try_from(position).unwrap_or(usize::MAX));
        let most = buffer.len().min(self.most);
        (&self.bytes[from..]).read(&mut buffer[..most])
    }
}

/// A pass without values finds the shape of a log, which gives each part the columns of the whole log.
pub fn shape(data: &[u8]) {
    let Input { mut random, stream } = Input::of(data);
    let options = options(&mut random);
    let mut parts = |values| {
        let mut reader = Reader::new(Options { values, ..options.clone() }, stream.len() as u64);
        let step = random.pick(&[100, 5000, stream.len() + 1]);
        let mut clocks = Clocks::default();
        let mut parts = vec![];
        while !reader.is_finished() {
            let until = reader.at() + 1 + random.below(step) as u64;
            reader.read(Window { bytes: &stream, offset: 0, last: true }, until).expect("not strict");
            parts.push(TimedPart::take(&mut reader, &mut clocks));
        }
        parts
    };
    let mut shape = Shape::default();
    parts(false).iter().for_each(|part| shape.add(&part.part));
    let mut reader = Reader::new(options.clone(), stream.len() as u64);
    reader.read(Window { bytes: &stream, offset: 0, last: true }, u64::MAX).expect("not strict");
    let whole = reader.take();
    let columns = known_columns(&whole);
    assert_eq!(shape.samples(), whole.len() as u64);
    let mut bids = vec![];
    for part in parts(true) {
        let part = part.shaped(&shape).expect("a part of this log").part;
        let own = known_columns(&part);
        assert_eq!(own.len(), columns.len());
        for (index, (own, column)) in own.iter().zip(&columns).enumerate() {
            assert_eq!(own.subject, column.subject);
            assert!(own.has_type_of(column), "{own:?}, {column:?}");
            assert_eq!(part.is_dense_in_log(index), whole.is_dense(column), "{:?}", column.subject);
        }
        bids.extend(part.bids_of_several());
    }
    assert_eq!(bids.concat(), whole.bids_of_several().unwrap_or_default());
}

fn known_columns(part: &Part) -> Vec<&Column> {
    part.columns.iter().map(AsRef::as_ref).filter(|column: &&Column| column.quantity().is_some()).collect()
}

/// A stream in which a block can begin inside a message that has frames in it: the stream, as it is and as packets.
fn nested(stream: &[u8]) -> Vec<u8> {
    let messages = stream.chunks(3000).map(|piece| {
        let packets: Vec<_> = piece.chunks(250).flat_map(|data| packet(0xF1F0, data)).collect();
        [&extended(0xFF, table::MTDATA2, &packets)[..], piece].concat()
    });
    messages.collect::<Vec<_>>().concat()
}

/// Options with any limit and any choice of quantities.
fn options(random: &mut Random) -> Options {
    let wanted = random.once_in(3).then(|| {
        let some = |_| (&QUANTITIES[random.below(QUANTITIES.len())], random.pick(&[None, Some(Coordinates::Ned)]));
        (0..20).map(some).collect()
    });
    Options { limit: random.pick(&LIMITS), wanted, fast: !random.once_in(4), ..Options::default() }
}

/// Decoded packets are encoded to the same bytes if these are canonical. For any numbers the encoder writes a packet that
/// can be read, or nothing.
pub fn codec(data: &[u8]) {
    let Input { mut random, stream } = Input::of(data);
    for packet in packets(&stream).flatten() {
        rewrite(&packet);
    }
    // The same bytes as data of packets with valid sizes.
    let mut rest = &stream[..];
    while !rest.is_empty() {
        let quantity = random.pick(QUANTITIES);
        let id = quantity.id | u16::from(rest[0] & 0xF);
        let size =
            (1..=rest.len().min(255)).find(|&size| Packet { id, at: 0, data: &rest[..size] }.reading().is_some());
        let (data, behind) = rest.split_at(size.unwrap_or(1));
        rewrite(&Packet { id, at: 0, data });
        write_anything(data, &mut random);
        rest = behind;
    }
}

/// Decodes a packet and encodes it again.
pub fn rewrite(packet: &Packet<'_>) {
    let Some(reading) = packet.reading() else {
        assert!(!is_canonical(packet));
        return;
    };
    let values = numbers(&reading, packet.data);
    let mut payload = vec![0xAA];
    write_as(&mut payload, &reading, &values).expect("what was read can be written");
    let [0xAA, high, low, size, data @ ..] = &payload[..] else { panic!("no packet: {payload:?}") };
    assert_eq!(data, packet.data);
    assert_eq!(usize::from(*size), data.len());
    let id = u16::from_be_bytes([*high, *low]);
    assert_eq!(is_canonical(packet), id == packet.id);
    let again = Packet { id, at: 0, data };
    assert!(is_canonical(&again));
    let again = again.reading().expect("what was written can be read");
    assert_eq!((again.form, again.coordinates), (reading.form, reading.coordinates));
    assert_eq!(again.quantity.id, reading.quantity.id);
}

/// Encodes numbers made of `data`, valid and invalid ones.
fn write_anything(data: &[u8], random: &mut Random) {
    let quantity = random.pick(QUANTITIES);
    let some = |chunk: &[u8]| {
        let mut bytes = [0; 8];
        bytes[..chunk.len()].copy_from_slice(chunk);
        let bits = u64::from_be_bytes(bytes);
        match random.below(5) {
            0 => Number::Integer(bits.cast_signed()),
            1 => Number::Integer(i64::from(chunk[0])),
            2 => Number::Wide(bits),
            3 => Number::Single(f32::from_be_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])),
            _ => Number::Double(f64::from_bits(bits)),
        }
    };
    let mut values: Vec<Number> = data.chunks(8).map(some).collect();
    let expected = match quantity.kind {
        Kind::Real(n) | Kind::Fixed(_, n) => n,
        Kind::Id => 1,
        Kind::Struct(fields) => fields.len(),
        Kind::List(head, _) => head.len(),
    };
    if !random.once_in(4) {
        values.resize(expected, Number::Integer(1));
    }
    let precision = if matches!(quantity.kind, Kind::Real(_)) || random.once_in(9) {
        Some(random.pick(&Precision::ALL))
    } else {
        None
    };
    let coordinates = (quantity.rotates || random.once_in(9)).then(|| random.pick(&Coordinates::ALL));
    let mut payload = vec![0xAA];
    if let Err(error) = write_packet(&mut payload, &quantity, precision, coordinates, &values) {
        assert_eq!(payload, [0xAA], "{error}");
        assert!(!error.to_string().is_empty());
        return;
    }
    let all: Vec<_> = packets(&payload[1..]).collect();
    let [Ok(packet)] = &all[..] else { panic!("{all:?}") };
    assert!(is_canonical(packet), "{} {values:?}: {packet:?}", quantity.name);
    rewrite(packet);
}
