//! Acquisition and recording: all input is returned and recorded, and losses are counted.

use std::fs;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use xbus::frame::Frame;
use xbus::live::{Acquisition, QUEUE, Recording, Report, TIMES_HEADER, TIMES_MAGIC, Taken};
use xbus::log::{Options, Reader};
use xbus::scan::{Scanner, Step, Window};
use xbus::table::{ERROR, LONGEST_PAYLOAD, MTDATA2, WARNING};

/// A test fails after this time.
const LONG: Duration = Duration::from_secs(20);

fn frame(mid: u8, payload: &[u8]) -> Vec<u8> {
    Frame { bid: 0xFF, mid, payload }.encode().unwrap()
}

/// A message with packet counter and acceleration.
fn sample(counter: u16) -> Vec<u8> {
    let [high, low] = counter.to_be_bytes();
    let acceleration = [[0x40, 0x20, 0x0C].as_slice(), &[low; 12]].concat();
    frame(MTDATA2, &[&[0x10, 0x20, 0x02, high, low], acceleration.as_slice()].concat())
}

fn samples(n: u16) -> Vec<u8> {
    (0..n).flat_map(sample).collect()
}

/// Takes pieces until the end of the input.
fn drain(acquisition: &Acquisition) -> (Vec<u8>, u64) {
    let (mut all, mut missed) = (vec![], 0);
    while acquisition.wait(1, LONG) {
        let Some(taken) = acquisition.take() else { return (all, missed) };
        let offset = all.len() as u64 + missed;
        assert!(taken.offset >= offset);
        missed += taken.offset - offset;
        assert_eq!(taken.pieces.back().unwrap().end, taken.offset + taken.bytes.len() as u64);
        assert!(taken.pieces.iter().zip(taken.pieces.iter().skip(1)).all(|(a, b)| a.end < b.end));
        assert!(taken.pieces.iter().zip(taken.pieces.iter().skip(1)).all(|(a, b)| a.arrival <= b.arrival));
        all.extend(taken.bytes);
    }
    panic!("the stream should have ended");
}

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    folder
}

fn stop(acquisition: &Acquisition) -> Report {
    acquisition.stop_recording(LONG).expect("a recording that can be stopped")
}

/// Frames in a log, and bytes outside of frames.
fn frames_of(log: &[u8]) -> (u64, u64) {
    let mut reader = Reader::new(Options::default(), 0);
    reader.read(Window { bytes: log, offset: 0, last: true }, u64::MAX).unwrap();
    let stats = reader.take().stats;
    (stats.frames, stats.skipped_bytes)
}

#[test]
fn pushed_bytes_are_counted_and_queued() {
    let acquisition = Acquisition::new(QUEUE);
    let stream = [
        sample(7),
        sample(8),
        sample(11),       // two are missing
        frame(0x11, &[]), // GoToMeasurementAck
        sample(0),        // the counter restarted
        b"noise".to_vec(),
        sample(1),
        frame(MTDATA2, &[0x10, 0x20, 0x09]), // a packet that runs past the end, in step
        frame(ERROR, &[41]),
        frame(WARNING, &[0, 0, 1, 0x95, b'!']),
    ]
    .concat();
    for piece in stream.chunks(3) {
        assert!(acquisition.push(piece));
    }
    let stats = acquisition.stats();
    let counts = stats.counts;
    assert_eq!((counts.bytes, stats.queued, stats.dropped), (stream.len() as u64, stream.len(), 0));
    assert_eq!((counts.frames, counts.samples, counts.messages, counts.malformed), (9, 5, 4, 1));
    assert_eq!(counts.quantities.into_iter().collect::<Vec<_>>(), [(0x1020, 5), (0x4020, 5)]);
    assert_eq!((counts.losses.samples, counts.losses.gaps), (2, 1));
    assert_eq!((counts.skipped_bytes, counts.errors, counts.warnings), (5, 1, 1));
    assert_eq!(counts.last_error.unwrap(), "Warning 405: the connection to the GNSS receiver was lost");
    acquisition.end("the test is over");
    assert!(!acquisition.push(b"more"));
    assert_eq!(drain(&acquisition), (stream, 0));
    assert_eq!(acquisition.ended().unwrap(), "the test is over");
}

