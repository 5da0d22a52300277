//! Memory that belongs to Python, and that other threads and processes may write while it is read.

use std::io;

use pyo3::buffer::PyBuffer;
use pyo3::prelude::*;

use crate::input::ReadAt;

/// The bytes of an array, a bytearray, a memory map or another object that exports them.
pub struct SharedBytes(PyBuffer<u8>);

impl SharedBytes {
    /// The bytes of a contiguous array.
    pub fn of(array: &Bound<'_, PyAny>) -> PyResult<Self> {
        Ok(Self(PyBuffer::get(array)?))
    }
}

impl ReadAt for SharedBytes {
    fn size(&self) -> io::Result<u64> {
        Ok(self.0.as_slice_ptr().map_or(0, |bytes| bytes.len() as u64))
    }

    fn read_at(&self, buffer: &mut [u8], position: u64) -> io::Result<usize> {
        let Some(bytes) = self.0.as_slice_ptr() else { return Ok(0) };
        let position = usize::try_from(position).unwrap_or(usize::MAX).min(bytes.len());
        let size = buffer.len().min(bytes.len() - position);
        // SAFETY: The object does not move or free its memory while the buffer is exported, and `position..position + size`
        // lies inside of it. A slice of it must not exist, because others may write to it. So it is copied through a pointer:
        // whatever bytes another thread writes meanwhile, each that arrives is a valid u8, and only the copy is looked at.
        #[allow(unsafe_code)]
        unsafe {
            let from = bytes.as_ptr().cast::<u8>().add(position);
            std::ptr::copy_nonoverlapping(from, buffer.as_mut_ptr(), size);
        }
        Ok(size)
    }
}
