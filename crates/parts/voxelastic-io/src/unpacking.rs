//! How much may be made of what is stored: one rule for every decompressor and decoder of files.
//!
//! A few kilobytes can claim, and be, gigabytes. What is unpacked is limited by the size of what it is unpacked from.

/// Whatever unpacks to less is taken, bytes.
const ALWAYS: u64 = 64 << 20;
/// More than this many bytes from one are no measurements: scans shrink to a third, pictures to a hundredth at most, and both are smaller than what is always taken.
const LARGEST_RATIO: u64 = 64;
/// Nothing that is unpacked in one piece is larger, bytes.
const LARGEST: u64 = 1 << 30;
/// Memory of a point that is decoded, bytes.
const POINT: u64 = 40;

/// How many bytes may come of `stored` ones.
pub(crate) fn limit(stored: u64) -> u64 {
    stored.saturating_mul(LARGEST_RATIO).clamp(ALWAYS, LARGEST)
}

/// How many points a packed file of `stored` bytes may have: none of those that it holds take more memory than [`limit`], but a large file may have as many as it likes.
pub(crate) fn most_points(stored: u64) -> u64 {
    stored.saturating_mul(LARGEST_RATIO).max(ALWAYS) / POINT
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_unpacked_is_limited_by_what_is_stored() {
        assert_eq!([0, 1000, 2 << 20, 1 << 30].map(limit), [64 << 20, 64 << 20, 128 << 20, 1 << 30]);
        assert!(most_points(1000) == (64 << 20) / 40 && most_points(u64::MAX) > 1 << 58);
    }
}
