//! The number formats of the manual's type ℝ (section 5.3.5, "Definition output formats").
//!
//! Decoding is exact: a double can represent every Fp1220 and Fp1632 value. All formats are big-endian; Fp1632 sends its 32
//! fraction bits first, then the 16 integer bits.

const ONE_1220: f64 = 1_048_576.0; // 2^20
const ONE_1632: f64 = 4_294_967_296.0; // 2^32

/// Reads a Float32; the bits of a NaN are preserved.
#[inline]
#[must_use]
pub fn float32(bytes: [u8; 4]) -> f32 {
    f32::from_bits(u32::from_be_bytes(bytes))
}

/// Reads an Fp1220.
#[inline]
#[must_use]
pub fn fp1220(bytes: [u8; 4]) -> f64 {
    f64::from(i32::from_be_bytes(bytes)) * (1.0 / ONE_1220)
}

/// Reads an Fp1632.
#[inline]
#[must_use]
#[allow(clippy::cast_precision_loss)] // 48 bits fit the 53 of a double
pub fn fp1632([b3, b2, b1, b0, b5, b4]: [u8; 6]) -> f64 {
    let integer = i64::from(i16::from_be_bytes([b5, b4])) << 32 | i64::from(u32::from_be_bytes([b3, b2, b1, b0]));
    integer as f64 * (1.0 / ONE_1632)
}

/// Reads a Float64.
#[inline]
#[must_use]
pub fn float64(bytes: [u8; 8]) -> f64 {
    f64::from_bits(u64::from_be_bytes(bytes))
}

/// Writes an Fp1220, rounded half away from zero like the manual's `round()`, and saturated at the limits of its range;
/// `None` for NaN.
#[must_use]
#[allow(clippy::cast_possible_truncation)] // a cast from float to integer saturates
pub fn to_fp1220(value: f64) -> Option<[u8; 4]> {
    (!value.is_nan()).then(|| ((value * ONE_1220).round() as i32).to_be_bytes())
}

/// Writes an Fp1632, with the rules of [`to_fp1220`].
#[must_use]
#[allow(clippy::cast_possible_truncation)] // within 48 bits
pub fn to_fp1632(value: f64) -> Option<[u8; 6]> {
    const LIMIT: f64 = 32_768.0 * ONE_1632;
    if value.is_nan() {
        return None;
    }
    let integer = (value * ONE_1632).round().clamp(-LIMIT, LIMIT - 1.0) as i64;
    let [_, _, b5, b4, b3, b2, b1, b0] = integer.to_be_bytes();
    Some([b3, b2, b1, b0, b5, b4])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bytes and value, exact both ways.
    const FP1220: &[([u8; 4], f64)] = &[
        ([0x00, 0x10, 0x00, 0x00], 1.0),
        ([0xFF, 0xF0, 0x47, 0x35], -0.982_615_470_886_230_5),
        ([0xFF, 0xFD, 0xC8, 0x86], -0.138_544_082_641_601_56),
        ([0x07, 0x3B, 0x35, 0xC8], 115.700_630_187_988_28),
        ([0x80, 0x00, 0x00, 0x00], -2048.0),
        ([0x7F, 0xFF, 0xFF, 0xFF], 2_047.999_999_046_325_7),
        ([0x00, 0x00, 0x00, 0x00], 0.0),
    ];

    const FP1632: &[([u8; 6], f64)] = &[
        ([0x00, 0x00, 0x00, 0x00, 0x00, 0x01], 1.0),
        ([0x00, 0x00, 0x00, 0x00, 0xFF, 0xFF], -1.0),
        ([0x80, 0x00, 0x00, 0x00, 0xFF, 0xFF], -0.5),
        ([0x00, 0x00, 0x00, 0x01, 0x00, 0x01], 1.000_000_000_232_830_6),
        ([0x60, 0x00, 0x00, 0x00, 0x00, 0x18], 24.375),
        ([0xAD, 0xF0, 0x52, 0x98, 0x00, 0x39], 57.679_448_282_346_13),
        ([0x64, 0xA6, 0x8A, 0xA8, 0x00, 0x1F], 31.393_166_223_540_902),
        ([0x3A, 0xD0, 0x1E, 0xFC, 0x00, 0x79], 121.229_738_174_937_67),
        ([0xF6, 0x3F, 0xCA, 0xF0, 0xFF, 0xFF], -0.038_089_100_271_463_394),
        ([0x00, 0x00, 0x00, 0x00, 0x80, 0x00], -32768.0),
        ([0xFF, 0xFF, 0xFF, 0xFF, 0x7F, 0xFF], 32_767.999_999_999_767),
    ];

    #[test]
    #[allow(clippy::float_cmp)] // they must be exact
    fn the_manuals_fixed_point_numbers() {
        for &(bytes, value) in FP1220 {
            assert_eq!(fp1220(bytes), value);
            assert_eq!(to_fp1220(value), Some(bytes), "{value}");
        }
        for &(bytes, value) in FP1632 {
            assert_eq!(fp1632(bytes), value);
            assert_eq!(to_fp1632(value), Some(bytes), "{value}");
        }
        assert_eq!(float32([0x41, 0x1C, 0xF5, 0xC3]), 9.81);
    }

    #[test]
    fn out_of_range_saturates_half_rounds_away_and_nan_is_refused() {
        assert_eq!(to_fp1220(1e9), Some([0x7F, 0xFF, 0xFF, 0xFF]));
        assert_eq!(to_fp1220(f64::NEG_INFINITY), Some([0x80, 0, 0, 0]));
        assert_eq!(to_fp1632(32768.0), Some([0xFF, 0xFF, 0xFF, 0xFF, 0x7F, 0xFF]));
        assert_eq!(to_fp1632(f64::NEG_INFINITY), Some([0, 0, 0, 0, 0x80, 0]));
        assert_eq!(to_fp1220(0.5 / ONE_1220), Some([0, 0, 0, 1]));
        assert_eq!(to_fp1220(-0.5 / ONE_1220), Some([0xFF; 4]));
        assert_eq!(to_fp1632(-0.5 / ONE_1632), Some([0xFF; 6]));
        assert_eq!((to_fp1220(f64::NAN), to_fp1632(f64::NAN)), (None, None));
    }
}
