//! The extension module `xbus._core`. Every function here converts, lets go of the interpreter, calls the core, and hands
//! over; what it does is decided elsewhere.

mod arrow;
mod codec;
mod hostclock;
mod live;
mod reader;
mod tables;
mod utc;

use pyo3::prelude::*;

#[pymodule(gil_used = false)]
mod _core {
    use pyo3::prelude::*;

    #[pymodule_export]
    use super::arrow::ArrowStream;
    #[pymodule_export]
    use super::codec::{
        Scanner, configuration, device_id, encode_frame, encode_packet, encode_samples, packets, product_code,
    };
    #[pymodule_export]
    use super::hostclock::HostClock;
    #[pymodule_export]
    use super::live::Acquisition;
    #[pymodule_export]
    use super::reader::{Column, Decoder, Part, Reader};
    #[pymodule_export]
    use super::tables::{
        damage_reasons, message_name, messages, products, quantities, result_codes, status_flags, strings,
    };

    /// The version stands in Cargo.toml and nowhere else.
    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}

/// A row of a table, as Python sees it.
type Row<'py> = Bound<'py, pyo3::types::PyDict>;
