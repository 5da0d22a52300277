//! MCAP files of messages, read back by the crate `mcap`.
#![cfg(feature = "export")]

use std::collections::BTreeMap;

use mcap::{MessageStream, Summary};
use xbus::message_file::{Bodies, Compression, MessageFile, Rows, Topic};

/// Head of the messages of the tests: an encapsulation and a time stamp.
const HEAD: [u8; 12] = [0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
const SECOND: i64 = 1_000_000_000;

fn topic(name: &str) -> Topic {
    let metadata = BTreeMap::from([("offered_qos_profiles".to_owned(), "[]".to_owned())]);
    Topic { name: name.to_owned(), schema: "a/msg/B".to_owned(), definition: "float64 data".to_owned(), metadata }
}

fn rows<'a>(topic: usize, sample: &'a [i64], body: Bodies<'a>) -> Rows<'a> {
    Rows { topic, sample, head: &HEAD, stamp: Some(4), body }
}

fn file(compression: Compression) -> MessageFile {
    let about = ("about".to_owned(), BTreeMap::from([("key".to_owned(), "value".to_owned())]));
    let mut file = MessageFile::new(compression, "test", &[about]).unwrap();
    for name in ["/a", "/b", "/c"] {
        file.declare(topic(name));
    }
    file
}

/// Topic, time and bytes of each message.
fn read(bytes: &[u8]) -> Vec<(String, u64, Vec<u8>)> {
    let messages = MessageStream::new(bytes).unwrap().map(Result::unwrap);
    messages.map(|message| (message.channel.topic.clone(), message.log_time, message.data.to_vec())).collect()
}

#[test]
fn samples_in_order_and_topics_in_order_within_a_sample() {
    for compression in Compression::ALL {
        let mut file = file(compression);
        let (stamps, times) = ([3 * SECOND + 7, 5 * SECOND], [30, 50]);
        let texts = (b"xyyy", [1, 4]);
        let given = [rows(1, &[10, 11], Bodies::Even(b"pq")), rows(0, &[10, 11], Bodies::Ends(texts.0, &texts.1))];
        file.write(10, &stamps, &times, &given).unwrap();
        let mut bytes = file.take();
        bytes.extend(file.finish().unwrap());
        let message = |topic: &str, time, seconds: u8, nanoseconds: u8, body: &[u8]| {
            let head = [0, 1, 0, 0, seconds, 0, 0, 0, nanoseconds, 0, 0, 0];
            (topic.to_owned(), time, [&head[..], body].concat())
        };
        let expected = [
            message("/b", 30, 3, 7, b"p"),
            message("/a", 30, 3, 7, b"x"),
            message("/b", 50, 5, 0, b"q"),
            message("/a", 50, 5, 0, b"yyy"),
        ];
        assert_eq!(read(&bytes), expected);
        assert_eq!(file.counts(), [2, 2, 0]);
        let summary = Summary::read(&bytes).unwrap().unwrap();
        let statistics = summary.stats.unwrap();
        assert_eq!((statistics.message_count, statistics.channel_count), (4, 2), "/c has no message");
        assert_eq!((statistics.message_start_time, statistics.message_end_time), (30, 50));
        assert_eq!(summary.metadata_indexes.len(), 1);
        assert_eq!(summary.chunk_indexes.len(), 1);
    }
}

#[test]
fn the_bytes_of_a_file_do_not_depend_on_calls() {
    let samples: Vec<i64> = (0..50_000).collect();
    let bodies: Vec<u8> = samples.iter().flat_map(|sample| (sample * sample).to_le_bytes()).collect();
    let stamps: Vec<i64> = samples.iter().map(|sample| sample * 10_000_000).collect();
    let times: Vec<u64> = stamps.iter().map(|stamp| stamp.unsigned_abs()).collect();
    let of = |size: usize| {
        let mut file = file(Compression::Zstd);
        let mut bytes = vec![];
        for first in (0..samples.len()).step_by(size) {
            let range = first..samples.len().min(first + size);
            let body = Bodies::Even(&bodies[8 * range.start..8 * range.end]);
            let given = [rows(2, &samples[range.clone()], body)];
            file.write(samples[first], &stamps[range.clone()], &times[range], &given).unwrap();
            bytes.extend(file.take());
        }
        bytes.extend(file.finish().unwrap());
        bytes
    };
    let whole = of(samples.len());
    assert!(whole == of(777));
    assert!(Summary::read(&whole).unwrap().unwrap().chunk_indexes.len() > 1);
    assert_eq!(read(&whole).len(), samples.len());
}

#[test]
fn rows_that_do_not_fit_are_refused() {
    let ends = [2, 1];
    let cases = [
        ("no such topic", rows(3, &[0], Bodies::Even(b"x"))),
        ("descend", rows(0, &[1, 0], Bodies::Even(b"xy"))),
        ("no time stamp", rows(0, &[-1], Bodies::Even(b"x"))),
        ("no time stamp", rows(0, &[2], Bodies::Even(b"x"))),
        ("as many", rows(0, &[0, 1], Bodies::Even(b"xyz"))),
        ("as many", rows(0, &[], Bodies::Even(b"x"))),
        ("as many", rows(0, &[0, 1], Bodies::Ends(b"x", &ends))),
        ("as many", rows(0, &[0, 1], Bodies::Ends(b"xy", &ends))),
        ("behind the head", Rows { stamp: Some(5), ..rows(0, &[0], Bodies::Even(b"x")) }),
        ("behind the head", Rows { head: b"short", ..rows(0, &[0], Bodies::Even(b"x")) }),
    ];
    for (problem, given) in cases {
        let mut file = file(Compression::None);
        let error = file.write(0, &[0, 0], &[0, 0], &[rows(1, &[0], Bodies::Even(b"x")), given]).unwrap_err();
        assert!(error.to_string().contains(problem), "{error}");
        assert_eq!(file.counts(), [0, 0, 0], "nothing is written");
    }
}
