//! What takes the numbers of a column: a batch for Arrow, or memory of the caller.

use arrow_array::ArrayRef;
use arrow_buffer::ArrowNativeType;
use arrow_schema::DataType;

/// Takes some rows of a column, once.
pub trait Sink {
    /// What the rows become.
    type Taken;

    /// Takes numbers that are in memory as an Arrow array has them. `array` returns that array.
    fn lent<N: Number>(self, numbers: impl Iterator<Item = N>, array: impl FnOnce() -> ArrayRef) -> Self::Taken;

    /// Takes a number for each row. Those that do not exist are null.
    fn dense<N: Number>(self, numbers: impl Iterator<Item = N>, exists: Option<impl Fn(N) -> bool>) -> Self::Taken;

    /// Takes numbers for some of the rows, in ascending order; the last one of a row counts. The other rows, and numbers that
    /// do not exist, are null.
    fn sparse<N: Number>(
        self,
        numbers: impl Iterator<Item = (usize, N)>,
        exists: Option<impl Fn(N) -> bool>,
    ) -> Self::Taken;
}

/// A type of numbers that columns have.
pub trait Number: ArrowNativeType {
    /// The numbers, if they have this type.
    fn slice_of<'a>(numbers: &'a mut Numbers<'_>) -> Option<&'a mut [Self]>;
}

/// Invokes a macro with the types of numbers, each after the name that Arrow has for it.
macro_rules! with_numbers {
    ($then:ident) => {
        $then! {
            UInt8 u8, UInt16 u16, UInt32 u32, UInt64 u64, Int8 i8, Int16 i16, Int32 i32, Int64 i64, Float32 f32,
            Float64 f64,
        }
    };
}
pub(crate) use with_numbers;

macro_rules! numbers {
    ($($variant:ident $number:ty),+ $(,)?) => {
        /// Memory of the caller for the numbers of a column.
        #[derive(Debug)]
        #[allow(missing_docs)] // the variants are the types
        pub enum Numbers<'a> {
            $($variant(&'a mut [$number]),)+
        }

        impl Numbers<'_> {
            /// How many there are.
            pub(super) const fn len(&self) -> usize {
                match self {
                    $(Self::$variant(numbers) => numbers.len(),)+
                }
            }

            /// The type of a column that has such numbers.
            pub(super) const fn data_type(&self) -> DataType {
                match self {
                    $(Self::$variant(_) => DataType::$variant,)+
                }
            }
        }

        $(impl Number for $number {
            fn slice_of<'a>(numbers: &'a mut Numbers<'_>) -> Option<&'a mut [Self]> {
                match numbers {
                    Numbers::$variant(numbers) => Some(numbers),
                    _ => None,
                }
            }
        })+
    };
}

with_numbers!(numbers);

/// Writes numbers into memory of the caller. Where a row has none, that memory stays as it is.
pub struct Writer<'a, 'b> {
    pub numbers: &'a mut Numbers<'b>,
    /// The first row.
    pub first: usize,
}

impl Writer<'_, '_> {
    fn rows<N: Number>(&mut self) -> &mut [N] {
        &mut N::slice_of(self.numbers).expect("the types are compared before")[self.first..]
    }
}

impl Sink for Writer<'_, '_> {
    type Taken = ();

    fn lent<N: Number>(self, numbers: impl Iterator<Item = N>, _: impl FnOnce() -> ArrayRef) {
        self.dense(numbers, None::<fn(N) -> bool>);
    }

    fn dense<N: Number>(mut self, numbers: impl Iterator<Item = N>, _: Option<impl Fn(N) -> bool>) {
        self.rows().iter_mut().zip(numbers).for_each(|(row, number)| *row = number);
    }

    fn sparse<N: Number>(mut self, numbers: impl Iterator<Item = (usize, N)>, _: Option<impl Fn(N) -> bool>) {
        let rows = self.rows();
        numbers.for_each(|(row, number)| rows[row] = number);
    }
}
