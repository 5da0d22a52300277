//! Recordings: each byte is in exactly one file, and a recording that cannot go on ends with an error and a valid log.

#[allow(dead_code)] // each test takes what it needs
mod common;

use std::fs;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use common::{LONG, SAMPLE, folder, frame, sample, samples, stop};
use xbus::frame::MASTER;
use xbus::live::{Acquisition, QUEUE, Recording, TIMES_HEADER, TIMES_MAGIC};
use xbus::log::{Options, Reader};
use xbus::scan::{Scanner, Step, Window};
use xbus::table::LONGEST_PAYLOAD;

/// What a file begins with: a Configuration that is too short.
const HEAD: u8 = 0x0D;

fn acquisition() -> Acquisition {
    Acquisition::new(QUEUE, MASTER, None)
}

/// The side file with the times of a log.
fn side_file(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".times");
    name.into()
}

/// Header and records of a side file: position and arrival.
fn times(path: &Path) -> (Vec<u8>, Vec<(u64, i64)>) {
    let bytes = fs::read(side_file(path)).unwrap();
    let (header, records) = bytes.split_at(TIMES_HEADER);
    let record = |bytes: &[u8; 16]| {
        (u64::from_le_bytes(*bytes.first_chunk().unwrap()), i64::from_le_bytes(*bytes.last_chunk().unwrap()))
    };
    let (records, rest) = records.as_chunks::<16>();
    assert!(rest.is_empty());
    (header.to_vec(), records.iter().map(record).collect())
}

/// Frames in a log, and bytes outside of frames.
fn frames_of(log: &[u8]) -> (u64, u64) {
    let mut reader = Reader::new(Options::default(), 0);
    reader.read(Window { bytes: log, offset: 0, last: true }, u64::MAX).unwrap();
    let stats = reader.take().stats;
    (stats.frames, stats.skipped_bytes)
}

/// Whether a frame is cut at the end.
fn has_cut_frame(log: &[u8]) -> bool {
    let mut scanner = Scanner::new(LONGEST_PAYLOAD);
    while let Step::Frame { .. } = scanner.step(Window { bytes: log, offset: 0, last: false }) {}
    scanner.at() < log.len() as u64
}

// ---------------------------------------------------------------------------------------------
// Bytes
// ---------------------------------------------------------------------------------------------

#[test]
fn recordings_hold_the_head_and_every_byte() {
    let path = folder("every_byte").join("log.mtb");
    let acquisition = acquisition();
    let stream = [samples(100), b"noise".to_vec(), samples(100)].concat();
    acquisition.push(&samples(2), None);
    acquisition.push(&stream[..10], None); // the recording begins with the frame that is under way
    let head = frame(HEAD, &[0; 16]);
    let recorder = acquisition.record(Recording { head: head.clone(), ..Recording::to(&path) }).unwrap();
    let again = acquisition.record(Recording::to(&path)).unwrap_err();
    assert_eq!(again.kind(), std::io::ErrorKind::AlreadyExists);
    for piece in stream[10..].chunks(7) {
        acquisition.push(piece, None);
    }
    assert!(recorder.report().active);
    let report = stop(&recorder);
    acquisition.push(&samples(1), None);
    assert_eq!((report.active, &report.error, report.queued_bytes), (false, &None, 0));
    assert_eq!((report.bytes, report.frames), (stream.len() as u64, 200));
    assert_eq!(fs::read(&path).unwrap(), [head, stream].concat());
    assert!(acquisition.recording().is_none());
}

#[test]
fn recordings_one_after_another_share_no_byte_and_miss_none() {
    let folder = folder("one_after_another");
    let acquisition = acquisition();
    let stream = [samples(4), b"noise".to_vec(), samples(4)].concat();
    let mut files = vec![];
    for (number, piece) in stream.chunks(17).enumerate() {
        let path = folder.join(format!("{number}.mtb"));
        let recorder = acquisition.record(Recording::to(&path)).unwrap();
        acquisition.push(piece, None);
        let report = stop(&recorder);
        let file = fs::read(path).unwrap();
        assert_eq!((report.error, report.bytes), (None, file.len() as u64));
        assert!(!has_cut_frame(&file) || file.starts_with(b"noise") || file.ends_with(b"noise"));
        files.push(file);
    }
    assert_eq!(files.concat(), stream);
    assert!(files.iter().filter(|file| file.is_empty()).count() > 2, "the pieces were shorter than a frame");
}

