//! The rules of the scanner, once more and with nothing else in mind: whole input, no memory, no speed.
//!
//! The oracle of the tests and fuzz targets. It may look at a byte as often as it likes, so do not feed it much.

use super::{Damage, Reason};
use crate::frame::{self, Frame, Header, PREAMBLE};
use crate::packet::packets;
use crate::table;

/// The frames of `input` as (offset, length), its damage, and how many candidates their checksum refused where a frame
/// was due.
#[must_use]
pub fn scan(input: &[u8], limit: usize) -> (Vec<(usize, usize)>, Vec<Damage>, u64) {
    let (mut frames, mut damage, mut checksum_errors) = (Vec::new(), Vec::new(), 0);
    let mut due = 0; // where the last accepted frame ended
    let mut refused = None; // what was wrong there
    let mut at = 0;
    while at < input.len() {
        match candidate(input, at, limit) {
            Ok(length)
                if is_plausible(&input[at..at + length]) || (at == due && is_followed(input, at + length, limit)) =>
            {
                damage.extend(refused.take().map(|reason| stretch(due, at, reason)));
                frames.push((at, length));
                at += length;
                due = at;
            }
            verdict => {
                if at == due {
                    let reason = verdict.err().unwrap_or(Reason::Implausible);
                    checksum_errors += u64::from(reason == Reason::Checksum);
                    refused = Some(reason);
                }
                at += 1;
            }
        }
    }
    damage.extend(refused.map(|reason| stretch(due, at, reason)));
    (frames, damage, checksum_errors)
}

fn stretch(from: usize, to: usize, reason: Reason) -> Damage {
    Damage { offset: from as u64, length: (to - from) as u64, reason }
}

/// The length of the frame at `at`, if there is one with a good checksum.
fn candidate(input: &[u8], at: usize, limit: usize) -> Result<usize, Reason> {
    let bytes = &input[at..];
    if bytes.first() != Some(&PREAMBLE) {
        return Err(Reason::NoPreamble);
    }
    let header = Header::read(bytes).ok_or(Reason::Truncated)?;
    if header.payload > limit {
        return Err(Reason::TooLong);
    }
    let bytes = bytes.get(..header.frame()).ok_or(Reason::Truncated)?;
    if frame::sum(&bytes[1..]) == 0 { Ok(bytes.len()) } else { Err(Reason::Checksum) }
}

fn is_plausible(bytes: &[u8]) -> bool {
    let frame = Frame::of(bytes);
    (frame.bid == 0xFF || (1..=31).contains(&frame.bid))
        && if frame.mid == table::MTDATA2 {
            !frame.payload.is_empty() && packets(frame.payload).all(|packet| packet.is_ok_and(|it| it.is_sound()))
        } else {
            table::device_sends(frame.mid, frame.payload.len())
        }
}

fn is_followed(input: &[u8], at: usize, limit: usize) -> bool {
    at == input.len() || candidate(input, at, limit).is_ok()
}
