//! Live samples as parts of a log.

use super::lanes::Block;
use crate::clock::{Gap, Restart};
use crate::hostclock::HostClock;
use crate::log::{Options, Reader, TimedPart, Times, Wanted};

/// Decodes the blocks of a stream to columns. Samples are counted from the first block on.
#[derive(Debug)]
pub struct BlockDecoder {
    reader: Reader,
    /// What to add to arrivals for nanoseconds since 1970.
    epoch: i64,
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
        Self { reader: Reader::new(Options { wanted, ..Options::default() }, 0), epoch }
    }

    /// Decodes the next block.
    pub fn decode(&mut self, block: Block) -> DecodedBlock {
        let Block { frames, samples, strings, clocks } = block;
        let mut rest = frames.as_slice();
        let mut done = 0;
        for text in &strings {
            let before = samples.partition_point(|sample| sample.offset < text.offset);
            let size = samples[done..before].iter().map(|sample| sample.length as usize).sum();
            let (head, tail) = rest.split_at(size);
            self.read(head);
            self.reader.read_accepted_string(text.place, &text.bytes);
            (rest, done) = (tail, before);
        }
        self.read(rest);
        let part = self.reader.take();
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

    fn read(&mut self, frames: &[u8]) {
        self.reader.read_accepted(frames).expect("only strict readers fail");
    }
}
