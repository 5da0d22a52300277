//! Acquisition: all input is handed out and counted, waits end when they should, and ports are read without delay.

#[allow(dead_code)] // each test takes what it needs
mod common;

use std::fs;
use std::thread;
use std::time::{Duration, Instant};

use common::{LONG, SAMPLE, folder, frame, frame_of, sample, sample_of, samples, stop};
use xbus::frame::{MASTER, PREAMBLE};
use xbus::live::{Acquisition, Cancel, Dropped, Event, Item, Need, QUEUE, Recording};
use xbus::scan::plain;
use xbus::table::{ERROR, LONGEST_PAYLOAD, MTDATA2, WARNING};

/// A string with a checksum.
const STRING: &[u8] = b"$PSONCMS,0*43\r\n";
/// GoToConfigAck.
const CONFIG_ACK: u8 = 0x31;
const SECOND: i64 = 1_000_000_000;
/// A short time to wait for what does not happen.
const SHORT: Duration = Duration::from_millis(20);

fn acquisition() -> Acquisition {
    Acquisition::new(QUEUE, MASTER, None)
}

fn samples_needed(count: usize) -> Need {
    Need { samples: Some(count), ..Need::default() }
}

fn wait(acquisition: &Acquisition, need: Need, timeout: Duration) -> bool {
    acquisition.wait(need, timeout, &Cancel::default())
}

/// Takes everything until the end of the stream, of which nothing was dropped or taken before.
fn drain(acquisition: &Acquisition, stream: &[u8]) {
    let mut end = 0;
    while let Some(items) = acquisition.take_all() {
        for item in items {
            let (offset, bytes) = match &item {
                Item::Sample(sample, bytes) => (sample.offset, &bytes[..]),
                Item::Text(text) => (text.offset, &text.bytes[..]),
                Item::Event(Event::Message { offset, bytes }) => (*offset, &bytes[..]),
                Item::Event(Event::Damage(damage)) => {
                    let at = usize::try_from(damage.offset).unwrap();
                    (damage.offset, &stream[at..at + usize::try_from(damage.length).unwrap()])
                }
                Item::Event(Event::Data) => panic!("a mark is not received"),
            };
            assert_eq!(offset, end as u64);
            assert_eq!(*bytes, stream[end..end + bytes.len()]);
            end += bytes.len();
        }
        assert!(wait(acquisition, samples_needed(1), LONG));
    }
    assert_eq!(end, stream.len());
}

/// The packet counters of all samples that wait.
fn counters(acquisition: &Acquisition) -> Vec<i64> {
    std::iter::from_fn(|| acquisition.take_sample()).map(|(sample, _)| sample.moment.counter).collect()
}

/// The frames of the messages.
fn messages<'a>(events: impl IntoIterator<Item = &'a Event>) -> Vec<Vec<u8>> {
    let bytes = |event: &Event| match event {
        Event::Message { bytes, .. } => Some(bytes.to_vec()),
        Event::Damage(_) | Event::Data => None,
    };
    events.into_iter().filter_map(bytes).collect()
}

// ---------------------------------------------------------------------------------------------
// Counts and queues
// ---------------------------------------------------------------------------------------------

#[test]
fn pushed_bytes_are_counted_and_queued() {
    let acquisition = acquisition();
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
        STRING.to_vec(),
        frame(WARNING, &[0, 0, 1, 0x95, b'!']),
    ]
    .concat();
    for piece in stream.chunks(3) {
        assert!(acquisition.push(piece, None));
    }
    let stats = acquisition.stats(0);
    let counts = stats.counts;
    assert_eq!((counts.bytes, stats.queued), (stream.len() as u64, stream.len() - b"noise".len()));
    assert_eq!((stats.unread, stats.dropped), (5, Dropped::default()));
    assert_eq!((counts.frames, counts.samples, counts.messages, counts.malformed), (9, 5, 4, 1));
    assert_eq!(counts.quantities.into_iter().collect::<Vec<_>>(), [(0x1020, 5), (0x4020, 5)]);
    assert_eq!(counts.strings.into_iter().collect::<Vec<_>>(), [("PSONCMS", 1)]);
    assert_eq!((counts.losses.samples, counts.losses.gaps), (2, 1));
    assert_eq!((counts.skipped_bytes, counts.errors, counts.warnings), (5, 1, 1));
    assert_eq!(counts.last_error.unwrap(), "Warning 405: the connection to the GNSS receiver was lost");
    acquisition.end("the test is over");
    assert!(!acquisition.push(b"more", None));
    drain(&acquisition, &stream);
    assert_eq!(acquisition.ended().unwrap(), "the test is over");
}

