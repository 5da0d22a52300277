//! The Xbus protocol of Xsens MTi motion trackers.
//!
//! ```text
//! bytes → frames → packets → columns
//!         scan     packet    layout, column
//! ```
//!
//! Nothing is copied from the input to a frame or packet; each number is copied once, byte-swapped, into its column.
//! The protocol itself is data, in [`table`].
//!
//! # Example
//!
//! [`frames`] finds the frames of a recording, and [`frame::Frame::packets`] the packets of a sample:
//!
//! ```
//! use xbus::value::{Number, numbers};
//!
//! // A stray byte, then a sample: PacketCounter and Temperature.
//! let bytes = b"\x00\xFA\xFF\x36\x0C\x10\x20\x02\xDF\xC5\x08\x10\x04\x41\xC3\x00\x00\xC9";
//! let found: Vec<_> = xbus::frames(bytes).collect();
//! let [(1, frame)] = found[..] else { panic!("one frame, at byte 1") };
//! assert_eq!(frame.mid, xbus::table::MTDATA2);
//! for packet in frame.packets() {
//!     let packet = packet.expect("an accepted sample has whole packets");
//!     let reading = packet.reading().expect("the tables have both identifiers");
//!     match reading.quantity.name {
//!         "packet_counter" => assert_eq!(numbers(&reading, packet.data), [Number::Integer(57285)]),
//!         "temperature" => assert_eq!(numbers(&reading, packet.data), [Number::Single(24.375)]),
//!         _ => unreachable!(),
//!     }
//! }
//! ```
//!
//! [`log::Reader`] decodes a whole recording into columns:
//!
//! ```
//! # let bytes = b"\x00\xFA\xFF\x36\x0C\x10\x20\x02\xDF\xC5\x08\x10\x04\x41\xC3\x00\x00\xC9";
//! use xbus::column::Values;
//! use xbus::log::{Options, Reader};
//! use xbus::scan::Window;
//!
//! let mut reader = Reader::new(Options::default(), bytes.len() as u64);
//! reader.read(Window { bytes, offset: 0, last: true }, u64::MAX)?;
//! let part = reader.take();
//! assert_eq!((part.len(), part.stats.skipped_bytes), (1, 1));
//! let Values::F32(temperature) = &part.columns[1].values else { panic!("Float32") };
//! assert_eq!(temperature, &[24.375]);
//! # Ok::<(), xbus::error::Fault>(())
//! ```
//!
//! # Features
//!
//! None is on by default: the core needs only `memchr`, `chrono` and `rustc-hash`, and on Unix `libc`.
//!
//! | feature | adds |
//! |---|---|
//! | `arrow` | `arrow`: columns as Arrow record batches |
//! | `export` | `export`: Parquet, CSV, Arrow and MCAP files; includes `arrow` |
//! | `serde` | `state`: parts of logs and clocks as bytes, to send them to other processes |
//! | `python` | the extension module of the Python package, which is of no use to Rust programs |

#[cfg(feature = "arrow")]
pub mod arrow;
pub mod catch;
pub mod clock;
pub mod column;
pub mod device;
pub mod error;
#[cfg(feature = "export")]
pub mod export;
pub mod frame;
pub mod hostclock;
mod huge_pages;
pub mod input;
pub mod layout;
pub mod live;
pub mod log;
#[cfg(feature = "export")]
pub mod message_file;
pub mod mtdata;
pub mod packet;
#[cfg(feature = "python")]
mod py;
pub mod real;
pub mod requests;
pub mod scan;
mod simd;
#[cfg(feature = "serde")]
pub mod state;
pub mod strings;
pub mod table;
pub mod utc;
pub mod value;

pub use scan::frames;

/// The Rust example of the README runs as a test.
#[cfg(doctest)]
#[doc = include_str!("../../README.md")]
mod readme {}
