//! Logs of older devices, which send MTData in the layout of their settings.

#[allow(dead_code)] // each test takes what it needs
#[path = "../fuzz/src/lib.rs"]
mod fuzz;

use fuzz::checks;
use fuzz::streams::{frame, frame_of};
use proptest::prelude::*;
use xbus::column::Values;
use xbus::error::Fault;
use xbus::log::{Options, Part, Place, Reader};
use xbus::mtdata::{Output, Outputs};
use xbus::scan::Window;
use xbus::table::MTDATA;

/// Input of a fuzz target: a recipe with many devices that send MTData.
fn recipe() -> impl Strategy<Value = Vec<u8>> {
    let device = prop::collection::vec(any::<u8>(), 4..30).prop_map(|bytes| [&[0xFF], &bytes[..]].concat());
    let devices = prop::collection::vec(device, 1..6).prop_map(|devices| devices.concat());
    (any::<[u8; 2]>(), devices).prop_map(|([a, b], devices)| [&[a, b, 1], &devices[..]].concat())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 32, ..ProptestConfig::default() })]

    #[test]
    fn the_laws_of_all_streams_hold(data in recipe()) {
        checks::chunking(&data);
        checks::decode(&data);
        checks::fast_is_plain(&data);
        checks::parts(&data);
        checks::parallel(&data);
        checks::shape(&data);
    }
}

const FACTORY: Output = Output { mode: 0x0004, settings: 1 };
const EULER: Output = Output { mode: 0x0004, settings: 5 };

fn read(stream: &[u8], given: Vec<Output>) -> Part {
    let place = Place { outputs: Outputs::given(given), ..Place::default() };
    let mut reader = Reader::resume(Options::default(), place, 0);
    reader.read(Window { bytes: stream, offset: 0, last: true }, u64::MAX).unwrap();
    reader.take()
}

/// Messages of a device with a constant value and a counter.
fn messages(output: Output, count: u16) -> Vec<u8> {
    let size = output.size().unwrap();
    let message = |i: u16| frame(MTDATA, &[&[0; 64][..size - 2], &i.to_be_bytes()].concat());
    (0..count).flat_map(message).collect()
}

fn names(part: &Part) -> Vec<(&'static str, usize)> {
    part.columns.iter().map(|column| (column.quantity().unwrap().name, column.rows)).collect()
}

#[test]
fn settings_of_the_caller_hold_until_the_stream_has_others() {
    let reply = [frame(0xD3, &5_u32.to_be_bytes()), messages(EULER, 100)].concat();
    let stream = [messages(FACTORY, 100), reply].concat();
    let part = read(&stream, vec![FACTORY]);
    assert_eq!(names(&part), [("quaternion", 100), ("packet_counter", 200), ("euler_angles", 100)]);
    assert_eq!((part.stats.samples, part.stats.unfit, part.stats.messages), (200, 0, 1));
    // Without them, half of the settings is not enough.
    assert_eq!(read(&stream, vec![]).stats.unfit, 200);
}

#[test]
fn a_request_counts_when_it_is_acknowledged() {
    let settings = EULER.settings.to_be_bytes();
    let request = |answer: Vec<u8>| [frame(0xD2, &settings), answer, messages(EULER, 10)].concat();
    assert_eq!(read(&request(frame(0xD3, &[])), vec![FACTORY]).stats.unfit, 0);
    assert_eq!(read(&request(frame(0x42, &[3])), vec![FACTORY]).stats.unfit, 10);
    // A later reply to a question does not take it up again.
    let refused = [frame(0xD2, &settings), frame(0x42, &[3]), frame(0xD2, &[]), frame(0xD3, &1_u32.to_be_bytes())];
    assert_eq!(read(&[refused.concat(), messages(FACTORY, 10)].concat(), vec![FACTORY]).stats.unfit, 0);
}

#[test]
fn each_device_of_a_bus_has_its_own_settings() {
    let set = |bid, output: Output| {
        [frame_of(bid, 0xD1, &output.mode.to_be_bytes()), frame_of(bid, 0xD3, &output.settings.to_be_bytes())].concat()
    };
    let message = |bid, output: Output| frame_of(bid, MTDATA, &vec![0; output.size().unwrap()]);
    let stream = [set(1, FACTORY), set(2, EULER), message(2, EULER), message(0xFF, FACTORY), message(1, EULER)];
    let part = read(&stream.concat(), vec![]);
    assert_eq!(part.bids(), [2, 0xFF]);
    assert_eq!(part.stats.unfit, 1);
}

#[test]
fn layouts_that_look_the_same_are_not_mixed_up() {
    // 14 bytes: a quaternion without its counter has 16, so: three numbers and a counter, twice.
    let (euler, sensor) = (EULER, Output { mode: 0x0002, settings: 0x61 });
    assert_eq!(euler.size(), sensor.size());
    let set = |output: Output| {
        [frame(0xD1, &output.mode.to_be_bytes()), frame(0xD3, &output.settings.to_be_bytes())].concat()
    };
    let stream = [set(euler), messages(euler, 300), set(sensor), messages(sensor, 300), set(euler), messages(euler, 9)];
    let part = read(&stream.concat(), vec![]);
    assert_eq!(names(&part), [("euler_angles", 309), ("packet_counter", 609), ("acceleration", 300)]);
}

#[test]
fn the_trackers_of_an_xbus_master_share_the_counter() {
    // Two quaternions behind a counter.
    let quaternions = [[0x3F80_0000_u32, 0, 0, 0], [0x3F00_0000; 4]];
    let bytes: Vec<u8> = quaternions.as_flattened().iter().flat_map(|number| number.to_be_bytes()).collect();
    let message = |counter: u16| frame(MTDATA, &[&counter.to_be_bytes(), &bytes[..]].concat());
    let stream: Vec<u8> = (4660..4670).flat_map(message).collect();
    assert_eq!(stream[..3], [0xFA, 0xFF, 0x32]);
    let part = read(&stream, vec![Output { mode: 4, settings: 0 }; 2]);
    assert_eq!((part.stats.frames, part.stats.samples), (10, 20));
    assert_eq!(part.bids()[..4], [1, 2, 1, 2]);
    assert_eq!(part.offsets()[..4], [0, 0, 39, 39]);
    let Values::U16(counters) = &part.columns[0].values else { panic!("a U2") };
    assert_eq!(counters[..4], [4660, 4660, 4661, 4661]);
    let Values::F32(numbers) = &part.columns[1].values else { panic!("Float32") };
    assert_eq!(numbers[..8], [1.0, 0.0, 0.0, 0.0, 0.5, 0.5, 0.5, 0.5]);
}

#[test]
fn a_strict_reader_names_the_length() {
    let place = |given| Place { outputs: Outputs::given(given), ..Place::default() };
    let fault = |stream: &[u8], given| {
        let mut reader = Reader::resume(Options { strict: true, ..Options::default() }, place(given), 0);
        reader.read(Window { bytes: stream, offset: 0, last: true }, u64::MAX).unwrap_err()
    };
    let stream = messages(EULER, 1);
    assert_eq!(fault(&stream, vec![]), Fault::Unfit { offset: 0, length: 14, expected: None });
    assert_eq!(fault(&stream, vec![FACTORY]), Fault::Unfit { offset: 0, length: 14, expected: Some(18) });
}
