//! Memory for columns that grow by megabytes.
//!
//! The first touch of fresh memory is the largest single cost of decoding into new columns: about 3 GB/s with pages of
//! 4 KiB, about 8 GB/s with huge pages. So a column reserves all the memory that it is expected to need at once, and asks
//! the kernel for huge pages.

use std::cell::Cell;

use crate::catch::{expect_memory, out_of_memory};
use crate::column::Progress;

/// Below this many numbers a vector grows at most by `PACE`: a quantity that occurs once must not reserve memory for
/// millions of rows.
const SMALL: usize = 1 << 14;
/// How many times as large a small vector becomes if the rest of the input is expected to need it.
const PACE: usize = 16;
/// Bytes of a page of memory on most systems.
const PAGE: usize = 4096;
/// Bytes that a thread takes between two checks of the memory that is left. A check maps memory and returns it, which takes
/// as long as decoding a few kilobytes.
const UNCHECKED: usize = 4 << 20;

/// Reserves memory for at least `more` numbers at the end of `out`.
///
/// A full vector grows to what the rest of the input will need at the current pace, and a little more. So it moves once or
/// twice in all, and most of the memory is touched only when it is written.
pub fn reserve<T>(out: &mut Vec<T>, more: usize, progress: Progress) {
    if out.capacity() - out.len() >= more {
        return;
    }
    let needed = out.len() + more;
    let doubled = needed.max(2 * out.len());
    let expected = needed as u128 * u128::from(progress.total) / u128::from(progress.done.max(1));
    // A number takes at least one byte of input.
    let most = needed as u128 + u128::from(progress.total.saturating_sub(progress.done));
    let expected = usize::try_from((expected + expected / 64).min(most)).unwrap_or(needed);
    if needed < SMALL {
        return reserve_or_end(out, doubled.max(expected.min(PACE * needed).min(SMALL)) - out.len());
    }
    // The stated length of the input may be wrong.
    if out.try_reserve_exact(expected.max(doubled) - out.len()).is_err() {
        reserve_or_end(out, doubled - out.len());
    }
    leave_room(out);
    request_huge_pages(out);
}

/// Reserves memory for `more` numbers at the end of `out`, or ends the work: see [`out_of_memory`].
pub fn reserve_or_end<T>(out: &mut Vec<T>, more: usize) {
    if out.try_reserve_exact(more).is_err() {
        out_of_memory();
    }
    leave_room(out);
}

/// Ends the work if this vector and those before it took nearly all memory: other code does not check whether there is any.
/// Many small vectors count as one large one.
fn leave_room<T>(out: &Vec<T>) {
    leave_room_for(out.capacity() * size_of::<T>());
}

/// As [`leave_room`], for other memory of this size.
pub fn leave_room_for(size: usize) {
    if is_check_due(size) {
        expect_memory(0);
    }
}

/// Whether a thread has taken so much memory since its last check that the next one is due.
fn is_check_due(size: usize) -> bool {
    /// What malloc adds to each piece of memory.
    const OVERHEAD: usize = 16;
    thread_local! {
        static TAKEN: Cell<usize> = const { Cell::new(0) };
    }
    // glibc's malloc gives each piece separate pages once a thread cannot get another heap, which takes 64 MiB.
    let own = size.saturating_add(OVERHEAD).checked_next_multiple_of(PAGE).unwrap_or(size);
    let taken = TAKEN.get().saturating_add(own);
    let is_due = taken >= UNCHECKED;
    TAKEN.set(if is_due { 0 } else { taken });
    is_due
}

/// All numbers of an iterator.
#[cfg(feature = "arrow")]
pub fn collect<T>(numbers: impl ExactSizeIterator<Item = T>) -> Vec<T> {
    let mut out = with_capacity(numbers.len());
    out.extend(numbers);
    out
}

/// Appends a number to a vector that doubles when it is full.
#[inline]
pub fn push<T>(out: &mut Vec<T>, number: T) {
    extend(out, [number]);
}

/// Appends numbers to a vector that at least doubles when it is full.
#[inline]
pub fn extend<T>(out: &mut Vec<T>, numbers: impl IntoIterator<Item = T, IntoIter: ExactSizeIterator>) {
    let numbers = numbers.into_iter();
    if out.capacity() - out.len() < numbers.len() {
        let doubled = out.len().max(4);
        reserve_or_end(out, numbers.len().max(doubled));
    }
    out.extend(numbers);
}

