//! What the tests of live streams share.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use xbus::frame::{Frame, MASTER};
use xbus::live::{Recorder, Report};
use xbus::table::MTDATA2;

/// A test fails after this time.
pub const LONG: Duration = Duration::from_secs(20);

pub fn frame(mid: u8, payload: &[u8]) -> Vec<u8> {
    frame_of(MASTER, mid, payload)
}

pub fn frame_of(bid: u8, mid: u8, payload: &[u8]) -> Vec<u8> {
    Frame { bid, mid, payload }.encode().unwrap()
}

/// Bytes of a [`sample`].
pub const SAMPLE: usize = 25;

/// A message with packet counter and acceleration.
pub fn sample(counter: u16) -> Vec<u8> {
    sample_of(MASTER, counter)
}

pub fn sample_of(bid: u8, counter: u16) -> Vec<u8> {
    let [high, low] = counter.to_be_bytes();
    let acceleration = [[0x40, 0x20, 0x0C].as_slice(), &[low; 12]].concat();
    frame_of(bid, MTDATA2, &[&[0x10, 0x20, 0x02, high, low], acceleration.as_slice()].concat())
}

pub fn samples(n: u16) -> Vec<u8> {
    (0..n).flat_map(sample).collect()
}

/// An empty folder.
pub fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    folder
}

/// Ends a recording, and returns its last state.
pub fn stop(recorder: &Recorder) -> Report {
    recorder.close();
    assert!(recorder.wait(LONG), "it can be stopped");
    recorder.report()
}
