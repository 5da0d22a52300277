//! Work that ends early: a panic, or no memory, as an error for the caller.
//!
//! Columns grow in many places, and all of them would have to return an error for the rare case that the system has no more
//! memory. Instead [`out_of_memory`] unwinds to [`catch`], which every call from Python goes through.

use std::any::Any;
use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};

/// Why work ended early.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Caught {
    /// The system has no more memory.
    OutOfMemory,
    /// A panic with this message: a fault of this crate.
    Panic(String),
}

impl fmt::Display for Caught {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::OutOfMemory => f.write_str("not enough memory"),
            Self::Panic(message) => {
                write!(
                    f,
                    "a fault of xbus, not of the input ({message}); please report it with the input that causes it"
                )
            }
        }
    }
}

impl std::error::Error for Caught {}

/// What [`out_of_memory`] unwinds with.
struct OutOfMemory;

/// Ends the work that [`catch`] has begun, because the system has no more memory.
pub fn out_of_memory() -> ! {
    resume_unwind(Box::new(OutOfMemory)) // without the message and the backtrace of a panic
}

/// Ends the work if there is no memory for this many bytes more, and at least for `ROOM`: small vectors and some libraries
/// do not check whether there is any, and abort the process.
pub fn expect_memory(size: usize) {
    if Vec::<u8>::new().try_reserve_exact(size.max(ROOM)).is_err() {
        out_of_memory();
    }
}

/// When glibc frees less than this, it later keeps more memory instead of returning it to the system.
const ROOM: usize = (32 << 20) + 1;

/// Does work. What it changes is not to be used any more if it ends early.
///
/// # Errors
/// If it ended early, in this thread or in one whose panic was passed on to this thread.
pub fn catch<T>(work: impl FnOnce() -> T) -> Result<T, Caught> {
    catch_unwind(AssertUnwindSafe(work)).map_err(|payload| caught(payload.as_ref()))
}

fn caught(payload: &(dyn Any + Send)) -> Caught {
    if payload.is::<OutOfMemory>() {
        return Caught::OutOfMemory;
    }
    let text = payload.downcast_ref::<&str>().map(ToString::to_string);
    let text = text.or_else(|| payload.downcast_ref::<String>().cloned());
    Caught::Panic(text.unwrap_or_else(|| "no message".into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn panic(message: &str) -> Result<(), Caught> {
        Err(Caught::Panic(message.into()))
    }

    #[test]
    fn work_ends_with_its_result_or_with_why_it_ended() {
        assert_eq!(catch(|| 1), Ok(1));
        assert_eq!(catch(|| panic!("constant")), panic("constant"));
        assert_eq!(catch(|| panic!("byte {}", 7)), panic("byte 7"));
        assert_eq!(catch(|| std::panic::panic_any(7)), panic("no message"));
        assert_eq!(catch(|| out_of_memory()), Err::<(), _>(Caught::OutOfMemory));
    }
}