#[test]
fn a_checksum_error_is_counted_once() {
    let acquisition = Acquisition::new(QUEUE);
    let mut stream = samples(3);
    stream[30] ^= 1;
    acquisition.push(&stream);
    let counts = acquisition.stats().counts;
    assert_eq!((counts.samples, counts.checksum_errors, counts.skipped_bytes), (2, 1, 25));
    assert_eq!((counts.losses.samples, counts.losses.gaps), (1, 1));
}

#[test]
fn a_full_queue_drops_the_oldest_and_counts_them() {
    let acquisition = Acquisition::new(100);
    for byte in 0..30u8 {
        acquisition.push(&[byte; 20]);
    }
    let stats = acquisition.stats();
    assert_eq!((stats.queued, stats.most_queued, stats.dropped, stats.counts.bytes), (100, 100, 500, 600));
    let Taken { offset, bytes, pieces } = acquisition.take().unwrap();
    assert_eq!((offset, bytes[0], bytes[99], pieces.len()), (500, 25, 29, 5));
    acquisition.push(&[1; 500]);
    assert_eq!(acquisition.stats().queued, 500, "the last piece stays, however long");
    (0..100).for_each(|byte| {
        acquisition.push(&[byte]);
    });
    assert_eq!(acquisition.stats().queued, 100 / 16, "short pieces take room too");
}

#[test]
fn waiting_for_missing_bytes_times_out() {
    let acquisition = Acquisition::new(QUEUE);
    acquisition.push(b"ab");
    assert!(acquisition.wait(2, Duration::ZERO));
    assert!(!acquisition.wait(3, Duration::from_millis(1)));
    assert_eq!(acquisition.take().unwrap().bytes, b"ab");
    assert_eq!(acquisition.take().unwrap().bytes, b"");
    let small = Acquisition::new(100);
    small.push(&[0; 50]);
    assert!(small.wait(100, Duration::ZERO), "half of what fits is enough");
}

#[test]
fn the_end_of_input_wakes_the_reader() {
    let acquisition = Acquisition::new(QUEUE);
    thread::scope(|scope| {
        let reader = scope.spawn(|| acquisition.wait(1, LONG));
        acquisition.end("unplugged");
        assert!(reader.join().unwrap());
    });
    assert_eq!(acquisition.take(), None);
}

#[test]
fn recordings_hold_the_head_and_every_byte() {
    let path = folder("every_byte").join("log.mtb");
    let acquisition = Acquisition::new(QUEUE);
    let stream = [samples(100), b"noise".to_vec(), samples(100)].concat();
    acquisition.push(&samples(2));
    acquisition.push(&stream[..10]); // the recording begins with the frame that is under way
    let head = frame(0x0D, &[0; 16]);
    acquisition.record(Recording { head: head.clone(), ..Recording::to(&path) }).unwrap();
    let again = acquisition.record(Recording::to(&path)).unwrap_err();
    assert_eq!(again.kind(), std::io::ErrorKind::AlreadyExists);
    for piece in stream[10..].chunks(7) {
        acquisition.push(piece);
    }
    assert!(acquisition.recording().unwrap().active);
    let report = stop(&acquisition);
    acquisition.push(&samples(1));
    assert_eq!((report.active, &report.error, report.queued_bytes), (false, &None, 0));
    assert_eq!((report.bytes, report.frames), (stream.len() as u64, 200));
    assert_eq!(fs::read(&path).unwrap(), [head, stream].concat());
    assert_eq!(acquisition.recording(), None);
}

