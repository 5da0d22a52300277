//! The products of the manual's section 3, the older ones that send `MTData`, and sets of them.

use super::same;

/// The four families of the manual, and the products before them. They differ in the length of the device id and in when
/// their clock starts again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Series {
    /// The 1-series.
    One,
    /// The 10-series.
    Ten,
    /// The 100-series, the MTi-G-710 among them.
    Hundred,
    /// The 600-series.
    SixHundred,
    /// The MTi, MTx and MTi-G of 2003 to 2012, which send `MTData`.
    Legacy,
}

impl Series {
    /// The manual's name: `"10-series"`.
    #[must_use]
    pub const fn label(self) -> &'static str {
        match self {
            Self::One => "1-series",
            Self::Ten => "10-series",
            Self::Hundred => "100-series",
            Self::SixHundred => "600-series",
            Self::Legacy => "legacy",
        }
    }

    /// Bytes of the device id in a `DeviceID` message.
    #[must_use]
    pub const fn id_size(self) -> usize {
        match self {
            Self::One | Self::Ten | Self::Hundred | Self::Legacy => 4,
            Self::SixHundred => 8,
        }
    }

    /// Ticks of `SampleTimeFine` before it starts again at zero: 32 bits full, or one day of 0.1 ms.
    #[must_use]
    pub const fn fine_wrap(self) -> u64 {
        match self {
            Self::One | Self::SixHundred => 1 << 32,
            Self::Ten | Self::Hundred | Self::Legacy => 864_000_000,
        }
    }
}

/// How much a product computes from its sensors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// Calibrated sensor data, no orientation.
    Imu,
    /// Orientation whose yaw has no reference.
    Vru,
    /// Orientation with a magnetic heading.
    Ahrs,
    /// Orientation, position and velocity, with a satellite receiver.
    Gnss,
}

impl Class {
    /// The manual's name: `"AHRS"`.
    #[must_use]
    pub const fn label(self) -> &'static str {
        match self {
            Self::Imu => "IMU",
            Self::Vru => "VRU",
            Self::Ahrs => "AHRS",
            Self::Gnss => "GNSS/INS",
        }
    }
}

/// One product.
#[derive(Clone, Copy, Debug)]
pub struct Product {
    /// The manual's number, by which its tables name the product; 0 for a legacy product.
    pub number: u16,
    /// The model: `"MTi-680G"`.
    pub name: &'static str,
    /// The model and what it is, as section 3 has it: `"MTi-680G RTK GNSS/INS"`.
    pub title: &'static str,
    /// Its family.
    pub series: Series,
    /// What it computes.
    pub class: Class,
}

/// The products, in the order in which the manual lists them.
#[rustfmt::skip]
pub const PRODUCTS: &[Product] = &[
    product(  1, "MTi-1",     "MTi-1 IMU",             Series::One,        Class::Imu),
    product(  2, "MTi-2",     "MTi-2 VRU",             Series::One,        Class::Vru),
    product(  3, "MTi-3",     "MTi-3 AHRS",            Series::One,        Class::Ahrs),
    product(  7, "MTi-7",     "MTi-7 GNSS/INS",        Series::One,        Class::Gnss),
    product( 10, "MTi-10",    "MTi-10 IMU",            Series::Ten,        Class::Imu),
    product( 20, "MTi-20",    "MTi-20 VRU",            Series::Ten,        Class::Vru),
    product( 30, "MTi-30",    "MTi-30 AHRS",           Series::Ten,        Class::Ahrs),
    product(100, "MTi-100",   "MTi-100 IMU",           Series::Hundred,    Class::Imu),
    product(200, "MTi-200",   "MTi-200 VRU",           Series::Hundred,    Class::Vru),
    product(300, "MTi-300",   "MTi-300 AHRS",          Series::Hundred,    Class::Ahrs),
    product(710, "MTi-G-710", "MTi-G-710 GNSS/INS",    Series::Hundred,    Class::Gnss),
    product(610, "MTi-610",   "MTi-610 IMU",           Series::SixHundred, Class::Imu),
    product(620, "MTi-620",   "MTi-620 VRU",           Series::SixHundred, Class::Vru),
    product(630, "MTi-630",   "MTi-630 AHRS",          Series::SixHundred, Class::Ahrs),
    product(670, "MTi-670",   "MTi-670 GNSS/INS",      Series::SixHundred, Class::Gnss),
    product(680, "MTi-680G",  "MTi-680G RTK GNSS/INS", Series::SixHundred, Class::Gnss),
];

/// The products before those of the manual.
#[rustfmt::skip]
pub const LEGACY_PRODUCTS: &[Product] = &[
    product(0, "MTi",   "MTi AHRS",       Series::Legacy, Class::Ahrs),
    product(0, "MTx",   "MTx AHRS",       Series::Legacy, Class::Ahrs),
    product(0, "MTi-G", "MTi-G GNSS/INS", Series::Legacy, Class::Gnss),
];

// A set of products has one bit for each.
const _: () = assert!(PRODUCTS.len() == 16 && LEGACY_PRODUCTS.len() <= 16);

const fn product(number: u16, name: &'static str, title: &'static str, series: Series, class: Class) -> Product {
    Product { number, name, title, series, class }
}

/// A set of products. Bit i stands for `PRODUCTS[i]`, bit 16 + i for `LEGACY_PRODUCTS[i]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Products(u32);

impl Products {
    /// No product of the manual.
    pub const NONE: Self = Self(0);
    /// Every product of the manual.
    pub const ALL: Self = Self(u16::MAX as u32);
    /// The legacy products.
    pub const LEGACY: Self = Self(((1 << LEGACY_PRODUCTS.len()) - 1) << PRODUCTS.len());

    /// The products with these numbers. A number that no product has is a panic: in a table, a compile error.
    #[must_use]
    #[allow(clippy::missing_panics_doc)]
    pub const fn of(numbers: &[u16]) -> Self {
        let mut bits = 0;
        let mut i = 0;
        while i < numbers.len() {
            let bit = bit(numbers[i]);
            assert!(bit != 0, "no such product");
            bits |= bit;
            i += 1;
        }
        Self(bits)
    }

    /// The legacy product of this name. A name that none has is a panic: in a table, a compile error.
    #[must_use]
    #[allow(clippy::missing_panics_doc)]
    pub const fn legacy(name: &str) -> Self {
        let mut i = 0;
        while !same(LEGACY_PRODUCTS[i].name, name) {
            i += 1;
        }
        Self(1 << (PRODUCTS.len() + i))
    }

    /// The products in either set.
    #[must_use]
    pub const fn or(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Whether the product with this number is among them.
    #[must_use]
    pub const fn has(self, number: u16) -> bool {
        self.0 & bit(number) != 0
    }

    /// Whether there is none.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// The products, in the manual's order, and then the legacy ones.
    pub fn iter(self) -> impl Iterator<Item = &'static Product> {
        let all = PRODUCTS.iter().chain(LEGACY_PRODUCTS).enumerate();
        all.filter(move |(place, _)| self.0 >> place & 1 == 1).map(|(_, product)| product)
    }

    /// Their numbers as the manual prints them: `"1 2 3 7"`.
    #[must_use]
    pub fn label(self) -> String {
        let numbers: Vec<String> = self.iter().map(|product| product.number.to_string()).collect();
        numbers.join(" ")
    }
}

/// The bit of the product with this number, 0 for an unknown number.
const fn bit(number: u16) -> u32 {
    let mut i = 0;
    while i < PRODUCTS.len() {
        if PRODUCTS[i].number == number {
            return 1 << i;
        }
        i += 1;
    }
    0
}