#[test]
fn a_checksum_error_is_counted_once() {
    let acquisition = acquisition();
    let mut stream = samples(3);
    stream[30] ^= 1;
    acquisition.push(&stream, None);
    let counts = acquisition.stats(0).counts;
    assert_eq!((counts.samples, counts.checksum_errors, counts.skipped_bytes), (2, 1, 25));
    assert_eq!((counts.losses.samples, counts.losses.gaps), (1, 1));
}

#[test]
fn skipped_bytes_are_counted_before_a_frame_follows() {
    let acquisition = acquisition();
    acquisition.push(&[0; 7], None);
    assert_eq!(acquisition.stats(0).counts.skipped_bytes, 7);
    acquisition.push(&sample(0), None);
    assert_eq!(acquisition.stats(0).counts.skipped_bytes, 7);
}

#[test]
fn full_queues_drop_the_oldest_and_count_them() {
    let acquisition = Acquisition::new(4 * SAMPLE, MASTER, None);
    acquisition.push(&samples(30), None);
    let stats = acquisition.stats(0);
    assert_eq!((stats.unread, stats.dropped.samples, stats.counts.samples), (4, 26, 30));
    assert_eq!(acquisition.waiting().dropped_samples, 26);
    let block = acquisition.take_block(None).unwrap();
    assert_eq!(block.frames, samples(30)[26 * SAMPLE..]);
    assert!(block.samples.iter().all(|sample| sample.moment.lost == 0), "the device lost none");

    let long = frame(MTDATA2, &[[0x40, 0x20, 0x0C].as_slice(), &[0; 12]].concat().repeat(20));
    acquisition.push(&[sample(30), long.clone()].concat(), None);
    assert_eq!(acquisition.take_sample().unwrap().1, long, "the last sample stays, however long");
    assert!(acquisition.take_sample().is_none());
    assert_eq!(acquisition.stats(0).dropped.samples, 27);

    let short = frame(MTDATA2, &[0xF0, 0x10, 0]); // a packet of an unlisted quantity, without data
    acquisition.push(&short.repeat(8), None);
    assert_eq!((acquisition.waiting().samples, acquisition.waiting().dropped_samples), (4 * SAMPLE / 16, 29));
    assert_eq!(acquisition.clear_data(), 6);

    let _ = acquisition.take_events(false);
    let acks: Vec<_> = (0..20).flat_map(|_| frame(CONFIG_ACK, &[])).collect();
    acquisition.push(&acks, None);
    let dropped = acquisition.stats(0).dropped;
    let events = acquisition.take_events(false).0;
    assert_eq!((events.len(), dropped.messages), (4 * SAMPLE / 16, 14), "short entries take room, too");

    (0..9).for_each(|_| assert!(acquisition.push(STRING, None)));
    assert_eq!(acquisition.stats(0).dropped, Dropped { samples: 29, strings: 3, messages: 14 });
    assert_eq!(std::iter::from_fn(|| acquisition.take_string()).count(), 6);
    assert_eq!(acquisition.stats(0).queued, 0);
}

#[test]
fn dropped_damage_is_no_dropped_message() {
    let acquisition = Acquisition::new(64, MASTER, None);
    for counter in 0..20 {
        acquisition.push(&[&[0][..], &sample(counter)].concat(), None);
    }
    let stats = acquisition.stats(0);
    assert_eq!((stats.counts.skipped_bytes, stats.dropped.messages), (20, 0));
}

#[test]
fn removed_samples_are_not_dropped() {
    let acquisition = acquisition();
    acquisition.push(&[&samples(3), STRING, &frame(CONFIG_ACK, &[])].concat(), None);
    assert_eq!(acquisition.clear_data(), 4);
    let stats = acquisition.stats(0);
    assert_eq!((stats.unread, stats.dropped, stats.queued), (0, Dropped::default(), 5));
    acquisition.push(&sample(3), None);
    assert_eq!(counters(&acquisition), [3]);
}