#[test]
fn the_end_of_the_stream_completes_the_recording() {
    let path = folder("end").join("log.mtb");
    let acquisition = acquisition();
    let recorder = acquisition.record(Recording::to(&path)).unwrap();
    let stream = &samples(3)[..60];
    acquisition.push(stream, None);
    acquisition.end("unplugged");
    assert!(recorder.report().active, "the stream may go on");
    acquisition.resume().unwrap();
    acquisition.push(&sample(3), None);
    let report = stop(&recorder);
    assert_eq!((report.frames, report.bytes), (3, 85));
    assert_eq!(fs::read(path).unwrap(), [stream, &sample(3)].concat());
}

#[test]
fn closing_writes_all_that_was_received() {
    let path = folder("close").join("log.mtb");
    let acquisition = acquisition();
    let recorder = acquisition.record(Recording { flush: LONG, ..Recording::to(&path) }).unwrap();
    let stream = &samples(3)[..60];
    acquisition.push(stream, None);
    acquisition.close();
    let report = recorder.report();
    assert_eq!((report.active, report.error, report.bytes), (false, None, 60));
    assert_eq!(fs::read(path).unwrap(), stream);
}

#[test]
fn flushed_files_are_valid_logs_at_any_cut() {
    let path = folder("killed").join("log.mtb");
    let acquisition = acquisition();
    acquisition.record(Recording { flush: Duration::ZERO, ..Recording::to(&path) }).unwrap();
    let stream = samples(400);
    for piece in stream.chunks(100) {
        acquisition.push(piece, None);
    }
    // No stop: as if the process was killed.
    let began = Instant::now();
    while fs::metadata(&path).unwrap().len() < stream.len() as u64 {
        assert!(began.elapsed() < LONG);
        thread::yield_now();
    }
    let log = fs::read(&path).unwrap();
    assert_eq!(log, stream);
    for end in [1, 24, 25, 26, 1000, log.len() - 1] {
        assert_eq!(frames_of(&log[..end]), ((end / 25) as u64, (end % 25) as u64));
    }
}

#[test]
fn one_of_two_recordings_that_start_together_is_refused() {
    let folder = folder("together");
    for round in 0..50 {
        let acquisition = &acquisition();
        acquisition.push(&samples(1), None);
        let path = &folder.join(format!("{round}.mtb"));
        let started = thread::scope(|scope| {
            let start = || acquisition.record(Recording { overwrite: true, head: samples(1), ..Recording::to(path) });
            let threads = [scope.spawn(start), scope.spawn(start)];
            threads.map(|thread| thread.join().unwrap()).into_iter().flatten().collect::<Vec<_>>()
        });
        acquisition.push(&samples(2), None);
        assert_eq!((started.len(), stop(&started[0]).error), (1, None));
        assert_eq!(fs::read(path).unwrap(), [samples(1), samples(2)].concat());
    }
}

// ---------------------------------------------------------------------------------------------
// Times
// ---------------------------------------------------------------------------------------------

#[test]
fn arrival_times_are_recorded() {
    let path = folder("times").join("log.mtb");
    let acquisition = acquisition();
    let recorder = acquisition.record(Recording { head: frame(HEAD, &[0; 16]), ..Recording::to(&path) }).unwrap();
    for counter in 0..500 {
        acquisition.push(&sample(counter), None);
    }
    let last = acquisition.stats(0).last_arrival.unwrap() + acquisition.epoch();
    stop(&recorder);
    let (header, records) = times(&path);
    assert_eq!(header[..8], TIMES_MAGIC);
    assert_eq!(header[8..16], [1, 0, 0, 0, 16, 0, 0, 0]);
    assert_eq!(i64::from_le_bytes(*header[16..].first_chunk().unwrap()), acquisition.epoch());
    assert_eq!(records[0].0, 21 + 25, "the head and the first piece");
    assert_eq!(*records.last().unwrap(), (fs::metadata(&path).unwrap().len(), last));
    assert!(records.windows(2).all(|pair| pair[0].0 < pair[1].0 && pair[0].1 <= pair[1].1));
    assert!(records.len() < 500, "of pieces that come close together only some are noted");
}

