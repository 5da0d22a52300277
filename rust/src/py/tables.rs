//! The tables, row by row.

use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};

use super::Row;
use crate::packet::record_size;
use crate::scan::Reason;
use crate::table::{self, CanContent, Content, Field, Kind, MessageField, Payload, Products};

/// A row as a dict: fields and variables under their names, and values under other names.
macro_rules! row {
    ($py:ident, $row:ident { $($field:ident),+ } $(, $variable:ident)* $(, $name:literal: $value:expr)* $(,)?) => {{
        let row = PyDict::new($py);
        $(row.set_item(stringify!($field), $row.$field)?;)+
        $(row.set_item(stringify!($variable), $variable)?;)*
        $(row.set_item($name, $value)?;)*
        Ok(row)
    }};
}

fn numbers_of(products: Products) -> Vec<u16> {
    products.iter().map(|product| product.number).collect()
}

fn fields<'py>(py: Python<'py>, fields: &[Field]) -> PyResult<Vec<Row<'py>>> {
    fields.iter().map(|field| row!(py, field { name, scale, unit, missing }, "type": field.wire)).collect()
}

fn message_fields<'py>(py: Python<'py>, fields: &[MessageField]) -> PyResult<Vec<Row<'py>>> {
    let row = |field: &MessageField| {
        let (kind, repeat, rest) = match field.content {
            Content::Numbers(wire, count) => (wire.numpy(), count, false),
            Content::Double => ("f8", 1, false),
            Content::Text(size) => ("text", size, false),
            Content::Bytes(size) => ("bytes", size, false),
            Content::RestText(most) => ("text", most, true),
            Content::RestBytes(most) => ("bytes", most, true),
        };
        row!(py, field { name, unit, note }, repeat, rest, "type": kind)
    };
    fields.iter().map(row).collect()
}

