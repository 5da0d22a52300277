//! Tables: names, nulls, units and batches, without Python.

#![cfg(feature = "arrow")]

use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::types::{Float32Type, Float64Type, Int64Type, TimestampNanosecondType, UInt8Type, UInt16Type};
use arrow_array::{Array, RecordBatch, RecordBatchReader};
use xbus::arrow::Table;
use xbus::clock::Clocks;
use xbus::error::HostTimesError;
use xbus::frame::Frame;
use xbus::log::{Options, Reader, TimedPart};
use xbus::packet::{Coordinates, Precision};
use xbus::scan::Window;
use xbus::table;
use xbus::value::{Number, write_packet};

/// The packets of one message.
#[derive(Default)]
struct Message(Vec<u8>);

impl Message {
    fn integers(mut self, name: &str, values: &[i64]) -> Self {
        let numbers: Vec<_> = values.iter().map(|value| Number::Integer(*value)).collect();
        write_packet(&mut self.0, table::quantity_named(name).unwrap(), None, None, &numbers).unwrap();
        self
    }

    fn reals(mut self, name: &str, coordinates: Option<Coordinates>, values: &[f64]) -> Self {
        let numbers: Vec<_> = values.iter().map(|value| Number::Double(*value)).collect();
        let quantity = table::quantity_named(name).unwrap();
        write_packet(&mut self.0, quantity, Some(Precision::Float32), coordinates, &numbers).unwrap();
        self
    }
}

fn part(messages: Vec<Message>) -> Arc<TimedPart> {
    let frame = |message: Message| Frame { bid: 0xFF, mid: table::MTDATA2, payload: &message.0 }.encode().unwrap();
    let bytes: Vec<u8> = messages.into_iter().flat_map(frame).collect();
    let mut reader = Reader::new(Options::default(), 0);
    reader.read(Window { bytes: &bytes, offset: 0, last: true }, u64::MAX).unwrap();
    Arc::new(TimedPart::take(&mut reader, &mut Clocks::default()))
}

fn wide(part: &Arc<TimedPart>) -> Table {
    Table::wide(part.clone(), (0..part.part.columns.len()).collect())
}

fn only_batch(table: &Table) -> RecordBatch {
    let batches: Vec<_> = table.batches().map(Result::unwrap).collect();
    let [batch] = &batches[..] else { panic!("{} batches", batches.len()) };
    batch.clone()
}

fn names(batch: &RecordBatch) -> Vec<String> {
    batch.schema().fields().iter().map(|field| field.name().clone()).collect()
}

#[test]
fn missing_values_are_null() {
    let part = part(vec![
        Message::default().integers("sample_time_fine", &[10_000]).reals("acceleration", None, &[1.0, 2.0, 3.0]),
        Message::default().integers("packet_counter", &[7]),
        Message::default().integers("sample_time_fine", &[20_000]).reals("acceleration", None, &[4.0, 5.0, 6.0]),
    ]);
    let batch = only_batch(&wide(&part));
    assert_eq!(
        names(&batch),
        ["sample", "time", "sample_time_fine", "acceleration_x", "acceleration_y", "acceleration_z", "packet_counter"]
    );
    assert_eq!(batch["sample"].as_primitive::<Int64Type>().values(), &[0, 1, 2]);
    let time: Vec<_> = batch["time"].as_primitive::<Float64Type>().iter().collect();
    assert_eq!(time, [Some(1.0), None, Some(2.0)]);
    let y: Vec<_> = batch["acceleration_y"].as_primitive::<Float32Type>().iter().collect();
    assert_eq!(y, [Some(2.0), None, Some(5.0)]);
    let counter: Vec<_> = batch["packet_counter"].as_primitive::<UInt16Type>().iter().collect();
    assert_eq!(counter, [None, Some(7), None]);

    let schema = batch.schema();
    let metadata = schema.field_with_name("acceleration_x").unwrap().metadata().clone();
    let metadata = ["data_id", "unit", "precision"].map(|key| metadata.get(key).cloned().unwrap());
    assert_eq!(metadata, ["0x4020", "m/s2", "Float32"]);

    let rows = part.part.columns.iter().position(|column| column.rows == 2 && column.width == 3).unwrap();
    let batch = only_batch(&Table::rows(part, rows));
    assert_eq!(batch["sample"].as_primitive::<Int64Type>().values(), &[0, 2]);
    assert_eq!(batch["acceleration_z"].as_primitive::<Float32Type>().values(), &[3.0, 6.0]);
    assert_eq!(batch["acceleration_z"].null_count(), 0);
}

