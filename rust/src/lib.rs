//! The Xbus protocol of Xsens MTi motion trackers.
//!
//! ```text
//! bytes → frames → packets → columns
//!         scan     packet    layout, column
//! ```
//!
//! Nothing is copied from the input to a frame or packet; each number is copied once, byte-swapped, into its column.
//! The protocol itself is data, in [`table`].

#[cfg(feature = "arrow")]
pub mod arrow;
pub mod clock;
pub mod column;
pub mod device;
pub mod error;
pub mod frame;
pub mod hostclock;
mod huge_pages;
pub mod input;
pub mod layout;
pub mod live;
pub mod log;
pub mod packet;
#[cfg(feature = "python")]
mod py;
pub mod real;
pub mod scan;
mod simd;
pub mod strings;
pub mod table;
pub mod utc;
pub mod value;

pub use scan::frames;
