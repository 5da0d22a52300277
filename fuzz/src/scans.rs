//! Everything a scanner says about an input, in whatever pieces it gets it.

use xbus::frame::{EXTENDED, PREAMBLE};
use xbus::scan::{Damage, Scanner, Step, Window, plain};
use xbus::strings::LONGEST_STRING;
use xbus::table;

use super::streams::Random;

/// What a scanner found: offset and length of each frame; the same of each string, and its place in the table; the damage;
/// the candidates that their checksum refused.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Scan {
    pub frames: Vec<(usize, usize)>,
    pub strings: Vec<(usize, usize, Option<u8>)>,
    pub damage: Vec<Damage>,
    pub checksum_errors: u64,
}

impl Scan {
    /// By the plain rules.
    pub fn plainly(input: &[u8], limit: usize) -> Self {
        let plain::Scan { frames, strings, damage, checksum_errors } = plain::scan(input, limit, 0);
        Self { frames, strings, damage, checksum_errors }
    }

    /// In one window.
    pub fn whole(input: &[u8], limit: usize) -> Self {
        Self::in_windows(input, limit, |_| 0..input.len())
    }

    /// One byte more at a time, and none that the scanner needs no more.
    pub fn byte_by_byte(input: &[u8], limit: usize) -> Self {
        let mut end = 0;
        Self::in_windows(input, limit, |at| {
            end = input.len().min(end + 1);
            at..end
        })
    }

    /// Cut where it happens to be cut; a window may still have some bytes from before.
    pub fn at_random(input: &[u8], limit: usize, random: &mut Random) -> Self {
        let mut end = 0;
        let longest = random.pick(&[3, 20, 300, 3000]);
        Self::in_windows(input, limit, |at| {
            end = input.len().min(end + random.below(longest));
            at - random.below(at.min(20) + 1)..end
        })
    }

    /// In the windows that `window` gives for the scanner's position. That the input ends becomes known late: after the
    /// last byte there is once more a window without anything new.
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
                        assert!(!last, "the scanner waits for bytes behind the end");
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

    /// Frames, strings and damage cover the input, no byte twice.
    pub fn covers(&self, input: &[u8]) {
        let position = |at: u64| usize::try_from(at).expect("a position in memory");
        let damage = self.damage.iter().map(|it| (position(it.offset), position(it.length)));
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

/// Whether no scanner can run out of credit on `input`, wherever it is: the plain rules know no credit.
pub fn credit_suffices(input: &[u8]) -> bool {
    const CREDIT: usize = 1 << 16;
    let claims = input.windows(4).filter(|it| [it[0], it[2], it[3]] == [PREAMBLE, table::MTDATA2, EXTENDED]);
    claims.count() * (input.len() / 3) < CREDIT
}