#[test]
fn arrival_times_are_recorded() {
    let path = folder("times").join("log.mtb");
    let acquisition = Acquisition::new(QUEUE);
    acquisition.record(Recording { head: frame(0x0D, &[0; 16]), ..Recording::to(&path) }).unwrap();
    for counter in 0..500 {
        acquisition.push(&sample(counter));
    }
    let last = acquisition.stats().last_arrival.unwrap() + acquisition.epoch();
    stop(&acquisition);
    let times = fs::read(path.with_file_name("log.mtb.times")).unwrap();
    let (header, records) = times.split_at(TIMES_HEADER);
    assert_eq!(header[..8], TIMES_MAGIC);
    assert_eq!(header[8..16], [1, 0, 0, 0, 16, 0, 0, 0]);
    assert_eq!(i64::from_le_bytes(*header[16..].first_chunk().unwrap()), acquisition.epoch());
    let record = |bytes: &[u8; 16]| {
        (u64::from_le_bytes(*bytes.first_chunk().unwrap()), i64::from_le_bytes(*bytes.last_chunk().unwrap()))
    };
    let records: Vec<_> = records.as_chunks::<16>().0.iter().map(record).collect();
    assert_eq!(records[0].0, 21 + 25, "the head and the first piece");
    assert_eq!(*records.last().unwrap(), (fs::metadata(&path).unwrap().len(), last));
    assert!(records.windows(2).all(|pair| pair[0].0 < pair[1].0 && pair[0].1 <= pair[1].1));
    assert!(records.len() < 500, "of pieces that come close together only some are noted");
}

