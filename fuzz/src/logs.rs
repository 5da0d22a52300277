//! The contents of a log in a form that can be compared, and a plain reader that shares no code with the two paths.

use std::collections::HashMap;

use xbus::clock::{Change, Clocks, Gap, Losses, Restart, Stamps};
use xbus::column::{Column, Pieces, Subject, Values};
use xbus::device;
use xbus::error::Fault;
use xbus::frame::Frame;
use xbus::log::{Options, Part, Reader, Stats, Strings, Times};
use xbus::mtdata::stamps as stamps_of;
use xbus::packet::{Coordinates, Form, Packet, Precision, Reading, packets};
use xbus::scan::{Damage, Window};
use xbus::table::{self, Field, Kind, Quantity, Wire};
use xbus::value::{Number, numbers};

use super::mtdata::InForce;
use super::scans::Scan;
use super::streams::Random;

/// Everything of a log that users can see, with numbers as their bits.
#[derive(Debug, Default, PartialEq)]
pub struct Log {
    /// Index of the first sample.
    pub first: u64,
    pub columns: Vec<Contents>,
    pub offsets: Vec<i64>,
    pub bids: Vec<u8>,
    pub times: Vec<Bits>,
    pub counters: Vec<i64>,
    pub gaps: Vec<Gap>,
    pub restarts: Vec<Restart>,
    pub messages: Vec<Message>,
    pub strings: Vec<Text>,
    pub damage: Vec<Damage>,
    pub stats: Stats,
}

/// The contents of a column.
#[derive(Debug, PartialEq)]
pub struct Contents {
    /// Name and coordinates, or the identifier of packets that the tables do not explain.
    pub subject: String,
    /// Type of the numbers.
    pub numbers: &'static str,
    pub id: u16,
    pub mixed_ids: bool,
    pub mixed_precisions: bool,
    pub samples: Vec<i64>,
    /// Rows: the numbers of each packet in the order of the wire, with the entries of lists.
    pub rows: Vec<Vec<Bits>>,
}

/// A message that is not a sample.
#[derive(Debug, PartialEq, Eq)]
pub struct Message {
    pub mid: u8,
    pub bid: u8,
    pub offset: u64,
    pub sample: u64,
    pub payload: Vec<u8>,
}

/// A string output.
#[derive(Debug, PartialEq, Eq)]
pub struct Text {
    pub place: Option<u8>,
    pub offset: u64,
    pub sample: u64,
    pub bytes: Vec<u8>,
}

/// A number as its 64 bits, so that a NaN equals itself.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Bits(pub u64);

impl std::fmt::Debug for Bits {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:X}", self.0)
    }
}

impl Log {
    /// Reads the log in one window and one part.
    pub fn whole(bytes: &[u8], options: Options) -> Self {
        let mut reader = Reader::new(options, bytes.len() as u64);
        reader.read(Window { bytes, offset: 0, last: true }, u64::MAX).expect("strict only where it says so");
        assert!(reader.is_finished());
        Self::of(&reader.take(), &mut Clocks::default())
    }

    /// Reads the log in random windows and parts, and joins the parts.
    pub fn apart(bytes: &[u8], options: Options, random: &mut Random) -> Result<Self, Fault> {
        let mut reader = Reader::new(options, random.pick(&[0, bytes.len() as u64, 3 * bytes.len() as u64]));
        let mut clocks = Clocks::default();
        let mut log = Self::default();
        let longest = random.pick(&[10, 200, 5000]);
        let seldom = random.pick(&[1, 3, 30]);
        let mut end = 0;
        while !reader.is_finished() {
            let at = usize::try_from(reader.at()).expect("a position in memory");
            let from = at - random.below(at.min(50) + 1);
            // That the input ends may become known late.
            let last = end == bytes.len() || (bytes.len() - end < longest && random.once_in(2));
            end = if last { bytes.len() } else { bytes.len().min(end.max(at) + random.below(longest)) };
            let until = if random.once_in(2) { u64::MAX } else { reader.at() + 1 + random.below(longest) as u64 };
            let read = reader.read(Window { bytes: &bytes[from..end], offset: from as u64, last }, until);
            if random.once_in(seldom) || read.is_err() || reader.is_finished() {
                log.join(Self::of(&reader.take(), &mut clocks));
            }
            read?;
        }
        Ok(log)
    }

