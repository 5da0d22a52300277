//! Live samples as parts of a log.

use super::lanes::{Block, Sample, Text};
use crate::clock::{Gap, Restart};
use crate::hostclock::HostClock;
use crate::log::{Options, Part, Reader, TimedPart, Times, Wanted, can};

/// Decodes the blocks of a stream to columns. Samples are counted from the first block on.
#[derive(Debug)]
pub struct BlockDecoder {
    decoder: Decoder,
    /// What to add to arrivals for nanoseconds since 1970.
    epoch: i64,
}

/// What decodes the samples of a block.
#[derive(Debug)]
enum Decoder {
    /// Frames of a stream of bytes.
    Frames(Box<Reader>),
    /// Samples of a CAN bus: the quantities to keep, and the index of the next sample.
    Can(Option<Wanted>, u64),
}

/// A decoded block.
#[derive(Debug)]
pub struct DecodedBlock {
    /// Its samples and strings, with the times that the samples were given when they arrived.
    pub part: TimedPart,
    /// For each sample when it was measured, in seconds since 1970 on the clock of the host; NaN if that is not known.
    pub host_times: Vec<f64>,
    /// For each string when it arrived, in seconds since 1970.
    pub string_times: Vec<f64>,
    /// The clocks of the host for the devices, by bus identifier.
    pub clocks: Vec<(u8, HostClock)>,
}

impl BlockDecoder {
    /// A decoder that keeps these quantities; all if `None`.
    #[must_use]
    pub fn new(wanted: Option<Wanted>, epoch: i64) -> Self {
        let reader = Reader::new(Options { wanted, ..Options::default() }, 0);
        Self { decoder: Decoder::Frames(Box::new(reader)), epoch }
    }

    /// A decoder for the samples of a CAN bus.
    #[must_use]
    pub const fn can(wanted: Option<Wanted>, epoch: i64) -> Self {
        Self { decoder: Decoder::Can(wanted, 0), epoch }
    }

    /// Decodes the next block.
    pub fn decode(&mut self, block: Block) -> DecodedBlock {
        let Block { frames, samples, strings, clocks } = block;
        let part = match &mut self.decoder {
            Decoder::Frames(reader) => read_frames(reader, &frames, &samples, &strings),
            Decoder::Can(wanted, next) => {
                let mut rest = frames.as_slice();
                let groups = samples.iter().map(|sample| {
                    let (own, tail) = rest.split_at(sample.length as usize);
                    rest = tail;
                    (sample.bid, sample.offset, own)
                });
                let part = can::part_of(*next, groups, wanted.as_ref());
                *next += samples.len() as u64;
                part
            }
        };
        let mut times = Times::default();
        for (sample, index) in samples.iter().zip(part.first..) {
            times.time.push(sample.moment.seconds);
            times.counter.push(sample.moment.counter);
            times.has_counter |= sample.moment.counter != -1;
            if sample.moment.lost > 0 {
                times.gaps.push(Gap { sample: index, lost: sample.moment.lost, bid: sample.bid });
            }
            if sample.moment.restarted {
                times.restarts.push(Restart { sample: index, bid: sample.bid });
            }
        }
        #[allow(clippy::cast_precision_loss)] // seconds since 1970 to a microsecond
        let seconds = |arrival: i64| arrival.saturating_add(self.epoch) as f64 / 1e9;
        DecodedBlock {
            part: TimedPart::of(part, times),
            host_times: samples.iter().map(|sample| sample.host_time).collect(),
            string_times: strings.iter().map(|text| seconds(text.arrival)).collect(),
            clocks,
        }
    }
}

fn read_frames(reader: &mut Reader, frames: &[u8], samples: &[Sample], strings: &[Text]) -> Part {
    let (mut rest, mut done) = (frames, 0);
    for text in strings {
        let before = samples.partition_point(|sample| sample.offset < text.offset);
        rest = read_samples(reader, rest, &samples[done..before]);
        reader.read_accepted_string(text.place, &text.bytes);
        done = before;
    }
    read_samples(reader, rest, &samples[done..]);
    reader.take()
}

/// Reads the frames of these samples, each with its settings of `MTData`, and returns the frames after them.
fn read_samples<'a>(reader: &mut Reader, frames: &'a [u8], samples: &[Sample]) -> &'a [u8] {
    let read = |reader: &mut Reader, frames| reader.read_accepted(frames).expect("only strict readers fail");
    let (mut from, mut end) = (0, 0);
    for sample in samples {
        if let Some(output) = sample.output
            && reader.output(sample.bid) != Some(output)
        {
            read(reader, &frames[from..end]);
            reader.use_output(sample.bid, output);
            from = end;
        }
        end += sample.length as usize;
    }
    read(reader, &frames[from..end]);
    &frames[end..]
}
