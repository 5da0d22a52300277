//! A descriptor to read from. It is a duplicate, so that it stays valid when the owner closes the original and the system
//! gives its number to another file.
//!
//! A duplicate shares its flags with the original, so this module sets none: whether reads block is up to the owner. Each
//! read follows a poll and takes the bytes that are available.

use std::fs::File;
use std::io::{self, PipeReader, PipeWriter, Read, Write, pipe};
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd, RawFd};
use std::time::Duration;

/// A port, and the pipe that interrupts a wait for it.
#[derive(Debug)]
pub struct Port {
    file: File,
    woken: PipeReader,
    wake: PipeWriter,
}

/// The result of a read.
#[derive(Debug, PartialEq, Eq)]
pub enum Event {
    /// This number of bytes.
    Bytes(usize),
    /// A call of [`Port::wake`].
    Wake,
    /// The end: no more bytes will be received.
    End,
}

impl Port {
    /// Duplicates a descriptor.
    ///
    /// # Errors
    /// Those of the system: it is not open, or too many are.
    pub fn of(fd: RawFd) -> io::Result<Self> {
        // SAFETY: no memory is involved; the system refuses a number that is not an open descriptor.
        #[allow(unsafe_code)]
        let duplicate = unsafe { libc::fcntl(fd, libc::F_DUPFD_CLOEXEC, 0) };
        if duplicate < 0 {
            return Err(io::Error::last_os_error());
        }
        // SAFETY: the descriptor has just been created, and nothing else uses it.
        #[allow(unsafe_code)]
        let file = File::from(unsafe { OwnedFd::from_raw_fd(duplicate) });
        let (woken, wake) = pipe()?;
        Ok(Self { file, woken, wake })
    }

    /// Waits for bytes and takes those that are available.
    ///
    /// # Errors
    /// Those of the system.
    pub fn read(&self, buffer: &mut [u8]) -> io::Result<Event> {
        /// Errors of a port that was unplugged, and of a pseudo-terminal whose other side is closed.
        const GONE: [i32; 2] = [libc::EIO, libc::ENXIO];
        let mut forever = true;
        loop {
            let timeout = if forever { FOREVER } else { 0 };
            let mut entries = [readable(&self.file), readable(&self.woken)];
            poll(&mut entries, timeout)?;
            let [port, wake] = entries.map(|entry| entry.revents);
            if wake != 0 {
                return Ok(Event::Wake);
            }
            if port & libc::POLLNVAL != 0 {
                return Err(io::Error::from_raw_os_error(libc::EBADF));
            }
            if port == 0 {
                forever = true;
                continue;
            }
            match (&self.file).read(buffer) {
                // A terminal may be configured to return nothing instead of waiting. So it is the end only if a second poll
                // reports bytes again; otherwise another reader was faster.
                Ok(0) if forever => forever = false,
                Ok(0) => return Ok(Event::End),
                Ok(bytes) => return Ok(Event::Bytes(bytes)),
                Err(error) if error.raw_os_error().is_some_and(|number| GONE.contains(&number)) => {
                    return Ok(Event::End);
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) if error.kind() == io::ErrorKind::WouldBlock && port & libc::POLLHUP == 0 => {}
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(Event::End),
                Err(error) => return Err(error),
            }
        }
    }

    /// Interrupts the current or the next wait.
    pub fn wake(&self) {
        // A full pipe interrupts the wait, too.
        let _ = (&self.wake).write(&[0]);
    }

    /// Waits so that more bytes arrive together, until [`Port::wake`] is called at most.
    pub fn rest(&self, time: Duration) {
        // If it fails the next read reports why.
        let _ = poll(&mut [readable(&self.woken)], i32::try_from(time.as_millis()).unwrap_or(i32::MAX));
    }

    /// How often the driver or its chip had no room for a byte, since the system started; `None` if that is not counted.
    #[cfg(target_os = "linux")]
    pub fn overruns(&self) -> Option<u64> {
        // struct serial_icounter_struct of linux/serial.h: cts, dsr, rng, dcd, rx, tx, frame, overrun, parity, brk,
        // buf_overrun, and nine reserved.
        const OVERRUN: usize = 7;
        const BUF_OVERRUN: usize = 10;
        let mut counters = [0 as libc::c_int; 20];
        // SAFETY: the request fills one such structure, twenty integers, which outlives the call.
        #[allow(unsafe_code)]
        let result = unsafe { libc::ioctl(self.file.as_raw_fd(), libc::TIOCGICOUNT, counters.as_mut_ptr()) };
        let count = |at: usize| u64::from(counters[at].cast_unsigned());
        (result == 0).then(|| count(OVERRUN) + count(BUF_OVERRUN))
    }

    /// How often the driver or its chip had no room for a byte; this system does not report it.
    #[cfg(not(target_os = "linux"))]
    #[allow(clippy::unused_self)]
    pub fn overruns(&self) -> Option<u64> {
        None
    }
}

const FOREVER: i32 = -1;

fn readable(file: &impl AsRawFd) -> libc::pollfd {
    libc::pollfd { fd: file.as_raw_fd(), events: libc::POLLIN, revents: 0 }
}

/// Waits until one of the entries has an event, at most for `timeout` milliseconds.
fn poll(entries: &mut [libc::pollfd], timeout: i32) -> io::Result<()> {
    #[allow(clippy::cast_possible_truncation)] // at most two
    let count = entries.len() as libc::nfds_t;
    loop {
        // SAFETY: the pointer and the count are those of a slice that outlives the call.
        #[allow(unsafe_code)]
        let result = unsafe { libc::poll(entries.as_mut_ptr(), count, timeout) };
        if result >= 0 {
            return Ok(());
        }
        let error = io::Error::last_os_error();
        if error.kind() != io::ErrorKind::Interrupted {
            return Err(error);
        }
    }
}