#[test]
fn blocks_take_the_strings_before_their_last_sample() {
    let acquisition = acquisition();
    acquisition.push(&[&sample(0), STRING, &sample(1), STRING, &sample(2), STRING].concat(), None);
    assert!(acquisition.take_block(Some(4)).is_none());
    let block = acquisition.take_block(Some(2)).unwrap();
    assert_eq!((block.samples.len(), block.strings.len(), &block.frames), (2, 1, &samples(2)));
    let rest = acquisition.take_block(None).unwrap();
    assert_eq!((rest.samples.len(), rest.strings.len(), rest.frames), (1, 2, sample(2)));
    let none = acquisition.take_block(None).unwrap();
    assert_eq!((none.samples.len(), none.strings.len(), none.frames.len()), (0, 0, 0));
}

#[test]
fn foreign_devices_are_counted_and_not_handed_out() {
    let acquisition = Acquisition::new(QUEUE, 3, None);
    let stream = [
        sample_of(3, 0),
        sample_of(4, 50),
        sample_of(4, 53),
        frame_of(4, CONFIG_ACK, &[]),
        sample_of(3, 1),
        frame_of(3, CONFIG_ACK, &[]),
        sample_of(MASTER, 7), // a device that answers with FF whatever its bus identifier is
    ]
    .concat();
    acquisition.push(&stream, None);
    let counts = acquisition.stats(0).counts;
    assert_eq!((counts.samples, counts.messages, counts.losses.samples), (5, 2, 2));
    assert_eq!(messages(&acquisition.take_events(true).0), [frame_of(3, CONFIG_ACK, &[])]);
    assert_eq!(counters(&acquisition), [0, 1, 7]);

    let master = Acquisition::new(QUEUE, 1, None);
    master.push(&[sample_of(1, 0), sample_of(MASTER, 1), sample_of(2, 2)].concat(), None);
    assert_eq!(counters(&master), [0, 1], "FF and 1 are the same device");
}

#[test]
fn the_first_data_after_a_message_is_marked() {
    let acquisition = acquisition();
    let marks = |bytes: &[u8]| {
        acquisition.push(bytes, None);
        acquisition.take_events(false).0.into_iter().filter(|event| *event == Event::Data).count()
    };
    assert_eq!(marks(&samples(3)), 1);
    assert_eq!(marks(&samples(3)), 0);
    assert_eq!(marks(&[frame(CONFIG_ACK, &[]), STRING.to_vec(), sample(3)].concat()), 1);
    acquisition.mark_data();
    assert_eq!(marks(&sample(4)), 1);
}

// ---------------------------------------------------------------------------------------------
// Incomplete frames
// ---------------------------------------------------------------------------------------------

#[test]
fn the_other_half_of_a_frame_may_be_late() {
    let acquisition = Acquisition::new(QUEUE, MASTER, Some(0));
    let stream = samples(3);
    acquisition.push(&stream[..40], Some(0));
    assert_eq!(counters(&acquisition), [0]);
    assert!(!wait(&acquisition, samples_needed(1), Duration::ZERO));
    assert!(messages(&acquisition.take_events(true).0).is_empty());
    acquisition.push(&stream[40..], Some(3600 * SECOND));
    let block = acquisition.take_block(None).unwrap();
    assert!(block.samples.iter().all(|sample| sample.arrival == 3600 * SECOND && sample.moment.lost == 0));
    let counts = acquisition.stats(3600 * SECOND).counts;
    assert_eq!((block.samples.len(), counts.samples, counts.skipped_bytes, counts.checksum_errors), (2, 3, 0, 0));
}

/// A header that claims the 8176 bytes that follow.
const FALSE_HEADER: [u8; 6] = [PREAMBLE, MASTER, MTDATA2, 0xFF, 0x1F, 0xF0];

