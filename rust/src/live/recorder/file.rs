//! One file of a recording, with its side file of times.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use super::Recording;
use super::times::Times;

/// A file that is being written.
#[derive(Debug)]
pub struct LogFile {
    pub path: PathBuf,
    file: File,
    /// Bytes in the file.
    pub length: u64,
    /// Bytes up to the end of the last whole frame.
    pub whole: u64,
    /// When its first bytes arrived; `None` if there are none.
    pub began: Option<i64>,
    times: Option<Times>,
    /// Whether there was no file with this path before.
    is_new: bool,
}

impl LogFile {
    /// Creates a file and writes its head, followed by `strings`, a frame or nothing.
    pub fn new(recording: &Recording, strings: &[u8], path: PathBuf, epoch: i64) -> io::Result<Self> {
        let is_new = fs::symlink_metadata(&path).is_err();
        let file = open(&path, recording.overwrite)?;
        let times_path = times_path(&path);
        let is_file = file.metadata()?.is_file();
        let times = if recording.times && is_file {
            // Before anything is overwritten, because it may fail.
            let times = Times::new(&times_path, epoch);
            if times.is_err() && is_new {
                let _ = fs::remove_file(&path);
            }
            Some(times?)
        } else {
            None
        };
        if is_file {
            file.set_len(0)?;
            if times.is_none() {
                // The times of a log that has just been overwritten would be taken for those of the new one.
                let _ = fs::remove_file(times_path);
            }
        }
        let mut output = Self { path, file, length: 0, whole: 0, began: None, times, is_new };
        if let Err(error) = output.write(&recording.head).and_then(|()| output.write(strings)) {
            output.truncate();
            return Err(error);
        }
        output.whole = output.length;
        Ok(output)
    }

    /// Writes bytes. `length` counts what the file has taken even if it does not take all.
    pub fn write(&mut self, mut bytes: &[u8]) -> io::Result<()> {
        while !bytes.is_empty() {
            match self.file.write(bytes) {
                Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
                Ok(more) => {
                    self.length += more as u64;
                    bytes = &bytes[more..];
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// Truncates the file after its last whole frame; returns how many bytes that removes. Removes a new file in which
    /// nothing is left, and a side file without a record.
    pub fn truncate(&mut self) -> u64 {
        // What cannot be truncated, such as a device, stays as it is: a log may end anywhere.
        if self.file.set_len(self.whole).is_err() {
            return 0;
        }
        let is_empty = self.whole == 0 && self.is_new;
        if is_empty {
            let _ = fs::remove_file(&self.path);
        }
        if self.times.as_ref().is_some_and(|times| is_empty || times.is_empty()) {
            let _ = fs::remove_file(times_path(&self.path));
        }
        let length = std::mem::replace(&mut self.length, self.whole);
        length - self.whole
    }

    /// Adds a time of arrival, in nanoseconds since 1970.
    pub fn add_time(&mut self, position: u64, arrival: i64) {
        if let Some(times) = &mut self.times {
            times.add(position, arrival);
        }
    }

    /// Whether a name still leads to the file: one that was removed takes bytes, and loses them at the end.
    #[cfg(unix)]
    fn check_exists(&self) -> io::Result<()> {
        use std::os::unix::fs::MetadataExt;
        if self.file.metadata()?.nlink() > 0 {
            return Ok(());
        }
        Err(io::Error::new(io::ErrorKind::NotFound, "the file was removed while it was being written"))
    }

    /// This system does not remove a file that is open.
    #[cfg(not(unix))]
    #[allow(clippy::unused_self, clippy::unnecessary_wraps)]
    fn check_exists(&self) -> io::Result<()> {
        Ok(())
    }

    /// Writes the times, and makes the disk store everything if `fsync` is set; `ends` is whether the file is complete.
    pub fn flush(&mut self, ends: bool, fsync: bool) -> io::Result<()> {
        self.check_exists()?;
        if fsync {
            self.file.sync_data()?;
        }
        // Times follow the bytes that they refer to.
        self.times.as_mut().map_or(Ok(()), |times| times.flush(ends, fsync))
    }
}

/// The path of the side file.
fn times_path(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".times");
    name.into()
}

/// Opens a file to be written, without truncating it. It is an error if it exists and is not empty, unless it may be
/// overwritten, and if it is a pipe, whose opening would wait for a reader. Other special files, like `/dev/null`, will do.
fn open(path: &Path, overwrite: bool) -> io::Result<File> {
    if let Ok(existing) = fs::metadata(path) {
        if existing.is_file() && existing.len() > 0 && !overwrite {
            #[cfg(unix)]
            return Err(io::Error::from_raw_os_error(libc::EEXIST));
            #[cfg(not(unix))]
            return Err(io::Error::from_raw_os_error(80)); // ERROR_FILE_EXISTS
        }
        #[cfg(unix)]
        if std::os::unix::fs::FileTypeExt::is_fifo(&existing.file_type()) {
            return Err(io::Error::from_raw_os_error(libc::ESPIPE));
        }
    }
    fs::OpenOptions::new().write(true).create(true).truncate(false).open(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_truncated_file_keeps_whole_frames_and_their_times() {
        let path = std::env::temp_dir().join(format!("xbus-truncated-{}.mtb", std::process::id()));
        let left = |head: &[u8], has_times: bool| {
            let recording = Recording { head: head.to_vec(), overwrite: true, ..Recording::to(&path) };
            let mut file = LogFile::new(&recording, &[], path.clone(), 0).unwrap();
            file.write(b"part of a frame").unwrap();
            if has_times {
                file.add_time(file.length, 0);
            }
            assert_eq!((file.truncate(), file.length), (15, head.len() as u64));
            let log = fs::read(&path).ok();
            let _ = fs::remove_file(&path);
            (log, fs::remove_file(times_path(&path)).is_ok())
        };
        assert_eq!(left(b"", false), (None, false));
        assert_eq!(left(b"", true), (None, false));
        assert_eq!(left(b"head", false), (Some(b"head".to_vec()), false));
        assert_eq!(left(b"head", true), (Some(b"head".to_vec()), true));
    }
}
