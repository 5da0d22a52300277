//! The columns of a part.

use std::sync::Arc;

use pyo3::prelude::*;

use super::array::{Array, hand_over, lend};
use super::convert::detached;
use crate::column::Values;
use crate::log::TimedPart;
use crate::packet::{Coordinates, Precision};
use crate::utc;

/// A column of a part.
#[pyclass(module = "xbus._core", frozen)]
pub struct Column {
    pub part: Arc<TimedPart>,
    pub index: usize,
}

/// Keeps the numbers of one column alive for its arrays, and nothing else of the log.
#[pyclass(module = "xbus._core", frozen)]
struct Owner(Arc<crate::column::Column>);

impl Column {
    fn column(&self) -> &Arc<crate::column::Column> {
        &self.part.part.columns[self.index]
    }

    fn owner<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, Owner>> {
        Bound::new(py, Owner(self.column().clone()))
    }
}

#[pymethods]
impl Column {
    fn __len__(&self) -> usize {
        self.column().rows
    }

    #[getter]
    fn name(&self) -> Option<&'static str> {
        self.column().quantity().map(|quantity| quantity.name)
    }

    #[getter]
    fn coordinates(&self) -> Option<Coordinates> {
        self.column().coordinates()
    }

    #[getter]
    fn data_id(&self) -> u16 {
        self.column().data_id()
    }

    #[getter]
    fn precision(&self) -> Option<Precision> {
        self.column().precision()
    }

    #[getter]
    fn values<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let owner = self.owner(py)?;
        let array = match &owner.get().0.values {
            Values::U8(values) | Values::Records(values) => lend(values, &owner).into_any(),
            Values::U16(values) => lend(values, &owner).into_any(),
            Values::U32(values) => lend(values, &owner).into_any(),
            Values::U64(values) => lend(values, &owner).into_any(),
            Values::I8(values) => lend(values, &owner).into_any(),
            Values::I16(values) => lend(values, &owner).into_any(),
            Values::I32(values) => lend(values, &owner).into_any(),
            Values::F32(values) => lend(values, &owner).into_any(),
            Values::F64(values) => lend(values, &owner).into_any(),
            Values::Raw(packets) => lend(&packets.bytes, &owner).into_any(),
        };
        Ok(array)
    }

    #[getter]
    fn nanoseconds<'py>(&self, py: Python<'py>) -> PyResult<Option<Array<'py, i64>>> {
        let stamps = detached(py, || utc::nanoseconds_of_column(self.column()))?;
        Ok(stamps.map(|stamps| hand_over(py, stamps)))
    }

    #[getter]
    fn entries<'py>(&self, py: Python<'py>) -> PyResult<Array<'py, u8>> {
        let owner = self.owner(py)?;
        Ok(lend(&owner.get().0.entries, &owner))
    }

    #[getter]
    fn ends<'py>(&self, py: Python<'py>) -> PyResult<Option<Array<'py, u64>>> {
        let owner = self.owner(py)?;
        match &owner.get().0.values {
            Values::Raw(packets) => Ok(Some(lend(&packets.ends, &owner))),
            _ => Ok(None),
        }
    }

    #[getter]
    fn sample<'py>(&self, py: Python<'py>) -> PyResult<Array<'py, i64>> {
        Ok(hand_over(py, detached(py, || self.part.part.samples_of(self.column()))?))
    }
}