    /// The contents of a part. `clocks` are updated from its beginning to its end.
    pub fn of(part: &Part, clocks: &mut Clocks) -> Self {
        let (messages, strings) = (&part.messages, &part.strings);
        let (mut payloads, mut texts) = (pieces(&messages.payload), pieces(&strings.bytes));
        let message = |i: usize| Message {
            mid: messages.mid[i],
            bid: messages.bid[i],
            offset: messages.offset[i],
            sample: messages.sample[i],
            payload: payloads.next().expect("one each"),
        };
        let text = |i: usize| Text {
            place: (strings.place[i] != Strings::UNKNOWN).then_some(strings.place[i]),
            offset: strings.offset[i],
            sample: strings.sample[i],
            bytes: texts.next().expect("one each"),
        };
        let mut plain = clocks.clone();
        let Times { time: times, counter: counters, gaps, restarts, has_counter } = part.unwrap_plainly(&mut plain);
        let fast = part.unwrap(clocks);
        assert!(fast.time.iter().map(|time| time.to_bits()).eq(times.iter().map(|time| time.to_bits())));
        assert_eq!((&fast.counter, &fast.gaps, &fast.restarts), (&counters, &gaps, &restarts));
        assert_eq!((fast.has_counter, &*clocks), (has_counter, &plain));
        let log = Self {
            first: part.first,
            columns: part.columns.iter().map(|column| Contents::of(part, column)).collect(),
            offsets: part.offsets(),
            bids: part.bids(),
            times: times.into_iter().map(|time| Bits(time.to_bits())).collect(),
            counters,
            gaps,
            restarts,
            messages: (0..messages.mid.len()).map(message).collect(),
            strings: (0..strings.place.len()).map(text).collect(),
            damage: part.damage.clone(),
            stats: part.stats,
        };
        assert_eq!(part.is_empty(), log.offsets.is_empty());
        for length in [log.offsets.len(), log.bids.len(), log.times.len(), log.counters.len()] {
            assert_eq!(length, part.len());
        }
        log
    }

    /// Lost samples and gaps.
    pub fn losses(&self) -> Losses {
        Losses::of(&self.gaps)
    }

    /// Adds the contents of the next part.
    pub fn join(&mut self, next: Self) {
        assert_eq!(next.first, self.first + self.offsets.len() as u64);
        for rows in next.columns {
            match self.columns.iter_mut().find(|column| column.subject == rows.subject) {
                None => self.columns.push(rows),
                Some(before) => before.join(rows),
            }
        }
        self.offsets.extend(next.offsets);
        self.bids.extend(next.bids);
        self.times.extend(next.times);
        self.counters.extend(next.counters);
        self.gaps.extend(next.gaps);
        self.restarts.extend(next.restarts);
        self.messages.extend(next.messages);
        self.strings.extend(next.strings);
        self.damage.extend(next.damage);
        let (sum, more) = (&mut self.stats, next.stats);
        sum.bytes += more.bytes;
        sum.frames += more.frames;
        sum.samples += more.samples;
        sum.messages += more.messages;
        sum.malformed += more.malformed;
        sum.unfit += more.unfit;
        sum.strings += more.strings;
        sum.skipped_bytes += more.skipped_bytes;
        sum.checksum_errors += more.checksum_errors;
    }

