//! Parts of logs and clocks as bytes, to hand them to another process or to keep them for a while.
//!
//! The bytes are those of one version of this crate: another one refuses them, since its tables may differ. They are
//! checked for being complete, and otherwise trusted.

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::error::StateError;

const VERSION: &str = env!("CARGO_PKG_VERSION");

/// The state of a value.
///
/// # Panics
/// Never: what this crate serializes has no maps and no sequences of unknown length.
#[must_use]
pub fn to_bytes<T: Serialize>(value: &T) -> Vec<u8> {
    postcard::to_stdvec(&(VERSION, value)).expect("structs, enums and vectors always serialize")
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
    postcard::from_bytes(state).map_err(|_| StateError::Damaged)
}
