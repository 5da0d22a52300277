//! All results of a scanner for an input, in any pieces.

use xbus::frame::{EXTENDED, PREAMBLE};
use xbus::scan::{Damage, Scanner, Step, Window, plain};
use xbus::strings::LONGEST_STRING;
use xbus::table;

use super::streams::Random;

/// The results of a scanner: offset and length of each frame; offset, length and place in the table of each string; the
/// damage; the number of candidates with a wrong checksum.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Scan {
    pub frames: Vec<(usize, usize)>,
    pub strings: Vec<(usize, usize, Option<u8>)>,
    pub damage: Vec<Damage>,
    pub checksum_errors: u64,
}

impl Scan {
    /// Scans by the plain rules.
    pub fn plainly(input: &[u8], limit: usize) -> Self {
        let plain::Scan { frames, strings, damage, checksum_errors } = plain::scan(input, limit, 0);
        Self { frames, strings, damage, checksum_errors }
    }

    /// Scans in one window.
    pub fn whole(input: &[u8], limit: usize) -> Self {
        Self::in_windows(input, limit, |_| 0..input.len())
    }

    /// Scans in windows that grow by one byte and have no byte that the scanner has passed.
    pub fn byte_by_byte(input: &[u8], limit: usize) -> Self {
        let mut end = 0;
        Self::in_windows(input, limit, |at| {
            end = input.len().min(end + 1);
            at..end
        })
    }

    /// Scans in windows that end at random; a window can begin with some bytes that the scanner has passed.
    pub fn at_random(input: &[u8], limit: usize, random: &mut Random) -> Self {
        let mut end = 0;
        let longest = random.pick(&[3, 20, 300, 3000]);
        Self::in_windows(input, limit, |at| {
            end = input.len().min(end + random.below(longest));
            at - random.below(at.min(20) + 1)..end
        })
    }

    /// Scans in the windows that `window` gives for the scanner's position. The end of the input is announced late: after
    /// the last byte there is another window without new bytes.
    pub fn in_windows(input: &[u8], limit: usize, mut window: impl FnMut(usize) -> std::ops::Range<usize>) -> Self {
        let position = |at: u64| usize::try_from(at).expect("a position in memory");
        let mut scanner = Scanner::new(limit);
        let mut scan = Self::default();
        let mut last = false;
        loop {
            let range = window(position(scanner.at()));
            let from = range.start;
            let window = Window { bytes: &input[range.clone()], offset: from as u64, last };
            loop {
                match scanner.step(window) {
                    Step::Frame { at, length, damage } => {
                        scan.frames.push((from + at, length));
                        scan.damage.extend(damage);
                    }
                    Step::String { at, length, place, damage } => {
                        scan.strings.push((from + at, length, place));
                        scan.damage.extend(damage);
                    }
                    Step::More => {
                        assert!(!last, "the scanner waits for bytes after the end");
                        let held_back = range.end - position(scanner.at());
                        assert!(held_back < 2 * (limit + 7).max(LONGEST_STRING), "{held_back} bytes are held back");
                        break;
                    }
                    Step::End(damage) => {
                        assert!(last, "the scanner ends before the input");
                        assert_eq!(position(scanner.at()), input.len());
                        scan.damage.extend(damage);
                        scan.checksum_errors = scanner.checksum_errors;
                        return scan;
                    }
                }
            }
            last = range.end == input.len();
        }
    }

    /// Panics unless frames, strings and damage cover each byte of the input once.
    pub fn covers(&self, input: &[u8]) {
        let position = |at: u64| usize::try_from(at).expect("a position in memory");
        let damage = self.damage.iter().map(|damage| (position(damage.offset), position(damage.length)));
        let strings = self.strings.iter().map(|&(offset, length, _)| (offset, length));
        let mut stretches: Vec<_> = damage.chain(strings).chain(self.frames.iter().copied()).collect();
        stretches.sort_unstable();
        let end = stretches.iter().fold(0, |end, &(offset, length)| {
            assert_eq!(offset, end);
            assert!(length > 0);
            end + length
        });
        assert_eq!(end, input.len());
        for pair in self.damage.windows(2) {
            assert!(pair[0].offset + pair[0].length < pair[1].offset, "one damage, two rows");
        }
    }
}

/// Whether the scanner's credit is sufficient for `input`, from any position. The plain rules have no credit.
pub fn credit_suffices(input: &[u8]) -> bool {
    const CREDIT: usize = 1 << 16;
    let claims =
        input.windows(4).filter(|bytes| [bytes[0], bytes[2], bytes[3]] == [PREAMBLE, table::MTDATA2, EXTENDED]);
    claims.count() * (input.len() / 3) < CREDIT
}