#[test]
fn an_answer_behind_a_false_header_is_handed_out_once() {
    let acquisition = acquisition();
    let answer = frame(CONFIG_ACK, &[]);
    let mut stream = [&sample(0)[..], &FALSE_HEADER, &answer].concat();
    acquisition.push(&stream, None);
    let (events, added) = acquisition.take_events(false);
    assert!(messages(&events).is_empty());
    let (events, still) = acquisition.take_events(true);
    assert_eq!((messages(&events), still), (vec![answer.clone()], added));
    assert!(acquisition.take_events(true).0.is_empty());
    assert_eq!(acquisition.stats(0).counts.messages, 0, "what is not decided is not counted");

    let rest = samples(400);
    acquisition.push(&rest, None);
    stream.extend(rest);
    let counts = acquisition.stats(0).counts;
    let expected = plain::scan(&stream, LONGEST_PAYLOAD, 0);
    assert_eq!((counts.frames, counts.messages), (expected.frames.len() as u64, 1));
    assert_eq!((counts.skipped_bytes, counts.checksum_errors), (6, expected.checksum_errors));
    assert!(messages(&acquisition.take_events(true).0).is_empty(), "it was handed out before");
    acquisition.push(&answer, None);
    assert_eq!(messages(&acquisition.take_events(true).0), [answer], "another one");
}

#[test]
fn an_interruption_decides_the_bytes_of_an_incomplete_frame() {
    let acquisition = acquisition();
    let answer = frame(CONFIG_ACK, &[]);
    acquisition.push(&[&FALSE_HEADER[..], &answer, &sample(0), STRING].concat(), None);
    assert_eq!(messages(&acquisition.take_events(true).0), [answer]);
    assert_eq!(acquisition.waiting().samples, 0);
    acquisition.interrupt();
    assert!(messages(&acquisition.take_events(false).0).is_empty());
    assert_eq!(counters(&acquisition), [0]);
    let counts = acquisition.stats(0).counts;
    assert_eq!((counts.messages, counts.skipped_bytes), (1, 6));
    acquisition.push(&sample(1), None);
    assert_eq!(counters(&acquisition), [1]);
}

#[test]
fn bytes_inside_a_frame_may_look_like_an_answer() {
    let acquisition = acquisition();
    let answer = frame(CONFIG_ACK, &[]);
    // A packet of an unlisted quantity, which holds an answer.
    let long = frame(MTDATA2, &[&[0xF0, 0x10, 200][..], &answer, &[0; 195], &[0xF0, 0x10, 100], &[0; 100]].concat());
    for round in 1..=3 {
        acquisition.push(&long[..250], None);
        assert_eq!(messages(&acquisition.take_events(true).0), std::slice::from_ref(&answer));
        acquisition.push(&long[250..], None);
        let counts = acquisition.stats(0).counts;
        assert_eq!((counts.samples, counts.messages, counts.skipped_bytes), (round, 0, 0));
        assert!(messages(&acquisition.take_events(true).0).is_empty());
    }
}

// ---------------------------------------------------------------------------------------------
// Waiting
// ---------------------------------------------------------------------------------------------

#[test]
fn waiting_for_what_is_missing_times_out() {
    let acquisition = acquisition();
    acquisition.push(&samples(3)[..60], None);
    assert!(wait(&acquisition, samples_needed(2), Duration::ZERO));
    assert!(!wait(&acquisition, samples_needed(3), Duration::from_millis(1)));
    assert!(!wait(&acquisition, Need { strings: true, ..Need::default() }, Duration::from_millis(1)));
    let added = acquisition.take_events(false).1;
    assert!(!wait(&acquisition, Need { events: Some(added), ..Need::default() }, Duration::from_millis(1)));
    assert!(wait(&acquisition, Need { events: Some(added - 1), ..Need::default() }, Duration::ZERO));
    assert_eq!(counters(&acquisition), [0, 1]);
}

#[test]
fn timeouts_hold_while_others_are_woken() {
    let acquisition = acquisition();
    thread::scope(|scope| {
        let reader = scope.spawn(|| {
            let mut count = 0;
            while acquisition.ended().is_none() {
                assert!(wait(&acquisition, samples_needed(1), LONG));
                count += counters(&acquisition).len();
            }
            count
        });
        let writer = scope.spawn(|| {
            (0..200).for_each(|counter| {
                acquisition.push(&sample(counter), None);
                thread::sleep(Duration::from_millis(1));
            });
        });
        let began = Instant::now();
        let never = Need { events: Some(u64::MAX), ..Need::default() };
        assert!(!wait(&acquisition, never, Duration::from_millis(100)));
        let waited = began.elapsed();
        assert!((Duration::from_millis(100)..LONG / 4).contains(&waited), "{waited:?}");
        writer.join().unwrap();
        acquisition.end("enough");
        assert_eq!(reader.join().unwrap() + counters(&acquisition).len(), 200);
    });
}

