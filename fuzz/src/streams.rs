//! Streams: frames that are built explicitly, and arbitrary streams from a recipe.

use xbus::frame::{EXTENDED, Frame, MASTER, PREAMBLE, sum};
use xbus::packet::{Coordinates, PACKET_HEADER, Precision, record_size};
use xbus::table::{self, Direction, End, Kind, MESSAGES, QUANTITIES, Quantity};

use super::mtdata;

/// A small random number generator (xorshift), the same on every machine.
#[derive(Clone, Debug)]
pub struct Random(u64);

impl Random {
    /// Any seed is valid.
    pub fn new(seed: u64) -> Self {
        Self(seed ^ 0x9E37_79B9_7F4A_7C15)
    }

    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    /// A number below `limit`, which is not 0.
    #[allow(clippy::cast_possible_truncation)] // below a usize
    pub fn below(&mut self, limit: usize) -> usize {
        ((self.next() >> 16) % limit as u64) as usize
    }

    /// True once in `n` times.
    pub fn once_in(&mut self, n: usize) -> bool {
        self.below(n) == 0
    }

    /// A random element.
    pub fn pick<T: Copy>(&mut self, list: &[T]) -> T {
        list[self.below(list.len())]
    }

    fn byte(&mut self) -> u8 {
        self.next().to_be_bytes()[3]
    }

    /// Random bytes with more headers than chance gives.
    pub fn noise(&mut self, length: usize) -> Vec<u8> {
        (0..length)
            .map(|_| if self.once_in(6) { self.pick(&[PREAMBLE, MASTER, table::MTDATA2]) } else { self.byte() })
            .collect()
    }

    /// The data of a packet: mostly random, sometimes all zeros or ones.
    pub fn data(&mut self, length: usize) -> Vec<u8> {
        match self.below(8) {
            0 => vec![0; length],
            1 => vec![0xFF; length],
            _ => (0..length).map(|_| self.byte()).collect(),
        }
    }
}

/// A frame in its shortest form, from a stand-alone device.
pub fn frame(mid: u8, payload: &[u8]) -> Vec<u8> {
    frame_of(MASTER, mid, payload)
}

/// A frame in its shortest form.
pub fn frame_of(bid: u8, mid: u8, payload: &[u8]) -> Vec<u8> {
    Frame { bid, mid, payload }.encode().expect("a payload of at most 65535 bytes")
}

/// A frame in extended form, which readers accept for any length.
pub fn extended(bid: u8, mid: u8, payload: &[u8]) -> Vec<u8> {
    let [.., high, low] = payload.len().to_be_bytes();
    let mut bytes = vec![PREAMBLE, bid, mid, EXTENDED, high, low];
    bytes.extend(payload);
    bytes.push(sum(&bytes[1..]).wrapping_neg());
    bytes
}

/// One packet.
pub fn packet(id: u16, data: &[u8]) -> Vec<u8> {
    let [high, low] = id.to_be_bytes();
    let size = u8::try_from(data.len()).expect("data of at most 255 bytes");
    [&[high, low, size], data].concat()
}

/// An `MTData2` frame of these packets.
pub fn sample(packets: &[(u16, &[u8])]) -> Vec<u8> {
    let packets: Vec<_> = packets.iter().map(|&(id, data)| packet(id, data)).collect();
    frame(table::MTDATA2, &packets.concat())
}

/// The meaning of the fuzzer's bytes.
pub struct Input {
    /// The source of random choices: where the stream is cut, and how it is read.
    pub random: Random,
    /// The stream.
    pub stream: Vec<u8>,
}

impl Input {
    /// The first bytes are the seed of the choices. The rest is the stream, or a recipe for a stream.
    pub fn of(data: &[u8]) -> Self {
        let (seed, rest) = seed_of(data);
        let mut random = Random::new(seed);
        let longest = random.pick(&[600, 600, 600, 6000, 6000, 40_000]);
        let stream = if seed % 2 == 0 { rest.to_vec() } else { stream(rest, longest, &mut random) };
        Self { random, stream }
    }
}

/// Bytes of the seed. An odd one makes the rest a recipe.
pub const SEED: usize = 3;

/// The seed of the random choices, and the rest of the fuzzer's bytes.
pub fn seed_of(data: &[u8]) -> (u64, &[u8]) {
    let (seed, rest) = data.split_at(data.len().min(SEED));
    (seed.iter().fold(0, |seed, byte| seed << 8 | u64::from(*byte)), rest)
}

/// A recipe. Any bytes are a recipe: each step takes the bytes that it needs, and zeros follow the end.
pub struct Recipe<'a>(pub &'a [u8]);

