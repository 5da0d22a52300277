//! Scanners that start in the middle of an input.

use super::{MAX_CREDIT, Reason, Scanner, Sums, Walk};

/// All that a scanner remembers at a position where a frame or string has just ended. Two scanners with equal seams find
/// the same from there on.
///
/// Its other fields do not matter there: nothing is being refused, no candidate has been looked at, and sums are computed
/// again when they are needed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Seam {
    /// Position in the input.
    pub at: u64,
    enabled: u32,
    credit: u64,
}

impl Default for Seam {
    /// The beginning of an input.
    fn default() -> Self {
        Self { at: 0, enabled: 0, credit: MAX_CREDIT }
    }
}

impl Seam {
    /// A scanner that goes on from here: see [`Scanner::new`].
    #[must_use]
    pub fn scanner(self, limit: usize) -> Scanner {
        let walk = Walk { credit: self.credit, ..Walk::default() };
        Scanner { at: self.at, enabled: self.enabled, walk, ..Scanner::new(limit) }
    }

    /// A scanner that starts at a later position `at`, without knowledge of the bytes in between. Like one that has just
    /// refused a byte, it accepts plausible frames only. At the end of the first of them it usually has the seam of a
    /// scanner that has read everything.
    #[must_use]
    pub fn scanner_at(self, limit: usize, at: u64) -> Scanner {
        Scanner { at, damage: Some((at, Reason::NoPreamble)), ..Self { credit: MAX_CREDIT, ..self }.scanner(limit) }
    }
}

impl Scanner {
    /// The seam at the present position; `None` while bytes are being refused, or if a candidate waits for more bytes.
    #[must_use]
    pub fn seam(&self) -> Option<Seam> {
        let is_waiting = self.walk.candidate == self.at && self.walk.at > 0;
        let seam = Seam { at: self.at, enabled: self.enabled, credit: self.walk.credit };
        (self.damage.is_none() && !is_waiting).then_some(seam)
    }

    /// Goes on where another scanner of the same input has arrived, which started at the seam of this one.
    pub fn go_on_from(&mut self, other: &Self) {
        let checksum_errors = self.checksum_errors + other.checksum_errors;
        *self = Self { sums: Sums::default(), checksum_errors, ..*other };
    }
}