    /// Panics with the place of the first difference to another log.
    pub fn same_as(&self, other: &Self, what: &str) {
        for (one, other) in self.columns.iter().zip(&other.columns) {
            let head = |contents: &Contents| {
                (contents.subject.clone(), contents.numbers, contents.id, contents.mixed_ids, contents.mixed_precisions)
            };
            assert_eq!(head(one), head(other), "{what}");
            assert_eq!(one.samples, other.samples, "{what}: {}", one.subject);
            let differs = one.rows.iter().zip(&other.rows).position(|(one, other)| one != other);
            assert_eq!(differs.map(|row| (row, &one.rows[row], &other.rows[row])), None, "{what}: {}", one.subject);
        }
        assert_eq!(self.subjects(), other.subjects(), "{what}");
        assert_eq!(self.messages, other.messages, "{what}");
        assert_eq!(self.strings, other.strings, "{what}");
        assert_eq!(self.damage, other.damage, "{what}");
        assert_eq!(self.stats, other.stats, "{what}");
        assert_eq!(self.offsets, other.offsets, "{what}");
        assert_eq!(self.times, other.times, "{what}");
        assert_eq!(self.counters, other.counters, "{what}");
        assert_eq!(self.restarts, other.restarts, "{what}");
        assert_eq!(self, other, "{what}");
    }

    /// The column of a quantity, in its only coordinate system.
    pub fn column(&self, subject: &str) -> &Contents {
        let named = |column: &&Contents| column.subject == subject;
        self.columns.iter().find(named).unwrap_or_else(|| panic!("there is no {subject} among {:?}", self.subjects()))
    }

    /// The subjects of all columns.
    pub fn subjects(&self) -> Vec<&str> {
        self.columns.iter().map(|column| &column.subject[..]).collect()
    }
}

fn pieces(pieces: &Pieces) -> impl Iterator<Item = Vec<u8>> {
    let starts = std::iter::once(&0).chain(&pieces.ends);
    starts.zip(&pieces.ends).map(|(&from, &to)| pieces.bytes[count(from)..count(to)].to_vec())
}

fn count(many: u64) -> usize {
    usize::try_from(many).expect("a number of things in memory")
}

impl Contents {
    fn of(part: &Part, column: &Column) -> Self {
        let samples = part.samples_of(column);
        assert_eq!(samples.len(), column.rows);
        assert!(samples.is_sorted());
        assert_eq!(part.rows(column).sum::<usize>(), column.rows);
        let once_each = samples.iter().copied().eq((part.first.cast_signed()..).take(part.len()));
        assert_eq!(part.is_dense(column), once_each);
        let (numbers, cells): (_, Vec<u64>) = match &column.values {
            Values::U8(values) => ("u1", values.iter().map(|&value| value.into()).collect()),
            Values::U16(values) => ("u2", values.iter().map(|&value| value.into()).collect()),
            Values::U32(values) => ("u4", values.iter().map(|&value| value.into()).collect()),
            Values::U64(values) => ("u8", values.clone()),
            Values::I8(values) => ("i1", values.iter().map(|&value| i64::from(value).cast_unsigned()).collect()),
            Values::I16(values) => ("i2", values.iter().map(|&value| i64::from(value).cast_unsigned()).collect()),
            Values::I32(values) => ("i4", values.iter().map(|&value| i64::from(value).cast_unsigned()).collect()),
            Values::F32(values) => ("f4", values.iter().map(|&value| value.to_bits().into()).collect()),
            Values::F64(values) => ("f8", values.iter().map(|&value| value.to_bits()).collect()),
            Values::Records(bytes) => ("record", bytes.iter().map(|&value| value.into()).collect()),
            Values::Raw(pieces) => ("raw", pieces.bytes.iter().map(|&value| value.into()).collect()),
        };
        let cells: Vec<Bits> = cells.into_iter().map(Bits).collect();
        let mut entries = &column.entries[..];
        let rows: Vec<Vec<Bits>> = match (&column.values, column.subject) {
            (Values::Raw(pieces), _) => {
                let starts = std::iter::once(&0).chain(&pieces.ends);
                starts.zip(&pieces.ends).map(|(&from, &to)| cells[count(from)..count(to)].to_vec()).collect()
            }
            (Values::Records(bytes), Subject::Known(quantity, _)) => {
                let row = |bytes: &[u8]| match quantity.kind {
                    Kind::List(head, entry) => {
                        let mut row = fields(bytes, head);
                        let size: usize = entry.iter().map(|field| field.wire.size()).sum();
                        for _ in 0..row[1].0 {
                            let (first, rest) = entries.split_at(size);
                            row.extend(fields(first, entry));
                            entries = rest;
                        }
                        row
                    }
                    Kind::Struct(all) => fields(bytes, all),
                    kind => panic!("records of {kind:?}"),
                };
                bytes.chunks(column.width).map(row).collect()
            }
            _ => cells.chunks(column.width).map(<[_]>::to_vec).collect(),
        };
        assert!(entries.is_empty());
        assert_eq!(rows.len(), column.rows);
        assert!(!rows.is_empty(), "a column without rows");
        let subject = match column.subject {
            Subject::Known(quantity, coordinates) => name(quantity, coordinates),
            Subject::Unknown(id) => unknown(id),
        };
        let Column { id, mixed_ids, mixed_precisions, .. } = *column;
        Self { subject, numbers, id, mixed_ids, mixed_precisions, samples, rows }
    }

