//! The side file with the times of arrival. [`recorder`](super) documents its format.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::Path;

/// The first bytes of the file.
pub const TIMES_MAGIC: [u8; 8] = *b"XBUSTIME";
/// Version of the format.
pub const TIMES_VERSION: u32 = 1;
/// Bytes before the first record.
pub const TIMES_HEADER: usize = 24;
/// Bytes of a record.
const RECORD_SIZE: u32 = 16;
/// Least time between two records, in ns.
const LEAST_INTERVAL: i64 = 10_000_000;

/// A side file.
#[derive(Debug)]
pub struct Times {
    file: File,
    /// Records to be written with the next flush.
    records: Vec<u8>,
    /// Arrival of the last record.
    last: Option<i64>,
    /// Position and arrival of the last piece that was left out since.
    left_out: Option<(u64, i64)>,
}

impl Times {
    /// Creates the file. `epoch` is what to add to the host's steady clock for nanoseconds since 1970.
    pub fn new(path: &Path, epoch: i64) -> io::Result<Self> {
        let mut file = File::create(path)?;
        let mut header = Vec::with_capacity(TIMES_HEADER);
        header.extend(TIMES_MAGIC);
        header.extend(TIMES_VERSION.to_le_bytes());
        header.extend(RECORD_SIZE.to_le_bytes());
        header.extend(epoch.to_le_bytes());
        if let Err(error) = file.write_all(&header) {
            let _ = fs::remove_file(path);
            return Err(error);
        }
        Ok(Self { file, records: vec![], last: None, left_out: None })
    }

    /// Whether there is no record.
    pub const fn is_empty(&self) -> bool {
        self.last.is_none()
    }

    /// Adds a record, unless the last one is too close. `arrival` is in nanoseconds since 1970.
    pub fn add(&mut self, position: u64, arrival: i64) {
        if self.last.is_some_and(|last| arrival.saturating_sub(last) < LEAST_INTERVAL) {
            self.left_out = Some((position, arrival));
            return;
        }
        self.last = Some(arrival);
        self.left_out = None;
        self.push((position, arrival));
    }

    fn push(&mut self, (position, arrival): (u64, i64)) {
        self.records.extend(position.to_le_bytes());
        self.records.extend(arrival.to_le_bytes());
    }

    /// Writes the records; if the file ends, with that of the last piece in any case.
    pub fn flush(&mut self, ends: bool, fsync: bool) -> io::Result<()> {
        if let Some(left_out) = self.left_out.take_if(|_| ends) {
            self.push(left_out);
        }
        self.file.write_all(&self.records)?;
        self.records.clear();
        if fsync { self.file.sync_data() } else { Ok(()) }
    }
}
