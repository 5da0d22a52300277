//! Room for columns that grow by megabytes.
//!
//! Touching fresh memory for the first time is the largest single cost of decoding into new columns: with 4 KiB pages
//! about 3 GB/s, with huge pages about 8. So a column that has shown its pace gets its room at once, and the kernel is
//! told that huge pages are welcome there.

use crate::column::Progress;

/// Below this many numbers a vector grows as vectors do: a quantity that turns up once must not reserve for millions.
const SMALL: usize = 1 << 14;

/// Makes sure that `more` numbers fit behind those in `out`.
///
/// A full vector grows to what the rest of the input will need if it goes on like this, and a little more; so it moves
/// once or twice in all, and most of the room is touched only when it is written.
pub fn make_room<T>(out: &mut Vec<T>, more: usize, progress: Progress) {
    if out.capacity() - out.len() >= more {
        return;
    }
    let needed = out.len() + more;
    let doubled = needed.max(2 * out.len());
    if needed < SMALL {
        return out.reserve_exact(doubled - out.len());
    }
    let expected = needed as u128 * u128::from(progress.total) / u128::from(progress.done.max(1));
    // No number takes less than a byte of input.
    let most = needed as u128 + u128::from(progress.total.saturating_sub(progress.done));
    let expected = usize::try_from((expected + expected / 64).min(most)).unwrap_or(needed);
    // An input that says it is longer than it can be must not be believed.
    if out.try_reserve_exact(expected.max(doubled) - out.len()).is_err() {
        out.reserve_exact(doubled - out.len());
    }
    welcome_huge_pages(out);
}

/// A vector with room for `length` numbers.
#[must_use]
pub fn with_room<T>(length: usize) -> Vec<T> {
    let mut out = Vec::with_capacity(length);
    welcome_huge_pages(&mut out);
    out
}

#[cfg(target_os = "linux")]
fn welcome_huge_pages<T>(out: &mut Vec<T>) {
    /// Smaller ones would waste most of a huge page of 2 MiB.
    const WORTHWHILE: usize = 4 << 20;
    const PAGE: usize = 4096;
    let from = out.as_ptr().addr().next_multiple_of(PAGE);
    let to = (out.as_ptr().addr() + out.capacity() * size_of::<T>()) / PAGE * PAGE;
    if to.saturating_sub(from) < WORTHWHILE {
        return;
    }
    // SAFETY: MADV_HUGEPAGE changes how the kernel backs a range, never what is in it. The range lies inside memory that
    // this vector owns and is made of whole pages. If the kernel refuses, nothing is lost, so the result is not looked at.
    #[allow(unsafe_code)]
    unsafe {
        libc::madvise(from as *mut libc::c_void, to - from, libc::MADV_HUGEPAGE);
    }
}

#[cfg(not(target_os = "linux"))]
fn welcome_huge_pages<T>(_: &mut Vec<T>) {}