impl Recipe<'_> {
    /// Whether all bytes are used.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The next byte.
    pub fn byte(&mut self) -> u8 {
        let Some((byte, rest)) = self.0.split_first() else { return 0 };
        self.0 = rest;
        *byte
    }

    /// A number below `limit`, which is not 0.
    pub fn below(&mut self, limit: usize) -> usize {
        usize::from(self.byte()) % limit
    }
}

/// The packets of a message, without their numbers.
type Layout = Vec<Shape>;

#[derive(Clone, Copy)]
struct Shape {
    id: u16,
    size: usize,
    /// Position of the count of entries of a list, and the count.
    count: Option<(usize, u8)>,
}

/// Makes a stream of about `longest` bytes from a recipe: sound frames of all kinds, recurring layouts, and every kind of
/// damage.
///
/// Frames that are wrong in one place find most faults, and random bytes hardly ever contain one.
pub fn stream(recipe: &[u8], longest: usize, random: &mut Random) -> Vec<u8> {
    let mut recipe = Recipe(recipe);
    let mut layouts: Vec<Layout> = vec![];
    let mut stream = vec![];
    while !recipe.is_empty() && stream.len() < longest {
        let step = recipe.byte();
        if step >= 252 {
            // MTData, with and without the settings that it needs.
            stream.extend(mtdata::stream(&mut recipe, random));
            continue;
        }
        match step % 21 {
            // A new layout, and the first message that has it.
            0..=3 => {
                let layout: Layout = (0..recipe.below(8)).map(|_| shape(&mut recipe)).collect();
                stream.extend(message(&layout, MASTER, random));
                layouts.push(layout);
            }
            // Messages of one layout that was used before, or of several in turns.
            4..=7 if !layouts.is_empty() => {
                let first = recipe.below(layouts.len());
                let among = 1 + recipe.below(layouts.len() - first).min(3);
                let bid = if recipe.below(6) == 0 { bid(&mut recipe) } else { MASTER };
                for i in 0..=recipe.below(80) {
                    stream.extend(message(&layouts[first + i % among], bid, random));
                }
            }
            // A message from the table, which most often has a length that its row allows.
            8..=9 => {
                let message = &MESSAGES[recipe.below(MESSAGES.len())];
                let lengths: Vec<usize> = message.lengths().iter().collect();
                let length = if lengths.is_empty() { recipe.below(40) } else { lengths[recipe.below(lengths.len())] };
                let spoilt = message.direction == Direction::ToHost && recipe.below(8) == 0;
                stream.extend(frame(message.mid, &random.data(length + usize::from(spoilt))));
            }
            // A frame in extended form, whether it needs it or not.
            10 => {
                let layout: Layout = (0..recipe.below(60)).map(|_| shape(&mut recipe)).collect();
                let mid = if recipe.below(4) == 0 { recipe.byte() } else { table::MTDATA2 };
                stream.extend(extended(bid(&mut recipe), mid, &payload(&layout, random)));
            }
            // A frame with a good checksum and anything in it.
            11 => {
                let (mid, length) = (recipe.byte(), recipe.below(40));
                stream.extend(frame_of(bid(&mut recipe), mid, &random.noise(length)));
            }
            // An MTData2 that its packets do not tile, and one with a packet of a wrong size.
            12 => {
                let mut payload = payload(&[shape(&mut recipe), shape(&mut recipe)], random);
                payload.truncate(recipe.below(payload.len() + 1));
                stream.extend(frame(table::MTDATA2, &payload));
            }
            13 => {
                let mut shape = shape(&mut recipe);
                shape.size = recipe.below(40);
                shape.count = None;
                stream.extend(message(&vec![shape], MASTER, random));
            }
            // A header that claims bytes of whatever follows.
            14 => stream.extend([PREAMBLE, bid(&mut recipe), table::MTDATA2, recipe.byte()]),
            15 => stream.extend([PREAMBLE, MASTER, table::MTDATA2, EXTENDED, recipe.byte() % 16, recipe.byte()]),
            // Noise, or preambles and nothing else.
            16 => stream.extend(random.noise(usize::from(recipe.byte()))),
            17 => match recipe.below(20) {
                few @ 0..5 => stream.extend(vec![PREAMBLE; few]),
                // Strings, now and then with a character that is wrong.
                kind => (0..recipe.below(8)).for_each(|_| stream.extend(string(kind - 5, random))),
            },
            // More layouts than anybody will remember.
            18 => {
                for _ in 0..recipe.byte() {
                    let layout: Layout = vec![shape(&mut Recipe(&random.data(4))); 1 + random.below(3)];
                    (0..3).for_each(|_| stream.extend(message(&layout, MASTER, random)));
                }
            }
            // One bit flipped, or bytes lost, not far from the end.
            19 if !stream.is_empty() => {
                let at = stream.len() - 1 - recipe.below(stream.len());
                stream[at] ^= 1 << recipe.below(8);
            }
            _ => {
                let end = stream.len() - recipe.below(stream.len() + 1);
                let start = end - recipe.below(end.min(20) + 1);
                stream.drain(start..end);
            }
        }
    }
    stream
}

