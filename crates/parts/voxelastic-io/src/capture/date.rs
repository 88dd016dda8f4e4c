//! Dates in the packets of sensors.

/// Seconds since 1970 of a date and time of six bytes; 0 if it is none. Years are counted from 1900 or from 2000, by the sensor.
pub(super) fn seconds(date: &[u8]) -> f64 {
    let [year, month, day, hour, minute, second] = *date else { return 0.0 };
    let year = i64::from(year) + if year >= 100 { 1900 } else { 2000 };
    if !(1..=12).contains(&month) || !(1..=31).contains(&day) || hour > 23 || minute > 59 || second > 60 {
        return 0.0;
    }
    // Days since 1970, with years that begin in March.
    let (year, month) = if month > 2 { (year, i64::from(month) - 3) } else { (year - 1, i64::from(month) + 9) };
    let day_of_year = (153 * month + 2) / 5 + i64::from(day) - 1;
    let days = 365 * year + year.div_euclid(4) - year.div_euclid(100) + year.div_euclid(400) + day_of_year - 719_468;
    (days * 86_400 + i64::from(hour) * 3600 + i64::from(minute) * 60 + i64::from(second)) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_seconds_since_1970() {
        assert_eq!(seconds(&[70, 1, 1, 0, 0, 0]), 3_155_760_000.0, "2070");
        assert_eq!(seconds(&[100, 1, 1, 0, 0, 0]), 946_684_800.0);
        assert_eq!(seconds(&[124, 2, 29, 12, 34, 56]), 1_709_210_096.0);
        assert_eq!(seconds(&[24, 2, 29, 12, 34, 56]), 1_709_210_096.0);
        assert_eq!((seconds(&[124, 13, 1, 0, 0, 0]), seconds(&[1, 2])), (0.0, 0.0));
    }
}