#[test]
fn the_end_of_input_wakes_all_waiters() {
    let acquisition = &acquisition();
    thread::scope(|scope| {
        let needs = [samples_needed(1), samples_needed(usize::MAX), Need { strings: true, ..Need::default() }];
        let all = needs.into_iter().chain([Need { events: Some(0), ..Need::default() }, Need::default()]);
        let waiters: Vec<_> = all.map(|need| scope.spawn(move || wait(acquisition, need, LONG))).collect();
        thread::sleep(SHORT);
        acquisition.end("unplugged");
        assert!(waiters.into_iter().all(|waiter| waiter.join().unwrap()));
    });
    assert!(acquisition.take_all().is_none());
}

#[test]
fn each_waiter_is_woken_by_what_it_needs() {
    let acquisition = &acquisition();
    acquisition.mark_data();
    acquisition.push(&sample(0), None); // the mark is an event
    assert_eq!(counters(acquisition), [0]);
    let events = Some(acquisition.take_events(false).1);
    thread::scope(|scope| {
        let spawn = |need| scope.spawn(move || wait(acquisition, need, LONG));
        let one = [samples_needed(1), samples_needed(1)].map(spawn);
        let three = spawn(samples_needed(3));
        let string = spawn(Need { strings: true, ..Need::default() });
        let event = spawn(Need { events, ..Need::default() });
        let either = spawn(Need { events, samples: Some(2), ..Need::default() });
        thread::sleep(SHORT);

        acquisition.push(&sample(1), None);
        assert!(one.into_iter().all(|waiter| waiter.join().unwrap()), "all who need the same");
        thread::sleep(SHORT);
        assert!(![&three, &string, &event, &either].into_iter().any(thread::ScopedJoinHandle::is_finished));

        acquisition.push(STRING, None);
        assert!(string.join().unwrap());
        thread::sleep(SHORT);
        assert!(![&three, &event, &either].into_iter().any(thread::ScopedJoinHandle::is_finished));

        acquisition.push(&frame(CONFIG_ACK, &[]), None);
        assert!(event.join().unwrap() && either.join().unwrap());
        assert!(!three.is_finished());

        acquisition.push(&[sample(2), sample(3)].concat(), None);
        assert!(three.join().unwrap());
    });
}

#[test]
fn no_wake_up_is_lost() {
    let acquisition = acquisition();
    thread::scope(|scope| {
        // Each waits for the next of its kind, and sends one to the other.
        let other = scope.spawn(|| {
            for counter in 0..2000 {
                assert!(wait(&acquisition, Need { strings: true, ..Need::default() }, LONG), "string {counter}");
                assert!(acquisition.take_string().is_some());
                acquisition.push(&sample(counter), None);
            }
        });
        for counter in 0..2000 {
            acquisition.push(STRING, None);
            assert!(wait(&acquisition, samples_needed(1), LONG), "sample {counter}");
            assert_eq!(counters(&acquisition), [counter]);
        }
        other.join().unwrap();
    });
}

#[test]
fn a_cancellation_ends_its_wait_only() {
    let acquisition = &acquisition();
    let (mine, other) = (Cancel::default(), Cancel::default());
    thread::scope(|scope| {
        let [cancelled, waiting] =
            [&mine, &other].map(|cancel| scope.spawn(move || acquisition.wait(samples_needed(1), LONG, cancel)));
        thread::sleep(SHORT);
        let began = Instant::now();
        acquisition.cancel(&mine);
        assert!(cancelled.join().unwrap());
        assert!(began.elapsed() < LONG / 4);
        assert!(mine.is_set() && !other.is_set());
        thread::sleep(SHORT);
        assert!(!waiting.is_finished());
        acquisition.push(&sample(0), None);
        assert!(waiting.join().unwrap());
    });
    assert!(acquisition.wait(samples_needed(9), LONG, &mine), "also those to come");
    assert_eq!(counters(acquisition), [0], "nothing was taken");
}

