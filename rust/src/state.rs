//! Parts of logs and clocks as bytes, to hand them to another process or to keep them for a while.
//!
//! The bytes are the version of this crate, the CRC-32 of the state, and the state. Another version refuses them, since
//! its tables may differ. Damaged bytes are refused too: a state whose lengths do not agree would panic wherever it is
//! used, and abort the process inside an Arrow stream. Bytes with a good CRC-32 are trusted.

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::error::StateError;

const VERSION: &str = env!("CARGO_PKG_VERSION");
const CHECKSUM_SIZE: usize = size_of::<u32>();

/// The state of a value.
///
/// # Panics
/// Never: what this crate serializes has no maps and no sequences of unknown length.
#[must_use]
pub fn to_bytes<T: Serialize>(value: &T) -> Vec<u8> {
    let mut bytes = postcard::to_stdvec(VERSION).expect("a string always serializes");
    let checksum = bytes.len();
    bytes.extend([0; CHECKSUM_SIZE]);
    let mut bytes = postcard::to_extend(value, bytes).expect("structs, enums and vectors always serialize");
    let state = checksum + CHECKSUM_SIZE;
    let crc = crc32fast::hash(&bytes[state..]);
    bytes[checksum..state].copy_from_slice(&crc.to_le_bytes());
    bytes
}

/// The value of a state.
///
/// # Errors
/// If another version made it, or if it is damaged.
pub fn from_bytes<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, StateError> {
    let (version, state) = postcard::take_from_bytes::<String>(bytes).map_err(|_| StateError::Damaged)?;
    if version != VERSION {
        return Err(StateError::Version(version));
    }
    let (checksum, state) = state.split_first_chunk::<CHECKSUM_SIZE>().ok_or(StateError::Damaged)?;
    if crc32fast::hash(state) != u32::from_le_bytes(*checksum) {
        return Err(StateError::Damaged);
    }
    postcard::from_bytes(state).map_err(|_| StateError::Damaged)
}