#[test]
fn recorded_times_are_those_of_the_live_samples() {
    const STEP: i64 = 10_000_001;
    let path = folder("same_times").join("log.mtb");
    let acquisition = Acquisition::new(QUEUE, MASTER, Some(1_000));
    let stream = samples(60);
    // The recording begins inside a frame, whose beginning had arrived before.
    acquisition.push(&stream[..10], Some(0));
    let head = frame(HEAD, &[0; 16]);
    let (rotate_bytes, begin) = (Some(500), head.len() as u64);
    let recorder = acquisition.record(Recording { head, rotate_bytes, ..Recording::to(&path) }).unwrap();
    for (piece, number) in stream[10..].chunks(37).zip(1..) {
        acquisition.push(piece, Some(number * STEP));
    }
    let report = stop(&recorder);
    let live = acquisition.take_block(None).unwrap().samples;
    assert_eq!((live.len(), report.files.len()), (60, 3));
    let mut live = live.iter();
    for file in &report.files {
        let records = times(file).1;
        let length = fs::metadata(file).unwrap().len();
        for end in (begin..=length).step_by(SAMPLE).skip(1) {
            let record = records.iter().find(|record| record.0 >= end).unwrap();
            assert_eq!(record.1, live.next().unwrap().arrival + 1_000, "the frame that ends at {end} of {file:?}");
        }
        assert_eq!(records.last().unwrap().0, length);
    }
    assert_eq!(live.count(), 0);
}

// ---------------------------------------------------------------------------------------------
// Files
// ---------------------------------------------------------------------------------------------

#[test]
fn files_rotate_on_frame_boundaries() {
    let path = folder("rotate").join("log.mtb");
    let acquisition = acquisition();
    let head = frame(HEAD, &[0; 16]);
    let rotate_bytes = Some(1000);
    let recorder = acquisition.record(Recording { head: head.clone(), rotate_bytes, ..Recording::to(&path) }).unwrap();
    let stream = [samples(300), b"noise".to_vec(), samples(300)].concat();
    for piece in stream.chunks(333) {
        acquisition.push(piece, None);
    }
    let report = stop(&recorder);
    assert_eq!(report.error, None);
    assert_eq!(report.files[..2], [path.clone(), path.with_file_name("log-0001.mtb")]);
    let mut joined = vec![];
    for file in &report.files {
        let log = fs::read(file).unwrap();
        let rest = log.strip_prefix(head.as_slice()).expect("the head in each");
        assert!(log.len() < 1000 + 25 + 5, "{} bytes", log.len());
        assert!(!has_cut_frame(rest), "{}", file.display());
        joined.extend_from_slice(rest);
    }
    assert_eq!(joined, stream);
    assert_eq!(report.files.len(), 16);
}

#[test]
fn files_rotate_by_time() {
    let path = folder("rotate_by_time").join("log.mtb");
    let acquisition = acquisition();
    let rotate_after = Some(Duration::from_nanos(1));
    let recorder = acquisition.record(Recording { rotate_after, times: false, ..Recording::to(&path) }).unwrap();
    (0..9).for_each(|counter| {
        acquisition.push(&sample(counter), None);
    });
    let files = stop(&recorder).files;
    let contents: Vec<_> = files.iter().map(|path| fs::read(path).unwrap()).collect();
    assert!(contents.iter().all(|file| !file.is_empty() && file.len() % 25 == 0));
    assert_eq!(contents.concat(), samples(9));
    assert!(contents.len() > 2);
}

#[test]
fn the_time_of_a_file_is_that_of_the_stream() {
    let path = folder("rotate_by_stream_time").join("log.mtb");
    let acquisition = Acquisition::new(QUEUE, MASTER, Some(0));
    let rotate_after = Some(Duration::from_secs(2));
    let recorder = acquisition.record(Recording { rotate_after, ..Recording::to(&path) }).unwrap();
    for second in 0..9_u16 {
        acquisition.push(&sample(second), Some(i64::from(second) * 1_000_000_000));
    }
    let lengths = stop(&recorder).files.iter().map(|path| fs::read(path).unwrap().len()).collect::<Vec<_>>();
    assert_eq!(lengths, [3 * SAMPLE; 3], "first to third second in each");
}

