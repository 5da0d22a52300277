//! Copied columns of a batch, in one piece of memory.
//!
//! A column of a batch is too small for huge pages, and large enough that malloc often takes its memory from the system and
//! returns it soon, above all in the workers of dask. The first touch of such memory takes longer than the copy. All columns
//! together are large enough for huge pages. The price: one column that is kept keeps the others of its batch in memory.

use arrow_array::builder::BooleanBufferBuilder;
use arrow_array::{ArrayRef, make_array};
use arrow_buffer::{ArrowNativeType, Buffer, MutableBuffer, NullBuffer};
use arrow_data::ArrayData;
use arrow_schema::{ArrowError, DataType};

use super::sink::{Number, Sink};
use crate::huge_pages;

/// Each column begins at a multiple of this, as Arrow recommends.
const ALIGNMENT: usize = 64;
/// How many numbers are gathered in the first-level cache before they are written to memory.
const GATHERED: usize = 512;

/// Memory for the copied columns of a batch.
pub struct Copies {
    rows: usize,
    bytes: MutableBuffer,
}

/// A column of a batch.
pub enum Cells {
    /// An array that refers to the memory of the log.
    Lent(ArrayRef),
    /// Numbers in separate memory, and which of them are null.
    Separate { numbers: Buffer, nulls: Option<NullBuffer> },
    /// The numbers at byte `at` of the copies, and which of them are null.
    Copied { at: usize, nulls: Option<NullBuffer> },
}

impl Copies {
    /// Memory for columns of `rows` numbers of these widths in bytes.
    pub fn new(rows: usize, widths: impl Iterator<Item = usize>) -> Self {
        let size = widths.map(|width| (rows * width).next_multiple_of(ALIGNMENT)).sum();
        Self { rows, bytes: huge_pages::buffer(size) }
    }

    /// Where the next column begins.
    fn len(&self) -> usize {
        self.bytes.len()
    }

    /// Appends a column, and returns its numbers.
    fn append<T: ArrowNativeType>(&mut self, mut numbers: impl Iterator<Item = T>) -> &[T] {
        let at = self.len();
        let mut gathered = [T::default(); GATHERED];
        loop {
            let mut count = 0;
            for (slot, number) in gathered.iter_mut().zip(&mut numbers) {
                *slot = number;
                count += 1;
            }
            self.bytes.extend_from_slice(&gathered[..count]);
            if count < GATHERED {
                break;
            }
        }
        self.bytes.resize(self.len().next_multiple_of(ALIGNMENT), 0);
        &self.bytes.typed_data()[at / size_of::<T>()..][..self.rows]
    }

    /// The columns of the batch as arrays of these types.
    pub fn arrays<'a>(self, cells: impl Iterator<Item = (&'a DataType, Cells)>) -> Result<Vec<ArrayRef>, ArrowError> {
        let rows = self.rows;
        let bytes: Buffer = self.bytes.into();
        let array = |(data_type, cells): (&DataType, Cells)| {
            let (numbers, nulls) = match cells {
                Cells::Lent(array) => return Ok(array),
                Cells::Separate { numbers, nulls } => (numbers, nulls),
                Cells::Copied { at, nulls } => (bytes.slice_with_length(at, rows * width_of(data_type)), nulls),
            };
            let data = ArrayData::builder(data_type.clone()).len(rows).add_buffer(numbers).nulls(nulls);
            Ok(make_array(data.build()?))
        };
        cells.map(array).collect()
    }
}

impl Sink for &mut Copies {
    type Taken = Cells;

    fn lent<N: Number>(self, _: impl Iterator<Item = N>, array: impl FnOnce() -> ArrayRef) -> Cells {
        Cells::Lent(array())
    }

    fn dense<N: Number>(self, numbers: impl Iterator<Item = N>, exists: Option<impl Fn(N) -> bool>) -> Cells {
        let at = self.len();
        let numbers = self.append(numbers);
        Cells::Copied { at, nulls: exists.map(|exists| existing(numbers, exists)) }
    }

    fn sparse<N: Number>(self, numbers: impl Iterator<Item = (usize, N)>, exists: Option<impl Fn(N) -> bool>) -> Cells {
        huge_pages::leave_room_for(self.rows * size_of::<N>());
        let mut out = vec![N::default(); self.rows];
        let mut is_valid = BooleanBufferBuilder::new(self.rows);
        is_valid.append_n(self.rows, false);
        for (row, number) in numbers {
            out[row] = number;
            is_valid.set_bit(row, true);
        }
        let is_valid = NullBuffer::new(is_valid.finish());
        let nulls = NullBuffer::union(exists.map(|exists| existing(&out, exists)).as_ref(), Some(&is_valid));
        Cells::Separate { numbers: Buffer::from_vec(out), nulls }
    }
}

fn existing<N: Number>(numbers: &[N], exists: impl Fn(N) -> bool) -> NullBuffer {
    numbers.iter().map(|number| exists(*number)).collect()
}

/// Size of a number of this type, in bytes.
///
/// # Panics
/// If it is no type of numbers.
pub fn width_of(data_type: &DataType) -> usize {
    data_type.primitive_width().expect("columns are numbers")
}

#[cfg(test)]
mod tests {
    use arrow_array::cast::AsArray;
    use arrow_array::types::{UInt8Type, UInt32Type, UInt64Type};

    use super::*;

    #[test]
    fn columns_of_several_types_share_memory() {
        let rows = 2 * GATHERED + 1;
        let mut copies = Copies::new(rows, [1, 8].into_iter());
        let capacity = copies.bytes.capacity();
        assert_eq!(copies.append((0..=250_u8).cycle().take(rows))[251], 0);
        let at = copies.len();
        assert_eq!(at % ALIGNMENT, 0);
        copies.append((0..rows).map(|row| (1 << 40) + row as u64));
        assert_eq!((copies.len(), copies.bytes.capacity()), (capacity, capacity));

        let nulls = (0..rows).map(|row| row != 7).collect();
        let cells = [
            Cells::Copied { at: 0, nulls: Some(nulls) },
            Cells::Separate { numbers: Buffer::from_vec(vec![5_u32; rows]), nulls: None },
            Cells::Copied { at, nulls: None },
        ];
        let types = [DataType::UInt8, DataType::UInt32, DataType::UInt64];
        let arrays = copies.arrays(types.iter().zip(cells)).unwrap();
        assert_eq!((arrays[0].null_count(), arrays[0].is_null(7)), (1, true));
        assert_eq!(arrays[0].as_primitive::<UInt8Type>().value(250), 250);
        assert_eq!(arrays[1].as_primitive::<UInt32Type>().value(GATHERED), 5);
        assert_eq!(arrays[2].as_primitive::<UInt64Type>().value(rows - 1), (1 << 40) + 2 * GATHERED as u64);
    }
}