#[test]
fn a_wait_for_more_samples_than_fit_ends_when_the_lane_is_full() {
    let acquisition = Acquisition::new(4 * SAMPLE, MASTER, None);
    thread::scope(|scope| {
        let waiter = scope.spawn(|| wait(&acquisition, samples_needed(5), LONG));
        acquisition.push(&samples(3), None);
        thread::sleep(SHORT);
        assert!(!waiter.is_finished());
        // The waiter may have begun after the first sample was dropped; the next one is dropped, too.
        for counter in 3.. {
            acquisition.push(&sample(counter), None);
            if waiter.is_finished() {
                break;
            }
            thread::sleep(Duration::from_millis(1));
        }
        assert!(waiter.join().unwrap());
    });
    assert_eq!(counters(&acquisition).len(), 4);
}

// ---------------------------------------------------------------------------------------------
// Times
// ---------------------------------------------------------------------------------------------

#[test]
fn rates_do_not_depend_on_who_asks() {
    let [asked, unasked] = [(); 2].map(|()| Acquisition::new(QUEUE, MASTER, Some(0)));
    for tick in 0..1000_u16 {
        let now = i64::from(tick) * SECOND / 100;
        let bytes = [sample(tick), if tick % 25 == 0 { STRING.to_vec() } else { vec![] }].concat();
        for acquisition in [&asked, &unasked] {
            acquisition.push(&bytes, Some(now));
        }
        let rates = asked.stats(now + 1).rates;
        assert!(rates.quantities.values().all(|rate| (rate - 100.0).abs() < 1e-9), "{rates:?} at {now}");
    }
    let now = 10 * SECOND;
    let rates = unasked.stats(now).rates;
    assert_eq!(rates, asked.stats(now).rates);
    assert_eq!(rates.quantities.into_iter().collect::<Vec<_>>(), [(0x1020, 100.0), (0x4020, 100.0)]);
    assert!((rates.strings["PSONCMS"] - 4.0).abs() <= 0.5);
    let rates = unasked.stats(now + 2 * SECOND).rates;
    assert!(rates.quantities.values().chain(rates.strings.values()).all(|rate| *rate == 0.0));
}

#[test]
fn arrivals_never_decrease() {
    let acquisition = Acquisition::new(QUEUE, MASTER, Some(0));
    for (counter, arrival) in (0..).zip([5, 3, 9]) {
        acquisition.push(&sample(counter), Some(arrival));
    }
    let arrivals: Vec<_> = acquisition.take_block(None).unwrap().samples.iter().map(|sample| sample.arrival).collect();
    assert_eq!(arrivals, [5, 5, 9]);
    assert_eq!(acquisition.stats(0).last_arrival, Some(9));
}

#[test]
fn any_arrival_is_valid() {
    let path = folder("any_arrival").join("log.mtb");
    for epoch in [i64::MIN, 0, i64::MAX] {
        let acquisition = Acquisition::new(QUEUE, MASTER, Some(epoch));
        let rotate_after = Some(Duration::from_secs(1));
        let recorder = acquisition.record(Recording { rotate_after, overwrite: true, ..Recording::to(&path) }).unwrap();
        let mut decoder = xbus::live::BlockDecoder::new(None, epoch);
        for (counter, arrival) in (0..).zip([i64::MIN, -1, 0, i64::MAX, i64::MIN]) {
            let time = [[0x10, 0x60, 4, 0, 0, 0, 7].as_slice(), &[0x10, 0x20, 2, 0, counter]].concat();
            acquisition.push(&[&frame(MTDATA2, &time), STRING].concat(), Some(arrival));
            for now in [i64::MIN, 0, i64::MAX] {
                let _ = acquisition.stats(now);
            }
            let block = decoder.decode(acquisition.take_block(None).unwrap());
            assert_eq!((block.part.part.len(), block.string_times.len()), (1, 1));
        }
        let report = stop(&recorder);
        assert_eq!((report.error, report.frames), (None, 5));
    }
}