#[test]
fn a_missing_folder_is_an_immediate_error() {
    let acquisition = acquisition();
    let error = acquisition.record(Recording::to(folder("absent").join("no/log.mtb"))).unwrap_err();
    assert_eq!(error.kind(), std::io::ErrorKind::NotFound);
    assert!(acquisition.recording().is_none());
}

#[cfg(unix)]
#[test]
fn a_folder_that_is_removed_is_an_error() {
    let folder = folder("removed");
    let acquisition = acquisition();
    let recorder = acquisition.record(Recording::to(folder.join("log.mtb"))).unwrap();
    acquisition.push(&samples(3), None);
    fs::remove_dir_all(&folder).unwrap();
    let error = stop(&recorder).error.unwrap();
    assert!(error.contains("log.mtb: the file was removed"), "{error}");

    // Also if nothing is received afterwards.
    fs::create_dir_all(&folder).unwrap();
    let recorder = acquisition.record(Recording::to(folder.join("log.mtb"))).unwrap();
    fs::remove_dir_all(&folder).unwrap();
    assert!(stop(&recorder).error.unwrap().contains("the file was removed"));
}

#[test]
fn queue_overflow_ends_the_recording_without_a_gap() {
    let path = folder("overflow").join("log.mtb");
    let acquisition = acquisition();
    let recorder = acquisition.record(Recording { flush: LONG, bound: 2500, ..Recording::to(&path) }).unwrap();
    let stream = samples(200);
    for piece in stream.chunks(250) {
        acquisition.push(piece, None);
    }
    let report = stop(&recorder);
    assert!(report.error.unwrap().contains("too slow"));
    let log = fs::read(&path).unwrap();
    assert!(log.len() >= 2500 && log.len() < stream.len());
    assert_eq!(log, stream[..log.len()]);
    assert_eq!(acquisition.stats(0).counts.samples, 200, "everybody else misses nothing");
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_an_error() {
    let recording = || Recording { times: false, ..Recording::to("/dev/full") };
    let acquisition = acquisition();
    let error = acquisition.record(Recording { head: samples(1), ..recording() }).unwrap_err();
    assert_eq!(error.kind(), std::io::ErrorKind::StorageFull);

    let recorder = acquisition.record(recording()).unwrap();
    acquisition.push(&samples(10), None);
    let report = stop(&recorder);
    let error = report.error.unwrap();
    assert!(error.starts_with("/dev/full: No space left on device"), "{error}");
    assert_eq!((report.bytes, report.frames), (0, 0));

    // The second file does not fit: the first one is good.
    let path = folder("full").join("log.mtb");
    std::os::unix::fs::symlink("/dev/full", path.with_file_name("log-0001.mtb")).unwrap();
    let rotate_bytes = Some(500);
    let recorder = acquisition.record(Recording { head: samples(1), rotate_bytes, ..Recording::to(&path) }).unwrap();
    acquisition.push(&samples(100), None);
    let report = stop(&recorder);
    assert!(report.error.unwrap().contains("log-0001.mtb: No space left"));
    assert_eq!((report.files, report.frames), (vec![path.clone()], 19));
    assert_eq!(fs::read(&path).unwrap(), [samples(1), samples(19)].concat());
}

#[cfg(target_os = "linux")]
#[test]
fn a_disk_that_is_full_from_the_start_leaves_no_file() {
    let folder = folder("full_from_the_start");
    let path = folder.join("log.mtb");
    let acquisition = acquisition();
    std::os::unix::fs::symlink("/dev/full", side_file(&path)).unwrap();
    let error = acquisition.record(Recording::to(&path)).unwrap_err();
    assert_eq!(error.kind(), std::io::ErrorKind::StorageFull);
    assert_eq!(fs::read_dir(&folder).unwrap().count(), 0, "neither log nor side file");
    assert!(acquisition.recording().is_none());

    // A log that is a special file has no side file, whether its head fits or not.
    std::os::unix::fs::symlink("/dev/full", &path).unwrap();
    for head in [vec![], samples(1)] {
        if let Ok(recorder) = acquisition.record(Recording { head, ..Recording::to(&path) }) {
            acquisition.push(&samples(3), None);
            assert!(stop(&recorder).error.unwrap().contains("No space left"));
        }
        assert!(!side_file(&path).exists());
    }
}