    /// Adds the rows of the next part, and widens the narrower side.
    fn join(&mut self, mut next: Self) {
        if self.rows.is_empty() {
            *self = next;
            return;
        }
        let real = matches!(table::column_quantity(self.id).map(|quantity| quantity.kind), Some(Kind::Real(_)))
            && self.numbers != "raw";
        self.mixed_ids |= next.mixed_ids || self.id != next.id;
        self.mixed_precisions |= next.mixed_precisions || (real && Precision::of(self.id) != Precision::of(next.id));
        if self.numbers != next.numbers {
            self.widen();
            next.widen();
        }
        assert_eq!(self.numbers, next.numbers);
        self.samples.extend(next.samples);
        self.rows.extend(next.rows);
    }

    fn widen(&mut self) {
        match self.numbers {
            "f4" => {
                self.numbers = "f8";
                self.rows.iter_mut().flatten().for_each(|number| *number = wide(*number));
            }
            "u4" => self.numbers = "u8",
            _ => {}
        }
    }
}

#[allow(clippy::cast_possible_truncation)] // they are the bits of a single
fn wide(single: Bits) -> Bits {
    Bits(f64::from(f32::from_bits(single.0 as u32)).to_bits())
}

fn name(quantity: &Quantity, coordinates: Option<Coordinates>) -> String {
    coordinates.map_or(quantity.name.into(), |coordinates| format!("{} {}", quantity.name, coordinates.name()))
}

fn unknown(id: u16) -> String {
    format!("{id:04X}")
}

/// The fields of a record in native byte order.
fn fields(bytes: &[u8], fields: &[Field]) -> Vec<Bits> {
    let mut rest = bytes;
    let mut number = |field: &Field| {
        let (bytes, behind) = rest.split_at(field.wire.size());
        rest = behind;
        let mut wide = [0; 8];
        wide[..bytes.len()].copy_from_slice(bytes);
        let unsigned = if cfg!(target_endian = "big") {
            u64::from_be_bytes(wide) >> (64 - 8 * bytes.len())
        } else {
            u64::from_le_bytes(wide)
        };
        let unused = 64 - 8 * bytes.len();
        let signed = matches!(field.wire, Wire::I1 | Wire::I2 | Wire::I4);
        Bits(if signed { ((unsigned << unused).cast_signed() >> unused).cast_unsigned() } else { unsigned })
    };
    let numbers = fields.iter().map(&mut number).collect();
    assert!(rest.is_empty());
    numbers
}

/// A log read plainly: with the plain scanner, packet by packet and number by number.
pub struct ByHand {
    pub log: Log,
    /// The faults at which a strict reader stops, in order.
    pub faults: Vec<Fault>,
    clocks: Clocks,
    mtdata: InForce,
    places: HashMap<String, usize>,
}

