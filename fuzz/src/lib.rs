//! What fuzz targets and tests share: streams to read, and laws to hold the readers to.
//!
//! ```text
//! bytes → streams (a stream, and a source of choices) → checks: scans, logs
//! ```
//!
//! The tests include this file by its path, so that one law is written once.

pub mod checks;
pub mod logs;
pub mod scans;
pub mod seeds;
pub mod streams;
