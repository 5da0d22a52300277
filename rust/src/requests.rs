//! Requests: the frames in the bytes that a host sends to a device.
//!
//! The checksum alone decides. The rules of plausibility in [`scan`](crate::scan) are for what devices send; a host may
//! send any message with any payload, and the device replies with an Error.

use crate::frame::{Frame, Header, PREAMBLE, field};
use crate::scan::Window;

/// Iterates over the requests in a window, each with its position in the input.
///
/// ```
/// use xbus::{requests::Requests, scan::Window};
/// let bytes = [0x00, 0xFA, 0xFF, 0x30, 0x00, 0xD1, 0xFA, 0xFF];
/// let mut requests = Requests::new(Window { bytes: &bytes, offset: 0, last: false }, 2048);
/// let (position, frame) = requests.next().unwrap();
/// assert_eq!((position, frame.mid), (1, 0x30));
/// assert!(requests.next().is_none());
/// assert_eq!(requests.at(), 6); // an incomplete frame begins here
/// ```
#[derive(Clone, Debug)]
pub struct Requests<'a> {
    window: Window<'a>,
    limit: usize,
    at: usize,
    /// `sums[n]` is the sum of the first n bytes of the window, modulo 256. A checksum takes constant time with it, so
    /// overlapping candidates do not slow down the search.
    sums: Vec<u8>,
}

/// What the bytes from a preamble on can be.
enum Candidate {
    Frame(usize),
    Incomplete,
    Invalid,
}

impl<'a> Requests<'a> {
    /// Starts at the beginning of `window`. A header with more than `limit` bytes of payload is skipped.
    #[must_use]
    pub fn new(window: Window<'a>, limit: usize) -> Self {
        Self { window, limit, at: 0, sums: vec![] }
    }

    /// The position in the input up to which all bytes are done with. After the last request an incomplete frame begins
    /// there, unless it is the end of the window.
    #[must_use]
    pub const fn at(&self) -> u64 {
        self.window.offset + self.at as u64
    }

    fn candidate(&mut self) -> Candidate {
        let bytes = &self.window.bytes[self.at..];
        let Some(header) = Header::read(bytes) else { return Candidate::Incomplete };
        if header.payload > self.limit {
            return Candidate::Invalid;
        }
        let length = header.frame();
        if length > bytes.len() {
            return Candidate::Incomplete;
        }
        // The bytes after the preamble sum to 0 if the sums before and after them are the same.
        let (start, end) = (self.at + field::BID, self.at + length);
        self.sum_up();
        if self.sums[start] == self.sums[end] { Candidate::Frame(length) } else { Candidate::Invalid }
    }

    /// Fills `sums` when the first candidate needs it.
    fn sum_up(&mut self) {
        if self.sums.is_empty() {
            let mut sum = 0_u8;
            self.sums.reserve_exact(self.window.bytes.len() + 1);
            self.sums.push(0);
            self.sums.extend(self.window.bytes.iter().map(|byte| {
                sum = sum.wrapping_add(*byte);
                sum
            }));
        }
    }
}

impl<'a> Iterator for Requests<'a> {
    type Item = (u64, Frame<'a>);

    fn next(&mut self) -> Option<Self::Item> {
        while let Some(skipped) = memchr::memchr(PREAMBLE, &self.window.bytes[self.at..]) {
            self.at += skipped;
            match self.candidate() {
                Candidate::Frame(length) => {
                    let (position, start) = (self.at(), self.at);
                    self.at += length;
                    return Some((position, Frame::of(&self.window.bytes[start..self.at])));
                }
                // More bytes may complete it, so they cannot be skipped yet.
                Candidate::Incomplete if !self.window.last => return None,
                Candidate::Incomplete | Candidate::Invalid => self.at += 1,
            }
        }
        self.at = self.window.bytes.len();
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT: usize = 2048;

    fn found(bytes: &[u8], last: bool) -> (Vec<(u64, u8, usize)>, u64) {
        let mut requests = Requests::new(Window { bytes, offset: 100, last }, LIMIT);
        let frames = requests.by_ref().map(|(at, frame)| (at, frame.mid, frame.payload.len())).collect();
        (frames, requests.at())
    }

    fn frame(mid: u8, payload: &[u8]) -> Vec<u8> {
        Frame { bid: 0xFF, mid, payload }.encode().unwrap()
    }

    #[test]
    fn every_message_is_a_request_if_its_checksum_is_right() {
        let unknown = Frame { bid: 0, mid: 0x99, payload: &[1, 2] }.encode().unwrap();
        let mut wrong = frame(0x30, &[]);
        wrong[4] ^= 1;
        let bytes = [&frame(0x30, &[])[..], b"noise", &wrong, &unknown, &frame(0xC0, &[0; 300])].concat();
        assert_eq!(found(&bytes, false), (vec![(100, 0x30, 0), (115, 0x99, 2), (122, 0xC0, 300)], 429));
    }

    #[test]
    fn an_incomplete_frame_is_kept_until_the_end_of_the_input() {
        let bytes = [&[PREAMBLE, 0xFF, 0x10, 20][..], &frame(0x30, &[])].concat();
        assert_eq!(found(&bytes, false), (vec![], 100));
        assert_eq!(found(&bytes, true), (vec![(104, 0x30, 0)], 109));
        for length in 1..4 {
            assert_eq!(found(&bytes[..length], false), (vec![], 100));
        }
        assert_eq!(found(&[PREAMBLE, 0xFF, 0x10, 0xFF, 0], false), (vec![], 100));
    }

    #[test]
    fn a_header_with_too_long_a_payload_is_skipped() {
        let announce = |length: u16| {
            let [high, low] = length.to_be_bytes();
            [&[PREAMBLE, 0xFF, 0x10, 0xFF, high, low][..], &frame(0x30, &[])].concat()
        };
        assert_eq!(found(&announce(2049), false), (vec![(106, 0x30, 0)], 111));
        assert_eq!(found(&announce(2048), false), (vec![], 100));
    }
}