/// A string output by its place in the table; after the last place, the message that enables EM1000.
pub fn string(place: usize, random: &mut Random) -> Vec<u8> {
    let Some(row) = table::STRINGS.get(place) else {
        return frame(table::STRING_OUTPUT_TYPE, &table::BARE_STRINGS.to_be_bytes()[2..]);
    };
    let mut digits = |mask: &[u8]| -> Vec<u8> {
        mask.iter()
            .map(|character| if *character == b'D' { b"0123456789 "[random.below(11)] } else { *character })
            .collect()
    };
    let mut string = row.start.to_vec();
    match row.end {
        // The high bytes small, so that most angles are within their range.
        End::Length(length) => {
            string.extend((row.start.len()..length).map(|at| random.byte() % [255, 30][at % 2]));
        }
        End::Mask(mask) => string.extend(digits(mask)),
        End::Numbers(count) => string.extend(digits(b"-DD.D,".repeat(count).strip_suffix(b",").expect("some"))),
        End::Checksum => {
            string.extend(digits(b"DD.D,A, -D.DD"));
            let sum = string[1..].iter().fold(0, |sum, byte| sum ^ byte);
            string.extend(format!("*{sum:02X}").bytes());
        }
    }
    if !matches!(row.end, End::Length(_)) {
        string.extend(random.pick(&[&b"\r\n"[..], b"\r\n", b"\n", b"\r", b""]));
    }
    if random.once_in(6) {
        let at = random.below(string.len());
        string[at] = random.pick(b"$:*,A0\0\r\n\xFA");
    }
    string
}

fn bid(recipe: &mut Recipe<'_>) -> u8 {
    [MASTER, MASTER, MASTER, 1, 2, 31, 0, 32, PREAMBLE][recipe.below(9)]
}

/// A packet of any quantity, sometimes with an unknown identifier.
fn shape(recipe: &mut Recipe<'_>) -> Shape {
    let row = recipe.below(QUANTITIES.len() + 4);
    let format = recipe.byte();
    let Some(quantity) = QUANTITIES.get(row) else {
        return Shape { id: u16::from_be_bytes([0xF0 | format, recipe.byte()]), size: recipe.below(12), count: None };
    };
    // Format bits that mean nothing for the quantity are rare on the wire, and devices do send them.
    let idle = u16::from(format >> 4 & 3) * u16::from(format >= 0xE0);
    let precision = Precision::of(u16::from(format));
    let id = match quantity.kind {
        Kind::Real(_) => quantity.id | precision as u16,
        _ => quantity.id | idle,
    };
    let coordinates = Coordinates::ALL[usize::from(format >> 2) % 3];
    let id = if quantity.rotates { id | coordinates.bits() } else { id | idle << 2 };
    let entries = recipe.below(6);
    let count = matches!(quantity.kind, Kind::List(..)).then_some((4, u8::try_from(entries).expect("few")));
    Shape { id, size: size(quantity, precision, entries, format & 0x80 != 0), count }
}

/// Bytes of a packet of this quantity.
pub fn size(quantity: &Quantity, precision: Precision, entries: usize, long_id: bool) -> usize {
    match quantity.kind {
        Kind::Real(n) => n * precision.size(),
        Kind::Fixed(wire, n) => n * wire.size(),
        Kind::Id => [4, 8][usize::from(long_id)],
        Kind::Struct(fields) => record_size(fields),
        Kind::List(head, entry) => record_size(head) + entries * record_size(entry),
    }
}

fn payload(layout: &[Shape], random: &mut Random) -> Vec<u8> {
    let mut payload = vec![];
    for shape in layout {
        let mut data = random.data(shape.size);
        if let Some((at, count)) = shape.count {
            data[at] = count;
        }
        if payload.len() + PACKET_HEADER + data.len() < usize::from(u16::MAX) {
            payload.extend(packet(shape.id, &data));
        }
    }
    payload
}

fn message(layout: &Layout, bid: u8, random: &mut Random) -> Vec<u8> {
    frame_of(bid, table::MTDATA2, &payload(layout, random))
}
