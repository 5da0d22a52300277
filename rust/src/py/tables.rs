//! The tables, row by row.

use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::Row;
use crate::packet::record_size;
use crate::scan::Reason;
use crate::table::{self, ClockRole, Content, Direction, Field, Kind, MessageField, Payload};

fn fields<'py>(py: Python<'py>, fields: &[Field]) -> PyResult<Vec<Row<'py>>> {
    let row = |field: &Field| {
        let row = PyDict::new(py);
        row.set_item("name", field.name)?;
        row.set_item("type", field.wire.numpy())?;
        row.set_item("scale", field.scale)?;
        row.set_item("unit", field.unit)?;
        row.set_item("missing", field.missing)?;
        Ok(row)
    };
    fields.iter().map(row).collect()
}

fn message_fields<'py>(py: Python<'py>, fields: &[MessageField]) -> PyResult<Vec<Row<'py>>> {
    let row = |field: &MessageField| {
        let (kind, count, rest) = match field.content {
            Content::Numbers(wire, count) => (wire.numpy(), count, false),
            Content::Double => ("f8", 1, false),
            Content::Text(size) => ("text", size, false),
            Content::Bytes(size) => ("bytes", size, false),
            Content::RestText(most) => ("text", most, true),
            Content::RestBytes(most) => ("bytes", most, true),
        };
        let row = PyDict::new(py);
        row.set_item("name", field.name)?;
        row.set_item("type", kind)?;
        row.set_item("repeat", count)?;
        row.set_item("rest", rest)?;
        row.set_item("unit", field.unit)?;
        row.set_item("note", field.note)?;
        Ok(row)
    };
    fields.iter().map(row).collect()
}

/// The data identifiers.
#[pyfunction]
pub fn quantities(py: Python<'_>) -> PyResult<Vec<Row<'_>>> {
    let row = |quantity: &table::Quantity| {
        let row = PyDict::new(py);
        row.set_item("id", quantity.id)?;
        row.set_item("name", quantity.name)?;
        row.set_item("manual", quantity.manual)?;
        row.set_item("group", quantity.group)?;
        row.set_item("components", quantity.components.to_vec())?;
        row.set_item("unit", quantity.unit)?;
        row.set_item("is_matrix", quantity.is_matrix)?;
        row.set_item("coordinates", quantity.rotates)?;
        row.set_item("clock", quantity.clock.map(ClockRole::name))?;
        row.set_item("has_flags", quantity.has_flags)?;
        row.set_item("products", quantity.products.iter().map(|product| product.number).collect::<Vec<_>>())?;
        row.set_item("source", quantity.source)?;
        let (kind, count, size, head, entry) = match quantity.kind {
            Kind::Real(n) => ("real", n, None, vec![], vec![]),
            Kind::Fixed(wire, n) => (wire.numpy(), n, Some(n * wire.size()), vec![], vec![]),
            Kind::Id => ("id", 1, None, vec![], vec![]),
            Kind::Struct(head) => ("struct", 1, Some(record_size(head)), fields(py, head)?, vec![]),
            Kind::List(head, entry) => ("list", 1, None, fields(py, head)?, fields(py, entry)?),
        };
        row.set_item("kind", kind)?;
        row.set_item("numbers", count)?;
        row.set_item("size", size)?;
        row.set_item("fields", head)?;
        row.set_item("entry", entry)?;
        Ok(row)
    };
    table::QUANTITIES.iter().map(row).collect()
}

/// The messages.
#[pyfunction]
pub fn messages(py: Python<'_>) -> PyResult<Vec<Row<'_>>> {
    let row = |message: &table::Message| {
        let row = PyDict::new(py);
        row.set_item("mid", message.mid)?;
        row.set_item("name", message.name)?;
        let direction = match message.direction {
            Direction::ToDevice => "to device",
            Direction::ToHost => "to host",
            Direction::Both => "both",
        };
        row.set_item("direction", direction)?;
        let states = [
            (message.states.wakeup, "wakeup"),
            (message.states.config, "config"),
            (message.states.measurement, "measurement"),
        ];
        row.set_item("states", states.iter().filter(|state| state.0).map(|state| state.1).collect::<Vec<_>>())?;
        row.set_item("payload", message.description())?;
        let lengths: Vec<usize> = message.lengths().iter().collect();
        row.set_item("lengths", (!lengths.is_empty()).then_some(lengths))?;
        let (kind, forms, least, most, filled, zeros): (_, &[&[MessageField]], _, _, _, _) = match message.payload {
            Payload::Empty => ("empty", &[], 0, 0, false, false),
            Payload::Bytes(..) => ("bytes", &[], 0, 0, false, false),
            Payload::Text { least, most, filled } => ("text", &[], least, most, filled, false),
            Payload::Record(forms) => ("record", forms, 1, 1, false, false),
            Payload::List { entry, least, most, zeros } => ("list", &[entry], least, most, false, zeros),
        };
        row.set_item("kind", kind)?;
        let forms: Vec<_> = forms.iter().map(|form| message_fields(py, form)).collect::<PyResult<_>>()?;
        row.set_item("forms", forms)?;
        row.set_item("least", least)?;
        row.set_item("most", most)?;
        row.set_item("filled", filled)?;
        row.set_item("zeros", zeros)?;
        row.set_item("restarts", message.restarts)?;
        row.set_item("reply", message.reply)?;
        row.set_item("products", message.products.iter().map(|product| product.number).collect::<Vec<_>>())?;
        row.set_item("status", message.status)?;
        Ok(row)
    };
    table::MESSAGES.iter().map(row).collect()
}

/// The products.
#[pyfunction]
pub fn products(py: Python<'_>) -> PyResult<Vec<Row<'_>>> {
    let row = |product: &table::Product| {
        let row = PyDict::new(py);
        row.set_item("number", product.number)?;
        row.set_item("name", product.name)?;
        row.set_item("title", product.title)?;
        row.set_item("series", product.series.label())?;
        row.set_item("kind", product.class.label())?;
        row.set_item("id_size", product.series.id_size())?;
        row.set_item("fine_wrap", product.series.fine_wrap())?;
        Ok(row)
    };
    table::PRODUCTS.iter().map(row).collect()
}

/// The bits of the status word.
#[pyfunction]
pub fn status_flags(py: Python<'_>) -> PyResult<Vec<Row<'_>>> {
    let row = |flag: &table::StatusFlag| {
        let row = PyDict::new(py);
        row.set_item("name", flag.name)?;
        row.set_item("bit", flag.bit)?;
        row.set_item("width", flag.width)?;
        row.set_item("meaning", flag.meaning)?;
        Ok(row)
    };
    table::STATUS_FLAGS.iter().map(row).collect()
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
pub fn damage_reasons() -> Vec<&'static str> {
    Reason::ALL.map(Reason::name).to_vec()
}

/// The manual's name of a message with a payload of this length, if it has one.
#[pyfunction]
pub fn message_name(mid: u8, length: usize) -> Option<&'static str> {
    table::message_name(mid, length)
}