impl ByHand {
    /// Reads the frames of `scan` in `bytes`.
    pub fn read(bytes: &[u8], scan: &Scan) -> Self {
        let mut this = Self {
            log: Log::default(),
            faults: vec![],
            clocks: Clocks::default(),
            mtdata: InForce::default(),
            places: HashMap::default(),
        };
        let mut damage = scan.damage.iter().peekable();
        let fault = |damage: &Damage| Fault::Damage { offset: damage.offset, reason: damage.reason };
        for &(offset, length) in &scan.frames {
            while let Some(damage) = damage.next_if(|damage| damage.offset < offset as u64) {
                this.faults.push(fault(damage));
            }
            this.frame(Frame::of(&bytes[offset..offset + length]), offset as u64);
        }
        this.faults.extend(damage.map(fault));
        let offsets = &this.log.offsets;
        let text = |&(at, length, place): &(usize, usize, Option<u8>)| Text {
            place,
            offset: at as u64,
            sample: offsets.partition_point(|offset| offset.cast_unsigned() < at as u64) as u64,
            bytes: bytes[at..at + length].to_vec(),
        };
        this.log.strings = scan.strings.iter().map(text).collect();
        this.log.damage.clone_from(&scan.damage);
        this.log.stats = Stats {
            bytes: bytes.len() as u64,
            frames: scan.frames.len() as u64,
            samples: this.log.offsets.len() as u64,
            messages: this.log.messages.len() as u64,
            strings: scan.strings.len() as u64,
            malformed: this.log.messages.iter().filter(|message| message.mid == table::MTDATA2).count() as u64,
            unfit: this.log.messages.iter().filter(|message| message.mid == table::MTDATA).count() as u64,
            skipped_bytes: scan.damage.iter().map(|damage| damage.length).sum(),
            checksum_errors: scan.checksum_errors,
        };
        this
    }

    fn frame(&mut self, frame: Frame<'_>, offset: u64) {
        if frame.mid == table::MTDATA {
            return self.mtdata(frame, offset);
        }
        let tiles: Result<Vec<_>, _> = packets(frame.payload).collect();
        match tiles {
            Ok(packets) if frame.mid == table::MTDATA2 && !packets.is_empty() => {
                if let Some(packet) = packets.iter().find(|packet| !packet.is_sound()) {
                    self.faults.push(Fault::Size { offset, id: packet.id, size: packet.data.len() });
                }
                let packets: Vec<_> = packets.iter().map(|packet| (*packet, packet.reading())).collect();
                let stamps = self.sample(frame.bid, &packets, offset);
                assert_eq!(Stamps::read(frame.payload), stamps, "a live sample has the stamps of a logged one");
            }
            tiles => {
                if frame.mid == table::MTDATA2 {
                    self.faults.push(Fault::Malformed { offset, id: tiles.err().and_then(|error| error.id) });
                }
                self.message(frame, offset);
            }
        }
    }

    fn mtdata(&mut self, frame: Frame<'_>, offset: u64) {
        let (length, layout) = (frame.payload.len(), self.mtdata.layout(frame.bid));
        let expected = layout.as_ref().map(|(size, _)| *size);
        let Some((_, samples)) = layout.filter(|_| expected == Some(length) && length > 0) else {
            self.faults.push(Fault::Unfit { offset, length, expected });
            return self.message(frame, offset);
        };
        for (bid, items) in samples {
            let packets: Vec<_> = items.iter().map(|item| (item.packet(frame.payload), Some(item.reading))).collect();
            let stamps = self.sample(bid, &packets, offset);
            let alone = stamps_of(frame.payload, &items);
            assert_eq!(Stamps::read(&alone), stamps, "a dumped sample has the stamps of a logged one");
        }
    }

    fn message(&mut self, frame: Frame<'_>, offset: u64) {
        let Frame { bid, mid, payload } = frame;
        self.mtdata.learn(bid, mid, payload);
        let devices = if bid == 0xFF && self.mtdata.trackers > 0 { 1..=self.mtdata.trackers } else { bid..=bid };
        for device in devices {
            if let Some(ticks) = device::wrap_of_message(mid, payload) {
                self.clocks.of(device).change(Change::Wrap(ticks));
            }
            if [0x11, 0x41, 0x3E].contains(&mid) {
                self.clocks.of(device).change(Change::Restart);
            }
        }
        let sample = self.log.offsets.len() as u64;
        self.log.messages.push(Message { mid, bid, offset, sample, payload: payload.to_vec() });
    }

