//! Counts of what has been received.

use std::collections::BTreeMap;

use crate::clock::Losses;
use crate::frame::Frame;
use crate::log::can::{self, CanEvent};
use crate::scan::Damage;
use crate::table;

/// The counts. They never decrease.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "python", derive(pyo3::IntoPyObject))]
pub struct Counts {
    /// Bytes received.
    pub bytes: u64,
    /// Accepted frames.
    pub frames: u64,
    /// MTData2 messages, and MTData messages whose settings are known.
    pub samples: u64,
    /// Other messages, malformed ones included.
    pub messages: u64,
    /// These by their identifier.
    pub mids: BTreeMap<u8, u64>,
    /// MTData2 messages that are empty or that their packets do not fill.
    pub malformed: u64,
    /// MTData messages whose settings are not known or do not fit, and those of an Xbus Master.
    pub unfit: u64,
    /// String outputs by name; the name of those that the manual does not list is empty.
    pub strings: BTreeMap<&'static str, u64>,
    /// Packets by data identifier without format bits.
    pub quantities: BTreeMap<u16, u64>,
    /// Losses according to the packet counters.
    pub losses: Losses,
    /// Candidates refused by their checksum where a frame was due.
    pub checksum_errors: u64,
    /// Bytes that belong to neither frame nor string.
    pub skipped_bytes: u64,
    /// Error messages (0x42), including replies to commands.
    pub errors: u64,
    /// Warnings (0x43).
    pub warnings: u64,
    /// The last error or warning, in words.
    pub last_error: Option<String>,
}

impl Counts {
    /// Counts a stretch of damage, if there is one.
    pub(super) fn damage(&mut self, damage: Option<Damage>) {
        self.skipped_bytes += damage.map_or(0, |damage| damage.length);
    }

    /// Counts a string: see [`table::STRINGS`] for its place.
    pub(super) fn string(&mut self, place: Option<u8>) {
        let name = place.map_or("", |place| table::STRINGS[usize::from(place)].name);
        *self.strings.entry(name).or_default() += 1;
    }

    /// Counts a sample with packets of these identifiers, before which samples are missing.
    pub(super) fn sample(&mut self, ids: impl Iterator<Item = u16>, lost: u64) {
        self.frames += 1;
        self.samples += 1;
        for id in ids {
            *self.quantities.entry(id & !0xF).or_default() += 1;
        }
        self.losses.add(lost);
    }

    /// Counts a sample of CAN frames, before which samples are missing.
    pub(super) fn can_sample(&mut self, frames: &[u8], lost: u64) {
        self.samples += 1;
        let mut before = None;
        for id in can::quantities_of(frames).map(|quantity| quantity.id) {
            // The components of a position are separate frames, one after the other.
            if before.replace(id) != Some(id) {
                *self.quantities.entry(id).or_default() += 1;
            }
        }
        self.losses.add(lost);
    }

    /// Counts an event of a CAN device.
    pub(super) fn can_event(&mut self, event: CanEvent) {
        let (message, count) =
            if event.is_error { ("Error", &mut self.errors) } else { ("Warning", &mut self.warnings) };
        *count += 1;
        let text = match event {
            CanEvent { is_error: true, code: CanEvent::OVERFLOW } => "the output buffer overflowed, frames are missing",
            _ => UNDOCUMENTED,
        };
        self.last_error = Some(format!("CAN {message} {}: {text}", event.code));
    }

    /// Counts a message that is no sample.
    pub(super) fn message(&mut self, frame: Frame<'_>) {
        self.frames += 1;
        self.messages += 1;
        *self.mids.entry(frame.mid).or_default() += 1;
        self.malformed += u64::from(frame.mid == table::MTDATA2);
        self.unfit += u64::from(frame.mid == table::MTDATA);
        match (frame.mid, frame.payload) {
            (table::ERROR, [code, ..]) => {
                self.errors += 1;
                self.last_error = Some(in_words("Error", (*code).into()));
            }
            (table::WARNING, [a, b, c, d, ..]) => {
                self.warnings += 1;
                self.last_error = Some(in_words("Warning", u32::from_be_bytes([*a, *b, *c, *d])));
            }
            _ => {}
        }
    }
}

const UNDOCUMENTED: &str = "an undocumented code";

fn in_words(message: &str, code: u32) -> String {
    format!("{message} {code}: {}", table::result_text(code).unwrap_or(UNDOCUMENTED))
}
