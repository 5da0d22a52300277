//! The extension module `xbus._core`. Every function converts its arguments, releases the GIL, calls the core and hands
//! over the result. What needs no conversion is exported where the core declares it. `_core.pyi` documents what Python
//! sees.

mod array;
mod arrow;
mod can;
mod clock;
mod codec;
mod column;
mod convert;
mod export;
mod hostclock;
mod live;
mod log;
mod message_file;
mod mtdata;
mod shared;
mod source;
mod tables;

use pyo3::prelude::*;

#[pymodule(gil_used = false)]
mod _core {
    use pyo3::prelude::*;

    #[pymodule_export]
    use super::arrow::{ArrowStream, Batch, BatchIterator};
    #[pymodule_export]
    use super::can::{CanPart, CanReader, can_sample};
    #[pymodule_export]
    use super::clock::{SampleClock, device_of, is_sample};
    #[pymodule_export]
    use super::codec::{
        EncodedFrames, Packet, RequestScanner, ScannedFrame, ScannedString, Scanner, configuration, encode_frame,
        encode_packet, encode_samples, frame_size, packet_headers, packet_numbers, packets,
    };
    #[pymodule_export]
    use super::column::Column;
    #[pymodule_export]
    use super::export::{Chunk, TableFile};
    #[pymodule_export]
    use super::hostclock::HostClock;
    #[pymodule_export]
    use super::live::{
        Acquisition, Block, BlockDecoder, Cancel, Events, ReceivedSample, ReceivedString, Recorder, Waiting,
    };
    #[pymodule_export]
    use super::log::{DamageArrays, GapArrays, MessageArrays, Part, Reader, RestartArrays, Shape, StringArrays};
    #[pymodule_export]
    use super::message_file::MessageFile;
    #[pymodule_export]
    use super::mtdata::{
        MtDataOutputs, MtDataPlace, MtDataSample, encode_mtdata, mtdata_layout, mtdata_packets, tracker_ids,
    };
    #[pymodule_export]
    use super::tables::{
        can_messages, can_quantities, damage_reasons, legacy_products, messages, mtdata_items, mtdata_quantities,
        mtssp, products, quantities, result_codes, status_flags, strings,
    };
    #[pymodule_export]
    use crate::device::{device_id, product_code};
    #[pymodule_export]
    use crate::hostclock::Step;
    #[pymodule_export]
    use crate::huge_pages::keep_freed_memory;
    #[pymodule_export]
    use crate::scan::Damage;
    #[pymodule_export]
    use crate::table::message_name;

    /// Numbers that are written in one place: the version in Cargo.toml, the others beside the code that they belong to.
    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("EXTENDED_HEADER_SIZE", crate::frame::EXTENDED_HEADER_SIZE)?;
        module.add("PACKET_HEADER", crate::packet::PACKET_HEADER)?;
        module.add("CAN_EXTENDED", crate::log::can::flag::EXTENDED)?;
        module.add("CAN_REMOTE", crate::log::can::flag::REMOTE)?;
        module.add("CAN_ERROR", crate::log::can::flag::ERROR)?;
        module.add("UTC_VALID", crate::utc::UTC_VALID)?;
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}

/// A row of a table: a dict.
type Row<'py> = Bound<'py, pyo3::types::PyDict>;