    fn sample(&mut self, bid: u8, packets: &[(Packet<'_>, Option<Reading>)], offset: u64) -> Stamps {
        let (mut stamps, mut triggers) = (Stamps::default(), [None; 3]);
        for (packet, reading) in packets {
            self.packet(packet, *reading, &mut stamps, &mut triggers);
        }
        stamps.trigger = triggers.into_iter().flatten().next_back(); // of several lines the highest counts
        let moment = self.clocks.of(bid).sample(stamps);
        let sample = self.log.offsets.len() as u64;
        if moment.lost > 0 {
            self.log.gaps.push(Gap { sample, lost: moment.lost, bid });
        }
        if moment.restarted {
            self.log.restarts.push(Restart { sample, bid });
        }
        self.log.offsets.push(offset.cast_signed());
        self.log.bids.push(bid);
        self.log.times.push(Bits(moment.seconds.to_bits()));
        self.log.counters.push(moment.counter);
        stamps
    }

    fn packet(
        &mut self,
        packet: &Packet<'_>,
        reading: Option<Reading>,
        stamps: &mut Stamps,
        triggers: &mut [Option<u32>; 3],
    ) {
        let Some(reading) = reading else {
            let row = packet.data.iter().map(|byte| Bits((*byte).into())).collect();
            self.row(unknown(packet.id), packet.id, "raw", row);
            return;
        };
        let numbers = numbers(&reading, packet.data);
        let u4 = |at: usize| match numbers[at] {
            Number::Integer(value) => u32::try_from(value).expect("a U4"),
            number => panic!("{number:?} is no U4"),
        };
        #[allow(clippy::cast_possible_truncation)] // a U2
        match reading.quantity.name {
            "packet_counter" => stamps.counter = Some(u4(0) as u16),
            "sample_time_fine" => stamps.fine = Some(u4(0)),
            "sample_time_coarse" => stamps.coarse = Some(u4(0)),
            "trigger_in1" => triggers[0] = Some(u4(2)),
            "trigger_in2" => triggers[1] = Some(u4(2)),
            "trigger_in3" => triggers[2] = Some(u4(2)),
            "gnss_pvt_data" | "gnss_sat_info" => stamps.gnss = true,
            _ => {}
        }
        let kind = match reading.form {
            Form::Real(Precision::Float32, _) => "f4",
            Form::Real(..) => "f8",
            Form::Fixed(wire, _) => wire.numpy(),
            Form::Steps(_) => "u4",
            Form::Struct(_) | Form::List(..) => "record",
        };
        let row = numbers.into_iter().map(bits).collect();
        self.row(name(reading.quantity, reading.coordinates), packet.id, kind, row);
    }

    fn row(&mut self, subject: String, id: u16, numbers: &'static str, row: Vec<Bits>) {
        let columns = &mut self.log.columns;
        let place = *self.places.entry(subject.clone()).or_insert_with(|| {
            let (samples, rows) = (vec![], vec![]);
            columns.push(Contents { subject, numbers, id, mixed_ids: false, mixed_precisions: false, samples, rows });
            columns.len() - 1
        });
        let sample = self.log.offsets.len() as u64;
        let (samples, rows) = (vec![sample.cast_signed()], vec![row]);
        let subject = columns[place].subject.clone();
        columns[place].join(Contents {
            subject,
            numbers,
            id,
            mixed_ids: false,
            mixed_precisions: false,
            samples,
            rows,
        });
    }
}

fn bits(number: Number) -> Bits {
    Bits(match number {
        Number::Integer(value) => value.cast_unsigned(),
        Number::Wide(value) => value,
        Number::Single(value) => value.to_bits().into(),
        Number::Double(value) => value.to_bits(),
    })
}