#[test]
fn a_full_scalar_column_is_not_copied() {
    let part = part((0..50).map(|counter| Message::default().integers("packet_counter", &[counter])).collect());
    let batch = only_batch(&wide(&part));
    let xbus::column::Values::U16(values) = &part.part.columns[0].values else { panic!() };
    assert_eq!(batch["packet_counter"].as_primitive::<UInt16Type>().values().as_ptr(), values.as_ptr());
    assert_eq!(batch["time"].null_count(), 50);
}

#[test]
fn each_coordinate_system_has_columns() {
    let quaternion = |system| Message::default().reals("quaternion", Some(system), &[1.0, 0.0, 0.0, 0.0]);
    let part = part(vec![quaternion(Coordinates::Enu), quaternion(Coordinates::Ned)]);
    let names = names(&only_batch(&wide(&part)));
    assert!(names.contains(&"quaternion_enu_q0".to_owned()) && names.contains(&"quaternion_ned_q3".to_owned()));
    let batch = only_batch(&Table::wide(part, vec![1]));
    assert!(batch.column_by_name("quaternion_q0").is_some());
}

#[test]
fn rotation_matrices_are_in_row_order() {
    let matrix: Vec<f64> = (0..9).map(f64::from).collect();
    let batch = only_batch(&wide(&part(vec![Message::default().reals("rotation_matrix", None, &matrix)])));
    let names = names(&batch);
    assert_eq!(
        names[2..6],
        ["rotation_matrix_m11", "rotation_matrix_m12", "rotation_matrix_m13", "rotation_matrix_m21"]
    );
    assert_eq!(batch["rotation_matrix_m12"].as_primitive::<Float32Type>().values(), &[3.0]);
}

#[test]
fn invalid_dates_are_null() {
    let utc = |month: i64| Message::default().integers("utc_time", &[5, 2026, month, 22, 12, 30, 15, 7]);
    let batch = only_batch(&wide(&part(vec![utc(11), utc(13)])));
    let stamps: Vec<_> = batch["utc_time"].as_primitive::<TimestampNanosecondType>().iter().collect();
    assert_eq!(stamps, [Some(1_795_350_615_000_000_005), None]);
}

#[test]
fn lists_have_one_row_for_each_entry() {
    let satellites = |tow: i64, ids: &[i64]| {
        let mut numbers = vec![tow, i64::try_from(ids.len()).unwrap(), 0, 0, 0];
        numbers.extend(ids.iter().flat_map(|id| [0, *id, 30, 1]));
        Message::default().integers("gnss_sat_info", &numbers)
    };
    let part = part(vec![satellites(100, &[3, 4]), satellites(200, &[]), satellites(300, &[5])]);
    let batch = only_batch(&Table::rows(part.clone(), 0));
    assert_eq!(batch["sample"].as_primitive::<Int64Type>().values(), &[0, 0, 2]);
    assert_eq!(batch["svId"].as_primitive::<UInt8Type>().values(), &[3, 4, 5]);
    assert_eq!(names(&only_batch(&wide(&part))).iter().filter(|name| name.starts_with("gnss_sat_info")).count(), 5);
}

#[test]
fn host_times_are_a_column() {
    let part = part((0..3).map(|counter| Message::default().integers("packet_counter", &[counter])).collect());
    let batch = only_batch(&wide(&part).with_host_times(vec![1.5, f64::NAN, 3.5]).unwrap());
    let times: Vec<_> = batch["host_time"].as_primitive::<Float64Type>().iter().collect();
    assert_eq!(times, [Some(1.5), None, Some(3.5)]);
    let error = wide(&part).with_host_times(vec![1.5]).unwrap_err();
    assert_eq!(error, HostTimesError { samples: 3, found: 1 });
    assert_eq!(error.to_string(), "a table of 3 samples needs 3 host times, not 1");
}

#[test]
fn long_tables_are_batched_and_empty_tables_have_a_schema() {
    let count = (1 << 18) + 10;
    let message = |counter: i64| {
        let message = Message::default().integers("packet_counter", &[counter & 0xFFFF]);
        if counter % 2 == 0 { message.reals("temperature", None, &[20.0]) } else { message }
    };
    let part = part((0..count).map(message).collect());
    let batches: Vec<_> = wide(&part).batches().map(Result::unwrap).collect();
    assert_eq!(batches.iter().map(RecordBatch::num_rows).collect::<Vec<_>>(), [1 << 18, 10]);
    assert_eq!(batches[1]["sample"].as_primitive::<Int64Type>().value(9), count - 1);
    let temperature: Vec<_> = batches[1]["temperature"].as_primitive::<Float32Type>().iter().collect();
    assert_eq!(temperature[..3], [Some(20.0), None, Some(20.0)]);

    let empty = self::part(vec![]);
    let batches = wide(&empty).batches();
    assert_eq!(batches.schema().fields().len(), 2);
    assert_eq!(batches.count(), 0);
}