/// An empty vector with memory for `length` numbers.
#[must_use]
pub fn with_capacity<T>(length: usize) -> Vec<T> {
    let mut out = vec![];
    reserve_or_end(&mut out, length);
    request_huge_pages(&mut out);
    out
}

/// An empty buffer of Arrow with memory for `size` bytes.
#[cfg(feature = "arrow")]
#[must_use]
pub fn buffer(size: usize) -> arrow_buffer::MutableBuffer {
    let Ok(mut out) = arrow_buffer::MutableBuffer::try_with_capacity(size) else { out_of_memory() };
    leave_room_for(size);
    request(out.as_mut_ptr(), out.capacity());
    out
}

fn request_huge_pages<T>(out: &mut Vec<T>) {
    request(out.as_mut_ptr().cast(), out.capacity() * size_of::<T>());
}

/// Requests huge pages for the memory from `start` on, which belongs to the caller.
#[cfg(target_os = "linux")]
fn request(start: *mut u8, size: usize) {
    /// Least size in bytes. Smaller ones would waste most of a huge page of 2 MiB.
    const LEAST_SIZE: usize = 4 << 20;
    let from = start.addr().next_multiple_of(PAGE);
    let to = (start.addr() + size) / PAGE * PAGE;
    if to.saturating_sub(from) < LEAST_SIZE {
        return;
    }
    // SAFETY: MADV_HUGEPAGE changes how the kernel backs a range, never its contents. The range consists of whole pages
    // inside memory that the caller owns. The result is ignored, because a refusal only costs speed.
    #[allow(unsafe_code)]
    unsafe {
        libc::madvise(from as *mut libc::c_void, to - from, libc::MADV_HUGEPAGE);
    }
}

#[cfg(not(target_os = "linux"))]
fn request(_: *mut u8, _: usize) {}

/// Lets the process keep the memory that it frees, and use it again: up to 256 MiB in the main thread, in others about as
/// much as they needed at once. Otherwise malloc returns large vectors to the system, and every part of a log pays for
/// the first touch of fresh memory again.
///
/// This is for a program that does nothing but read logs part by part. Only glibc has these settings.
#[cfg(feature = "python")]
#[pyo3::pyfunction]
pub fn keep_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        /// The largest that glibc accepts.
        const MMAP_THRESHOLD: i32 = 32 << 20;
        /// A part of a log, its columns and its DataFrame.
        const TRIM_THRESHOLD: i32 = 256 << 20;
        /// The memory of other threads consists of heaps of this size. Whatever the threshold, an empty heap is returned
        /// if the one before it has more room than the padding. No heap has that much, so none is returned. A new heap
        /// counts as a whole for `ulimit -d`.
        const TOP_PAD: i32 = 64 << 20;
        // SAFETY: mallopt takes two numbers and changes how malloc gets memory from the system. It ignores what it does not
        // know.
        #[allow(unsafe_code)]
        unsafe {
            libc::mallopt(libc::M_MMAP_THRESHOLD, MMAP_THRESHOLD);
            libc::mallopt(libc::M_TRIM_THRESHOLD, TRIM_THRESHOLD);
            libc::mallopt(libc::M_TOP_PAD, TOP_PAD);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_small_vectors_count_as_a_large_one() {
        let mut out: Vec<u64> = vec![];
        while is_check_due(0) {}
        let due = (0..100_000).filter(|_| {
            out = vec![];
            out.reserve_exact(7);
            is_check_due(out.capacity() * size_of::<u64>())
        });
        assert_eq!(due.count(), 100_000 * PAGE / UNCHECKED);
        assert!(is_check_due(UNCHECKED) && is_check_due(usize::MAX) && !is_check_due(0));
    }

    #[test]
    fn a_small_vector_grows_as_the_input_will_need() {
        let capacity = |needed, total| {
            let mut out: Vec<u32> = vec![];
            reserve(&mut out, needed, Progress { done: 1000, total });
            out.capacity()
        };
        assert_eq!(capacity(100, 1000), 100); // all of the input is read
        assert_eq!(capacity(100, 5000), 507);
        assert_eq!(capacity(100, 1 << 40), 100 * PACE);
        assert_eq!(capacity(10_000, 1 << 40), SMALL);
        assert_eq!(capacity(1, 1 << 40), PACE);
    }
}
