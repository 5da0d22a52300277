//! The code that fuzz targets and tests share: streams, and laws that the readers must satisfy.
//!
//! ```text
//! bytes → streams (a stream, and a source of random choices) → checks: scans, logs
//! ```
//!
//! The tests include this file by its path, so that each law is written once.

pub mod checks;
pub mod logs;
pub mod mtdata;
pub mod scans;
pub mod seeds;
pub mod stamps;
pub mod streams;