#[test]
fn files_rotate_on_frame_boundaries() {
    let path = folder("rotate").join("log.mtb");
    let acquisition = Acquisition::new(QUEUE);
    let head = frame(0x0D, &[0; 16]);
    let rotate_bytes = Some(1000);
    acquisition.record(Recording { head: head.clone(), rotate_bytes, ..Recording::to(&path) }).unwrap();
    let stream = [samples(300), b"noise".to_vec(), samples(300)].concat();
    for piece in stream.chunks(333) {
        acquisition.push(piece);
    }
    let report = stop(&acquisition);
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

/// Whether a frame is cut at the end.
fn has_cut_frame(log: &[u8]) -> bool {
    let mut scanner = Scanner::new(LONGEST_PAYLOAD);
    while let Step::Frame { .. } = scanner.step(Window { bytes: log, offset: 0, last: false }) {}
    scanner.at() < log.len() as u64
}

#[test]
fn files_rotate_by_time() {
    let path = folder("rotate_by_time").join("log.mtb");
    let acquisition = Acquisition::new(QUEUE);
    let rotate_after = Some(Duration::from_nanos(1));
    acquisition.record(Recording { rotate_after, times: false, ..Recording::to(&path) }).unwrap();
    (0..9).for_each(|counter| {
        acquisition.push(&sample(counter));
    });
    let files = stop(&acquisition).files;
    let contents: Vec<_> = files.iter().map(|path| fs::read(path).unwrap()).collect();
    assert!(contents.iter().all(|file| !file.is_empty() && file.len() % 25 == 0));
    assert_eq!(contents.concat(), samples(9));
    assert!(contents.len() > 2);
}

#[test]
fn flushed_files_are_valid_logs_at_any_cut() {
    let path = folder("killed").join("log.mtb");
    let acquisition = Acquisition::new(QUEUE);
    acquisition.record(Recording { flush: Duration::ZERO, ..Recording::to(&path) }).unwrap();
    let stream = samples(400);
    for piece in stream.chunks(100) {
        acquisition.push(piece);
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
fn queue_overflow_ends_the_recording_without_a_gap() {
    let path = folder("overflow").join("log.mtb");
    let acquisition = Acquisition::new(QUEUE);
    acquisition.record(Recording { flush: LONG, bound: 2500, ..Recording::to(&path) }).unwrap();
    let stream = samples(200);
    for piece in stream.chunks(250) {
        acquisition.push(piece);
    }
    let report = stop(&acquisition);
    assert!(report.error.unwrap().contains("too slow"));
    let log = fs::read(&path).unwrap();
    assert!(log.len() >= 2500 && log.len() < stream.len());
    assert_eq!(log, stream[..log.len()]);
    assert_eq!(acquisition.stats().counts.samples, 200, "everybody else misses nothing");
}

#[test]
fn a_missing_folder_is_an_immediate_error() {
    let acquisition = Acquisition::new(QUEUE);
    let error = acquisition.record(Recording::to(folder("absent").join("no/log.mtb"))).unwrap_err();
    assert_eq!(error.kind(), std::io::ErrorKind::NotFound);
    assert_eq!(acquisition.recording(), None);
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_an_error() {
    let recording = || Recording { times: false, ..Recording::to("/dev/full") };
    let acquisition = Acquisition::new(QUEUE);
    let error = acquisition.record(Recording { head: samples(1), ..recording() }).unwrap_err();
    assert_eq!(error.kind(), std::io::ErrorKind::StorageFull);

    acquisition.record(recording()).unwrap();
    acquisition.push(&samples(10));
    let report = stop(&acquisition);
    let error = report.error.unwrap();
    assert!(error.starts_with("/dev/full: No space left on device"), "{error}");
    assert_eq!((report.bytes, report.frames), (0, 0));

    // The second file does not fit: the first one is good.
    let path = folder("full").join("log.mtb");
    std::os::unix::fs::symlink("/dev/full", path.with_file_name("log-0001.mtb")).unwrap();
    let rotate_bytes = Some(500);
    acquisition.record(Recording { head: samples(1), rotate_bytes, ..Recording::to(&path) }).unwrap();
    acquisition.push(&samples(100));
    let report = stop(&acquisition);
    assert!(report.error.unwrap().contains("log-0001.mtb: No space left"));
    assert_eq!((report.files, report.frames), (vec![path.clone()], 19));
    assert_eq!(fs::read(&path).unwrap(), [samples(1), samples(19)].concat());
}

#[cfg(unix)]
mod ports {
    use std::fs::File;
    use std::io::{ErrorKind, Write, pipe};
    use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};

    use super::*;

    /// Both sides of a pseudo-terminal, raw as a port is.
    fn pty() -> (File, File) {
        let (mut master, mut slave) = (0, 0);
        // SAFETY: the calls write only to their arguments, and the descriptors are new and owned here.
        #[allow(unsafe_code)]
        unsafe {
            let null = std::ptr::null_mut();
            assert_eq!(libc::openpty(&raw mut master, &raw mut slave, null, null.cast(), null.cast()), 0);
            let mut settings: libc::termios = std::mem::zeroed();
            libc::tcgetattr(slave, &raw mut settings);
            libc::cfmakeraw(&raw mut settings);
            // As pyserial configures a port: a read returns immediately, even without data.
            (settings.c_cc[libc::VMIN], settings.c_cc[libc::VTIME]) = (0, 0);
            libc::tcsetattr(slave, libc::TCSANOW, &raw const settings);
            (File::from(OwnedFd::from_raw_fd(master)), File::from(OwnedFd::from_raw_fd(slave)))
        }
    }

    fn flags(file: &File) -> i32 {
        // SAFETY: no memory is involved.
        #[allow(unsafe_code)]
        unsafe {
            libc::fcntl(file.as_raw_fd(), libc::F_GETFL)
        }
    }

    #[test]
    fn bursts_are_received_without_a_reader() {
        let (mut master, slave) = pty();
        let path = folder("burst").join("log.mtb");
        let acquisition = Acquisition::new(QUEUE);
        acquisition.open(slave.as_raw_fd()).unwrap();
        acquisition.record(Recording::to(&path)).unwrap();
        assert_eq!(acquisition.open(slave.as_raw_fd()).unwrap_err().kind(), ErrorKind::AlreadyExists);
        drop(slave); // its number is free for other files now
        let _others = [(); 4].map(|()| File::open("/dev/zero").unwrap());
        let stream: Vec<u8> = (0..60).flat_map(|_| samples(1000)).collect();
        master.write_all(&stream).unwrap(); // waits whenever the terminal is full
        assert!(acquisition.wait(stream.len(), LONG));
        drop(master); // closing a terminal discards its buffer
        assert!(drain(&acquisition) == (stream.clone(), 0));
        assert_eq!(acquisition.ended().unwrap(), "the port is gone: unplugged, or closed on the other side");
        let stats = acquisition.stats();
        assert_eq!((stats.counts.samples, stats.counts.skipped_bytes, stats.overruns), (60_000, 0, None));
        assert_eq!(stop(&acquisition).frames, 60_000);
        assert!(fs::read(path).unwrap() == stream);
    }

    #[test]
    fn descriptor_flags_are_unchanged() {
        let (_master, slave) = pty();
        let before = flags(&slave);
        let acquisition = Acquisition::new(QUEUE);
        acquisition.open(slave.as_raw_fd()).unwrap();
        assert_eq!(flags(&slave), before);
        acquisition.close();
        assert_eq!(flags(&slave), before);
    }

    #[test]
    fn closing_ends_a_wait_for_a_silent_port() {
        let (_master, slave) = pty();
        let acquisition = Acquisition::new(QUEUE);
        acquisition.open(slave.as_raw_fd()).unwrap();
        thread::scope(|scope| {
            let reader = scope.spawn(|| acquisition.wait(1, LONG));
            let began = Instant::now();
            acquisition.close();
            assert!(reader.join().unwrap());
            assert!(began.elapsed() < Duration::from_secs(1));
        });
        assert_eq!(acquisition.ended().unwrap(), "it was closed");
        assert_eq!(acquisition.take(), None);
    }

    #[test]
    fn drop_ends_the_thread() {
        let (reader, mut writer) = pipe().unwrap();
        let acquisition = Acquisition::new(QUEUE);
        acquisition.open(reader.as_raw_fd()).unwrap();
        drop(reader);
        drop(acquisition);
        assert_eq!(writer.write(&[1]).unwrap_err().kind(), ErrorKind::BrokenPipe, "the other side is closed");
    }

    #[test]
    fn a_new_port_continues_the_stream() {
        let acquisition = Acquisition::new(QUEUE);
        let path = folder("again").join("log.mtb");
        acquisition.record(Recording::to(&path)).unwrap();
        for part in [samples(3), samples(5)] {
            let (reader, mut writer) = pipe().unwrap();
            acquisition.open(reader.as_raw_fd()).unwrap();
            writer.write_all(&part).unwrap();
            writer.write_all(&part[..10]).unwrap(); // and in the middle of a frame
            drop(writer);
            while acquisition.ended().is_none() {
                thread::yield_now();
            }
            let bytes = acquisition.take().unwrap().bytes;
            assert_eq!(bytes, [&part, &part[..10]].concat());
        }
        let counts = acquisition.stats().counts;
        assert_eq!((counts.samples, counts.skipped_bytes), (8, 20));
        assert_eq!(stop(&acquisition).frames, 8);
        assert_eq!(fs::metadata(path).unwrap().len(), 8 * 25 + 20);
    }

    #[test]
    fn a_port_can_be_opened_after_a_pushed_end() {
        let (_master, slave) = pty();
        let acquisition = Acquisition::new(QUEUE);
        acquisition.open(slave.as_raw_fd()).unwrap();
        acquisition.end("enough");
        acquisition.open(slave.as_raw_fd()).unwrap();
        assert_eq!(acquisition.ended(), None);
    }

    #[test]
    fn invalid_descriptors_are_an_error() {
        let acquisition = Acquisition::new(QUEUE);
        assert_eq!(acquisition.open(-1).unwrap_err().raw_os_error(), Some(libc::EBADF));
        assert_eq!(acquisition.open(99_999).unwrap_err().raw_os_error(), Some(libc::EBADF));
    }
}
