//! `UtcTime` and `GnssPvtData` as points in time.

use std::sync::Arc;

use chrono::{NaiveDate, TimeDelta};

use crate::column::{Column, Subject, Values};
use crate::log::Part;
use crate::table::data_id;

const UTC_TIME: u16 = data_id("utc_time");
const GNSS_PVT_DATA: u16 = data_id("gnss_pvt_data");

/// Bits of the field `valid` of both records that are set in a valid time: date, time of day, and all of both resolved.
pub const UTC_VALID: u8 = 0b111;
/// Where both records have the field `valid`.
const VALID: usize = 11;

/// The same as [`nanoseconds_of_column`], but [`i64::MIN`] also where the device does not mark the time as valid.
#[must_use]
pub fn valid_nanoseconds_of_column(column: &Column) -> Option<Vec<i64>> {
    let mut nanoseconds = nanoseconds_of_column(column)?;
    if let Values::Records(bytes) = &column.values {
        for (stamp, record) in nanoseconds.iter_mut().zip(bytes.chunks_exact(column.width)) {
            if record[VALID] & UTC_VALID != UTC_VALID {
                *stamp = i64::MIN;
            }
        }
    }
    Some(nanoseconds)
}

/// The UTC of each sample of a part in nanoseconds since 1970, [`i64::MIN`] where it is not known; `None` if none of
/// these columns of the part has UTC. It comes from `UtcTime`, otherwise from `GnssPvtData`, where the device marks it as valid.
#[must_use]
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // samples of a part
pub fn nanoseconds_of_samples(part: &Part, columns: &[&Arc<Column>]) -> Option<Vec<i64>> {
    let mut all = None;
    for id in [GNSS_PVT_DATA, UTC_TIME] {
        let is = |column: &&&Arc<Column>| column.quantity().is_some_and(|quantity| quantity.id == id);
        let Some(column) = columns.iter().find(is) else { continue };
        let all = all.get_or_insert_with(|| vec![i64::MIN; part.len()]);
        let stamps = valid_nanoseconds_of_column(column).unwrap_or_default();
        for (sample, stamp) in part.samples_of(column).into_iter().zip(stamps) {
            if stamp != i64::MIN {
                all[(sample as u64 - part.first) as usize] = stamp;
            }
        }
    }
    all
}

/// The records of a `UtcTime` or `GnssPvtData` column in nanoseconds since 1970, [`i64::MIN`] for a date or time of day
/// that does not exist; `None` for any other column.
#[must_use]
pub fn nanoseconds_of_column(column: &Column) -> Option<Vec<i64>> {
    let (Subject::Known(quantity, _), Values::Records(bytes)) = (column.subject, &column.values) else { return None };
    let nanoseconds = match quantity.id {
        UTC_TIME => nanoseconds,
        GNSS_PVT_DATA => nanoseconds_of_fix,
        _ => return None,
    };
    Some(bytes.chunks_exact(column.width).map(|record| nanoseconds(record).unwrap_or(i64::MIN)).collect())
}

/// Nanoseconds since 1970 of a `UtcTime` record in native byte order; `None` for a date or time of day that does not
/// exist, and outside the years 1678 to 2261, which are those that 64 bits can hold.
///
/// A leap second (second 60) counts as the first second of the next minute.
#[must_use]
pub fn nanoseconds(record: &[u8]) -> Option<i64> {
    let &[n0, n1, n2, n3, ref date @ .., _valid] = record.first_chunk::<12>()?;
    since_1970(*date, u32::from_ne_bytes([n0, n1, n2, n3]).into())
}

/// Nanoseconds since 1970 of a `GnssPvtData` record, whose nanoseconds may be negative; `None` as for [`nanoseconds`].
#[must_use]
pub fn nanoseconds_of_fix(record: &[u8]) -> Option<i64> {
    let (date, nano) = (record.get(4..)?.first_chunk()?, record.get(16..)?.first_chunk()?);
    since_1970(*date, i32::from_ne_bytes(*nano).into())
}

/// Year, month, day, hour, minute and second, plus nanoseconds.
fn since_1970([y0, y1, month, day, hour, minute, second]: [u8; 7], nanos: i64) -> Option<i64> {
    let year = u16::from_ne_bytes([y0, y1]);
    if second > 60 || nanos.abs() > 1_000_000_000 {
        return None;
    }
    let minute =
        NaiveDate::from_ymd_opt(year.into(), month.into(), day.into())?.and_hms_opt(hour.into(), minute.into(), 0)?;
    let time = minute + TimeDelta::seconds(second.into()) + TimeDelta::nanoseconds(nanos);
    time.and_utc().timestamp_nanos_opt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(ns: u32, year: u16, rest: [u8; 6]) -> Vec<u8> {
        [&ns.to_ne_bytes()[..], &year.to_ne_bytes(), &rest].concat()
    }

    #[test]
    fn dates() {
        // From a real device: 749227324 ns, 2025-07-13 09:21:34.
        assert_eq!(nanoseconds(&record(749_227_324, 2025, [7, 13, 9, 21, 34, 0])), Some(1_752_398_494_749_227_324));
        assert_eq!(nanoseconds(&record(0, 1970, [1, 1, 0, 0, 0, 7])), Some(0));
        assert_eq!(nanoseconds(&record(0, 2000, [2, 29, 0, 0, 0, 7])), Some(951_782_400_000_000_000));
        assert_eq!(nanoseconds(&record(0, 1969, [12, 31, 23, 59, 60, 7])), Some(0));
    }

    #[test]
    fn fixes() {
        let fix = |second: u8, nano: i32| {
            let date = [1, 20, 13, 47, second, 0x37, 0, 0, 0, 0];
            let record = [&[0; 4][..], &2019_u16.to_ne_bytes(), &date, &nano.to_ne_bytes()].concat();
            nanoseconds_of_fix(&record)
        };
        // From a real device: 2019-01-20 13:47:24, nano 249768484.
        assert_eq!(fix(24, 249_768_484), Some(1_547_992_044_249_768_484));
        assert_eq!(fix(24, -1_000), Some(1_547_992_043_999_999_000));
        assert_eq!(fix(61, 0), None);
        assert_eq!(fix(0, -1_000_000_001), None);
        assert_eq!(nanoseconds_of_fix(&[0; 12]), None);
    }

    #[test]
    fn dates_that_do_not_exist() {
        for rest in
            [[0, 1, 0, 0, 0, 0], [13, 1, 0, 0, 0, 0], [2, 29, 0, 0, 0, 0], [1, 1, 24, 0, 0, 0], [1, 1, 0, 60, 0, 0]]
        {
            assert_eq!(nanoseconds(&record(0, 2026, rest)), None, "{rest:?}");
        }
        assert_eq!(nanoseconds(&record(0, 0, [0; 6])), None);
        assert_eq!(nanoseconds(&record(0, 65535, [1, 1, 0, 0, 0, 0])), None);
    }
}
