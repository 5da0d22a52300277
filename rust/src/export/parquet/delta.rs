//! `DELTA_BINARY_PACKED`: integers as differences, which are packed into as many bits as they need.
//!
//! The values after the first one are divided into blocks of four miniblocks. A block begins with its least difference and
//! the number of bits for each miniblock. The miniblocks have the differences from the least one. A regular counter
//! therefore has no bits at all.

/// Miniblocks of a block.
const MINIBLOCKS: usize = 4;
/// Values of the largest block.
const MOST: usize = MINIBLOCKS * 64;

/// An integer as Parquet stores it. Differences wrap.
pub trait Integer: Copy + Ord {
    const ZERO: Self;
    /// Values of a miniblock, as many as the type has bits.
    const MINIBLOCK: usize;

    fn minus(self, other: Self) -> Self;
    fn bits(self) -> u64;
    fn wide(self) -> i64;
}

impl Integer for i32 {
    const ZERO: Self = 0;
    const MINIBLOCK: usize = 32;

    fn minus(self, other: Self) -> Self {
        self.wrapping_sub(other)
    }

    fn bits(self) -> u64 {
        self.cast_unsigned().into()
    }

    fn wide(self) -> i64 {
        self.into()
    }
}

impl Integer for i64 {
    const ZERO: Self = 0;
    const MINIBLOCK: usize = 64;

    fn minus(self, other: Self) -> Self {
        self.wrapping_sub(other)
    }

    fn bits(self) -> u64 {
        self.cast_unsigned()
    }

    fn wide(self) -> i64 {
        self
    }
}

/// Appends values to a page.
pub fn append<I: Integer>(values: &[I], page: &mut Vec<u8>) {
    let block = MINIBLOCKS * I::MINIBLOCK;
    for number in [block, MINIBLOCKS, values.len()] {
        varint(page, number as u64);
    }
    zigzag(page, values.first().map_or(0, |first| first.wide()));
    let mut differences = [I::ZERO; MOST];
    for (before, values) in values.chunks(block).zip(values.get(1..).unwrap_or_default().chunks(block)) {
        let differences = &mut differences[..values.len()];
        for (difference, (value, before)) in differences.iter_mut().zip(values.iter().zip(before)) {
            *difference = value.minus(*before);
        }
        append_block(differences, page);
    }
}

fn append_block<I: Integer>(differences: &mut [I], page: &mut Vec<u8>) {
    let least = differences.iter().copied().min().unwrap_or(I::ZERO);
    zigzag(page, least.wide());
    let widths = page.len();
    page.extend([0; MINIBLOCKS]);
    for (place, differences) in differences.chunks_mut(I::MINIBLOCK).enumerate() {
        differences.iter_mut().for_each(|difference| *difference = difference.minus(least));
        let bits = differences.iter().fold(0, |all, difference| all | difference.bits());
        let width = u64::BITS - bits.leading_zeros();
        page[widths + place] = width.to_le_bytes()[0];
        if width > 0 {
            let rest = std::iter::repeat_n(I::ZERO, I::MINIBLOCK - differences.len());
            pack(differences.iter().copied().chain(rest).map(I::bits), width, page);
        }
    }
}

/// Appends the lowest `width` bits of each number, one behind the other, the lowest first. The numbers have no other bits.
fn pack(numbers: impl Iterator<Item = u64>, width: u32, page: &mut Vec<u8>) {
    let (mut word, mut filled) = (0_u64, 0);
    for number in numbers {
        word |= number << filled;
        filled += width;
        if filled >= u64::BITS {
            page.extend(word.to_le_bytes());
            filled -= u64::BITS;
            word = if filled > 0 { number >> (width - filled) } else { 0 };
        }
    }
    page.extend_from_slice(&word.to_le_bytes()[..filled.div_ceil(8) as usize]);
}

/// Appends seven bits a byte, the lowest first. The highest bit of a byte says whether another one follows.
pub fn varint(bytes: &mut Vec<u8>, mut number: u64) {
    while number >= 0x80 {
        bytes.push(number.to_le_bytes()[0] | 0x80);
        number >>= 7;
    }
    bytes.push(number.to_le_bytes()[0]);
}

/// Appends a number with its sign in the lowest bit.
fn zigzag(bytes: &mut Vec<u8>, number: i64) {
    varint(bytes, ((number << 1) ^ (number >> 63)).cast_unsigned());
}
