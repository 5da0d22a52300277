//! Vectors as read-only numpy arrays. Every array that this module hands to Python is made here.

use numpy::ndarray::aview1;
use numpy::{Element, IntoPyArray, PyArray1, PyArrayMethods};
use pyo3::prelude::*;

use super::convert::detached;
use crate::huge_pages;

/// A read-only array.
pub type Array<'py, T> = Bound<'py, PyArray1<T>>;

/// A vector as a read-only array, without a copy.
pub fn hand_over<T: Element>(py: Python<'_>, numbers: Vec<T>) -> Array<'_, T> {
    read_only(numbers.into_pyarray(py))
}

/// Numbers as a read-only array.
pub fn hand_over_all<T: Element>(
    py: Python<'_>,
    numbers: impl ExactSizeIterator<Item = T> + Send,
) -> PyResult<Array<'_, T>> {
    Ok(hand_over(py, detached(py, || huge_pages::collect(numbers))?))
}

/// Positions and counts as a read-only int64 array, numpy's own index type.
pub fn hand_over_signed(
    py: Python<'_>,
    numbers: impl ExactSizeIterator<Item = u64> + Send,
) -> PyResult<Array<'_, i64>> {
    hand_over_all(py, numbers.map(u64::cast_signed))
}

/// A read-only array over numbers that `owner` keeps alive, without a copy.
pub fn lend<'py, T: Element, O>(numbers: &[T], owner: &Bound<'py, O>) -> Array<'py, T> {
    // SAFETY: `owner` is the base object of the array, so it lives as long as the array. The numbers belong to it, are
    // never moved or changed after it was made, and the array does not allow writes.
    #[allow(unsafe_code)]
    let array = unsafe { PyArray1::borrow_from_array(&aview1(numbers), owner.clone().into_any()) };
    read_only(array)
}

fn read_only<T: Element>(array: Array<'_, T>) -> Array<'_, T> {
    array.readwrite().make_nonwriteable();
    array
}
