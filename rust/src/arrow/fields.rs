//! Names, types, units and metadata of a table's columns.

use arrow_schema::{DataType, Field, Metadata, TimeUnit};

use crate::column::{Column, Values};
use crate::table::{self, Wire};

/// The index of a sample in its log.
pub fn sample() -> Field {
    Field::new("sample", DataType::Int64, false)
}

/// A time in seconds; null where it is unknown.
pub fn seconds(name: &str) -> Field {
    let unit = Metadata::from([("unit".to_owned(), "s".to_owned())]);
    Field::new(name, DataType::Float64, true).with_metadata(unit)
}

/// The bus identifier of the device.
pub fn bid() -> Field {
    Field::new("bid", DataType::UInt8, false)
}

/// UTC of each sample; null where it is not known.
pub fn utc() -> Field {
    Field::new("utc", timestamp(), true)
}

/// A point in time in UTC; null where the device does not mark it as valid, and for a date that does not exist.
pub fn utc_of(name: &str, column: &Column) -> Field {
    Field::new(name, timestamp(), true).with_metadata(metadata(column, ""))
}

fn timestamp() -> DataType {
    DataType::Timestamp(TimeUnit::Nanosecond, Some("UTC".into()))
}

/// One number of each row of a column.
pub fn number(name: String, column: &Column, nullable: bool) -> Field {
    let unit = column.quantity().map_or("", |quantity| quantity.unit);
    Field::new(name, type_of_values(&column.values), nullable).with_metadata(metadata(column, unit))
}

/// One field of each record of a column, in its unit; null where the device does not provide it.
pub fn scaled_field(name: String, column: &Column, field: &table::Field, nullable: bool) -> Field {
    let nullable = nullable || field.missing.is_some();
    Field::new(name, DataType::Float64, nullable).with_metadata(metadata(column, field.unit))
}

/// One field of each record of a column, as the raw integer.
pub fn record_field(name: String, column: &Column, field: &table::Field, nullable: bool) -> Field {
    Field::new(name, type_of_wire(field.wire), nullable).with_metadata(metadata(column, &raw_unit(field)))
}

/// The name of a quantity in a table that has these columns: with coordinates if there are several systems.
pub fn stem(column: &Column, others: &[&Column]) -> Option<String> {
    let quantity = column.quantity()?;
    let is_same = |other: &&&Column| other.quantity().is_some_and(|other| other.id == quantity.id);
    match column.coordinates() {
        Some(coordinates) if others.iter().filter(is_same).count() > 1 => {
            Some(format!("{}_{}", quantity.name, coordinates.name().to_lowercase()))
        }
        _ => Some(quantity.name.to_owned()),
    }
}

fn metadata(column: &Column, unit: &str) -> Metadata {
    let mut pairs = vec![("data_id", format!("{:#06X}", column.data_id()))];
    if !unit.is_empty() {
        pairs.push(("unit", unit.to_owned()));
    }
    if let Some(coordinates) = column.coordinates() {
        pairs.push(("coordinates", coordinates.name().to_owned()));
    }
    if let Some(precision) = column.precision() {
        pairs.push(("precision", precision.name().to_owned()));
    }
    pairs.into_iter().map(|(key, value)| (key.to_owned(), value)).collect()
}

/// The unit of a raw integer: `"1e-7 deg"`.
fn raw_unit(field: &table::Field) -> String {
    #[allow(clippy::float_cmp)] // a constant of the table
    if field.scale == 1.0 {
        field.unit.to_owned()
    } else {
        format!("{:e} {}", field.scale, field.unit).trim().to_owned()
    }
}

fn type_of_wire(wire: Wire) -> DataType {
    type_of_values(&Values::of(wire))
}

fn type_of_values(values: &Values) -> DataType {
    match values {
        Values::U8(_) => DataType::UInt8,
        Values::U16(_) => DataType::UInt16,
        Values::U32(_) => DataType::UInt32,
        Values::U64(_) => DataType::UInt64,
        Values::I8(_) => DataType::Int8,
        Values::I16(_) => DataType::Int16,
        Values::I32(_) => DataType::Int32,
        Values::F32(_) => DataType::Float32,
        Values::F64(_) => DataType::Float64,
        Values::Records(_) | Values::Raw(_) => DataType::Null,
    }
}
