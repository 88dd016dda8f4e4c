//! Order, numbers and times in the names of cloud files.

use std::cmp::Ordering;

/// Compares names with the numbers in them compared as numbers: `scan2` comes before `scan10`.
pub(crate) fn natural(a: &str, b: &str) -> Ordering {
    let (mut x, mut y) = (a.as_bytes(), b.as_bytes());
    while let (Some(p), Some(q)) = (x.first(), y.first()) {
        let order = if p.is_ascii_digit() && q.is_ascii_digit() {
            let (m, n) = (take_digits(&mut x), take_digits(&mut y));
            m.len().cmp(&n.len()).then(m.cmp(n))
        } else {
            (x, y) = (&x[1..], &y[1..]);
            p.cmp(q)
        };
        if order.is_ne() {
            return order;
        }
    }
    x.len().cmp(&y.len()).then_with(|| a.cmp(b))
}

/// Cuts the leading digits off and returns them without leading zeros.
fn take_digits<'a>(text: &mut &'a [u8]) -> &'a [u8] {
    let end = text.iter().position(|b| !b.is_ascii_digit()).unwrap_or(text.len());
    let (digits, rest) = text.split_at(end);
    *text = rest;
    &digits[digits.iter().take_while(|b| **b == b'0').count()..]
}

/// The number that a file's stem ends with: 123 for `scan_000123`.
pub(crate) fn number(stem: &str) -> Option<u64> {
    let start = stem.len() - stem.bytes().rev().take_while(u8::is_ascii_digit).count();
    stem[start..].parse().ok()
}

/// The time in seconds since 1970 that a file's stem ends with: `cloud_<sec>_<nsec>`, `<sec>.<fraction>`, or a whole number of
/// seconds, milli-, micro- or nanoseconds. Smaller numbers cannot be dates and are ignored.
pub(crate) fn stamp(stem: &str) -> Option<f64> {
    let is_digits = |w: &str| !w.is_empty() && w.bytes().all(|b| b.is_ascii_digit());
    let mut words = stem.rsplit('_');
    let last = words.next()?;
    if let Some(seconds) = words.next().filter(|w| is_digits(w) && (9..=10).contains(&w.len()))
        && is_digits(last)
        && last.len() <= 9
    {
        return Some(seconds.parse::<f64>().ok()? + last.parse::<f64>().ok()? * 1e-9).filter(|t| *t >= 1e8);
    }
    let fraction = last.strip_prefix(|c: char| c.is_ascii_alphabetic()).unwrap_or(last);
    if !fraction.split('.').all(is_digits) || fraction.split('.').count() > 2 {
        return None;
    }
    let value = fraction.parse::<f64>().ok()?;
    match value {
        v if v >= 1e20 => None,
        v if v >= 1e17 => Some(v * 1e-9),
        v if v >= 1e14 => Some(v * 1e-6),
        v if v >= 1e11 => Some(v * 1e-3),
        v if v >= 1e9 => Some(v),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_names_count_as_numbers() {
        let mut names = ["scan10", "scan9", "scan09b", "a", "scan1_20", "scan1_3", "scan010"];
        names.sort_by(|a, b| natural(a, b));
        assert_eq!(names, ["a", "scan1_3", "scan1_20", "scan9", "scan09b", "scan010", "scan10"]);
    }

    #[test]
    fn numbers_and_times_are_read_from_names() {
        assert_eq!(number("scan_000123"), Some(123));
        assert_eq!(number("scan"), None);
        assert_eq!(stamp("000123"), None);
        assert_eq!(stamp("0000000123"), None);
        assert!((stamp("cloud_1583836591_82590976").unwrap() - 1_583_836_591.082_591).abs() < 1e-6);
        assert!((stamp("1583836591.182590").unwrap() - 1_583_836_591.182_59).abs() < 1e-6);
        assert!((stamp("1583836591182590976").unwrap() - 1_583_836_591.182_591).abs() < 1e-6);
        assert_eq!(stamp("1583836591182"), Some(1_583_836_591.182));
        assert_eq!(stamp("scan_1_2"), None);
        assert_eq!(stamp("1.2.3"), None);
    }
}