// ---------------------------------------------------------------------------------------------
// Ports
// ---------------------------------------------------------------------------------------------

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
        let acquisition = acquisition();
        acquisition.open(slave.as_raw_fd()).unwrap();
        let recorder = acquisition.record(Recording::to(&path)).unwrap();
        assert_eq!(acquisition.open(slave.as_raw_fd()).unwrap_err().kind(), ErrorKind::AlreadyExists);
        drop(slave); // its number is free for other files now
        let _others = [(); 4].map(|()| File::open("/dev/zero").unwrap());
        let stream: Vec<u8> = (0..60).flat_map(|_| samples(1000)).collect();
        master.write_all(&stream).unwrap(); // waits whenever the terminal is full
        assert!(wait(&acquisition, samples_needed(60_000), LONG));
        drop(master); // closing a terminal discards its buffer
        drain(&acquisition, &stream);
        assert_eq!(acquisition.ended().unwrap(), "the port is gone: unplugged, or closed on the other side");
        let stats = acquisition.stats(0);
        assert_eq!((stats.counts.samples, stats.counts.skipped_bytes, stats.overruns), (60_000, 0, None));
        assert_eq!(stop(&recorder).frames, 60_000);
        assert!(fs::read(path).unwrap() == stream);
    }

    #[test]
    fn descriptor_flags_are_unchanged() {
        let (_master, slave) = pty();
        let before = flags(&slave);
        let acquisition = acquisition();
        acquisition.open(slave.as_raw_fd()).unwrap();
        assert_eq!(flags(&slave), before);
        acquisition.close();
        assert_eq!(flags(&slave), before);
    }

    #[test]
    fn closing_ends_a_wait_for_a_silent_port() {
        let (_master, slave) = pty();
        let acquisition = acquisition();
        acquisition.open(slave.as_raw_fd()).unwrap();
        thread::scope(|scope| {
            let reader = scope.spawn(|| wait(&acquisition, samples_needed(1), LONG));
            let began = Instant::now();
            acquisition.close();
            assert!(reader.join().unwrap());
            assert!(began.elapsed() < Duration::from_secs(1));
        });
        assert_eq!(acquisition.ended().unwrap(), "it was closed");
        assert!(acquisition.take_all().is_none());
    }

    #[test]
    fn drop_ends_the_thread() {
        let (reader, mut writer) = pipe().unwrap();
        let acquisition = acquisition();
        acquisition.open(reader.as_raw_fd()).unwrap();
        drop(reader);
        drop(acquisition);
        assert_eq!(writer.write(&[1]).unwrap_err().kind(), ErrorKind::BrokenPipe, "the other side is closed");
    }

    #[test]
    fn a_new_port_continues_the_stream() {
        let acquisition = acquisition();
        let path = folder("again").join("log.mtb");
        let recorder = acquisition.record(Recording::to(&path)).unwrap();
        for (offset, part) in [(0, samples(3)), (3 * 25 + 10, samples(5))] {
            let (reader, mut writer) = pipe().unwrap();
            acquisition.open(reader.as_raw_fd()).unwrap();
            writer.write_all(&part).unwrap();
            writer.write_all(&part[..10]).unwrap(); // and in the middle of a frame
            drop(writer);
            while acquisition.ended().is_none() {
                thread::yield_now();
            }
            let block = acquisition.take_block(None).unwrap();
            assert_eq!((block.frames, block.samples[0].offset), (part, offset));
        }
        let counts = acquisition.stats(0).counts;
        assert_eq!((counts.samples, counts.skipped_bytes), (8, 20));
        assert_eq!(stop(&recorder).frames, 8);
        assert_eq!(fs::metadata(path).unwrap().len(), 8 * 25 + 20);
    }

    #[test]
    fn a_port_can_be_opened_after_a_pushed_end() {
        let (_master, slave) = pty();
        let acquisition = acquisition();
        acquisition.open(slave.as_raw_fd()).unwrap();
        acquisition.end("enough");
        acquisition.open(slave.as_raw_fd()).unwrap();
        assert_eq!(acquisition.ended(), None);
    }

    #[test]
    fn invalid_descriptors_are_an_error() {
        let acquisition = acquisition();
        assert_eq!(acquisition.open(-1).unwrap_err().raw_os_error(), Some(libc::EBADF));
        assert_eq!(acquisition.open(99_999).unwrap_err().raw_os_error(), Some(libc::EBADF));
    }
}

#[test]
fn a_pushed_stream_continues_after_its_end() {
    let acquisition = acquisition();
    assert_eq!(acquisition.resume().unwrap_err().kind(), std::io::ErrorKind::AlreadyExists);
    acquisition.push(&samples(2)[..30], None);
    acquisition.end("lost");
    acquisition.resume().unwrap();
    assert!(acquisition.push(&sample(2), None));
    assert_eq!(counters(&acquisition), [0, 2]);
    let counts = acquisition.stats(0).counts;
    assert_eq!((counts.skipped_bytes, counts.losses.samples), (5, 1));
}
