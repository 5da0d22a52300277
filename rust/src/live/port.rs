//! A descriptor to read from: a duplicate, so that it stays what it is when its owner closes the original and the number
//! goes to another file.
//!
//! The duplicate shares its flags with the original, so none are set: whether reads block is the owner's business. A read
//! follows a poll and takes what is there.

use std::fs::File;
use std::io::{self, PipeReader, PipeWriter, Read, Write, pipe};
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd, RawFd};
use std::time::Duration;

/// A port, and the pipe that ends a wait for it.
#[derive(Debug)]
pub struct Port {
    file: File,
    woken: PipeReader,
    wake: PipeWriter,
}

/// What a wait has brought.
#[derive(Debug, PartialEq, Eq)]
pub enum Came {
    /// So many bytes.
    Bytes(usize),
    /// Somebody called [`Port::wake`].
    Wake,
    /// There will be no more.
    End,
}

impl Port {
    /// Duplicates a descriptor.
    ///
    /// # Errors
    /// What the system says: it is not open, or too many are.
    pub fn of(fd: RawFd) -> io::Result<Self> {
        // SAFETY: no memory is involved; a number that is no open descriptor is refused.
        #[allow(unsafe_code)]
        let duplicate = unsafe { libc::fcntl(fd, libc::F_DUPFD_CLOEXEC, 0) };
        if duplicate < 0 {
            return Err(io::Error::last_os_error());
        }
        // SAFETY: the descriptor was made just now, and nobody else knows it.
        #[allow(unsafe_code)]
        let file = File::from(unsafe { OwnedFd::from_raw_fd(duplicate) });
        let (woken, wake) = pipe()?;
        Ok(Self { file, woken, wake })
    }

    /// Waits for bytes and takes those that are there.
    ///
    /// # Errors
    /// What the system says.
    pub fn read(&self, buffer: &mut [u8]) -> io::Result<Came> {
        /// What a port says that has been unplugged, and a pseudo-terminal whose other side is closed.
        const GONE: [i32; 2] = [libc::EIO, libc::ENXIO];
        let mut forever = true;
        loop {
            let timeout = if forever { FOREVER } else { 0 };
            let mut entries = [readable(&self.file), readable(&self.woken)];
            poll(&mut entries, timeout)?;
            let [port, wake] = entries.map(|it| it.revents);
            if wake != 0 {
                return Ok(Came::Wake);
            }
            if port & libc::POLLNVAL != 0 {
                return Err(io::Error::from_raw_os_error(libc::EBADF));
            }
            if port == 0 {
                forever = true;
                continue;
            }
            match (&self.file).read(buffer) {
                // A terminal may be set to return nothing rather than wait, so nothing is an end only where poll insists
                // that there is something; else somebody was quicker.
                Ok(0) if forever => forever = false,
                Ok(0) => return Ok(Came::End),
                Ok(bytes) => return Ok(Came::Bytes(bytes)),
                Err(error) if error.raw_os_error().is_some_and(|it| GONE.contains(&it)) => return Ok(Came::End),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) if error.kind() == io::ErrorKind::WouldBlock && port & libc::POLLHUP == 0 => {}
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(Came::End),
                Err(error) => return Err(error),
            }
        }
    }

    /// Ends a wait, now or to come.
    pub fn wake(&self) {
        // A pipe that is full has been written to before.
        let _ = (&self.wake).write(&[0]);
    }

    /// Lets bytes come together for so long, unless somebody calls [`Port::wake`].
    pub fn rest(&self, time: Duration) {
        // If it fails there is no rest, and the next read says why.
        let _ = poll(&mut [readable(&self.woken)], i32::try_from(time.as_millis()).unwrap_or(i32::MAX));
    }

    /// How often the driver or its chip had no room for a byte, since the system started; `None` where nobody counts.
    #[cfg(target_os = "linux")]
    pub fn overruns(&self) -> Option<u64> {
        // struct serial_icounter_struct of linux/serial.h: cts, dsr, rng, dcd, rx, tx, frame, overrun, parity, brk,
        // buf_overrun, and nine reserved.
        const OVERRUN: usize = 7;
        const BUF_OVERRUN: usize = 10;
        let mut counters = [0 as libc::c_int; 20];
        // SAFETY: the request fills in one such structure, twenty integers, which lives through the call.
        #[allow(unsafe_code)]
        let result = unsafe { libc::ioctl(self.file.as_raw_fd(), libc::TIOCGICOUNT, counters.as_mut_ptr()) };
        let count = |at: usize| u64::from(counters[at].cast_unsigned());
        (result == 0).then(|| count(OVERRUN) + count(BUF_OVERRUN))
    }

    /// How often the driver or its chip had no room for a byte; this system does not tell.
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

/// Waits until something has happened to one of them, for so many milliseconds.
fn poll(entries: &mut [libc::pollfd], timeout: i32) -> io::Result<()> {
    #[allow(clippy::cast_possible_truncation)] // two at most
    let count = entries.len() as libc::nfds_t;
    loop {
        // SAFETY: the pointer and the count are those of a slice that lives through the call.
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