/// The data identifiers.
#[pyfunction]
pub fn quantities(py: Python<'_>) -> PyResult<Vec<Row<'_>>> {
    quantity_rows(py, table::QUANTITIES)
}

/// The quantities that only CAN has.
#[pyfunction]
pub fn can_quantities(py: Python<'_>) -> PyResult<Vec<Row<'_>>> {
    quantity_rows(py, table::CAN_QUANTITIES)
}

/// The quantities that only `MTData` has.
#[pyfunction]
pub fn mtdata_quantities(py: Python<'_>) -> PyResult<Vec<Row<'_>>> {
    quantity_rows(py, table::MTDATA_QUANTITIES)
}

/// The items of `MTData`.
#[pyfunction]
pub fn mtdata_items(py: Python<'_>) -> PyResult<Vec<Row<'_>>> {
    let row = |item: &table::MtDataItem| row!(py, item { mode, mask, value, step }, "quantity": item.quantity.name);
    table::MTDATA_ITEMS.iter().map(row).collect()
}

fn quantity_rows<'py>(py: Python<'py>, quantities: &[table::Quantity]) -> PyResult<Vec<Row<'py>>> {
    let row = |quantity: &table::Quantity| {
        let (kind, numbers, size, head, entry): (_, _, _, &[Field], &[Field]) = match quantity.kind {
            Kind::Real(n) => ("real", n, None, &[], &[]),
            Kind::Fixed(wire, n) => (wire.numpy(), n, Some(n * wire.size()), &[], &[]),
            Kind::Id => ("id", 1, None, &[], &[]),
            Kind::Struct(head) => ("struct", 1, Some(record_size(head)), head, &[]),
            Kind::List(head, entry) => ("list", 1, None, head, entry),
        };
        row!(
            py,
            quantity { id, name, manual, group, components, unit, is_matrix, axes, interpolation, clock, has_flags, source },
            kind, numbers, size,
            "coordinates": quantity.rotates,
            "products": numbers_of(quantity.products),
            "fields": fields(py, head)?,
            "entry": fields(py, entry)?,
        )
    };
    quantities.iter().map(row).collect()
}

/// The CAN messages.
#[pyfunction]
pub fn can_messages(py: Python<'_>) -> PyResult<Vec<Row<'_>>> {
    let signal = |signal: &table::CanSignal| {
        let (min, max) = signal.range;
        row!(py, signal { name, per_unit, unit }, min, max, "type": signal.wire)
    };
    let row = |message: &table::CanMessage| {
        let kind = match message.content {
            CanContent::Numbers(_) => "numbers",
            CanContent::Scaled(_) => "scaled",
            CanContent::Component(..) => "component",
            CanContent::Integer(_) => "integer",
            CanContent::Record(_) => "record",
            CanContent::Utc(_) => "utc",
            CanContent::Event => "event",
            CanContent::Opaque => "opaque",
        };
        row!(
            py,
            message { code, name, max_rate },
            kind,
            "quantity": message.content.quantity().map(|quantity| quantity.name),
            "size": message.size(),
            "signals": message.signals.iter().map(signal).collect::<PyResult<Vec<_>>>()?,
            "products": numbers_of(message.products),
        )
    };
    table::CAN_MESSAGES.iter().map(row).collect()
}

/// The numbers of MTSSP, by name.
#[pyfunction]
pub fn mtssp(py: Python<'_>) -> PyResult<Row<'_>> {
    let opcodes = table::mtssp::OPCODES.iter().map(|opcode| row!(py, opcode { code, name, is_read, size }));
    let row = PyDict::new(py);
    row.set_item("opcodes", opcodes.collect::<PyResult<Vec<_>>>()?)?;
    row.set_item("data_ready_bits", table::mtssp::DATA_READY_BITS)?;
    row.set_item("addresses", PyBytes::new(py, &table::mtssp::ADDRESSES))?;
    row.set_item("spi_header", PyBytes::new(py, &table::mtssp::SPI_HEADER))?;
    row.set_item("spi_mode", table::mtssp::SPI_MODE)?;
    row.set_item("max_spi_hz", table::mtssp::MAX_SPI_HZ)?;
    row.set_item("max_i2c_hz", table::mtssp::MAX_I2C_HZ)?;
    row.set_item("max_input", table::mtssp::MAX_INPUT)?;
    row.set_item("max_output", table::mtssp::MAX_OUTPUT)?;
    row.set_item("pipe_overflow", table::mtssp::PIPE_OVERFLOW)?;
    Ok(row)
}

/// The messages.
#[pyfunction]
pub fn messages(py: Python<'_>) -> PyResult<Vec<Row<'_>>> {
    let row = |message: &table::Message| {
        let lengths: Vec<usize> = message.lengths().iter().collect();
        let (kind, forms, least, most, filled, zeros): (_, &[&[MessageField]], _, _, _, _) = match message.payload {
            Payload::Empty => ("empty", &[], 0, 0, false, false),
            Payload::Bytes(..) => ("bytes", &[], 0, 0, false, false),
            Payload::Text { least, most, filled } => ("text", &[], least, most, filled, false),
            Payload::Record(forms) => ("record", forms, 1, 1, false, false),
            Payload::List { entry, least, most, zeros } => ("list", &[entry], least, most, false, zeros),
        };
        row!(
            py,
            message { mid, name, direction, restarts, reply, status },
            kind, least, most, filled, zeros,
            "states": message.states.names(),
            "payload": message.description(),
            "lengths": (!lengths.is_empty()).then_some(lengths),
            "forms": forms.iter().map(|form| message_fields(py, form)).collect::<PyResult<Vec<_>>>()?,
            "products": numbers_of(message.products),
            "legacy": message.legacy.iter().map(|product| product.name).collect::<Vec<_>>(),
        )
    };
    table::MESSAGES.iter().map(row).collect()
}

/// The products.
#[pyfunction]
pub fn products(py: Python<'_>) -> PyResult<Vec<Row<'_>>> {
    product_rows(py, table::PRODUCTS)
}

/// The products before those of the manual.
#[pyfunction]
pub fn legacy_products(py: Python<'_>) -> PyResult<Vec<Row<'_>>> {
    product_rows(py, table::LEGACY_PRODUCTS)
}

fn product_rows<'py>(py: Python<'py>, products: &[table::Product]) -> PyResult<Vec<Row<'py>>> {
    let row = |product: &table::Product| {
        let series = product.series;
        row!(
            py,
            product { number, name, title, series },
            "kind": product.class,
            "id_size": series.id_size(),
            "fine_wrap": series.fine_wrap(),
        )
    };
    products.iter().map(row).collect()
}

/// The bits of the status word.
#[pyfunction]
pub fn status_flags(py: Python<'_>) -> PyResult<Vec<Row<'_>>> {
    table::STATUS_FLAGS.iter().map(|flag| row!(py, flag { name, bit, width, meaning })).collect()
}

/// The string outputs, in the order of their bits: name, and how it begins.
#[pyfunction]
pub fn strings() -> Vec<(&'static str, &'static [u8])> {
    table::STRINGS.iter().map(|string| (string.name, string.start)).collect()
}

/// What the numbers in Error and Warning messages mean.
#[pyfunction]
pub fn result_codes() -> Vec<(u32, &'static str)> {
    table::RESULT_CODES.to_vec()
}

/// Why bytes were refused, in the order of their numbers.
#[pyfunction]
pub fn damage_reasons() -> [Reason; Reason::ALL.len()] {
    Reason::ALL
}
